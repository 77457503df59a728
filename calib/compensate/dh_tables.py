"""DHTables: the DH rows of a robot before and after its calibration, checked against the robot's poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.errors import ModelError
from calib.model.dh_conventions import HAYATI, STANDARD, DHRows
from calib.model.dh_rows import dh_rows, near_parallel, taken_as_parallel
from calib.model.readback import TOLERANCE, column_ranges, spread_between
from calib.model.robot import Robot

Array = NDArray[np.float64]

#: Joint values that poses are compared at.
_POSES = 64

#: A row's d longer than this beside nearly parallel axes is worth a remark [m].
_FAR = 2.0


@dataclass(frozen=True, slots=True)
class RowJoint:
    """What the value added to a row is: factor * value of the driver + offset.

    Attributes:
        joint: The row's joint.
        prismatic: Whether it slides.
        driver: The joint whose value is read: itself, or the one that it mimics; None where it is held.
        factor: See above.
        offset: See above, [rad] or [m].
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
    """The DH rows of a robot, and of what it was before.

    Attributes:
        name: The robot's name.
        base: Link that the rows begin at.
        tip: Link that they end at.
        joints: What is added to each row.
        before: The nominal robot's rows; None where no nominal robot was given.
        after: The robot's rows, their free choices as in those before.
        values: shape (N, n), values of the rows' joints [rad or m] at which the rows were compared with the robots.
        poses_before: shape (N, 4, 4), the nominal robot's poses there [m].
        poses_after: shape (N, 4, 4), the robot's poses there [m].
        allowed: What rows may differ from the robot by [m and rad]: 1e-9, and more where axes that the URDF's
            rounding leaves out of parallel are taken as parallel.
        remarks: What whoever types the rows in should know, sentence by sentence.
    """

    name: str
    base: str
    tip: str
    joints: tuple[RowJoint, ...]
    before: DHRows | None
    after: DHRows
    values: Array
    poses_before: Array
    poses_after: Array
    allowed: float
    remarks: tuple[str, ...]

    @property
    def convention(self) -> str:
        """One of `calib.model.dh_conventions.CONVENTIONS`."""
        return self.after.convention

    def check(self, before: DHRows | None, after: DHRows, where: str) -> None:
        """Compare rows, such as a file's, with the robots.

        Args:
            before: Rows of the nominal robot; None where there are none.
            after: Rows of the robot.
            where: What the message begins with.

        Raises:
            ModelError: They put the tip elsewhere.
        """
        off = deviation(after, self.values, self.poses_after)
        if before is not None:
            off = max(off, deviation(before, self.values, self.poses_before))
        if not off <= self.allowed:
            message = (
                f"{where}: the rows in the convention '{self.convention}' put the tip up to {off:.1e} m or rad away "
                f"from the robot '{self.name}'; {self.allowed:.1e} is allowed, so nothing is written. Choose the "
                "convention 'hayati', which has no far common normals."
            )
            raise ModelError(message)


def dh_tables(robot: Robot, nominal: Robot | None = None, convention: str = STANDARD) -> DHTables:
    """The DH rows of a robot beside those of its nominal state, compared with the poses of both.

    Args:
        robot: The robot, such as a calibrated one.
        nominal: The same chain before the calibration.
        convention: One of `calib.model.dh_conventions.CONVENTIONS`.

    Raises:
        ModelError: No such convention, the robots have other joints, or the rows do not hold the robot.
    """
    after = dh_rows(robot, convention, like=nominal)
    q = spread_between(column_ranges(robot), _POSES)
    values = robot.chain_values(q)
    poses = robot.poses(q)
    states = [robot] if nominal is None else [robot, nominal]
    tables = DHTables(
        name=robot.name,
        base=robot.base,
        tip=robot.tip,
        joints=_joints(robot),
        before=None if nominal is None else dh_rows(nominal, convention),
        after=after,
        values=values,
        poses_before=poses if nominal is None else nominal.poses(q),
        poses_after=poses,
        allowed=TOLERANCE + _by_parallels(states, convention),
        remarks=_remarks(robot, after, states),
    )
    tables.check(tables.before, after, f"{robot.urdf.source}")
    return tables


def deviation(rows: DHRows, values: Array, poses: Array) -> float:
    """The largest difference of position [m] or of an entry of the rotation between rows and poses."""
    return float(np.abs(rows.poses(values) - poses).max())


def _by_parallels(robots: list[Robot], convention: str) -> float:
    """What taking axes as parallel may cost [m]: the angle times the arm's length, there and back."""
    if convention == HAYATI:
        return 0.0
    return max(
        2.0
        * taken_as_parallel(robot)
        * float(1.0 + np.linalg.norm(robot.placements[:, :3, 3], axis=1).sum())
        for robot in robots
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


def _remarks(robot: Robot, after: DHRows, states: list[Robot]) -> tuple[str, ...]:
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
        angle = max(map(taken_as_parallel, states))
        if angle > TOLERANCE:
            remarks.append(
                f"Axes that the URDF's rounding leaves {angle:.1e} rad out of parallel are taken as parallel, so that "
                "the rows differ from the URDF by less than "
                f"{1e6 * _by_parallels(states, after.convention):.2g} micrometres."
            )
    others = [j for j in _joints(robot) if j.text != j.joint]
    if others:
        named = ", ".join(f"'{j.joint}' ({j.text})" for j in others)
        remarks.append(f"Joints without a value of their own: {named}.")
    return tuple(remarks)
