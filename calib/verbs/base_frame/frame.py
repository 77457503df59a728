"""Base frame from the mounting plane and the axes of joints 1 and 2, with its uncertainty.

The base frame is as in the paper (section 4.2): the origin is where axis 1 meets the plane, z is along axis 1, y along
axis 2 made perpendicular to it; both axes point so that the joints' positive sense turns about them. That is the frame
A:

    o = c_1 + s n_1,  n_P . (o - p) = 0;     z = n_1;     y ~ n_2 - (n_2 . z) z

With a robot the result is the URDF's own base frame, in which the nominal axes 1 and 2 and the plane z = 0 are known:
T_tracker_base = T_tracker_A T_base_A^-1.

Uncertainty: the covariances C_k of plane and circles through the derivatives of these equations (central differences).
The noise is estimated from the residuals, each figure for itself with dof_k degrees of freedom, so that an interval of
one component is that of Student's t with (B. Welch, 1947; F. Satterthwaite, 1946)

    1 / dof = sum_k (var_k / var)^2 / dof_k,     var = sum_k var_k
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.basics.values import Value
from calib.errors import CalibError, UrdfError
from calib.model.dh_table import zero_poses
from calib.robot.robot import Robot
from calib.verbs.base_frame.fits import Circle, Plane

#: Axis 1 at a smaller angle than this to the plane does not meet it anywhere near [rad].
SLANT_RAD = float(np.radians(30.0))

#: Axes 1 and 2 closer than this to parallel do not determine y [rad].
PARALLEL_RAD = float(np.radians(5.0))

#: Step of the central differences that uncertainty is propagated with [m, rad]: all of it is smooth over centimetres.
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
    """Return the axes in the base of a robot whose joints turn, at zero.

    Args:
        robot: The robot.

    Returns:
        One for each joint, [m].

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


@dataclass(frozen=True, slots=True, eq=False)
class BaseFrame(Value):
    """Base frame and its uncertainty."""

    #: Pose of the base in the tracker's frame, shape (4, 4) [m]
    T_tracker_base: Array
    #: Of the twist xi (displacement [m], rotation [rad], in the base's axes) in T_tracker_base exp(xi), shape (6, 6)
    covariance: Array
    #: Degrees of freedom of each component's variance, shape (6,); infinite where the noise was given
    dof: Array

    @property
    def T_base_tracker(self) -> Array:
        """Pose of the tracker in the base, shape (4, 4) [m]."""
        return rigid_inverse(self.T_tracker_base)

    @property
    def std(self) -> Array:
        """Standard deviations of the twist, shape (6,) [m, rad], in the base's axes."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def within(self, share: float = 0.95) -> Array:
        """Return the half width of the interval of each component of the twist, shape (6,) [m, rad].

        Args:
            share: Probability that it lies inside.
        """
        dof = np.minimum(self.dof, 1e9)
        quantile = stdtrit(dof, 0.5 + 0.5 * share)
        return np.asarray(quantile * self.std)


def frame_of(
    plane: Plane,
    first: Circle,
    second: Circle,
    *,
    plane_offset: float = 0.0,
    T_axes_base: Array | None = None,
) -> BaseFrame:
    """Compute the base frame and its covariance.

    Args:
        plane: Through what was measured of the mounting plane.
        first: The circle of joint 1, its normal in the joint's positive sense.
        second: That of joint 2.
        plane_offset: Distance of the measured points from the mounting plane, towards the circles [m].
        T_axes_base: Pose of the base in the frame A as it was while joint 2 was swept, shape (4, 4) [m]; None: A is
            the base.

    Returns:
        The base frame.

    Raises:
        CalibError: Plane and axes do not determine it.
    """
    X = np.eye(4) if T_axes_base is None else T_axes_base
    figures = (plane, first, second)
    lines = lines_of(*figures, plane_offset=plane_offset)
    T = axes_frame(*lines) @ X

    def twist(displaced: Sequence[Line]) -> Array:
        """Return the frame's displacement with that of the figures, as a twist in its own axes."""
        M = rigid_inverse(T) @ axes_frame(*displaced) @ X
        rotation = 0.5 * (M - M.T)[[2, 0, 1], [1, 2, 0]]
        return np.concatenate([M[:3, 3], rotation])

    parts = np.array(propagated(twist, lines, figures))
    covariance = parts.sum(axis=0)
    dof = _degrees_of_freedom(parts, [figure.dof for figure in figures])
    return BaseFrame(read_only(T), read_only(covariance), read_only(dof))


def _degrees_of_freedom(parts: Array, dof_of_parts: Sequence[float]) -> Array:
    """Compute Welch's degrees of freedom of each variance of a sum; see the module's text.

    Args:
        parts: shape (K, n, n), contributions of K figures to the covariance of n numbers.
        dof_of_parts: Degrees of freedom of each figure's noise; infinite where it was given.

    Returns:
        shape (n,).
    """
    variances = np.diagonal(parts, axis1=1, axis2=2)
    share = variances / np.diag(parts.sum(axis=0))
    dof = np.array(dof_of_parts)[:, None]
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / np.sum(share**2 / dof, axis=0))


