"""Circle-point analysis: every swept joint's axis, and the base frame from the plane and the first two.

Each joint's axis is that of the circle which its sweep draws. Distance and angle of two neighbouring axes are compared
with the URDF's. Where joints before it were not at zero during a sweep, and the table says so, the axis is turned back
about theirs first:

    axis_k(0) = exp(-S_(k-1) q_(k-1)) ... exp(-S_1 q_1) axis_k(q),   S_j: the screw of axis_j(0)

The base frame is that of `calib.verbs.base_frame.frame`. Where joint 1 was not at zero while joint 2 was swept, the
frame is turned back about its z axis.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arguments import check_flags, check_number, check_type
from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.basics.json_files import JsonLayout
from calib.basics.values import Value
from calib.data.inputs import RobotInput, robot_of
from calib.errors import CalibError, MeasurementError, choices
from calib.robot.robot import Robot
from calib.verbs.base_frame.findings import ORDER, SweepFinding, findings, with_positive_sense
from calib.verbs.base_frame.fits import Circle, Plane, fit_circle, fit_plane
from calib.verbs.base_frame.frame import (
    PARALLEL_RAD,
    BaseFrame,
    Line,
    axes_frame,
    frame_of,
    lines_of,
    nominal_axes,
    nominal_axes_frame,
    propagated,
)
from calib.verbs.base_frame.sweeps import Sweeps

#: Kind and version of the table for JSON.
SCHEMA = "base-frame 2"

#: Neighbouring axes of no robot are at an angle that differs by this much from its URDF's [rad].
ANGLE_RAD = float(np.radians(5.0))

#: They are not at a distance that differs by this much [m] ...
DISTANCE_M = 20e-3

#: ... and by this many of its standard deviations on top.
_SIGMAS = 6.0


@dataclass(frozen=True, slots=True, eq=False)
class JointAxis(Value):
    """Axis of a joint, from its sweep."""

    #: Name of the joint
    name: str
    #: Of its sweep, in the tracker's frame, its normal in the joint's positive sense: centre and normal are the axis
    circle: Circle
    #: The points' numbers in the file
    rows: tuple[int, ...]
    #: The circle's centre in the base, shape (3,) [m]
    point: Array
    #: Its normal in the base, shape (3,)
    direction: Array
    #: shape (6, 6), of point [m] and direction in the base, the base's own uncertainty included
    covariance: Array


@dataclass(frozen=True, slots=True)
class AxisPair:
    """Angle and distance of two neighbouring axes; those of the URDF are NaN without one."""

    #: Names of the joints
    joints: tuple[str, str]
    #: In [0, pi] [rad]
    angle: float
    #: Their shortest one, positive along n_1 x n_2, or between parallel axes [m]
    distance: float
    #: [rad]
    angle_std: float
    #: [m]
    distance_std: float
    #: [rad]
    angle_nominal: float
    #: [m]
    distance_nominal: float


@dataclass(frozen=True, slots=True, eq=False)
class Survey(Value):
    """Results of all sweeps."""

    #: The base frame
    frame: BaseFrame
    #: The mounting plane as measured, in the tracker's frame
    plane: Plane
    #: The swept joints, from the first one on
    joints: tuple[JointAxis, ...]
    #: Of each joint and the next
    pairs: tuple[AxisPair, ...]
    #: What is wrong with the sweeps
    findings: tuple[SweepFinding, ...]

    def table(self) -> dict[str, Any]:
        """Return all of it as nested tables of plain values and arrays, SI units, see docs/base-frame.md."""
        return {"schema": SCHEMA, **_LAYOUT.table(self)}


def base_frame(
    sweeps: Sweeps,
    robot: RobotInput | None = None,
    *,
    plane_offset: float = 0.0,
    robust: bool = True,
) -> Survey:
    """Estimate the base frame and all axes from sweeps.

    Args:
        sweeps: Of the plane, of the joints 1 and 2, and of others if they were swept.
        robot: Its URDF places the base frame on the axes; or the path of a URDF or xacro, or a name such as ``"ur3"``;
            None: z is axis 1, y axis 2.
        plane_offset: Distance of the plane's points from it, towards the robot: the radius of the ball [m].
        robust: True to reject outliers, and to name them in the findings.

    Returns:
        The base frame, the axes, and what is wrong with the sweeps.

    Raises:
        MeasurementError: A sweep is missing, is not that of its joint, or no figure fits it.
        UrdfError: The robot's chain is not one of turning joints.
    """
    check_type(
        "sweeps", sweeps, Sweeps, "Sweeps, such as calib.verbs.base_frame.sweeps.read_sweeps reads"
    )
    check_number("plane_offset", plane_offset)
    check_flags(robust=robust)
    arm = None if robot is None else robot_of(robot)
    _check_sweeps(sweeps)
    plane, circles = _fitted_figures(sweeps, robust=robust)
    nominal = None if arm is None else nominal_axes(arm)
    values = _mean_joint_values(sweeps)
    T_axes_base = _pose_of_base(nominal, values)
    with _at(f"{sweeps.source}, plane and sweeps of the joints 1 and 2"):
        frame = frame_of(plane, *circles[:2], plane_offset=plane_offset, T_axes_base=T_axes_base)
        lines = lines_of(plane, *circles, plane_offset=plane_offset)
        if not values:
            _check_upright(frame, circles[0], plane)
    geometry = _geometry_of_axes(lines, [plane, *circles], values, T_axes_base)
    joints = _joint_axes(sweeps, circles, geometry)
    pairs = _axis_pairs(joints, geometry, nominal)
    if arm is not None:
        _check_pairs(pairs, arm)
    return Survey(frame, plane, joints, pairs, _all_findings(sweeps, [plane, *circles]))


def _check_sweeps(sweeps: Sweeps) -> None:
    """Refuse sweeps that are not those of the plane and of the joints from the first on; raises `MeasurementError`."""
    numbers = [sweep.joint for sweep in sweeps.sweeps]
    joints = max(2, len(numbers) - 1)
    if numbers != [None, *range(joints)]:
        names = choices(sweep.name for sweep in sweeps.sweeps)
        raise MeasurementError(
            f"{sweeps.source}: the sweeps are {names}. A base frame needs points on the mounting "
            f"plane, 'plane', and sweeps of '{sweeps.label(0)}', of '{sweeps.label(1)}', and of "
            "more joints, if wanted, in their order."
        )


def _fitted_figures(sweeps: Sweeps, *, robust: bool) -> tuple[Plane, list[Circle]]:
    """Fit the mounting plane and the circle of each swept joint, in the tracker's frame.

    Args:
        sweeps: Of the plane, then of the joints from the first on.
        robust: True to reject outliers.

    Returns:
        The plane, and the circles, each with its normal in the joint's positive sense.
    """
    touched, *swept = sweeps.sweeps
    with _at(touched.where):
        plane = fit_plane(touched.points, touched.sigma, robust=robust)
    circles = []
    for joint, sweep in enumerate(swept):
        with _at(sweep.where):
            circle = fit_circle(sweep.points, sweep.sigma, robust=robust)
            circles.append(with_positive_sense(circle, sweep.joints, joint, sweeps.joint_names))
    return plane, circles


def _mean_joint_values(sweeps: Sweeps) -> list[Array]:
    """Mean values of the n joints during each joint's sweep, each of shape (n,) [rad]; empty: none are known."""
    swept = sweeps.sweeps[1:]
    return [sweep.joints.mean(axis=0) for sweep in swept if sweep.joints is not None]


