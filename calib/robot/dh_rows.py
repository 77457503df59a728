"""DH rows of a robot, in the conventions that controllers take: standard, modified, Hayati.

    standard   T_base_tip = T_base_0  A_1 ... A_n  T_n_tip,   A_i = Rz(theta_i + q_i) Tz(d_i) Tx(a_i) Rx(alpha_i)
    hayati     the same with A_i Ry(beta_i): 0 except between nearly parallel axes, where d_i = 0
    modified   M_i = Rx(alpha_(i-1)) Tx(a_(i-1)) Rz(theta_i + q_i) Tz(d_i)   (Craig), with a_0 = alpha_0 = 0

(a prismatic joint adds q_i to d_i instead). What is added may be direction q_i + offset, if a controller counts in the
opposite sense or from another zero. Standard and modified rows are the same product of the same common normals, grouped
differently, and they are exact: the common normal of nearly parallel axes may be kilometres away, and d is then as
long. Hayati's rows, which the error model is built on, have no distant normals: in a nearly parallel row, except the
last, beta_i tilts the axis (S. Hayati, 1983).

Choices that the convention leaves open are made as a data sheet does: frame 0 is the base frame if it can be, x_i
points as near as possible to x_(i-1) at q = 0, frame n is the tip if it can be. To compare two robots, `dh_table` makes
the choices of the other robot, and leaves what comes after the last axis to T_n_tip alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from calib.basics.arrays import Array
from calib.basics.values import ReadOnlyMapping, Value
from calib.errors import ModelError, choices, did_you_mean

#: The convention of Denavit and Hartenberg; see the module's text.
STANDARD = "standard"

#: The convention of Craig.
MODIFIED = "modified"

#: The convention of Hayati, with a rotation beta between nearly parallel axes.
HAYATI = "hayati"

CONVENTIONS = (STANDARD, MODIFIED, HAYATI)
"""The conventions; see the module's text."""

EQUATIONS = {
    STANDARD: "A_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i)",
    MODIFIED: "M_i = Rx(alpha_(i-1)) Tx(a_(i-1)) Rz(theta_i) Tz(d_i)",
    HAYATI: "A_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i)",
}
"""The transform that a row states, for each convention."""

NEARLY_PARALLEL_RAD = np.radians(3.0)
"""Axes closer to parallel than this get a Hayati row [rad]; a real arm's parallel axes differ by a few mrad."""


BASE = "base"
"""Link before the first row, if the rows do not name it."""

TIP = "flange"
"""Link after the last row, if the rows do not name it."""

#: Signs that a joint's value may have in a row.
_DIRECTIONS = (1, -1)