def lines_of(plane: Plane, *circles: Circle, plane_offset: float) -> list[Line]:
    """Return the mounting plane, which is below the measured one, away from the first circle, and the circles' axes.

    Args:
        plane: The measured plane.
        circles: Of the joints.
        plane_offset: Distance of the measured plane from the mounting plane [m].

    Raises:
        CalibError: The first circle is too near to the plane to tell its sides.
    """
    height = float(plane.normal @ (circles[0].point - plane.point))
    if plane_offset and abs(height) < 2.0 * abs(plane_offset):
        raise CalibError(
            f"the circle of joint 1 lies {1e3 * abs(height):.3g} mm from the measured plane: that is too near to tell "
            f"on which side the robot stands, as an offset of {1e3 * plane_offset:.6g} mm needs it. Fix the target "
            "higher up"
        )
    up = np.sign(height)
    mounting = Line(plane.point - up * plane_offset * plane.normal, plane.normal)
    return [mounting, *(Line(circle.point, circle.normal) for circle in circles)]


def propagated(
    result: Callable[[Sequence[Line]], Array], lines: Sequence[Line], figures: Sequence[Plane]
) -> list[Array]:
    """Propagate the covariances of plane and circles to a result.

    Args:
        result: Of mounting plane and axes, shape (k,).
        lines: Mounting plane and axes.
        figures: Plane and circles, in the same order.

    Returns:
        The contribution of each figure to the covariance of the result, shape (k, k).
    """
    parts = []
    for i, figure in enumerate(figures):
        columns = []
        for shift, tilt in _unit_displacements(figure):
            ahead = result(_displaced(lines, i, _STEP * shift, _STEP * tilt))
            behind = result(_displaced(lines, i, -_STEP * shift, -_STEP * tilt))
            columns.append((ahead - behind) / (2.0 * _STEP))
        D = np.column_stack(columns)
        # Without a circle's radius, which is last.
        covariance = figure.covariance[: len(columns), : len(columns)]
        parts.append(D @ covariance @ D.T)
    return parts


def _unit_displacements(figure: Plane) -> list[tuple[Array, Array]]:
    """Return the displacements of a plane or a circle's axis that its covariance is of, in that order.

    Returns:
        Shifts of the point, shape (3,) [m], with tilts of the direction, shape (3,) [rad], one of both zero: a shift
        along the normal of a plane, along u, v, normal of a circle; then tilts towards u and v.
    """
    along = figure.basis if isinstance(figure, Circle) else figure.basis[:, 2:]
    moves = [(column, np.zeros(3)) for column in along.T]
    moves += [(np.zeros(3), column) for column in figure.basis[:, :2].T]
    return moves


def _displaced(lines: Sequence[Line], i: int, shift: Array, tilt: Array) -> list[Line]:
    """Return the lines with one of them displaced by a shift (3,) [m] and a tilt of its direction (3,) [rad]."""
    direction = lines[i].direction + tilt
    line = Line(lines[i].point + shift, direction / np.linalg.norm(direction))
    return [*lines[:i], line, *lines[i + 1 :]]


def axes_frame(plane: Line, first: Line, second: Line) -> Array:
    """Compute T_tracker_A, shape (4, 4) [m]; see the module's text.

    Args:
        plane: The mounting plane, in the tracker's frame.
        first: Axis 1.
        second: Axis 2.

    Raises:
        CalibError: Axis 1 is too flat to the plane, or the axes are parallel.
    """
    z, n2 = first.direction, second.direction
    slope = float(plane.direction @ z)
    if abs(slope) < np.sin(SLANT_RAD):
        raise CalibError(
            f"axis 1 is at {np.degrees(np.arcsin(abs(slope))):.3g} deg to the plane, it should be upright on "
            "it: one of the two is not what its name says. Check which joint was turned and which surface was touched"
        )
    y = n2 - (n2 @ z) * z
    across = float(np.linalg.norm(y))
    if across < np.sin(PARALLEL_RAD):
        raise CalibError(
            f"the axes of joints 1 and 2 are parallel within {np.degrees(np.arcsin(across)):.2f} deg, so that they do "
            "not say where y points. Check that the second sweep is of joint 2"
        )
    y = y / across
    T = np.eye(4)
    T[:3, :3] = np.stack([np.cross(y, z), y, z], axis=1)
    T[:3, 3] = first.point + z * (plane.direction @ (plane.point - first.point)) / slope
    return T


def nominal_axes_frame(axes: Sequence[Line]) -> Array:
    """Compute T_base_A of nominal axes 1 and 2 at zero, (4, 4) [m]; the mounting plane is z = 0 of the base."""
    return axes_frame(Line(np.zeros(3), np.array([0.0, 0.0, 1.0])), *axes[:2])