def _all_findings(sweeps: Sweeps, figures: Sequence[Plane]) -> tuple[SweepFinding, ...]:
    """Collect what is wrong with the sweeps.

    Args:
        sweeps: Of the plane, then of the joints.
        figures: The plane and the circles through their points, in the same order.
    """
    result: list[SweepFinding] = []
    for sweep, figure in zip(sweeps.sweeps, figures, strict=True):
        result += findings(sweep, figure)
    return tuple(result)


def _pose_of_base(nominal: Sequence[Line] | None, values: Sequence[Array]) -> Array:
    """Return the pose of the base in the frame of the axes while joint 2 was swept, shape (4, 4), [m].

    Args:
        nominal: Nominal axes in the base at zero; None: the frame of the axes at zero is the base.
        values: Mean joint values of each sweep, [rad]; empty: none are known.
    """
    with _at("In the URDF, with the plane z = 0 of the base (--base)"):
        T_axes_base = np.eye(4)
        if nominal is not None:
            T_axes_base = rigid_inverse(nominal_axes_frame(nominal))
    if not values:
        return T_axes_base
    turned_back = np.eye(4)
    turned_back[:3, :3] = Rotation.from_rotvec([0.0, 0.0, -values[1][0]]).as_matrix()
    return np.asarray(turned_back @ T_axes_base)