#: Factors of the readings of other joints, by the joint whose value they change and by their own names.
Coupling = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, slots=True)
class DHRow:
    """One DH row of a robot; lengths [m], angles [rad].

    Example:
        >>> DHRow("A1", d=0.4, a=0.025, alpha=-1.5707963267948966, direction=-1).matrix()[:3, 3].tolist()
        [0.025, 0.0, 0.4]
    """

    #: The joint whose value is added.
    joint: str
    #: True if it is added to d instead of theta.
    prismatic: bool = False
    #: About z.
    theta: float = 0.0
    #: Along z.
    d: float = 0.0
    #: Along x: a_i, or a_(i-1) in the modified convention.
    a: float = 0.0
    #: About x: alpha_i, or alpha_(i-1) in the modified convention.
    alpha: float = 0.0
    #: About y, Hayati's; 0 in the others.
    beta: float = 0.0
    #: 1 or -1: the factor of the joint's value.
    direction: int = 1
    #: Added to direction times the joint's value [rad], or [m] if it slides.
    offset: float = 0.0
    #: Least value of the joint, without direction and offset [rad or m]; None: not known, or it turns without end.
    lower: float | None = None
    #: Largest value of the joint, without direction and offset [rad or m]; None if ``lower`` is.
    upper: float | None = None
    #: Line of the table that the row was read from, for messages; 0: of no table.
    line: int = field(default=0, repr=False, compare=False)

    @property
    def near_parallel(self) -> bool:
        """True if the row's axes are nearly parallel; Hayati's rows, except the last, then have a beta and d = 0."""
        sine = np.hypot(np.sin(self.alpha), np.cos(self.alpha) * np.sin(self.beta))
        return bool(sine < np.sin(NEARLY_PARALLEL_RAD))

    def matrix(self, q: ArrayLike = 0.0, *, modified: bool = False) -> Array:
        """Return the transform of the row at joint values: A_i, or M_i of the modified convention.

        Args:
            q: One value of the row's joint or N of them, [rad] or [m].
            modified: True if the row is of the modified convention.

        Returns:
            Shape (4, 4) or (N, 4, 4), [m].
        """
        values = self.direction * np.asarray(q, dtype=np.float64) + self.offset
        turn: float | Array = 0.0
        slide: float | Array = 0.0
        if self.prismatic:
            slide = values
        else:
            turn = values
        along_x = screw(0, self.alpha, self.a)
        along_z = screw(2, self.theta + turn, self.d + slide)
        if modified:
            return np.asarray(along_x @ along_z)
        return np.asarray(along_z @ along_x @ screw(1, self.beta, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class DHTable:
    """The rows of a chain, with the constant poses before the first and after the last."""

    #: One for each moving joint, base to tip.
    rows: tuple[DHRow, ...]
    #: Shape (4, 4), [m], pose of frame 0 in the base.
    T_base_0: Array
    #: Shape (4, 4), [m], pose of the tip in frame n.
    T_n_tip: Array
    #: One of `CONVENTIONS`.
    convention: str = HAYATI

    def poses(self, values: ArrayLike) -> Array:
        """Return T_base_tip from the rows alone.

        Args:
            values: Shape (N, n) or (n,), values of the chain's joints as of `Robot.chain_values`, [rad] or [m].

        Returns:
            Shape (N, 4, 4), [m].
        """
        q = np.atleast_2d(np.asarray(values, dtype=np.float64))
        T = np.tile(self.T_base_0, (len(q), 1, 1))
        for row, column in zip(self.rows, q.T, strict=True):
            T = T @ row.matrix(column, modified=self.convention == MODIFIED)
        return np.asarray(T @ self.T_n_tip)


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
        """Raise ModelError unless rows, names and coupling make a robot, and keep a read-only copy of the coupling."""
        entries = {joint: ReadOnlyMapping(factors) for joint, factors in self.coupling.items()}
        object.__setattr__(self, "coupling", ReadOnlyMapping(entries))
        rows = self.table.rows
        if not rows:
            raise ModelError("There are no DH rows; one for each joint is wanted, base to tip.")
        if self.table.convention not in CONVENTIONS:
            raise ModelError(
                f"'{self.table.convention}' is not a convention of DH rows; it must be one of {choices(CONVENTIONS)}."
            )
        names: set[str] = set()
        for row in rows:
            fault = row_fault(row, self.table.convention)
            if row.joint in names:
                fault = "has a name that another row has, too; rename one"
            if not row.joint:
                fault = "has no name"
            if fault:
                raise ModelError(f"The DH row of the joint '{row.joint}' {fault}.")
            names.add(row.joint)
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
        convention: One of `CONVENTIONS`.
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


def dh_frames(table: DHTable) -> list[Array]:
    """Return the frame after each row, before its rotation by beta, at q = 0.

    Args:
        table: Standard or Hayati rows.

    Returns:
        n poses in the base, each of shape (4, 4), [m].
    """
    T = table.T_base_0
    frames = []
    for row in table.rows:
        frames.append(T @ replace(row, beta=0.0).matrix())
        T = T @ row.matrix()
    return frames


def screw(axis: int, angle: ArrayLike, length: ArrayLike) -> Array:
    """Return a rotation about, and translation along, a coordinate axis.

    Args:
        axis: 0, 1 or 2 for x, y, z.
        angle: One angle or N of them [rad].
        length: One length or N of them [m].

    Returns:
        Shape (4, 4) or (N, 4, 4), [m].
    """
    angle, length = np.broadcast_arrays(np.asarray(angle, float), np.asarray(length, float))
    i = (axis + 1) % 3
    j = (axis + 2) % 3
    T = np.zeros((*angle.shape, 4, 4))
    T[..., axis, axis] = T[..., 3, 3] = 1.0
    T[..., i, i] = T[..., j, j] = np.cos(angle)
    T[..., j, i] = np.sin(angle)
    T[..., i, j] = -T[..., j, i]
    T[..., axis, 3] = length
    return T
