"""The robot's base frame in the tracker's, from its mounting plane and the axes of its first two joints.

As the paper does (section 4.2): the origin is where axis 1 meets the plane, z is along axis 1, y along axis 2 made
perpendicular to it; both axes point so that the joints' positive sense turns about them. That is the frame A:

    o = c_1 + s n_1,  n_P . (o - p) = 0;     z = n_1;     y ~ n_2 - (n_2 . z) z

Where joint 1 was not at zero while joint 2 was swept, A is turned back about z. With a robot the result is the URDF's
own base frame, in which the nominal axes 1 and 2 and the plane z = 0 are known:
T_tracker_base = T_tracker_A T_base_A^-1.

Uncertainty: the covariances C_k of plane and circles through the derivatives of these equations (central differences).
The noise is found from the residuals, each figure for itself with dof_k degrees of freedom, so that an interval of one
component is that of Student's t with (B. Welch, 1947; F. Satterthwaite, 1946)

    1 / dof = sum_k (var_k / var)^2 / dof_k,     var = sum_k var_k
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from calib.circle_points.fits import Circle, Plane
from calib.errors import CalibError, UrdfError
from calib.model.dh import zero_poses
from calib.robot.robot import Robot, read_only, rigid_inverse

Array = NDArray[np.float64]

#: Axis 1 closer than this to the plane does not meet it anywhere near [rad].
SLANT_RAD = float(np.radians(30.0))

#: Axes 1 and 2 closer than this to parallel say nothing of y [rad].
PARALLEL_RAD = float(np.radians(5.0))

# Of the central differences that uncertainty is propagated with [m, rad]: all of it is smooth over centimetres.
_STEP = 3e-6


class Line(NamedTuple):
    """A point (3,) [m] and a unit vector (3,): an axis, or a plane and its normal."""

    point: Array
    direction: Array

    def moved(self, T: Array) -> Line:
        """The same line seen from another frame, by the pose of its own there."""
        return Line(T[:3, :3] @ self.point + T[:3, 3], T[:3, :3] @ self.direction)


def nominal_axes(robot: Robot) -> tuple[Line, ...]:
    """The axes in the base at zero of a robot of which each joint turns and has a column of its own."""
    n = len(robot.joints)
    own = all(j.type != "prismatic" and j.name in robot.joint_names for j in robot.joints)
    free = robot.coupling.shape == (n, n) and np.array_equal(robot.coupling, np.eye(n))
    if not own or not free or robot.base_moves:
        raise UrdfError(
            f"'{robot.name}' from '{robot.base}' to '{robot.tip}': a base frame needs a chain of joints that turn one "
            "by one, none of them sliding, held or following another. Choose --base and --tip so that only such joints "
            "lie between them."
        )
    placed = zip(zero_poses(robot)[0], robot.joints, strict=True)
    return tuple(Line(T[:3, 3], T[:3, :3] @ np.asarray(joint.axis)) for T, joint in placed)


@dataclass(frozen=True, slots=True, eq=False)
class BaseFrame:
    """A base frame and how well it is known."""

    T_tracker_base: Array  #: Pose of the base in the tracker's frame, shape (4, 4) [m]
    #: Of the twist xi (displacement [m], rotation [rad], in the base's axes) in T_tracker_base exp(xi), shape (6, 6)
    covariance: Array
    dof: Array  #: Degrees of freedom of each component's variance, shape (6,); infinite where the noise was given

    @property
    def T_base_tracker(self) -> Array:
        """Pose of the tracker in the base, shape (4, 4) [m]."""
        return rigid_inverse(self.T_tracker_base)

    @property
    def std(self) -> Array:
        """Standard deviations of the twist, shape (6,) [m, rad], in the base's axes."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def within(self, share: float = 0.95) -> Array:
        """To both sides of zero, between which each component of the twist lies with this probability, shape (6,)."""
        return np.asarray(stdtrit(np.minimum(self.dof, 1e9), 0.5 + 0.5 * share) * self.std)


