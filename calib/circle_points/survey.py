"""Circle-point analysis: every swept joint's axis, the base frame from the first two, and the geometry that follows.

Each joint's axis is that of the circle which its sweep draws. Seen from the base, the axes are a first estimate of the
robot's DH rows, beside which stand those of the URDF. Where joints above were not at zero during a sweep, and the table
says so, the axis is turned back about theirs first:

    axis_k(0) = exp(-S_(k-1) q_(k-1)) ... exp(-S_1 q_1) axis_k(q),   S_j: the screw of axis_j(0)

"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import ndtr

from calib.circle_points.fits import LEVEL, Circle, Plane, fit_circle, fit_plane
from calib.circle_points.frame import (
    NUMBERS,
    PARALLEL_RAD,
    BaseFrame,
    Line,
    Nominal,
    axes_frame,
    axis_rows,
    frame_of,
    lines_of,
    nominal_axes,
    nominal_axes_frame,
    propagated,
)
from calib.circle_points.sweeps import (
    ORDER,
    Sweep,
    Sweeps,
    Turning,
    check_joint,
    positive,
    turning,
)
from calib.data.measurements import Measurements
from calib.errors import CalibError, MeasurementError, choices
from calib.fields import Key, Layout
from calib.robot.robot import Robot, read_only, rigid_inverse

Array = NDArray[np.float64]

#: Of the table for JSON; a number behind it changes with the meaning of a key.
SCHEMA = "base-frame 2"

#: No robot is built, and mounted, with axes that stand this much otherwise to each other than in its URDF; to the
#: distance come so many standard deviations of the circles' centres.
ANGLE_RAD, DISTANCE_M, _SIGMAS = float(np.radians(5.0)), 20e-3, 6.0


@dataclass(frozen=True, slots=True)
class Finding:
    """What is not as it should be of a sweep: a code, where, and its numbers [mm, mrad].

    Codes are ``downwards`` (axis 1), ``gross``, ``radial`` and ``axial`` (neighbours err alike), ``scatter``, ``gain``
    and ``eccentricity``.
    """

    code: str
    where: str
    values: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class JointAxis:
    """The axis of a joint as its sweep shows it."""

    joint: int  #: Its number in the chain, from 0
    name: str  #: What to call it
    #: In the tracker's frame, its normal in the joint's positive sense: centre and normal are the axis
    circle: Circle
    rows: tuple[int, ...]  #: The points' numbers in the file
    point: Array  #: The circle's centre in the base, shape (3,) [m]
    direction: Array  #: Its normal in the base, shape (3,)
    #: shape (6, 6), of point [m] and direction in the base, the base's own uncertainty included
    covariance: Array
    turning: Turning | None  #: How well the joint turned; None without joint values


@dataclass(frozen=True, slots=True, eq=False)
class AxisRow:
    """The DH row from one joint's axis to the next: a, alpha, d, theta, beta, as in `calib.model.dh.DHRow`, shape (5,).

    Standard deviations are 0 for what is zero by convention; ``nominal`` is the URDF's row, None without one.
    """

    joint: str
    values: Array
    std: Array
    nominal: Array | None


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What the sweeps say."""

    frame: BaseFrame  #: The base frame
    plane: Plane  #: The mounting plane as measured, in the tracker's frame
    joints: tuple[JointAxis, ...]  #: The swept joints, in the order of the chain
    #: The DH rows of the joints that follow each other from the first one
    rows: tuple[AxisRow, ...]
    #: Whether these are at the joints' zero; else at the pose in which the sweeps were measured
    at_zero: bool
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
    nominal = None if robot is None else nominal_axes(robot)
    by_joint = {sweep.joint: sweep for sweep in sweeps.sweeps}
    missing = [sweeps.label(k) for k in (0, 1) if k not in by_joint]
    if missing or None not in by_joint:
        raise MeasurementError(
            f"{sweeps.source}: the sweeps are {choices(s.name for s in sweeps.sweeps)}. A base frame needs points on "
            f"the mounting plane, 'plane', and sweeps of '{sweeps.label(0)}' and '{sweeps.label(1)}'."
        )
    touched = by_joint.pop(None)
    swept = [(joint, sweep) for joint, sweep in by_joint.items() if joint is not None]
    with _at(touched.where):
        plane = fit_plane(touched.points, touched.sigma, robust=robust)
    circles = []
    for _, sweep in swept:
        check_joint(sweep, sweeps.joint_names)
        with _at(sweep.where):
            circle = fit_circle(sweep.points, sweep.sigma, robust=robust)
        circles.append(positive(sweep, circle))
    run = next((i for i, (k, _) in enumerate(swept) if i != k), len(swept))
    given = [sweep.joints.mean(axis=0) for _, sweep in swept if sweep.joints is not None]
    values = given if len(given) == len(swept) else None
    X = np.eye(4) if nominal is None else rigid_inverse(nominal_axes_frame(nominal))
    if values is not None:
        back = np.eye(4)
        back[:3, :3] = Rotation.from_rotvec([0.0, 0.0, -values[1][0]]).as_matrix()
        X = back @ X
    with _at(f"{sweeps.source}, plane and sweeps of the joints 1 and 2"):
        frame = frame_of(plane, *circles[:2], plane_offset=plane_offset, T_axes_base=X)
        lines = lines_of(plane, *circles, plane_offset=plane_offset)
    table = None if nominal is None else nominal.table

    def geometry(displaced: Sequence[Line]) -> Array:
        """Points and directions of all axes in the base, then the DH rows, as one vector."""
        T = rigid_inverse(axes_frame(*displaced[:3]) @ X)
        home = [axis.moved(T) for axis in _at_zero(displaced[1 : run + 1], values)]
        axes = [axis.moved(T) for axis in displaced[1:]]
        return np.concatenate([np.ravel(axes), axis_rows(home, table).ravel()])

    found = _side(swept[0][1], plane, circles[0], robot)
    if robot is not None and nominal is not None:
        _check_pairs(sweeps, robot, nominal, _at_zero(lines[1 : run + 1], values), circles)
    numbers = read_only(geometry(lines))
    covariance = read_only(np.sum(propagated(geometry, lines, [plane, *circles]), axis=0))
    axes, found = [], [*found, *findings(touched, plane)]
    for k, ((joint, sweep), circle) in enumerate(zip(swept, circles, strict=True)):
        place, turned = slice(6 * k, 6 * k + 6), turning(sweep, circle)
        point, direction = numbers[place].reshape(2, 3)
        name, own = sweeps.label(joint), covariance[place, place]
        axes.append(JointAxis(joint, name, circle, sweep.rows, point, direction, own, turned))
        found += findings(sweep, circle, turned)
    measured = numbers[6 * len(axes) :].reshape(-1, len(NUMBERS))
    std = read_only(np.sqrt(np.diag(covariance))[6 * len(axes) :].reshape(measured.shape))
    wanted = None if nominal is None else axis_rows(nominal.lines, nominal.table)
    rows = tuple(
        AxisRow(sweeps.label(i), row, std[i], None if wanted is None else wanted[i])
        for i, row in enumerate(measured)
    )
    return Survey(frame, plane, tuple(axes), rows, values is not None, tuple(found))


