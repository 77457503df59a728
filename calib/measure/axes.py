"""Circle-point analysis: every swept joint's axis, the base frame from the first two, and the geometry that follows.

Each joint's axis is that of the circle which its sweep draws. Seen from the base, the axes are a first estimate of the
robot's DH rows, beside which stand those of the URDF. Where joints above were not at zero during a sweep, and the table
says so, the axis is turned back about theirs first:

    axis_k(0) = exp(-S_(k-1) q_(k-1)) ... exp(-S_1 q_1) axis_k(q),   S_j: the screw of axis_j(0)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calib.errors import CalibError, MeasurementError, choices
from calib.measure import axis_checks
from calib.measure.axis_geometry import NUMBERS, Nominal, axis_rows, nominal_axes
from calib.measure.base_frame import (
    BaseFrame,
    Line,
    axes_frame,
    axis_line,
    base_frame,
    mounting_plane,
    nominal_axes_frame,
    turned_about_z,
)
from calib.measure.geometric_fits import Circle, Plane, fit_circle, fit_plane
from calib.measure.sweep_findings import circle_findings, plane_findings
from calib.measure.sweeps import Sweep, Sweeps
from calib.measure.turning import Turning, check_joint, positive, turning
from calib.model.robot import Robot, read_only, rigid_inverse

Array = NDArray[np.float64]

# Of the central differences that the DH rows are propagated with [m, rad]: they are smooth over centimetres.
_STEP = 1e-6


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
    plane_sweep, numbers = _all_there(sweeps)
    plane = _fitted_plane(plane_sweep, robust=robust)
    circles = {}
    for k in numbers:
        sweep = _sweep(sweeps, k)
        check_joint(sweep, sweeps.joint_names)
        circles[k] = positive(sweep, _fitted_circle(sweep, robust=robust))
    setup = _Setup.of(sweeps, numbers, nominal, plane, circles[0], plane_offset)
    try:
        frame = base_frame(
            plane,
            circles[0],
            circles[1],
            q1=setup.q1,
            plane_offset=plane_offset,
            T_base_axes=setup.T_base_axes,
        )
    except CalibError as error:
        where = ", ".join(f"'{_sweep(sweeps, k).name}'" for k in (0, 1))
        message = f"{sweeps.source}, sweeps '{plane_sweep.name}', {where}: {error}."
        raise MeasurementError(message) from error
    lines = [axis_line(circles[k]) for k in numbers]
    findings = axis_checks.check_side(sweeps, plane, circles[0], robot)
    if robot is not None and nominal is not None:
        home = setup.at_zero(lines)
        axis_checks.check_pairs(sweeps, robot, nominal, home, [circles[k] for k in numbers])
    values, covariance = _propagated(setup, plane, [circles[k] for k in numbers])
    joints = tuple(
        _joint_axis(sweeps, k, circles[k], values[6 * i :], covariance[6 * i :, 6 * i :])
        for i, k in enumerate(numbers)
    )
    start = 6 * len(numbers)
    std = np.sqrt(np.diag(covariance))[start:].reshape(-1, len(NUMBERS))
    rows = tuple(
        AxisRow(
            sweeps.label(i),
            read_only(row),
            read_only(std[i]),
            None if nominal is None else read_only([getattr(nominal.rows[i], n) for n in NUMBERS]),
        )
        for i, row in enumerate(values[start:].reshape(-1, len(NUMBERS)))
    )
    findings += plane_findings(plane_sweep, plane, ~_fitted_plane(plane_sweep, robust=True).used)
    for k in numbers:
        sweep = _sweep(sweeps, k)
        gross = ~circles[k].used if robust else ~_fitted_circle(sweep, robust=True).used
        findings += circle_findings(sweep, circles[k], sweeps.label(k), gross)
    for joint in joints:
        findings += axis_checks.turning_findings(joint.name, joint.turning)
    return Survey(frame, plane, plane_sweep, joints, rows, setup.values is not None, findings)


def _all_there(sweeps: Sweeps) -> tuple[Sweep, list[int]]:
    """The plane's sweep, and the joints that were swept; refused without the plane, joint 1 or joint 2."""
    plane = sweeps.find(None)
    numbers = [s.joint for s in sweeps.sweeps if s.joint is not None]
    missing = [sweeps.label(k) for k in (0, 1) if k not in numbers]
    if plane is None or missing:
        wanted = [*([] if plane else ["plane"]), *missing]
        message = (
            f"{sweeps.source}: there is no sweep {choices(wanted)}; there are "
            f"{choices(s.name for s in sweeps.sweeps)}. A base frame needs points on the mounting plane, "
            "a sweep of joint 1 and one of joint 2."
        )
        raise MeasurementError(message)
    return plane, numbers


def _sweep(sweeps: Sweeps, joint: int) -> Sweep:
    """The sweep of a joint that was swept."""
    sweep = sweeps.find(joint)
    assert sweep is not None
    return sweep


def _fitted_plane(sweep: Sweep, *, robust: bool) -> Plane:
    """The plane of a sweep; what is wrong says where."""
    try:
        return fit_plane(sweep.points, sweep.sigma, robust=robust)
    except CalibError as error:
        message = f"{sweep.where}: {error}."
        raise MeasurementError(message) from error


