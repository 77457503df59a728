"""Circle-point analysis: every swept joint's axis, the base frame from the first two, and the geometry that follows.

Each joint's axis is that of the circle which its sweep draws. Seen from the base, the axes are a first estimate of the
robot's DH rows, beside which stand those of the URDF. Where joints above were not at zero during a sweep, and the table
says so, the axis is turned back about theirs first:

    axis_k(0) = exp(-S_(k-1) q_(k-1)) ... exp(-S_1 q_1) axis_k(q),   S_j: the screw of axis_j(0)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.base_frame import checks
from calib.base_frame.axes import NUMBERS, Line, axis_rows, nominal_axes
from calib.base_frame.fits import Circle, Plane, fit_circle, fit_plane
from calib.base_frame.frame import (
    BaseFrame,
    axes_frame,
    base_frame,
    mounting_plane,
    nominal_axes_frame,
    propagated,
    turned_about_z,
)
from calib.base_frame.sweeps import Sweep, Sweeps
from calib.base_frame.turning import Turning, positive, turning
from calib.errors import CalibError, MeasurementError, choices
from calib.model.robot import Robot, read_only, rigid_inverse

Array = NDArray[np.float64]
_T = TypeVar("_T")


@dataclass(frozen=True, slots=True, eq=False)
class JointAxis:
    """The axis of a joint as its sweep shows it.

    Attributes:
        joint: Its number in the chain, from 0.
        name: What to call it.
        sweep: The points.
        circle: Their circle in the tracker's frame, its normal in the joint's positive sense: centre and normal are the
            axis.
        point: The circle's centre in the base, shape (3,) [m].
        direction: Its normal in the base, shape (3,).
        covariance: shape (6, 6), of point [m] and direction in the base, the base's own uncertainty included.
        turning: How well the joint turned; None without joint values.
    """

    joint: int
    name: str
    sweep: Sweep
    circle: Circle
    point: Array
    direction: Array
    covariance: Array
    turning: Turning | None


@dataclass(frozen=True, slots=True, eq=False)
class AxisRow:
    """The DH row from one joint's axis to the next: a, alpha, d, theta, beta, as in `calib.model.dh.DHRow`.

    Attributes:
        joint: Name of the joint that the row's angle belongs to.
        values: shape (5,) [m, rad].
        std: Their standard deviations; 0 for what is zero by convention.
        nominal: Those of the URDF; None without one.
    """

    joint: str
    values: Array
    std: Array
    nominal: Array | None


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What the sweeps say.

    Attributes:
        frame: The base frame.
        plane: The mounting plane as measured, in the tracker's frame.
        plane_sweep: Its points.
        joints: The swept joints, in the order of the chain.
        rows: The DH rows of the joints that follow each other from the first one.
        at_zero: Whether these are at the joints' zero; else at the pose in which the sweeps were measured.
        findings: Sentences on what is not as it should be.
    """

    frame: BaseFrame
    plane: Plane
    plane_sweep: Sweep
    joints: tuple[JointAxis, ...]
    rows: tuple[AxisRow, ...]
    at_zero: bool
    findings: tuple[str, ...]


