"""The description of a robot by DH rows: the rows, the coupling of its joints' readings, and its names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from calib.basics.arrays import Array
from calib.basics.values import ReadOnlyMapping, Value
from calib.errors import ModelError, choices, did_you_mean
from calib.robot.dh.rows import CONVENTIONS, HAYATI, DHRow, DHTable

BASE = "base"
"""Link before the first row, if the rows do not name it."""

TIP = "flange"
"""Link after the last row, if the rows do not name it."""

#: Signs that a joint's value may have in a row.
_DIRECTIONS = (1, -1)

#: Factors of the readings of other joints, by the joint whose value they change and by their own names.
Coupling = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, slots=True, eq=False)
class DHRobot(Value):
    """A robot that is described by DH rows.

    The value of a joint is its reading, plus the readings of other joints times the factors of `coupling`:
    value_i = reading_i + sum_j coupling_ij reading_j. Its row then adds direction value + offset.
    """

    #: The rows, base to tip, with the constant poses before the first and after the last.
    table: DHTable
    #: Name of the robot.
    name: str = "robot"
    #: Link in whose frame poses are given.
    base: str = BASE
    #: Link whose pose is given.
    tip: str = TIP
    #: Factors of the readings of other joints, by joint; joints that are not coupled are left out.
    coupling: Coupling = field(default_factory=ReadOnlyMapping)

    def __post_init__(self) -> None:
        """Check that rows, names and coupling make a robot, and keep a read-only copy of the coupling."""
        entries = {joint: ReadOnlyMapping(factors) for joint, factors in self.coupling.items()}
        object.__setattr__(self, "coupling", ReadOnlyMapping(entries))
        rows = self.table.rows
        if not rows:
            raise ModelError("There are no DH rows; one for each joint is wanted, base to tip.")
        if self.table.convention not in CONVENTIONS:
            raise ModelError(
                f"'{self.table.convention}' is not a convention of DH rows; it must be one of {choices(CONVENTIONS)}."
            )
        for row, fault in _faults(rows, self.table.convention):
            raise ModelError(f"The DH row of the joint '{row.joint}' {fault}.")
        for joint, factors in self.coupling.items():
            coupled = coupling_fault(joint, factors, self.joint_names)
            if coupled:
                raise ModelError(f"The coupling of the joint '{joint}' {coupled}.")
        links = link_names(self)
        for link in (self.base, self.tip):
            if not link or links.count(link) > 1:
                raise ModelError(
                    f"A robot of DH rows has the links {choices(links, 20)}; '{link}' is empty or there twice. Name "
                    "base and tip otherwise."
                )

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The names of the joints, base to tip."""
        return tuple(row.joint for row in self.table.rows)

    def values(self, readings: ArrayLike) -> Array:
        """Return the values of the joints, shape (N, n), [rad] or [m].

        Args:
            readings: What the controller shows, shape (N, n) or (n,), [rad] or [m].
        """
        shown = np.atleast_2d(np.asarray(readings, dtype=np.float64))
        names = self.joint_names
        result: Array = shown.copy()
        for joint, factors in self.coupling.items():
            for other, factor in factors.items():
                result[:, names.index(joint)] += factor * shown[:, names.index(other)]
        return result

    def poses(self, readings: ArrayLike) -> Array:
        """Return T_base_tip, the product of the rows, shape (N, 4, 4), [m].

        Args:
            readings: What the controller shows, shape (N, n) or (n,), [rad] or [m].
        """
        return self.table.poses(self.values(readings))


def link_names(robot: DHRobot) -> list[str]:
    """Return the names of the n + 2 links: base, one after each joint, tip."""
    links = [f"link_{i + 1}" for i in range(len(robot.table.rows))]
    return [robot.base, *links, robot.tip]


def coupling_fault(joint: str, factors: Mapping[str, float], names: Iterable[str]) -> str | None:
    """Return what is wrong with the coupling of a joint, as text after its name; None if nothing is.

    Args:
        joint: The joint whose value follows other readings.
        factors: Their factors by name.
        names: The joints of the robot.
    """
    names = list(names)
    for name in (joint, *factors):
        if name not in names:
            return (
                f"names '{name}', which is not a joint{did_you_mean(name, names)}; the joints are "
                f"{choices(names)}"
            )
    if joint in factors:
        return "names the joint itself; its own reading has the factor 1"
    if not np.isfinite(list(factors.values())).all():
        return "has a factor that is not finite"
    return None


def row_fault(row: DHRow, convention: str) -> str | None:
    """Return what is wrong with a row, as text after ``The DH row of the joint 'NAME'``; None if nothing is.

    Args:
        row: The row.
        convention: One of `calib.robot.dh.rows.CONVENTIONS`.
    """
    numbers = (row.theta, row.d, row.a, row.alpha, row.beta, row.offset)
    limits = [limit for limit in (row.lower, row.upper) if limit is not None]
    if not np.isfinite([*numbers, *limits]).all():
        return "has a number that is not finite"
    if row.direction not in _DIRECTIONS:
        return f"has the direction {row.direction}; it must be 1 or -1"
    if row.beta and convention != HAYATI:
        return f"has a beta, which the convention '{convention}' has not; only 'hayati' has"
    if len(limits) == 1:
        return "has one limit; give lower and upper, or neither"
    if row.prismatic and not limits:
        return "slides and has no limits; give lower and upper"
    if limits and not limits[0] < limits[1]:
        unit, to_si = ("mm", 1e-3) if row.prismatic else ("deg", np.pi / 180.0)
        lower, upper = (f"{limit / to_si:g} {unit}" for limit in limits)
        return f"has the limits {lower} to {upper}; lower must be less than upper"
    return None


def _faults(rows: Iterable[DHRow], convention: str) -> Iterable[tuple[DHRow, str]]:
    """Yield rows with what is wrong with their names and numbers."""
    seen = set()
    for row in rows:
        if not row.joint:
            yield row, "has no name"
        if row.joint in seen:
            yield row, "has a name that another row has, too; rename one"
        seen.add(row.joint)
        fault = row_fault(row, convention)
        if fault:
            yield row, fault