def _fitted_circle(sweep: Sweep, *, robust: bool) -> Circle:
    """The circle of a sweep, of points that move; what is wrong says where."""
    axis_checks.check_moves(sweep)
    try:
        return fit_circle(sweep.points, sweep.sigma, robust=robust)
    except CalibError as error:
        message = f"{sweep.where}: {error}."
        raise MeasurementError(message) from error


@dataclass(frozen=True, slots=True, eq=False)
class _Setup:
    """What leads from plane and axes in the tracker's frame to the geometry in the base.

    Attributes:
        numbers: The joints of the axes, from 0.
        run: How many of them follow each other from the first.
        values: Values of all joints in each axis's sweep, shape (axes, n) [rad]; None where not given.
        nominal: What the URDF says.
        T_base_axes: The frame of axes 1 and 2 in the base, shape (4, 4).
        lower: How far the mounting plane lies below the measured one, against its normal [m].
    """

    numbers: list[int]
    run: int
    values: Array | None
    nominal: Nominal | None
    T_base_axes: Array
    lower: float

    @classmethod
    def of(
        cls,
        sweeps: Sweeps,
        numbers: list[int],
        nominal: Nominal | None,
        plane: Plane,
        first: Circle,
        offset: float,
    ) -> _Setup:
        """From the sweeps and the URDF.

        Raises:
            MeasurementError: The circle of joint 1 lies too near to the plane for an offset.
        """
        run = next((i for i, k in enumerate(numbers) if i != k), len(numbers))
        given = [_sweep(sweeps, k).joints for k in numbers]
        values = [v.mean(axis=0) for v in given if v is not None]
        try:
            lowered = mounting_plane(plane, first, offset)
        except CalibError as error:
            message = f"{sweeps.source}, sweep '{_sweep(sweeps, 0).name}': {error}."
            raise MeasurementError(message) from error
        return cls(
            numbers,
            run,
            np.array(values) if len(values) == len(numbers) else None,
            nominal,
            np.eye(4) if nominal is None else nominal_axes_frame(*nominal.lines[:2]),
            float((plane.point - lowered.point) @ plane.normal),
        )

    @property
    def q1(self) -> float:
        """Joint 1 while joint 2 was swept [rad]."""
        return 0.0 if self.values is None else float(self.values[1, 0])

    def at_zero(self, lines: Sequence[Line]) -> list[Line]:
        """The axes that follow each other from the first, turned back to the joints' zero; see the module's text."""
        result: list[Line] = []
        for k, (point, direction) in enumerate(lines[: self.run]):
            for j, axis in enumerate(result):
                q = 0.0 if self.values is None else self.values[k, j]
                R = Rotation.from_rotvec(-q * axis.direction).as_matrix()
                point, direction = axis.point + R @ (point - axis.point), R @ direction
            result.append(Line(point, direction))
        return result

    def geometry(self, plane: Line, lines: Sequence[Line]) -> Array:
        """Points and directions of all axes in the base, then the DH rows, as one vector."""
        T = axes_frame(plane, lines[0], lines[1]) @ turned_about_z(-self.q1)
        T = rigid_inverse(T @ rigid_inverse(self.T_base_axes))

        def in_base(line: Line) -> Line:
            return Line(T[:3, :3] @ line.point + T[:3, 3], T[:3, :3] @ line.direction)

        rows = axis_rows([in_base(line) for line in self.at_zero(lines)], self.nominal)
        return np.concatenate([np.ravel([in_base(line) for line in lines]), rows.ravel()])


def _propagated(setup: _Setup, plane: Plane, circles: Sequence[Circle]) -> tuple[Array, Array]:
    """The geometry and its covariance, by central differences over plane and axes."""
    lines = [axis_line(circle) for circle in circles]
    lowered = Line(plane.point - setup.lower * plane.normal, plane.normal)
    values = setup.geometry(lowered, lines)
    covariance = np.zeros((len(values), len(values)))
    figures: list[tuple[Array, Array]] = [
        (plane.basis, plane.covariance),
        *((circle.basis, circle.covariance[:5, :5]) for circle in circles),
    ]
    for i, (basis, C) in enumerate(figures):
        columns = []
        for k in range(len(C)):
            both = []
            for step in (_STEP, -_STEP):
                moved = [lowered, *lines]
                moved[i] = _displaced(moved[i], basis, k - len(C) + 2, step)
                both.append(setup.geometry(moved[0], moved[1:]))
            columns.append((both[0] - both[1]) / (2.0 * _STEP))
        D = np.column_stack(columns)
        covariance += D @ C @ D.T
    return values, covariance


def _displaced(line: Line, basis: Array, tilt: int, step: float) -> Line:
    """A line displaced along a column of its basis (tilt below 0, the last for -1), or tilted towards u or v (0, 1)."""
    if tilt < 0:
        return Line(line.point + step * basis[:, tilt], line.direction)
    direction = line.direction + step * basis[:, tilt]
    return Line(line.point, direction / np.linalg.norm(direction))


def _joint_axis(
    sweeps: Sweeps, joint: int, circle: Circle, values: Array, covariance: Array
) -> JointAxis:
    """The axis of a joint, from where its numbers begin."""
    sweep = _sweep(sweeps, joint)
    return JointAxis(
        joint,
        sweeps.label(joint),
        sweep,
        circle,
        read_only(values[:3]),
        read_only(values[3:6]),
        read_only(covariance[:6, :6]),
        turning(sweep, circle),
    )
