"""The robot's base frame in the tracker's, from its mounting plane and the axes of its first two joints.

As the paper does (section 4.2): the origin is where axis 1 meets the plane, z is along axis 1, y along axis 2 made
perpendicular to it; both axes point so that the joints' positive sense turns about them. That is the frame A:

    o = c_1 + s n_1,  n_P . (o - p) = 0;     z = n_1;     y ~ n_2 - (n_2 . z) z

Where joint 1 was not at zero while joint 2 was swept, A is turned back about z. With a robot the result is the URDF's
own base frame, in which the nominal axes 1 and 2 and the plane z = 0 are known:
T_tracker_base = T_tracker_A T_base_A^-1.

Uncertainty: the covariance of plane and circles through the derivatives of these equations (central differences),
C = sum_k C_k. The noise is found from the residuals, each figure for itself, so that the frame is off by

    xi = sum_k C_k^1/2 t_k,     t_k: Student's t in 6 dimensions with the figure's dof_k

(normal where the noise was given; W. Behrens, 1929; R. Fisher, 1935). Quantiles of xi^T C^-1 xi and of each component
of xi are those of draws, the same every time. A plane of four points has one degree of freedom and circles of 40 have
74: no single number stands for these, and a region made with one would hold the truth in 87 % of the cases, not 95 %.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaincinv, ndtri

from calib.circle_points.fits import Circle, Plane
from calib.errors import CalibError, UrdfError
from calib.model.dh import DHTable, dh_table, rows_between, zero_poses
from calib.robot.robot import Robot, read_only, rigid_inverse

Array = NDArray[np.float64]

#: The numbers of a DH row, in the order in which they are given here, and their units.
NUMBERS = {"a": "m", "alpha": "rad", "d": "m", "theta": "rad", "beta": "rad"}

#: Axis 1 closer than this to the plane does not meet it anywhere near [rad].
SLANT_RAD = float(np.radians(30.0))

#: Axes closer than this to parallel have their common normal anywhere, and 1 and 2 say nothing of y [rad].
PARALLEL_RAD = float(np.radians(5.0))

#: Draws of the frame's error, for a quantile to about 1 %, and their seed: the same every time.
_DRAWS, _SEED = 10_000, 19350101

# Of the central differences that uncertainty is propagated with [m, rad]: all of it is smooth over centimetres.
_STEP = 3e-6


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


def nominal_axes(robot: Robot) -> Nominal:
    """The axes of a robot of which each joint turns and has a column of its own."""
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
    lines = (Line(T[:3, 3], T[:3, :3] @ np.asarray(joint.axis)) for T, joint in placed)
    return Nominal(tuple(lines), dh_table(robot))


def axis_rows(lines: Sequence[Line], table: DHTable | None = None) -> Array:
    """a, alpha, d, theta, beta of the rows from each axis to the next, shape (n - 1, 5) [m, rad].

    The last row of a robot leads to its tip, which no axis says anything of. The n axes are in the base at zero; those
    of the URDF's table make the choices that the convention leaves open.
    """
    rows = rows_between(lines, table)
    return np.array([[getattr(row, name) for name in NUMBERS] for row in rows]).reshape(-1, 5)


@dataclass(frozen=True, slots=True, eq=False)
class BaseFrame:
    """A base frame and how well it is known."""

    T_tracker_base: Array  #: Pose of the base in the tracker's frame, shape (4, 4) [m]
    #: What plane, circle 1 and circle 2 contribute to the covariance, shape (6, 6) each
    parts: tuple[Array, ...]
    #: The degrees of freedom of each part; infinite where the noise was given
    dofs: tuple[float, ...]

    @property
    def covariance(self) -> Array:
        """Of the twist xi (displacement [m], rotation [rad], in the base's axes) in T_tracker_base exp(xi), (6, 6)."""
        return np.asarray(np.sum(self.parts, axis=0))

    @property
    def T_base_tracker(self) -> Array:
        """Pose of the tracker in the base, shape (4, 4) [m]."""
        return rigid_inverse(self.T_tracker_base)

    @property
    def std(self) -> Array:
        """Standard deviations of the twist, shape (6,) [m, rad], in the base's axes."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def carry(self, points: ArrayLike) -> Array:
        """Points of the tracker's frame in the base, shape (N, 3) or (3,) [m]."""
        T = self.T_base_tracker
        return np.asarray(np.asarray(points, dtype=np.float64) @ T[:3, :3].T + T[:3, 3])

    def std_at(self, points: Array) -> Array:
        """What the frame's uncertainty makes of points of the base in all directions together, shape (N,) [m]."""
        G = np.array([np.hstack([np.eye(3), -pin.skew(p)]) for p in points])
        return np.asarray(np.sqrt(np.einsum("nij,jk,nik->n", G, self.covariance, G)))

    def distance(self, T_tracker_base: Array) -> float:
        """Squared distance of another pose of the base in units of the covariance."""
        xi = pin.log6(rigid_inverse(self.T_tracker_base) @ T_tracker_base).vector
        return float(xi @ np.linalg.solve(self.covariance, xi))

    def limit(self, share: float = 0.95) -> float:
        """The squared distance below which the true base lies with this probability."""
        if np.all(np.isinf(self.dofs)):
            return 2.0 * float(gammaincinv(3.0, share))
        xi = self._draws()
        square = np.einsum("ni,ij,nj->n", xi, np.linalg.inv(self.covariance), xi)
        return float(np.quantile(square, share))

    def within(self, share: float = 0.95) -> Array:
        """To both sides of zero, between which each component of the twist lies with this probability, shape (6,)."""
        if np.all(np.isinf(self.dofs)):
            return np.asarray(ndtri(0.5 + 0.5 * share) * self.std)
        return np.asarray(np.quantile(np.abs(self._draws()), share, axis=0))

    def _draws(self) -> Array:
        """Errors of the frame that the measurements allow for, shape (draws, 6); see the module's text."""
        rng = np.random.default_rng(_SEED)
        xi, std = np.zeros((_DRAWS, 6)), self.std
        for part, dof in zip(self.parts, self.dofs, strict=True):
            wider = 1.0 if np.isinf(dof) else np.sqrt(dof / rng.chisquare(dof, size=(_DRAWS, 1)))
            # In units of the standard deviations: lengths stand beside angles.
            values, vectors = np.linalg.eigh(part / np.outer(std, std))
            root = vectors * np.sqrt(np.maximum(values, 0.0))
            xi += wider * (rng.normal(size=(_DRAWS, 6)) @ root.T)
        return xi * std


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

    parts = propagated(moved, lines, figures)
    return BaseFrame(read_only(T), tuple(map(read_only, parts)), tuple(f.dof for f in figures))


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


def nominal_axes_frame(nominal: Nominal) -> Array:
    """T_base_A of a robot's nominal axes 1 and 2 at zero; the mounting plane is z = 0 of the base."""
    try:
        return axes_frame(Line(np.zeros(3), np.array([0.0, 0.0, 1.0])), *nominal.lines[:2])
    except CalibError as error:
        raise CalibError(
            f"In the URDF, with the plane z = 0 of the base, {error}. Choose another base link (--base)."
        ) from error
