"""Base frame from single-joint sweeps (circle-point analysis), with every swept joint's axis and their uncertainty.

The axis of a joint is that of the circle on which its target moves. The base frame is that of the axes 1 and 2 and the
mounting plane, see `calib.verbs.base_frame.axes`. With a robot it is the URDF's own base, in which the nominal axes 1
and 2 and the plane z = 0 are known: T_tracker_base = T_tracker_A T_base_A^-1. If joint 1 was not at zero while joint 2
was swept, the frame is turned back about its z axis. Distance and angle of two neighbouring axes, turned back to zero,
are compared with the URDF's.

The noise is estimated from the residuals, of plane and each circle separately with dof_k degrees of freedom, so that an
interval of one component is that of Student's t with (B. Welch, 1947; F. Satterthwaite, 1946)

    1 / dof = sum_k (var_k / var)^2 / dof_k,     var = sum_k var_k
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import stdtrit

from calib.basics.arguments import check_flags, check_number, check_type
from calib.basics.arrays import Array, read_only, rigid_inverse
from calib.basics.json_files import JsonLayout
from calib.basics.values import Value
from calib.data.inputs import RobotInput, robot_of
from calib.errors import CalibError, MeasurementError, choices
from calib.robot.robot import Robot
from calib.verbs.base_frame.axes import (
    Line,
    axes_frame,
    between,
    measured_lines,
    nominal_axes,
    nominal_axes_frame,
    propagate,
    turn_to_zero,
)
from calib.verbs.base_frame.circles import Circle, Plane, fit_circle, fit_plane
from calib.verbs.base_frame.sweep_findings import ORDER, SweepFinding, findings, with_positive_sense
from calib.verbs.base_frame.sweeps import Sweeps

#: Kind and version of the table for JSON.
SCHEMA = "base-frame 2"

#: Neighbouring axes of one robot do not differ from its URDF's by this much in angle [rad] ...
ANGLE_RAD = float(np.radians(5.0))

#: ... nor in distance by this much [m] ...
DISTANCE_M = 20e-3

#: ... and by this many standard deviations of the distance on top.
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
class BaseFrame(Value):
    """Base frame with its uncertainty, and the axes and findings of the sweeps that it is from."""

    #: Pose of the base in the tracker's frame, shape (4, 4) [m]
    T_tracker_base: Array
    #: Of the twist xi (displacement [m], rotation [rad], in the base's axes) in T_tracker_base exp(xi), shape (6, 6)
    covariance: Array
    #: Degrees of freedom of each component's variance, shape (6,); infinite if the noise was given
    dof: Array
    #: The mounting plane as measured, in the tracker's frame
    plane: Plane
    #: The swept joints, from the first one on
    joints: tuple[JointAxis, ...] = ()
    #: Of each joint and the next
    pairs: tuple[AxisPair, ...] = ()
    #: Faults of the sweeps
    findings: tuple[SweepFinding, ...] = ()

    @property
    def T_base_tracker(self) -> Array:
        """Pose of the tracker in the base, shape (4, 4) [m]."""
        return rigid_inverse(self.T_tracker_base)

    @property
    def std(self) -> Array:
        """Standard deviations of the twist, shape (6,) [m, rad], in the base's axes."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def within(self, share: float = 0.95) -> Array:
        """Return the half width of the confidence interval of the displacement along and the rotation about each axis.

        The axes are those of the base; shape (6,), x, y, z [m], then about x, y, z [rad].

        Args:
            share: Probability that it lies inside.
        """
        dof = np.minimum(self.dof, 1e9)
        quantile = stdtrit(dof, 0.5 + 0.5 * share)
        return np.asarray(quantile * self.std)

    def table(self) -> dict[str, Any]:
        """Return all of it as nested tables of plain values and arrays, SI units, see docs/base-frame.md."""
        return {"schema": SCHEMA, **_LAYOUT.table(self)}


