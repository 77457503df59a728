"""Circle-point analysis: every swept joint's axis, and the base frame from the plane and the first two.

Each joint's axis is that of the circle which its sweep draws. How far apart two neighbouring axes are, and at what
angle, is compared with the URDF's. Where joints above were not at zero during a sweep, and the table says so, the axis
is turned back about theirs first:

    axis_k(0) = exp(-S_(k-1) q_(k-1)) ... exp(-S_1 q_1) axis_k(q),   S_j: the screw of axis_j(0)

The base frame is as in the paper (section 4.2): the origin is where axis 1 meets the plane, z is along axis 1, y along
axis 2 made perpendicular to it; both axes point so that the joints' positive sense turns about them. That is the frame
A:

    o = c_1 + s n_1,  n_P . (o - p) = 0;     z = n_1;     y ~ n_2 - (n_2 . z) z

Where joint 1 was not at zero while joint 2 was swept, A is turned back about z. With a robot the result is the URDF's
own base frame, in which the nominal axes 1 and 2 and the plane z = 0 are known: T_tracker_base = T_tracker_A
T_base_A^-1.

Uncertainty: the covariances C_k of plane and circles through the derivatives of these equations (central differences).
The noise is found from the residuals, each figure for itself with dof_k degrees of freedom, so that an interval of one
component is that of Student's t with (B. Welch, 1947; F. Satterthwaite, 1946)

    1 / dof = sum_k (var_k / var)^2 / dof_k,     var = sum_k var_k
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import ndtr, stdtrit

from calib.circle_points.fits import LEVEL, Circle, Plane, fit_circle, fit_plane
from calib.circle_points.sweeps import Sweep, Sweeps
from calib.errors import CalibError, MeasurementError, UrdfError, choices
from calib.json_files import JsonLayout
from calib.model.dh_table import zero_poses
from calib.robot.robot import Robot, read_only, rigid_inverse
from calib.units import Array

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


# The survey of every joint

#: Of the table for JSON; a number behind it changes with the meaning of a key.
SCHEMA = "base-frame 2"

#: Beside the joint that turns, no other may by more than the first [rad]; it turns by more than the second.
STILL_RAD, TURNED_RAD = float(np.radians(0.1)), float(np.radians(1.0))

#: Joint values and points may disagree by this much, rms, before they are of different sweeps [rad].
_DISAGREE_RAD = float(np.radians(3.0))

#: Of all turning, how much goes one way in a sweep.
_ONE_WAY = 0.8

#: No robot is built, and mounted, with axes that stand this much otherwise to each other than in its URDF; to the
#: distance come so many of its standard deviations.
ANGLE_RAD, DISTANCE_M, _SIGMAS = float(np.radians(5.0)), 20e-3, 6.0

_ORDER = (
    "Without joint values the rows of a sweep stand in the order of increasing joint angle: turn their order round, or "
    "give the joints' values in columns."
)


@dataclass(frozen=True, slots=True)
class Finding:
    """What is not as it should be of a sweep.

    Codes are ``gross`` (the value is its distance [m]), ``radial`` and ``axial`` (neighbours err alike, by this
    correlation), and ``scatter`` (larger than sigma by this factor).
    """

    code: str
    where: str
    value: float


@dataclass(frozen=True, slots=True, eq=False)
class JointAxis:
    """The axis of a joint as its sweep shows it."""

    name: str  #: What to call it
    #: In the tracker's frame, its normal in the joint's positive sense: centre and normal are the axis
    circle: Circle
    rows: tuple[int, ...]  #: The points' numbers in the file
    point: Array  #: The circle's centre in the base, shape (3,) [m]
    direction: Array  #: Its normal in the base, shape (3,)
    #: shape (6, 6), of point [m] and direction in the base, the base's own uncertainty included
    covariance: Array


@dataclass(frozen=True, slots=True)
class AxisPair:
    """How two neighbouring axes stand to each other; the URDF's numbers are NaN without one."""

    joints: tuple[str, str]
    angle: float  #: In [0, pi] [rad]
    distance: float  #: Their shortest one, positive along the first axis times the second, or parallel [m]
    angle_std: float  #: [rad]
    distance_std: float  #: [m]
    angle_nominal: float  #: [rad]
    distance_nominal: float  #: [m]


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What the sweeps say."""

    frame: BaseFrame  #: The base frame
    plane: Plane  #: The mounting plane as measured, in the tracker's frame
    joints: tuple[JointAxis, ...]  #: The swept joints, from the first one on
    pairs: tuple[AxisPair, ...]  #: Of each joint and the next
    findings: tuple[Finding, ...]  #: What is not as it should be

    def table(self) -> dict[str, Any]:
        """All of it as nested tables of plain values and arrays, SI units, see docs/base-frame.md."""
        return {"schema": SCHEMA, **_LAYOUT.table(self)}


def base_frame(
    sweeps: Sweeps, robot: Robot | None = None, *, plane_offset: float = 0.0, robust: bool = True
) -> Survey:
    """The base frame and all axes from sweeps.

    Args:
        sweeps: Of the plane, of the joints 1 and 2, and of others if they were swept.
        robot: Whose URDF says where the base frame lies on the axes; None: z is axis 1, y axis 2.
        plane_offset: How far the plane's points stand off it, towards the robot: the radius of the ball [m].
        robust: Whether gross rows are left out, and named.

    Raises:
        MeasurementError: A sweep is missing, is not that of its joint, or no figure fits it.
        UrdfError: The robot's chain is not one of turning joints.
    """
    touched, *swept = sweeps.sweeps
    if [touched.joint, *(s.joint for s in swept)] != [None, *range(max(2, len(swept)))]:
        raise MeasurementError(
            f"{sweeps.source}: the sweeps are {choices(s.name for s in sweeps.sweeps)}. A base frame needs points on "
            f"the mounting plane, 'plane', and sweeps of '{sweeps.label(0)}', of '{sweeps.label(1)}', and of more "
            "joints, if wanted, in their order."
        )
    with _at(touched.where):
        plane = fit_plane(touched.points, touched.sigma, robust=robust)
    circles = []
    for joint, sweep in enumerate(swept):
        with _at(sweep.where):
            circle = fit_circle(sweep.points, sweep.sigma, robust=robust)
            circles.append(positive(circle, sweep.joints, joint, sweeps.joint_names))
    nominal = None if robot is None else nominal_axes(robot)
    with _at("In the URDF, with the plane z = 0 of the base (--base)"):
        X = np.eye(4) if nominal is None else rigid_inverse(nominal_axes_frame(nominal))
    values = [sweep.joints.mean(axis=0) for sweep in swept if sweep.joints is not None]
    if values:
        back = np.eye(4)
        back[:3, :3] = Rotation.from_rotvec([0.0, 0.0, -values[1][0]]).as_matrix()
        X = back @ X
    with _at(f"{sweeps.source}, plane and sweeps of the joints 1 and 2"):
        frame = frame_of(plane, *circles[:2], plane_offset=plane_offset, T_axes_base=X)
        lines = lines_of(plane, *circles, plane_offset=plane_offset)
        if not values and frame.T_tracker_base[:3, 2] @ (circles[0].point - plane.point) < 0.0:
            raise CalibError(f"joint 1 turns the other way round, seen from the plane. {_ORDER}")

    def geometry(displaced: Sequence[Line]) -> Array:
        """Points and directions of all axes in the base, then angles and distances of neighbours, as one vector."""
        T = rigid_inverse(axes_frame(*displaced[:3]) @ X)
        axes = [axis.moved(T) for axis in displaced[1:]]
        neighbours = pairwise(_at_zero(displaced[1:], values))
        return np.concatenate([np.ravel(axes), *(between(*two) for two in neighbours)])

    numbers = read_only(geometry(lines))
    covariance = read_only(np.sum(propagated(geometry, lines, [plane, *circles]), axis=0))
    joints, found = [], [*findings(touched, plane)]
    for k, (sweep, circle) in enumerate(zip(swept, circles, strict=True)):
        place = slice(6 * k, 6 * k + 6)
        point, direction = numbers[place].reshape(2, 3)
        own = covariance[place, place]
        joints.append(JointAxis(sweeps.label(k), circle, sweep.rows, point, direction, own))
        found += findings(sweep, circle)
    pairs = []
    rest = np.stack([numbers, np.sqrt(np.diag(covariance))])[:, 6 * len(joints) :]
    for k in range(len(swept) - 1):
        wanted = (np.nan, np.nan) if nominal is None else between(*nominal[k : k + 2])
        both = [*rest[:, 2 * k : 2 * k + 2].ravel().tolist(), *wanted]
        pairs.append(AxisPair((joints[k].name, joints[k + 1].name), *both))
        if robot is not None:
            _check(pairs[-1], f"the URDF of '{robot.name}' from '{robot.base}' to '{robot.tip}'")
    return Survey(frame, plane, tuple(joints), tuple(pairs), tuple(found))


def positive(
    circle: Circle, values: Array | None, joint: int, joint_names: tuple[str, ...]
) -> Circle:
    """The circle with its normal so that the joint's positive sense turns about it.

    By the joints' values at all points, shape (N, n) [rad], of which one only may change; else by the points' order.
    """
    angles = circle.angles[circle.used]
    if values is None:
        steps = np.angle(np.exp(1j * np.diff(angles)))
        turned = float(steps.sum())
        if abs(turned) < _ONE_WAY * float(np.abs(steps).sum()):
            raise CalibError(
                f"the points go round both ways, and their order must tell the sense of turning. {_ORDER}"
            )
        return circle if turned > 0.0 else circle.turned()
    ranges = np.ptp(values, axis=0)
    if ranges[joint] < TURNED_RAD or np.any(np.delete(ranges, joint) > STILL_RAD):
        turns = zip(joint_names, np.degrees(ranges), strict=True)
        told = ", ".join(f"'{name}' {angle:.3g} deg" for name, angle in turns)
        raise CalibError(
            f"by their columns the joints turn by {told}. In a sweep one joint turns, as far as it can, and all others "
            "stand still; name the joint that turns, or measure it again"
        )
    own = values[circle.used, joint]
    rest = []
    for sign in (1.0, -1.0):
        off = np.exp(1j * (angles - sign * own))
        rest.append(float(np.angle(off / off.mean()).std()))
    if min(rest) > _DISAGREE_RAD:
        raise CalibError(
            f"the points turn otherwise than the joint's column says, by {np.degrees(min(rest)):.3g} deg rms. Check "
            "that joint values and points are of the same rows, and the column's unit"
        )
    return circle if rest[0] <= rest[1] else circle.turned()


def between(first: Line, second: Line) -> tuple[float, float]:
    """The angle between two axes, in [0, pi], and their shortest distance, positive along n_1 x n_2 [rad, m]."""
    cross = np.cross(first.direction, second.direction)
    sine = float(np.linalg.norm(cross))
    angle = float(np.arctan2(sine, first.direction @ second.direction))
    apart = second.point - first.point
    if sine < np.sin(PARALLEL_RAD):
        return angle, float(np.linalg.norm(np.cross(apart, first.direction)))
    return angle, float(apart @ cross) / sine


def findings(sweep: Sweep, figure: Plane) -> Iterator[Finding]:
    """Gross rows, neighbours that err alike, noise beyond sigma."""
    for i in np.flatnonzero(~figure.used):
        where = f"{sweep.source}, {sweep.counted} {sweep.rows[i]} (sweep '{sweep.name}')"
        yield Finding("gross", where, float(np.linalg.norm(figure.residuals[i])))
    if isinstance(figure, Circle) and figure.used.sum() >= 10:
        for e, code in zip(figure.residuals[figure.used].T, ("radial", "axial"), strict=True):
            correlation = float(e[1:] @ e[:-1] / (e @ e)) if np.any(e) else 0.0
            if ndtr(-correlation * np.sqrt(len(e))) < 0.5 * LEVEL:
                yield Finding(code, sweep.where, correlation)
    if figure.given is not None and np.isfinite(figure.dof):
        yield Finding("scatter", sweep.where, figure.noise / figure.given)


def _check(pair: AxisPair, wanted: str) -> None:
    """Refuse axes that stand to each other as no two of this robot do."""
    off = abs(abs(pair.distance) - abs(pair.distance_nominal))
    far = off > DISTANCE_M + _SIGMAS * pair.distance_std
    if not far and abs(pair.angle - pair.angle_nominal) <= ANGLE_RAD:
        return
    remedy = (
        "One of the two sweeps is of another joint, or the robot or its chain is another one: check what was turned, "
        "and --robot, --base."
    )
    if not far and abs(np.pi - pair.angle - pair.angle_nominal) < ANGLE_RAD:
        remedy = f"One of the two turns the other way round, or its joint's sign is not the URDF's. {_ORDER}"
    raise MeasurementError(
        f"The axes of {choices(pair.joints)} are {np.degrees(pair.angle):.1f} deg and {1e3 * pair.distance:.1f} mm "
        f"apart; in {wanted} they are {np.degrees(pair.angle_nominal):.1f} deg and "
        f"{1e3 * pair.distance_nominal:.1f} mm. {remedy}"
    )


@contextmanager
def _at(where: str) -> Iterator[None]:
    """An error of what is made in the block says of which sweeps."""
    try:
        yield
    except CalibError as error:
        raise MeasurementError(f"{where}: {str(error).rstrip('.')}.") from error


def _at_zero(axes: Sequence[Line], values: Sequence[Array]) -> list[Line]:
    """Axes in any frame, turned back to the joints' zero from the values in each one's sweep; see the module's text."""
    result: list[Line] = []
    for k, (point, direction) in enumerate(axes):
        for axis, q in zip(result, values[k] if values else (), strict=False):
            R = Rotation.from_rotvec(-q * axis.direction).as_matrix()
            point, direction = axis.point + R @ (point - axis.point), R @ direction
        result.append(Line(point, direction))
    return result


_LAYOUT = JsonLayout(
    {
        Plane: {
            "point": "point_m",
            "residuals": "residuals_m",
            "noise": "noise_m",
            "given": "sigma_m",
        },
        Circle: {"radius": "radius_m", "angles": "angles_rad"},
        JointAxis: {
            "point": "base.point_m",
            "direction": "base.direction",
            "covariance": "base.covariance",
        },
    },
    {},
)