def carried(measurements: Measurements, frame: BaseFrame) -> Measurements:
    """Measurements of the tracker's frame in the base: positions and orientations; all else stays.

    Raises:
        MeasurementError: The rows are of several set-ups, of which each has a frame.
    """
    rows = measurements.positions
    groups = dict.fromkeys(g for g, there in zip(measurements.groups, rows, strict=True) if there)
    if len(groups) > 1:
        raise MeasurementError(
            f"{measurements.source}: the rows are of the set-ups {choices(groups)} (column 'group'), and the sweeps "
            "tell the base frame of one. Carry each set-up with its own sweeps."
        )
    turned = measurements.rotations
    return replace(
        measurements,
        points=frame.carry(measurements.points),
        rotations=None if turned is None else frame.T_base_tracker[:3, :3] @ turned,
    )


def _side(sweep: Sweep, plane: Plane, first: Circle, robot: Robot | None) -> list[Finding]:
    """A finding, or a refusal, where axis 1 does not point from the plane towards its circle, as the URDF's does."""
    height = float((first.point - plane.point) @ plane.normal)
    height *= float(np.sign(first.normal @ plane.normal))
    if robot is not None:
        T = rigid_inverse(robot.T_root_base) @ robot.placements[0]
        height *= float(np.sign((T[:3, :3] @ np.asarray(robot.joints[0].axis))[2]))
    if height < 0.0 and robot is not None and sweep.joints is None:
        raise MeasurementError(
            f"{sweep.where}: seen from the plane the joint turns the other way than in the URDF. {ORDER}"
        )
    return [Finding("downwards", sweep.where)] if height < 0.0 else []


def _check_pairs(
    sweeps: Sweeps,
    robot: Robot,
    nominal: Nominal,
    lines: Sequence[Line],
    circles: Sequence[Circle],
) -> None:
    """Refuse axes at zero, of circles, in any frame, that stand to each other as no two of this robot do."""
    for k in range(len(lines) - 1):
        angle, distance = between(*lines[k : k + 2])
        wanted_angle, wanted_distance = between(*nominal.lines[k : k + 2])
        vague = sum(float(np.trace(c.covariance[:3, :3])) for c in circles[k : k + 2])
        far = abs(distance - wanted_distance) > DISTANCE_M + _SIGMAS * np.sqrt(vague)
        if not far and abs(angle - wanted_angle) <= ANGLE_RAD:
            continue
        remedy = (
            "One of the two sweeps is of another joint, or the robot or its chain is another one: check what was "
            "turned, and --robot, --base."
        )
        if not far and abs(np.pi - angle - wanted_angle) < ANGLE_RAD:
            remedy = f"One of the two turns the other way round, or its joint's sign is not the URDF's. {ORDER}"
        raise MeasurementError(
            f"{sweeps.source}: the axes of '{sweeps.label(k)}' and '{sweeps.label(k + 1)}' are "
            f"{np.degrees(angle):.1f} deg and {1e3 * distance:.1f} mm apart; in the URDF of '{robot.name}' from "
            f"'{robot.base}' to '{robot.tip}' they are {np.degrees(wanted_angle):.1f} deg and "
            f"{1e3 * wanted_distance:.1f} mm. {remedy}"
        )


