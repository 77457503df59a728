"""DH rows of axes that were measured, in the way `calib.model.dh` finds them of a URDF.

Rows 1 to n - 1: each leads from one axis to the next. The last row leads to the tip, which no axis says anything of.
The choices that the convention leaves open (which way x points, whether two axes are nearly parallel) are those of the
nominal rows, where there are any, so that both can be compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.errors import UrdfError, choices
from calib.measure.base_frame import Line
from calib.model.dh import NEARLY_PARALLEL_RAD, DHRow, dh_frames, dh_table, zero_poses
from calib.model.robot import Robot

Array = NDArray[np.float64]

#: The numbers of a row, in the order in which they are given here.
NUMBERS = ("a", "alpha", "d", "theta", "beta")


class Nominal(NamedTuple):
    """What a URDF says of the axes, in the base at zero.

    Attributes:
        lines: The axis of each joint.
        rows: The DH rows.
        first: DH frame 0, shape (4, 4) [m].
        hints: The x axis of each row's frame, shape (3,).
    """

    lines: tuple[Line, ...]
    rows: tuple[DHRow, ...]
    first: Array
    hints: tuple[Array, ...]


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
        message = (
            f"'{robot.name}' from '{robot.base}' to '{robot.tip}': {what}; a base frame needs a chain of joints that "
            "turn one by one. Choose --base and --tip so that only such joints lie between them."
        )
        raise UrdfError(message)
    frames, _ = zero_poses(robot)
    lines = tuple(
        Line(T[:3, 3], T[:3, :3] @ np.asarray(j.axis))
        for T, j in zip(frames, robot.joints, strict=True)
    )
    table = dh_table(robot)
    hints = tuple(F[:3, 0] for F in dh_frames(table))
    return Nominal(lines, table.rows, np.asarray(table.T_base_0), hints)


def axis_rows(lines: Sequence[Line], nominal: Nominal | None = None) -> Array:
    """a, alpha, d, theta, beta of the rows from each axis to the next, shape (n - 1, 5) [m, rad].

    Args:
        lines: The axes in the base at zero, n of them.
        nominal: Those of the URDF, for the choices that are open; None: as `calib.model.dh` makes them.
    """
    first = np.eye(4) if nominal is None else nominal.first
    z = lines[0].direction
    x = _across(z, first[:3, 0])
    origin = lines[0].point + z * (z @ (first[:3, 3] - lines[0].point))
    rows = []
    for i, (point, axis) in enumerate(lines[1:]):
        hint = x if nominal is None else nominal.hints[i]
        cross = np.cross(z, axis)
        parallel = (
            bool(np.linalg.norm(cross) < np.sin(NEARLY_PARALLEL_RAD))
            if nominal is None
            else nominal.rows[i].near_parallel
        )
        following = _parallel if parallel else _crossing
        row, origin, normal = following(origin, z, point, axis, hint)
        theta = np.arctan2(np.cross(x, normal) @ z, x @ normal)
        rows.append((*row[:3], theta, row[3]))
        z, x = axis, _across(axis, normal)
    return np.array(rows).reshape(-1, 5)


def _crossing(
    origin: Array, z: Array, point: Array, axis: Array, hint: Array
) -> tuple[tuple[float, float, float, float], Array, Array]:
    """a, alpha, d, beta to an axis that is not parallel, its origin, and the common normal x."""
    normal = np.cross(z, axis)
    normal = normal / np.linalg.norm(normal)
    if normal @ hint < 0.0:
        normal = -normal
    # Feet of the common normal: origin + d z + a normal = point + s axis.
    d, a, s = np.linalg.solve(np.stack([z, normal, -axis], axis=1), point - origin)
    alpha = float(np.arctan2(np.cross(z, axis) @ normal, z @ axis))
    return (float(a), alpha, float(d), 0.0), point + s * axis, normal


def _parallel(
    origin: Array, z: Array, point: Array, axis: Array, hint: Array
) -> tuple[tuple[float, float, float, float], Array, Array]:
    """The same to an axis that is nearly parallel: d = 0, and beta."""
    met = point + axis * ((origin - point) @ z) / (axis @ z)
    offset = met - origin
    normal = _across(z, offset if np.linalg.norm(offset) > 1e-9 else hint)
    if normal @ hint < 0.0:
        normal = -normal
    y = np.cross(z, normal)
    beta = float(np.arcsin(np.clip(axis @ normal, -1.0, 1.0)))
    alpha = float(np.arctan2(-(axis @ y), axis @ z))
    # Behind a tilt about its own y, x is no longer the normal but the nearest direction across the axis.
    return (float(offset @ normal), alpha, 0.0, beta), met, normal


def _across(z: Array, near: Array) -> Array:
    """The unit vector across z nearest to another one."""
    across = near - z * (z @ near)
    return np.asarray(across / np.linalg.norm(across))