def frame_of(
    plane: Plane,
    first: Circle,
    second: Circle,
    *,
    plane_offset: float = 0.0,
    T_axes_base: Array | None = None,
) -> BaseFrame:
    """The base frame.

    Args:
        plane: Through what was measured of the mounting plane.
        first: The circle of joint 1, its normal in the joint's positive sense.
        second: That of joint 2.
        plane_offset: How far the measured points stand off the mounting plane, towards the circles [m].
        T_axes_base: Pose of the base in the frame A as it was while joint 2 was swept, shape (4, 4) [m]; None: A is
            the base.
    """
    X = np.eye(4) if T_axes_base is None else T_axes_base
    figures = (plane, first, second)
    lines = lines_of(*figures, plane_offset=plane_offset)
    T = axes_frame(*lines) @ X

    def moved(displaced: Sequence[Line]) -> Array:
        """The frame's displacement with that of the figures, as a twist in its own axes."""
        M = rigid_inverse(T) @ axes_frame(*displaced) @ X
        return np.concatenate([M[:3, 3], 0.5 * (M - M.T)[[2, 0, 1], [1, 2, 0]]])

    parts = np.array(propagated(moved, lines, figures))
    covariance, own = parts.sum(axis=0), np.diagonal(parts, axis1=1, axis2=2)
    share = own / np.diag(covariance)
    with np.errstate(divide="ignore"):
        dof = 1.0 / np.sum(share**2 / np.array([[figure.dof] for figure in figures]), axis=0)
    return BaseFrame(read_only(T), read_only(covariance), read_only(dof))


def lines_of(plane: Plane, *circles: Circle, plane_offset: float) -> list[Line]:
    """The mounting plane, which lies under the measured one, away from the first circle, and the circles' axes."""
    height = float(plane.normal @ (circles[0].point - plane.point))
    if plane_offset and abs(height) < 2.0 * abs(plane_offset):
        raise CalibError(
            f"the circle of joint 1 lies {1e3 * abs(height):.3g} mm from the measured plane: that is too near to tell "
            f"on which side the robot stands, as an offset of {1e3 * plane_offset:.6g} mm needs it. Fix the target "
            "higher up"
        )
    mounting = Line(plane.point - np.sign(height) * plane_offset * plane.normal, plane.normal)
    return [mounting, *(Line(circle.point, circle.normal) for circle in circles)]


def propagated(
    result: Callable[[Sequence[Line]], Array], lines: Sequence[Line], figures: Sequence[Plane]
) -> list[Array]:
    """What plane and circles contribute to the covariance of a result, shape (k,), of mounting plane and axes."""
    parts = []
    for i, figure in enumerate(figures):
        # Columns of the basis along which the point moves, then two towards which the direction tilts.
        along = figure.basis if isinstance(figure, Circle) else figure.basis[:, 2:]
        moves = [(column, np.zeros(3)) for column in along.T]
        moves += [(np.zeros(3), column) for column in figure.basis[:, :2].T]

        def at(step: float, shift: Array, tilt: Array, i: int = i) -> Array:
            """The result with one figure displaced."""
            direction = lines[i].direction + step * tilt
            moved = Line(lines[i].point + step * shift, direction / np.linalg.norm(direction))
            return result([*lines[:i], moved, *lines[i + 1 :]])

        columns = [(at(_STEP, *move) - at(-_STEP, *move)) / (2.0 * _STEP) for move in moves]
        D = np.column_stack(columns)
        parts.append(D @ figure.covariance[: len(moves), : len(moves)] @ D.T)
    return parts


def axes_frame(plane: Line, first: Line, second: Line) -> Array:
    """T_tracker_A, shape (4, 4) [m]; see the module's text."""
    z, n2 = first.direction, second.direction
    slope = float(plane.direction @ z)
    if abs(slope) < np.sin(SLANT_RAD):
        raise CalibError(
            f"axis 1 stands at {np.degrees(np.arcsin(abs(slope))):.3g} deg to the plane, it should stand upright on "
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
    """T_base_A of a robot's nominal axes 1 and 2 at zero; the mounting plane is z = 0 of the base."""
    return axes_frame(Line(np.zeros(3), np.array([0.0, 0.0, 1.0])), *axes[:2])
