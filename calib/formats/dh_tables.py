"""DHTables: the DH rows of a robot before and after its calibration, checked against the robot's poses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calib.errors import ModelError
from calib.model.dh import dh_table, near_parallel, taken_as_parallel
from calib.model.dh_table import HAYATI, STANDARD, DHTable
from calib.model.readback import TOLERANCE, column_ranges, spread_between
from calib.model.robot import Robot, read_only, rigid_inverse

BEFORE, AFTER, CHANGE = "before", "after", "change"
"""What the tables are called; a robot without a nominal one has a single one, ``"robot"``."""

#: Joint values that poses are compared at.
_POSES = 64

#: A row's d longer than this beside nearly parallel axes is worth a remark [m].
_FAR = 2.0

_NUMBERS = ("theta", "d", "a", "alpha", "beta")


class RowJoint(NamedTuple):
    """What the value added to a row is: factor * value of the driver + offset [rad] or [m].

    The driver is the joint itself, or the one that it mimics; None where it is held.
    """

    joint: str
    prismatic: bool
    driver: str | None
    factor: float
    offset: float

    @property
    def text(self) -> str:
        """As a formula, such as ``"-2 * arm + 5 deg"``; of most joints the joint's own name."""
        unit, size = ("mm", 1e3) if self.prismatic else ("deg", 180.0 / np.pi)
        if self.driver is None:
            return f"held at {size * self.offset:.12g} {unit}"
        name = self.driver if self.factor == 1.0 else f"{self.factor:.12g} * {self.driver}"
        if self.offset == 0.0:
            return name
        return f"{name} {'-' if self.offset < 0 else '+'} {size * abs(self.offset):.12g} {unit}"


@dataclass(frozen=True, slots=True, eq=False)
class DHTables:
    """The DH rows of a robot beside those of its nominal state; both hold the poses of their robots.

    Attributes:
        robot: The robot.
        nominal: The same chain before the calibration; None where none was given.
        after: The robot's rows, their free choices as in those before.
        before: The nominal robot's rows.
        remarks: What whoever types the rows in should know, sentence by sentence.
    """

    robot: Robot
    nominal: Robot | None
    after: DHTable
    before: DHTable | None
    remarks: tuple[str, ...]

    @classmethod
    def of(cls, robot: Robot, nominal: Robot | None = None, convention: str = STANDARD) -> DHTables:
        """The rows, compared with the poses of both robots.

        Args:
            robot: The robot, such as a calibrated one.
            nominal: The same chain before the calibration.
            convention: One of `calib.model.dh_table.CONVENTIONS`.

        Raises:
            ModelError: No such convention, the robots have other joints, or the rows do not hold the robot.
        """
        after = dh_table(robot, convention, like=nominal)
        before = None if nominal is None else dh_table(nominal, convention)
        tables = cls(robot, nominal, after, before, _remarks(robot, nominal, after))
        off = tables.deviation(before, after)
        allowed = TOLERANCE + _by_parallels(robot, nominal, convention)
        if not off <= allowed:
            raise ModelError(
                f"{robot.urdf.source}: the rows in the convention '{convention}' put the tip up to {off:.1e} m or rad "
                f"away from the robot '{robot.name}'; {allowed:.1e} is allowed, so nothing is written. Choose the "
                "convention 'hayati', which has no far common normals."
            )
        return tables

    @property
    def joints(self) -> tuple[RowJoint, ...]:
        """What is added to each row."""
        return _joints(self.robot)

    def states(self) -> list[tuple[str, DHTable]]:
        """The tables that a file has, by what they are called: one, or before, after and change."""
        if self.before is None:
            return [("robot", self.after)]
        change = _change(self.before, self.after)
        return [(BEFORE, self.before), (AFTER, self.after), (CHANGE, change)]

    def deviation(self, before: DHTable | None, after: DHTable) -> float:
        """The largest difference of position [m] or of an entry of the rotation between rows and robots."""
        q = spread_between(column_ranges(self.robot), _POSES)
        values = self.robot.chain_values(q)
        off = float(np.abs(after.poses(values) - self.robot.poses(q)).max())
        if before is not None and self.nominal is not None:
            off = max(off, float(np.abs(before.poses(values) - self.nominal.poses(q)).max()))
        return off


def _by_parallels(robot: Robot, nominal: Robot | None, convention: str) -> float:
    """What taking axes as parallel may cost [m]: the angle times the arm's length, there and back."""
    if convention == HAYATI:
        return 0.0
    return max(
        2.0
        * taken_as_parallel(one)
        * float(1.0 + np.linalg.norm(one.placements[:, :3, 3], axis=1).sum())
        for one in (robot, nominal)
        if one is not None
    )


def _joints(robot: Robot) -> tuple[RowJoint, ...]:
    """What is added to each row."""
    at_zero = robot.chain_values(np.zeros(len(robot.joint_names)))[0]
    found = []
    for joint, row, offset in zip(robot.joints, robot.coupling, at_zero, strict=True):
        driven = np.flatnonzero(row)
        driver = robot.joint_names[driven[0]] if len(driven) else None
        factor = float(row[driven[0]]) if len(driven) else 0.0
        found.append(
            RowJoint(joint.name, joint.type == "prismatic", driver, factor, float(offset) + 0.0)
        )
    return tuple(found)


def _remarks(robot: Robot, nominal: Robot | None, after: DHTable) -> tuple[str, ...]:
    """What whoever types the rows in should know."""
    remarks = []
    if after.convention != HAYATI:
        pairs = near_parallel(robot)
        longest = max(abs(row.d) for row in after.rows)
        if pairs:
            named = ", ".join(
                f"'{a}' and '{b}' ({np.degrees(angle):.2g} deg)" for (a, b), angle in pairs.items()
            )
            far = f", here up to {longest:,.3g} m, and" if longest > _FAR else " and"
            remarks.append(
                f"Axes that are nearly parallel: {named}. The common normal of such axes lies anywhere: the d and "
                f"theta of their rows may be large{far} cancel over the rows. Enter every digit, and all rows "
                "together; the convention 'hayati' has no such rows."
            )
        angle = max(taken_as_parallel(one) for one in (robot, nominal) if one is not None)
        if angle > TOLERANCE:
            cost = 1e6 * _by_parallels(robot, nominal, after.convention)
            remarks.append(
                f"Axes that the URDF's rounding leaves {angle:.1e} rad out of parallel are taken as parallel, so that "
                f"the rows differ from the URDF by less than {cost:.2g} micrometres."
            )
    others = [j for j in _joints(robot) if j.text != j.joint]
    if others:
        named = ", ".join(f"'{j.joint}' ({j.text})" for j in others)
        remarks.append(f"Joints without a value of their own: {named}.")
    return tuple(remarks)


def _change(before: DHTable, after: DHTable) -> DHTable:
    """After - before; of the constant poses before^-1 after."""
    rows = tuple(
        replace(b, **{k: getattr(b, k) - getattr(a, k) for k in _NUMBERS})
        for a, b in zip(before.rows, after.rows, strict=True)
    )
    return DHTable(
        rows,
        read_only(rigid_inverse(before.T_base_0) @ after.T_base_0),
        read_only(rigid_inverse(before.T_n_tip) @ after.T_n_tip),
        after.convention,
    )