def between(first: Line, second: Line) -> tuple[float, float]:
    """The angle between two axes, in [0, pi], and their shortest distance [rad, m]."""
    cross = np.cross(first.direction, second.direction)
    sine = float(np.linalg.norm(cross))
    angle = float(np.arctan2(sine, first.direction @ second.direction))
    apart = second.point - first.point
    if sine < np.sin(PARALLEL_RAD):
        return angle, float(np.linalg.norm(np.cross(apart, first.direction)))
    return angle, float(abs(apart @ cross) / sine)


def findings(sweep: Sweep, figure: Plane, turned: Turning | None = None) -> Iterator[Finding]:
    """Gross rows, neighbours that err alike, noise beyond sigma, a joint's own errors."""
    used = figure.used
    off = np.linalg.norm(figure.residuals, axis=1)
    for i in np.flatnonzero(~used):
        where = f"{sweep.source}, {sweep.counted} {sweep.rows[i]} (sweep '{sweep.name}')"
        yield Finding("gross", where, {"off_mm": 1e3 * float(off[i])})
    if isinstance(figure, Circle) and used.sum() >= 10:
        for e, code in zip(figure.residuals[used].T, ("radial", "axial"), strict=True):
            correlation = float(e[1:] @ e[:-1] / (e @ e)) if np.any(e) else 0.0
            if ndtr(-correlation * np.sqrt(len(e))) < 0.5 * LEVEL:
                yield Finding(code, sweep.where, {"correlation": correlation})
    if figure.given is not None and np.isfinite(figure.dof):
        values = {"scatter_mm": 1e3 * figure.noise, "sigma_mm": 1e3 * figure.given}
        yield Finding("scatter", sweep.where, values)
    if turned is not None and turned.gain_found:
        values = {"gain": 1e3 * turned.gain, "std": 1e3 * turned.gain_std}
        yield Finding("gain", sweep.where, values)
    if turned is not None and turned.eccentricity_found:
        values = {"eccentricity": 1e3 * turned.eccentricity, "std": 1e3 * turned.eccentricity_std}
        yield Finding("eccentricity", sweep.where, values)


@contextmanager
def _at(where: str) -> Iterator[None]:
    """An error of what is made in the block says of which sweeps."""
    try:
        yield
    except CalibError as error:
        raise MeasurementError(f"{where}: {error}.") from error


def _at_zero(axes: Sequence[Line], values: Sequence[Array] | None) -> list[Line]:
    """Axes in any frame, turned back to the joints' zero from the values in each one's sweep; see the module's text."""
    result: list[Line] = []
    for k, (point, direction) in enumerate(axes):
        for j, axis in enumerate(result):
            q = 0.0 if values is None else values[k][j]
            R = Rotation.from_rotvec(-q * axis.direction).as_matrix()
            point, direction = axis.point + R @ (point - axis.point), R @ direction
        result.append(Line(point, direction))
    return result


def _frame_table(frame: BaseFrame) -> dict[str, Any]:
    """The base frame for the file."""
    return {
        "T_tracker_base": frame.T_tracker_base,
        "covariance": frame.covariance,
        "region_95": frame.limit(0.95),
        "std_m": frame.std[:3],
        "std_rad": frame.std[3:],
    }


def _named(values: Array | None) -> dict[str, float] | None:
    """The numbers of a DH row by their names and units."""
    if values is None:
        return None
    return {f"{n}_{u}": float(v) for (n, u), v in zip(NUMBERS.items(), values, strict=True)}


_LAYOUT = Layout(
    {
        Survey: {"at_zero": "rows_at_zero"},
        Plane: {
            "point": "point_m",
            "residuals": "residuals_m",
            "noise": "noise_m",
            "given": "sigma_m",
        },
        Circle: {"radius": "radius_m", "angles": "angles_rad"},
        JointAxis: {
            "joint": Key("joint", lambda joint: joint + 1),
            "point": "base.point_m",
            "direction": "base.direction",
            "covariance": "base.covariance",
        },
        AxisRow: {
            "values": Key("measured", _named),
            "std": Key("std", _named),
            "nominal": Key("nominal", _named),
        },
    },
    {BaseFrame: (_frame_table, None)},
)
