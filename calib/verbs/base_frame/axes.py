"""Axes of joints and the mounting plane as lines: the frame that they make, and the propagation of their uncertainty.

The frame of the axes A is the base frame of the paper (section 4.2): the origin is where axis 1 meets the plane, z is
along axis 1, y along axis 2 made perpendicular to it; both axes point so that the joints' positive sense turns about
them:

    o = c_1 + s n_1,  n_P . (o - p) = 0;     z = n_1;     y ~ n_2 - (n_2 . z) z

The covariances of plane and circles are propagated through such equations by central differences.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array
from calib.errors import CalibError, UrdfError
from calib.model.dh_table import zero_poses
from calib.robot.robot import Robot
from calib.verbs.base_frame.circles import Circle, Plane

#: Axis 1 at a smaller angle than this to the plane does not meet it anywhere near [rad].
SLANT_RAD = float(np.radians(30.0))

#: Axes 1 and 2 closer than this to parallel do not determine y [rad].
PARALLEL_RAD = float(np.radians(5.0))

#: Step of the central differences [m, rad]: all of it is smooth over centimetres.
_STEP = 3e-6


class Line(NamedTuple):
    """Axis, or plane with its normal."""

    #: Shape (3,), on it [m]
    point: Array
    #: Shape (3,), unit vector
    direction: Array

    def seen_from(self, T: Array) -> Line:
        """Return the line in another frame, by the pose T (4, 4) of its own frame there [m]."""
        R = T[:3, :3]
        return Line(R @ self.point + T[:3, 3], R @ self.direction)


def nominal_axes(robot: Robot) -> tuple[Line, ...]:
    """Return the axes in the base of a robot with revolute joints only, at zero.

    Args:
        robot: The robot.

    Returns:
        The axis of each joint, a point [m] and the direction of positive turns, base to tip.

    Raises:
        UrdfError: A joint slides, is held, follows another or has a coupled reading, or the base moves.
    """
    n = len(robot.joints)
    none_slides = all(joint.type != "prismatic" for joint in robot.joints)
    none_held = all(joint.name in robot.joint_names for joint in robot.joints)
    all_turn = none_slides and none_held
    independent = np.array_equal(robot.mimic_matrix, np.eye(n)) and not robot.reading_coupling
    if not all_turn or not independent or robot.base_moves:
        raise UrdfError(
            f"'{robot.name}' from '{robot.base}' to '{robot.tip}': a base frame needs a chain of joints that turn one "
            "by one, none of them sliding, held, following another or with a coupled reading. Choose --base and --tip "
            "so that only such joints lie between them."
        )
    T_base_joint, _ = zero_poses(robot)
    axes = []
    for T, joint in zip(T_base_joint, robot.joints, strict=True):
        axes.append(Line(T[:3, 3], T[:3, :3] @ np.asarray(joint.axis)))
    return tuple(axes)


def measured_lines(plane: Plane, *circles: Circle, plane_offset: float) -> list[Line]:
    """Return the mounting plane, which is below the measured one, away from the first circle, and the circles' axes.

    All are in the tracker's frame.

    Args:
        plane: The measured plane.
        circles: Of the joints, base to tip.
        plane_offset: Distance of the measured plane from the mounting plane [m].

    Raises:
        CalibError: The first circle is so near to the plane that it does not show on which side the robot stands.
    """
    height = float(plane.normal @ (circles[0].point - plane.point))
    if plane_offset and abs(height) < 2.0 * abs(plane_offset):
        raise CalibError(
            f"the circle of joint 1 lies {1e3 * abs(height):.3g} mm from the measured plane: that is too near to show "
            f"on which side the robot stands, which an offset of {1e3 * plane_offset:.6g} mm requires. Fix the target "
            "higher up"
        )
    up = np.sign(height)
    mounting = Line(plane.point - up * plane_offset * plane.normal, plane.normal)
    return [mounting, *(Line(circle.point, circle.normal) for circle in circles)]


def axes_frame(plane: Line, first: Line, second: Line) -> Array:
    """Compute the pose of the frame of the axes, T_tracker_A, shape (4, 4) [m].

    Its origin is where axis 1 meets the plane, z is along axis 1, and y along axis 2 made perpendicular to z.

    Args:
        plane: The mounting plane, in the tracker's frame.
        first: Axis 1 in that frame, in the positive sense of its joint.
        second: Axis 2, likewise.

    Raises:
        CalibError: Axis 1 is too flat to the plane, or the axes are parallel.
    """
    z, n2 = first.direction, second.direction
    slope = float(plane.direction @ z)
    if abs(slope) < np.sin(SLANT_RAD):
        raise CalibError(
            f"axis 1 is at {np.degrees(np.arcsin(abs(slope))):.3g} deg to the plane, but should be upright on it: one "
            "of the two is not what its name says. Check which joint was turned and which surface was touched"
        )
    y = n2 - (n2 @ z) * z
    across = float(np.linalg.norm(y))
    if across < np.sin(PARALLEL_RAD):
        raise CalibError(
            f"the axes of joints 1 and 2 are parallel within {np.degrees(np.arcsin(across)):.2f} deg, so they do not "
            "determine y. Check that the second sweep is of joint 2"
        )
    y = y / across
    T = np.eye(4)
    T[:3, :3] = np.stack([np.cross(y, z), y, z], axis=1)
    T[:3, 3] = first.point + z * (plane.direction @ (plane.point - first.point)) / slope
    return T


def nominal_axes_frame(axes: Sequence[Line]) -> Array:
    """Compute T_base_A of nominal axes 1 and 2 at zero, (4, 4) [m]; the mounting plane is z = 0 of the base."""
    return axes_frame(Line(np.zeros(3), np.array([0.0, 0.0, 1.0])), *axes[:2])


def turn_to_zero(axes: Sequence[Line], values: Sequence[Array]) -> list[Line]:
    """Turn axes back to where they are with all joints at zero.

        axis_k(0) = exp(-S_(k-1) q_(k-1)) ... exp(-S_1 q_1) axis_k(q),   S_j: the screw of axis_j(0)

    Args:
        axes: In any frame, each as it was during its sweep.
        values: Mean joint values of each sweep, [rad]; empty: all were at zero.

    Returns:
        The axes at zero, in the same frame.
    """
    at_zero: list[Line] = []
    for k, (point, direction) in enumerate(axes):
        joint_values = values[k] if values else ()
        # The joints before this one, whose axes are at zero already, in their order.
        for axis, q in zip(at_zero, joint_values, strict=False):
            R = Rotation.from_rotvec(-q * axis.direction).as_matrix()
            point = axis.point + R @ (point - axis.point)
            direction = R @ direction
        at_zero.append(Line(point, direction))
    return at_zero


def between(first: Line, second: Line) -> tuple[float, float]:
    """Compute angle and shortest distance of two axes.

    Args:
        first: An axis.
        second: Another.

    Returns:
        Angle in [0, pi] [rad], and distance, positive along n_1 x n_2, or that between parallel axes [m].
    """
    cross = np.cross(first.direction, second.direction)
    sine = float(np.linalg.norm(cross))
    angle = float(np.arctan2(sine, first.direction @ second.direction))
    displacement = second.point - first.point
    if sine < np.sin(PARALLEL_RAD):
        return angle, float(np.linalg.norm(np.cross(displacement, first.direction)))
    return angle, float(displacement @ cross) / sine


def propagate(
    result: Callable[[Sequence[Line]], Array], lines: Sequence[Line], figures: Sequence[Plane]
) -> list[Array]:
    """Propagate the covariances of plane and circles to a result, D C D^T with central differences D.

    Args:
        result: Of mounting plane and axes, shape (k,).
        lines: Mounting plane and axes.
        figures: Plane and circles, in the same order.

    Returns:
        The contribution of each figure to the covariance of the result, shape (k, k).
    """
    parts = []
    for i, figure in enumerate(figures):
        # In the order of its covariance: shifts along the normal of a plane, along u, v, normal of a circle; then tilts
        # of the direction towards u and v. The radius of a circle, which is last, does not move its axis.
        along = figure.basis if isinstance(figure, Circle) else figure.basis[:, 2:]
        moves = [(column, np.zeros(3)) for column in along.T]
        moves += [(np.zeros(3), column) for column in figure.basis[:, :2].T]
        columns = []
        for shift, tilt in moves:
            ahead = result(_displace(lines, i, _STEP * shift, _STEP * tilt))
            back = result(_displace(lines, i, -_STEP * shift, -_STEP * tilt))
            columns.append((ahead - back) / (2.0 * _STEP))
        D = np.column_stack(columns)
        covariance = figure.covariance[: len(columns), : len(columns)]
        parts.append(D @ covariance @ D.T)
    return parts


def _displace(lines: Sequence[Line], i: int, shift: Array, tilt: Array) -> list[Line]:
    """Return the lines with one of them displaced by a shift (3,) [m] and a tilt of its direction (3,) [rad]."""
    direction = lines[i].direction + tilt
    line = Line(lines[i].point + shift, direction / np.linalg.norm(direction))
    return [*lines[:i], line, *lines[i + 1 :]]