def _check_upright(frame: BaseFrame, first: Circle, plane: Plane) -> None:
    """Refuse a base frame whose z axis points away from the robot; raises `CalibError`."""
    if frame.T_tracker_base[:3, 2] @ (first.point - plane.point) < 0.0:
        raise CalibError(f"joint 1 turns the other way round, seen from the plane. {ORDER}")


@dataclass(frozen=True, slots=True, eq=False)
class _Geometry:
    """Axes in the base, and angles and distances of neighbours, with their covariance."""

    #: (n, 2, 3), point [m] and direction of each
    axes: Array
    #: (n, 6, 6), of each
    axes_covariance: Array
    #: (n - 1, 2), angle [rad] and distance [m] of each axis and the next
    neighbours: Array
    #: (n - 1, 2), their standard deviations
    neighbours_std: Array


def _geometry_of_axes(
    lines: Sequence[Line],
    figures: Sequence[Plane],
    values: Sequence[Array],
    T_axes_base: Array,
) -> _Geometry:
    """Compute the axes in the base, and angles and distances of neighbours.

    Args:
        lines: Mounting plane and axes in the tracker's frame.
        figures: Plane and circles, in the same order.
        values: Mean joint values of each sweep, [rad]; empty: none are known.
        T_axes_base: Pose of the base in the frame of the axes, shape (4, 4), [m].
    """

    def numbers(displaced: Sequence[Line]) -> Array:
        """Return points and directions of all axes in the base, then angles and distances, as one vector."""
        T_tracker_base = axes_frame(*displaced[:3]) @ T_axes_base
        T_base_tracker = rigid_inverse(T_tracker_base)
        axes = [axis.seen_from(T_base_tracker) for axis in displaced[1:]]
        axes_at_zero = _at_zero(displaced[1:], values)
        neighbours = [between(first, second) for first, second in pairwise(axes_at_zero)]
        return np.concatenate([np.ravel(axes), *neighbours])

    count = len(lines) - 1
    vector = read_only(numbers(lines))
    parts = propagated(numbers, lines, figures)
    covariance = read_only(np.sum(parts, axis=0))
    std = np.sqrt(np.diag(covariance))
    blocks = [covariance[k : k + 6, k : k + 6] for k in range(0, 6 * count, 6)]
    return _Geometry(
        axes=vector[: 6 * count].reshape(count, 2, 3),
        axes_covariance=np.array(blocks),
        neighbours=vector[6 * count :].reshape(-1, 2),
        neighbours_std=std[6 * count :].reshape(-1, 2),
    )


def _joint_axes(
    sweeps: Sweeps, circles: Sequence[Circle], geometry: _Geometry
) -> tuple[JointAxis, ...]:
    """Return the axis of each swept joint, in the order of the chain.

    Args:
        sweeps: Of the plane, then of the joints.
        circles: The circle of each joint, its normal in the joint's positive sense.
        geometry: The axes in the base, with their covariance.
    """
    swept = sweeps.sweeps[1:]
    axes = []
    for k, (sweep, circle) in enumerate(zip(swept, circles, strict=True)):
        point, direction = read_only(geometry.axes[k])
        covariance = read_only(geometry.axes_covariance[k])
        axes.append(JointAxis(sweeps.label(k), circle, sweep.rows, point, direction, covariance))
    return tuple(axes)