def survey(
    sweeps: Sweeps, robot: Robot | None = None, *, plane_offset: float = 0.0, robust: bool = True
) -> Survey:
    """The base frame and all axes from sweeps.

    Args:
        sweeps: Of the plane, of the joints 1 and 2, and of others if they were swept.
        robot: Whose URDF says where the base frame lies on the axes; None: z is axis 1, y axis 2.
        plane_offset: How far the plane's points stand off it, towards the robot: the radius of the ball [m].
        robust: Whether gross rows are left out; they are named either way.

    Raises:
        MeasurementError: A sweep is missing, is not that of its joint, or no figure fits it.
        UrdfError: The robot's chain is not one of turning joints.
    """
    nominal = None if robot is None else nominal_axes(robot)
    touched, swept = _all_there(sweeps)
    plane = _at(touched.where, partial(fit_plane, touched.points, touched.sigma, robust=robust))
    circles = [_circle(sweep, sweeps.joint_names, robust=robust) for sweep in swept]
    joints = [sweep.joint for sweep in swept if sweep.joint is not None]
    run = next((i for i, k in enumerate(joints) if i != k), len(joints))
    given = [sweep.joints.mean(axis=0) for sweep in swept if sweep.joints is not None]
    values = given if len(given) == len(swept) else None
    q1 = 0.0 if values is None else float(values[1][0])
    T_base_axes = np.eye(4) if nominal is None else nominal_axes_frame(*nominal.lines[:2])
    where = f"{sweeps.source}, sweeps {choices(s.name for s in (touched, *swept[:2]))}"
    mounting = _at(where, partial(mounting_plane, plane, circles[0], plane_offset))
    frame = _at(
        where,
        lambda: base_frame(
            plane,
            circles[0],
            circles[1],
            q1=q1,
            plane_offset=plane_offset,
            T_base_axes=T_base_axes,
        ),
    )

    def geometry(plane: Line, axes: Sequence[Line]) -> Array:
        """Points and directions of all axes in the base, then the DH rows, as one vector."""
        T = axes_frame(plane, axes[0], axes[1]) @ turned_about_z(-q1) @ rigid_inverse(T_base_axes)
        home = [axis.moved(rigid_inverse(T)) for axis in _at_zero(axes[:run], values)]
        lines = [axis.moved(rigid_inverse(T)) for axis in axes]
        return np.concatenate([np.ravel(lines), axis_rows(home, nominal).ravel()])

    lines = [Line(circle.center, circle.normal) for circle in circles]
    findings = checks.check_side(swept[0], plane, circles[0], robot)
    if robot is not None and nominal is not None:
        checks.check_pairs(sweeps, robot, nominal, _at_zero(lines[:run], values), circles)
    numbers = geometry(mounting, lines)
    covariance = np.sum(propagated(geometry, plane, mounting, circles), axis=0)
    axes = tuple(
        _axis(sweeps, sweep, circle, numbers[6 * i :], covariance[6 * i :, 6 * i :])
        for i, (sweep, circle) in enumerate(zip(swept, circles, strict=True))
    )
    start = 6 * len(axes)
    found = numbers[start:].reshape(-1, len(NUMBERS))
    std = np.sqrt(np.diag(covariance))[start:].reshape(found.shape)
    rows = tuple(
        AxisRow(
            sweeps.label(i),
            read_only(row),
            read_only(std[i]),
            None if nominal is None else read_only(nominal.rows[i]),
        )
        for i, row in enumerate(found)
    )
    findings += checks.plane_findings(touched, plane)
    for axis in axes:
        findings += checks.circle_findings(axis.sweep, axis.circle, axis.name)
    for axis in axes:
        findings += checks.turning_findings(axis.name, axis.turning)
    return Survey(frame, plane, touched, axes, rows, values is not None, findings)


def _all_there(sweeps: Sweeps) -> tuple[Sweep, list[Sweep]]:
    """The plane's sweep and those of joints; refused without the plane, joint 1 or joint 2."""
    plane = sweeps.find(None)
    missing = [sweeps.label(k) for k in (0, 1) if sweeps.find(k) is None]
    if plane is None or missing:
        wanted = [*([] if plane else ["plane"]), *missing]
        raise MeasurementError(
            f"{sweeps.source}: there is no sweep {choices(wanted)}; there are "
            f"{choices(s.name for s in sweeps.sweeps)}. A base frame needs points on the mounting plane, "
            "a sweep of joint 1 and one of joint 2."
        )
    return plane, [sweep for sweep in sweeps.sweeps if sweep.joint is not None]


def _at(where: str, made: Callable[[], _T]) -> _T:
    """What is made; if it cannot be, the error says of which sweeps."""
    try:
        return made()
    except CalibError as error:
        raise MeasurementError(f"{where}: {error}.") from error


def _circle(sweep: Sweep, joint_names: tuple[str, ...], *, robust: bool) -> Circle:
    """The circle of a sweep, its normal in the joint's positive sense."""
    checks.check_joint(sweep, joint_names)
    checks.check_moves(sweep)
    circle = _at(sweep.where, partial(fit_circle, sweep.points, sweep.sigma, robust=robust))
    return positive(sweep, circle)


def _at_zero(axes: Sequence[Line], values: Sequence[Array] | None) -> list[Line]:
    """Axes that follow each other from the first, turned back to the joints' zero; see the module's text.

    Args:
        axes: In any frame.
        values: Of all joints in each axis's sweep, shape (n,) each [rad]; None: all are at zero.
    """
    result: list[Line] = []
    for k, (point, direction) in enumerate(axes):
        for j, axis in enumerate(result):
            q = 0.0 if values is None else values[k][j]
            R = Rotation.from_rotvec(-q * axis.direction).as_matrix()
            point, direction = axis.point + R @ (point - axis.point), R @ direction
        result.append(Line(point, direction))
    return result


def _axis(
    sweeps: Sweeps, sweep: Sweep, circle: Circle, numbers: Array, covariance: Array
) -> JointAxis:
    """The axis of a joint, from where its numbers begin."""
    assert sweep.joint is not None
    return JointAxis(
        sweep.joint,
        sweeps.label(sweep.joint),
        sweep,
        circle,
        read_only(numbers[:3]),
        read_only(numbers[3:6]),
        read_only(covariance[:6, :6]),
        turning(sweep, circle),
    )
