"""The axes of joints as lines: those of a URDF, and the DH rows from each measured axis to the next."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.errors import UrdfError, choices
from calib.model.dh import DHRow, DHTable, dh_table, rows_between, zero_poses
from calib.model.robot import Robot

Array = NDArray[np.float64]

#: The numbers of a row, in the order in which they are given here.
NUMBERS = ("a", "alpha", "d", "theta", "beta")

#: Axes that stand to each other at less than this have their common normal anywhere [rad].
_PARALLEL_RAD = float(np.radians(5.0))


class Line(NamedTuple):
    """A point (3,) [m] and a unit vector (3,): an axis, or a plane and its normal."""

    point: Array
    direction: Array

    def moved(self, T: Array) -> Line:
        """The same line seen from another frame, by the pose of its own there."""
        return Line(T[:3, :3] @ self.point + T[:3, 3], T[:3, :3] @ self.direction)


class Nominal(NamedTuple):
    """What a URDF says of the axes, in the base at zero: the line of each joint, and the DH rows (Hayati's)."""

    lines: tuple[Line, ...]
    table: DHTable

    @property
    def rows(self) -> Array:
        """The numbers of the rows, shape (n, 5) [m, rad]."""
        return _numbers(self.table.rows)


def nominal_axes(robot: Robot) -> Nominal:
    """The axes of a robot of which each joint turns and has a column of its own.

    Raises:
        UrdfError: A joint slides, is held or follows another one, or joints move the base.
    """
    n = len(robot.joints)
    sliding = [joint.name for joint in robot.joints if joint.type == "prismatic"]
    free = robot.coupling.shape == (n, n) and np.array_equal(robot.coupling, np.eye(n))
    if sliding or not free or robot.base_moves:
        held = [j.name for j in robot.joints if j.name not in robot.joint_names]
        what = (
            f"the joints {choices(sliding)} slide"
            if sliding
            else f"the joints {choices(held)} are held or follow others"
            if held
            else f"joints move the base '{robot.base}' itself, or follow each other"
        )
        raise UrdfError(
            f"'{robot.name}' from '{robot.base}' to '{robot.tip}': {what}; a base frame needs a chain of joints that "
            "turn one by one. Choose --base and --tip so that only such joints lie between them."
        )
    frames, _ = zero_poses(robot)
    lines = tuple(
        Line(T[:3, 3], T[:3, :3] @ np.asarray(j.axis))
        for T, j in zip(frames, robot.joints, strict=True)
    )
    return Nominal(lines, dh_table(robot))


def axis_rows(lines: Sequence[Line], nominal: Nominal | None = None) -> Array:
    """a, alpha, d, theta, beta of the rows from each axis to the next, shape (n - 1, 5) [m, rad].

    The last row of a robot leads to its tip, which no axis says anything of.

    Args:
        lines: The axes in the base at zero, n of them.
        nominal: Those of the URDF, for the choices that the convention leaves open.
    """
    return _numbers(rows_between(lines, None if nominal is None else nominal.table))


def _numbers(rows: Sequence[DHRow]) -> Array:
    """The numbers of rows, shape (rows, 5) [m, rad]."""
    return np.array([[getattr(row, name) for name in NUMBERS] for row in rows]).reshape(-1, 5)


def between(first: Line, second: Line) -> tuple[float, float]:
    """The angle between two axes, in [0, pi], and their shortest distance [rad, m]."""
    cross = np.cross(first.direction, second.direction)
    sine = float(np.linalg.norm(cross))
    angle = float(np.arctan2(sine, first.direction @ second.direction))
    apart = second.point - first.point
    if sine < np.sin(_PARALLEL_RAD):
        return angle, float(np.linalg.norm(np.cross(apart, first.direction)))
    return angle, float(abs(apart @ cross) / sine)
