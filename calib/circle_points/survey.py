"""Circle-point analysis: every swept joint's axis, the base frame from the first two, and the geometry that follows.

Each joint's axis is that of the circle which its sweep draws. Seen from the base, the axes are a first estimate of the
robot's DH rows, beside which stand those of the URDF. Where joints above were not at zero during a sweep, and the table
says so, the axis is turned back about theirs first:

    axis_k(0) = exp(-S_(k-1) q_(k-1)) ... exp(-S_1 q_1) axis_k(q),   S_j: the screw of axis_j(0)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.circle_points import checks
from calib.circle_points.checks import Finding, Turning, positive, turning
from calib.circle_points.fits import Circle, Plane, fit_circle, fit_plane
from calib.circle_points.frame import (
    NUMBERS,
    BaseFrame,
    Line,
    axes_frame,
    axis_rows,
    frame_of,
    mounting_plane,
    nominal_axes,
    nominal_axes_frame,
    propagated,
    turned_about_z,
)
from calib.circle_points.sweeps import Sweep, Sweeps
from calib.errors import CalibError, MeasurementError, choices
from calib.robot.robot import Robot, read_only, rigid_inverse

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class JointAxis:
    """The axis of a joint as its sweep shows it."""

    joint: int  #: Its number in the chain, from 0
    name: str  #: What to call it
    sweep: Sweep  #: The points
    #: Their circle in the tracker's frame, its normal in the joint's positive sense: centre and normal are the axis
    circle: Circle
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
    plane_sweep: Sweep  #: Its points
    joints: tuple[JointAxis, ...]  #: The swept joints, in the order of the chain
    #: The DH rows of the joints that follow each other from the first one
    rows: tuple[AxisRow, ...]
    #: Whether these are at the joints' zero; else at the pose in which the sweeps were measured
    at_zero: bool
    findings: tuple[Finding, ...]  #: What is not as it should be


def base_frame(
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
    with _at(touched.where):
        plane = fit_plane(touched.points, touched.sigma, robust=robust)
    circles = []
    for sweep in swept:
        checks.check_joint(sweep, sweeps.joint_names)
        with _at(sweep.where):
            circle = fit_circle(sweep.points, sweep.sigma, robust=robust)
        circles.append(positive(sweep, circle))
    joints = [sweep.joint for sweep in swept if sweep.joint is not None]
    run = next((i for i, k in enumerate(joints) if i != k), len(joints))
    given = [sweep.joints.mean(axis=0) for sweep in swept if sweep.joints is not None]
    values = given if len(given) == len(swept) else None
    q1 = 0.0 if values is None else float(values[1][0])
    T_base_axes = np.eye(4) if nominal is None else nominal_axes_frame(*nominal.lines[:2])
    with _at(f"{sweeps.source}, sweeps {choices(s.name for s in (touched, *swept[:2]))}"):
        mounting = mounting_plane(plane, circles[0], plane_offset)
        frame = frame_of(
            plane, *circles[:2], q1=q1, plane_offset=plane_offset, T_base_axes=T_base_axes
        )

    def geometry(plane: Line, axes: Sequence[Line]) -> Array:
        """Points and directions of all axes in the base, then the DH rows, as one vector."""
        T = axes_frame(plane, axes[0], axes[1]) @ turned_about_z(-q1) @ rigid_inverse(T_base_axes)
        home = [axis.moved(rigid_inverse(T)) for axis in _at_zero(axes[:run], values)]
        lines = [axis.moved(rigid_inverse(T)) for axis in axes]
        return np.concatenate([np.ravel(lines), axis_rows(home, nominal).ravel()])

    lines = [Line(circle.point, circle.normal) for circle in circles]
    findings = [*checks.side_findings(swept[0], plane, circles[0], robot)]
    if robot is not None and nominal is not None:
        checks.check_pairs(sweeps, robot, nominal, _at_zero(lines[:run], values), circles)
    numbers = read_only(geometry(mounting, lines))
    covariance = read_only(np.sum(propagated(geometry, plane, mounting, circles), axis=0))
    axes = tuple(
        JointAxis(
            joint,
            sweeps.label(joint),
            sweep,
            circle,
            numbers[k : k + 3],
            numbers[k + 3 : k + 6],
            covariance[k : k + 6, k : k + 6],
            turning(sweep, circle),
        )
        for k, joint, sweep, circle in zip(
            range(0, 6 * len(swept), 6), joints, swept, circles, strict=True
        )
    )
    found = numbers[6 * len(axes) :].reshape(-1, len(NUMBERS))
    std = read_only(np.sqrt(np.diag(covariance))[6 * len(axes) :].reshape(found.shape))
    rows = tuple(
        AxisRow(sweeps.label(i), row, std[i], None if nominal is None else nominal.rows[i])
        for i, row in enumerate(found)
    )
    findings += checks.findings(touched, plane)
    for axis in axes:
        findings += checks.findings(axis.sweep, axis.circle, axis.turning)
    return Survey(frame, plane, touched, axes, rows, values is not None, tuple(findings))


def _all_there(sweeps: Sweeps) -> tuple[Sweep, list[Sweep]]:
    """The plane's sweep and those of joints; refused without the plane, joint 1 or joint 2."""
    by_joint = {sweep.joint: sweep for sweep in sweeps.sweeps}
    missing = [sweeps.label(k) for k in (0, 1) if k not in by_joint]
    wanted = [*(["plane"] if None not in by_joint else []), *missing]
    if wanted:
        raise MeasurementError(
            f"{sweeps.source}: there is no sweep {choices(wanted)}; there are "
            f"{choices(s.name for s in sweeps.sweeps)}. A base frame needs points on the mounting plane, "
            "a sweep of joint 1 and one of joint 2."
        )
    return by_joint[None], [sweep for sweep in sweeps.sweeps if sweep.joint is not None]


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