#: Paths in the table for JSON, with the units.
_LAYOUT = JsonLayout(
    {
        BaseFrame: {
            "T_tracker_base": "frame.T_tracker_base",
            "covariance": "frame.covariance",
            "dof": "frame.dof",
        },
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


def base_frame(
    sweeps: Sweeps,
    robot: RobotInput | None = None,
    *,
    plane_offset: float = 0.0,
    robust: bool = True,
) -> BaseFrame:
    """Estimate the base frame and all axes from sweeps.

    Args:
        sweeps: Of the plane, of the joints 1 and 2, and of others if they were swept.
        robot: Its URDF places the base frame on the axes; or the path of a URDF or xacro, or a name such as ``"ur3"``;
            None: z is axis 1, y axis 2.
        plane_offset: Distance of the plane's points from it, towards the robot: the radius of the ball [m].
        robust: True to reject outliers, and to name them in the findings.

    Returns:
        The base frame, the axes, and the faults of the sweeps.

    Raises:
        MeasurementError: A sweep is missing, is not that of its joint, or no plane or circle fits it.
        UrdfError: The robot's chain is not one of revolute joints.
    """
    check_type(
        "sweeps", sweeps, Sweeps, "Sweeps, such as calib.verbs.base_frame.sweeps.read_sweeps reads"
    )
    check_number("plane_offset", plane_offset)
    check_flags(robust=robust)
    arm = None if robot is None else robot_of(robot)
    numbers = [sweep.joint for sweep in sweeps.sweeps]
    if numbers != [None, *range(max(2, len(numbers) - 1))]:
        names = choices(sweep.name for sweep in sweeps.sweeps)
        raise MeasurementError(
            f"{sweeps.source}: the sweeps are {names}. A base frame needs points on the mounting "
            f"plane, 'plane', and sweeps of '{sweeps.label(0)}', of '{sweeps.label(1)}', and of "
            "more joints, if wanted, in their order."
        )
    touched, *swept = sweeps.sweeps
    with _at(touched.where):
        plane = fit_plane(touched.points, touched.sigma, robust=robust)
    circles = []
    for joint, sweep in enumerate(swept):
        with _at(sweep.where):
            circle = fit_circle(sweep.points, sweep.sigma, robust=robust)
            circles.append(with_positive_sense(circle, sweep.joints, joint, sweeps.joint_names))

    # The base in the frame of the axes, as it was while joint 2 was swept.
    nominal = None if arm is None else nominal_axes(arm)
    T_axes_base = np.eye(4)
    if nominal is not None:
        with _at("In the URDF, with the plane z = 0 of the base (--base)"):
            T_axes_base = rigid_inverse(nominal_axes_frame(nominal))
    values = [sweep.joints.mean(axis=0) for sweep in swept if sweep.joints is not None]
    if values:
        turned_back = np.eye(4)
        turned_back[:3, :3] = Rotation.from_rotvec([0.0, 0.0, -values[1][0]]).as_matrix()
        T_axes_base = np.asarray(turned_back @ T_axes_base)

    with _at(f"{sweeps.source}, plane and sweeps of the joints 1 and 2"):
        frame = frame_of(plane, *circles[:2], plane_offset=plane_offset, T_axes_base=T_axes_base)
        lines = measured_lines(plane, *circles, plane_offset=plane_offset)
        above = circles[0].point - plane.point
        if not values and frame.T_tracker_base[:3, 2] @ above < 0.0:
            raise CalibError(f"joint 1 turns the other way round, seen from the plane. {ORDER}")
    joints, pairs = _axes(sweeps, plane, circles, lines, values, T_axes_base, nominal)
    if arm is not None:
        _check_pairs(pairs, arm)
    found: list[SweepFinding] = []
    for sweep, figure in zip(sweeps.sweeps, [plane, *circles], strict=True):
        found += findings(sweep, figure)
    return replace(frame, joints=joints, pairs=pairs, findings=tuple(found))


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
        T_axes_base: Pose of the base in the frame of the axes as it was while joint 2 was swept, shape (4, 4) [m];
            None: the frame of the axes is the base.

    Returns:
        The base frame, without axes, pairs and findings.

    Raises:
        CalibError: Plane and axes do not determine it.
    """
    X = np.eye(4) if T_axes_base is None else T_axes_base
    figures = (plane, first, second)
    lines = measured_lines(*figures, plane_offset=plane_offset)
    T = axes_frame(*lines) @ X

    def twist(displaced: Sequence[Line]) -> Array:
        """Return the frame's displacement with that of plane and axes, as a twist in its own axes."""
        M = rigid_inverse(T) @ axes_frame(*displaced) @ X
        rotation = 0.5 * (M - M.T)[[2, 0, 1], [1, 2, 0]]
        return np.concatenate([M[:3, 3], rotation])

    parts = np.array(propagate(twist, lines, figures))
    covariance = parts.sum(axis=0)
    # Welch's degrees of freedom, see the module's text; infinite if the noise was given.
    share = np.diagonal(parts, axis1=1, axis2=2) / np.diag(covariance)
    dof_of_figures = np.array([figure.dof for figure in figures])
    with np.errstate(divide="ignore"):
        dof = 1.0 / np.sum(share**2 / dof_of_figures[:, None], axis=0)
    return BaseFrame(read_only(T), read_only(covariance), read_only(dof), plane)


def _axes(
    sweeps: Sweeps,
    plane: Plane,
    circles: Sequence[Circle],
    lines: Sequence[Line],
    values: Sequence[Array],
    T_axes_base: Array,
    nominal: Sequence[Line] | None,
) -> tuple[tuple[JointAxis, ...], tuple[AxisPair, ...]]:
    """Return the axes of the n swept joints in the base, and angle and distance of each and the next, with their noise.

    The lines are the mounting plane and the axes in the tracker's frame; values are the mean joint values of each
    sweep, [rad], or empty; nominal axes are at zero in the base, None without a robot.
    """

    def numbers(displaced: Sequence[Line]) -> Array:
        """Return points and directions of all axes in the base, (6 n,), then angle and distance of each pair."""
        T_tracker_base = axes_frame(*displaced[:3]) @ T_axes_base
        T_base_tracker = rigid_inverse(T_tracker_base)
        axes = [axis.seen_from(T_base_tracker) for axis in displaced[1:]]
        axes_at_zero = turn_to_zero(displaced[1:], values)
        neighbours = [between(first, second) for first, second in pairwise(axes_at_zero)]
        return np.concatenate([np.ravel(axes), *neighbours])

    vector = numbers(lines)
    covariance = np.sum(propagate(numbers, lines, [plane, *circles]), axis=0)
    std = np.sqrt(np.diag(covariance))

    joints = []
    for k, (sweep, circle) in enumerate(zip(sweeps.sweeps[1:], circles, strict=True)):
        block = slice(6 * k, 6 * k + 6)
        point, direction = read_only(vector[block].reshape(2, 3))
        axis_covariance = read_only(covariance[block, block])
        name = sweeps.label(k)
        joints.append(JointAxis(name, circle, sweep.rows, point, direction, axis_covariance))

    pairs = []
    neighbours = vector[6 * len(circles) :].reshape(-1, 2).tolist()
    neighbours_std = std[6 * len(circles) :].reshape(-1, 2).tolist()
    for k, (first, second) in enumerate(pairwise(joints)):
        angle_nominal, distance_nominal = np.nan, np.nan
        if nominal is not None:
            angle_nominal, distance_nominal = between(nominal[k], nominal[k + 1])
        angle, distance = neighbours[k]
        angle_std, distance_std = neighbours_std[k]
        pairs.append(
            AxisPair(
                joints=(first.name, second.name),
                angle=angle,
                distance=distance,
                angle_std=angle_std,
                distance_std=distance_std,
                angle_nominal=angle_nominal,
                distance_nominal=distance_nominal,
            )
        )
    return tuple(joints), tuple(pairs)


def _check_pairs(pairs: Sequence[AxisPair], robot: Robot) -> None:
    """Refuse axes whose angles or distances no calibration of the robot explains; raises `MeasurementError`."""
    for pair in pairs:
        difference = abs(abs(pair.distance) - abs(pair.distance_nominal))
        is_far = difference > DISTANCE_M + _SIGMAS * pair.distance_std
        if not is_far and abs(pair.angle - pair.angle_nominal) <= ANGLE_RAD:
            continue
        remedy = (
            "One of the two sweeps is of another joint, or it is another robot or chain: check what was turned, and "
            "--robot, --base."
        )
        if not is_far and abs(np.pi - pair.angle - pair.angle_nominal) < ANGLE_RAD:
            remedy = f"One of the two turns the other way round, or its joint's sign is not the URDF's. {ORDER}"
        raise MeasurementError(
            f"The axes of {choices(pair.joints)} are {np.degrees(pair.angle):.1f} deg and {1e3 * pair.distance:.1f} mm "
            f"apart; in the URDF of '{robot.name}' from '{robot.base}' to '{robot.tip}' they are "
            f"{np.degrees(pair.angle_nominal):.1f} deg and {1e3 * pair.distance_nominal:.1f} mm. {remedy}"
        )


@contextmanager
def _at(where: str) -> Iterator[None]:
    """Turn a `CalibError` of the block into a `MeasurementError` whose message begins with the place."""
    try:
        yield
    except CalibError as error:
        raise MeasurementError(f"{where}: {str(error).rstrip('.')}.") from error