def _axis_pairs(
    joints: Sequence[JointAxis], geometry: _Geometry, nominal: Sequence[Line] | None
) -> tuple[AxisPair, ...]:
    """Return angle and distance of each axis and the next, beside those of the URDF."""
    pairs = []
    for k, (first, second) in enumerate(pairwise(joints)):
        of_urdf = (np.nan, np.nan)
        if nominal is not None:
            of_urdf = between(nominal[k], nominal[k + 1])
        angle, distance = geometry.neighbours[k].tolist()
        angle_std, distance_std = geometry.neighbours_std[k].tolist()
        pairs.append(
            AxisPair(
                joints=(first.name, second.name),
                angle=angle,
                distance=distance,
                angle_std=angle_std,
                distance_std=distance_std,
                angle_nominal=of_urdf[0],
                distance_nominal=of_urdf[1],
            )
        )
    return tuple(pairs)


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


def _check_pairs(pairs: Sequence[AxisPair], robot: Robot) -> None:
    """Refuse axes whose angles or distances no calibration of the robot explains; raises `MeasurementError`."""
    chain = f"the URDF of '{robot.name}' from '{robot.base}' to '{robot.tip}'"
    for pair in pairs:
        _check_pair(pair, chain)


def _check_pair(pair: AxisPair, chain: str) -> None:
    """Refuse two axes whose angle or distance no calibration explains; raises `MeasurementError`.

    Args:
        pair: As measured, and of the URDF.
        chain: Words for the URDF's chain.
    """
    difference = abs(abs(pair.distance) - abs(pair.distance_nominal))
    far = difference > DISTANCE_M + _SIGMAS * pair.distance_std
    if not far and abs(pair.angle - pair.angle_nominal) <= ANGLE_RAD:
        return
    remedy = (
        "One of the two sweeps is of another joint, or the robot or its chain is another one: check what was turned, "
        "and --robot, --base."
    )
    if not far and abs(np.pi - pair.angle - pair.angle_nominal) < ANGLE_RAD:
        remedy = f"One of the two turns the other way round, or its joint's sign is not the URDF's. {ORDER}"
    raise MeasurementError(
        f"The axes of {choices(pair.joints)} are {np.degrees(pair.angle):.1f} deg and {1e3 * pair.distance:.1f} mm "
        f"apart; in {chain} they are {np.degrees(pair.angle_nominal):.1f} deg and "
        f"{1e3 * pair.distance_nominal:.1f} mm. {remedy}"
    )


@contextmanager
def _at(where: str) -> Iterator[None]:
    """Add to an error of the block the place that it is about; raises `MeasurementError`."""
    try:
        yield
    except CalibError as error:
        raise MeasurementError(f"{where}: {str(error).rstrip('.')}.") from error


def _at_zero(axes: Sequence[Line], values: Sequence[Array]) -> list[Line]:
    """Turn axes back to the joints' zero; see the module's text.

    Args:
        axes: In any frame, each as it was during its sweep.
        values: Mean joint values of each sweep, [rad]; empty: all were at zero.

    Returns:
        The axes at zero, in the same frame.
    """
    at_zero: list[Line] = []
    for k, (point, direction) in enumerate(axes):
        joint_values = values[k] if values else ()
        # The joints before this one, which are at zero already, in their order.
        for axis, q in zip(at_zero, joint_values, strict=False):
            R = Rotation.from_rotvec(-q * axis.direction).as_matrix()
            point = axis.point + R @ (point - axis.point)
            direction = R @ direction
        at_zero.append(Line(point, direction))
    return at_zero


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
