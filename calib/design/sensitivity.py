"""Foresight: what the fit of a robot in a cell would learn from poses, before any is measured.

The same rows, error model and priors as the fit's: planning takes them as two callables and a vector, see
`calib.design.forecast.Sensitivity`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

import calib.kinds as registry
from calib.design.candidates import planning_ranges
from calib.design.forecast import Forecast, Sensitivity, Workspace
from calib.design.forecast import forecast as forecast_of
from calib.errors import MeasurementError, ModelError, choices
from calib.families import FAMILIES
from calib.identify.estimate import FIRST_SIGMA_ANGLE
from calib.identify.fitting import Task, model_of
from calib.identify.inspection import GENERIC_TARGET
from calib.identify.registration import register
from calib.identify.rigid_motion import without_rigid_motion
from calib.identify.rows import Rows
from calib.identify.setup import Setup, along_own_axes, setup_of, targets_along_tip
from calib.identify.table_rows import rows_of
from calib.measure.cell import AUTO, Cell
from calib.measure.columns import DEFAULT_TARGET
from calib.measure.measurements import Measurements
from calib.measure.noise import TrackerNoise
from calib.model.kinematics import Kinematics, Samples
from calib.model.readback import spread_between
from calib.model.robot import Robot, read_only
from calib.model.torques import gravity_load

Array = NDArray[np.float64]

#: What `auto` is planned for: the largest geometry, so that every smaller one is covered.
PLANNED_FOR_AUTO = "placement"

#: The distance of an instrument of which nothing is said [m].
_USUAL_DISTANCE = 3.0

#: Kinds that poses can be planned for.
KINDS = ("point", "pose", "distance")

#: Poses whose derivatives are computed together.
_CHUNK = 8192

#: Poses over which a forecast without a plan is made.
_POSES = 4096


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """A robot in a cell, as the fit would see it.

    Attributes:
        robot: The nominal robot.
        cell: The cell.
        kind: What is measured at each pose.
        setup: Frames and targets; a target that was not given stands at a general place.
        kinematics: Under the model that the fit will use.
        notes: What was assumed, in sentences.
    """

    robot: Robot
    cell: Cell
    kind: str
    setup: Setup
    kinematics: Kinematics
    notes: tuple[str, ...]

    @classmethod
    def of(cls, robot: Robot, cell: Cell) -> Outlook:
        """The fit's model of a robot in a cell.

        Raises:
            ModelError: An unknown parameter set or parameter, or a kind or cell that cannot be planned for.
        """
        kind = _checked_kind(cell)
        cell = replace(cell, distances=())
        names = tuple(cell.targets) or (DEFAULT_TARGET,)
        group = next(iter(cell.frames), "")
        table = Measurements(
            joint_names=robot.joint_names,
            joints=np.zeros((len(names), len(robot.inputs))),
            points=np.zeros((len(names), 3)),
            rotations=np.tile(np.eye(3), (len(names), 1, 1)),
            distances=np.ones(len(names)),
            kinds=(kind,) * len(names),
            targets=names,
            groups=(group,) * len(names),
            prismatic=tuple(joint.name for joint in robot.inputs if joint.type == "prismatic"),
        )
        setup = setup_of(cell, table, np.full(len(names), registry.names().index(kind)))
        notes = []
        if not np.all(setup.target_given):
            T_tip_target = setup.T_tip_target.copy()
            T_tip_target[~setup.target_given, :3, 3] = GENERIC_TARGET
            setup = setup.placed(setup.T_frame_base, T_tip_target)
            notes.append(
                "No target was given: planned for one that is 50, 70, 30 mm off the tip. --target says where yours is."
            )
        if kind == "pose" and cell.sigma_angle is None:
            notes.append(
                f"The noise of an orientation was taken to be {1e3 * FIRST_SIGMA_ANGLE:g} mrad about each axis. "
                "sigma_angle_deg in the cell says what yours is."
            )
        model = model_of(Task(robot, cell, setup, planned_model(cell), lenient=cell.model == AUTO))
        model = targets_along_tip(along_own_axes(model, setup), setup)
        if cell.model != AUTO:
            for wanted in (*cell.parameter_priors, *cell.bounds):
                model.index(wanted)
        kinematics = Kinematics(robot, model, setup.T_frame_base, setup.T_tip_target)
        return cls(robot, cell, kind, setup, kinematics, tuple(notes))

    @property
    def sensitivity(self) -> Sensitivity:
        """What planning and forecasts take."""
        model = self.kinematics.model
        return Sensitivity(
            names=model.names,
            units=model.units,
            measured=self._measured,
            located=self._located,
            noise=self._noise,
            precision=_precision(self),
            model=model.name,
        )

    def expected(self, q: Array) -> Array:
        """Where the nominal robot puts each target in the measurement frame, shape (N, targets, 3), [m].

        A measurement frame that is not known counts as the base.
        """
        poses = self.kinematics.poses(np.zeros(len(self.kinematics.model)), self._samples(q))
        return np.asarray(poses[:, :3, 3].reshape(len(q), -1, 3))

    def _samples(self, q: Array) -> Samples:
        """Every target at every pose, pose by pose."""
        k = len(self.setup.targets)
        needed = any(p.factor and p.factor.loaded for p in self.kinematics.model.parameters)
        load = gravity_load(self.robot, q, self.cell.payload, self.cell.gravity) if needed else None
        return Samples(
            q=np.repeat(q, k, axis=0),
            frame=np.zeros(k * len(q), dtype=np.int_),
            target=np.tile(np.arange(k), len(q)),
            load=None if load is None else np.repeat(load, k, axis=0),
        )

    def _rows(self, samples: Samples, noise: Array) -> Rows:
        """Rows of the kind that is planned for, without values."""
        n = len(samples)
        angle = self.cell.sigma_angle or FIRST_SIGMA_ANGLE
        return Rows(
            samples=samples,
            kinds=np.full(n, registry.names().index(self.kind)),
            measured=np.zeros((n, registry.get(self.kind).size)),
            partner=np.full(n, -1),
            sigma=noise,
            sigma_angle=np.full(n, angle),
            poses=np.arange(n),
            blocks=np.arange(n),
        )

    def _measured(self, q: Array) -> Array:
        """The derivative of what is measured at poses, in standard deviations, shape (n, d, p)."""
        x = np.zeros(len(self.kinematics.model))
        parts = []
        for chunk in _chunks(q):
            samples = self._samples(chunk)
            poses, twists = self.kinematics.twists(x, samples)
            rows = self._rows(samples, np.repeat(self._noise(chunk), len(self.setup.targets)))
            rows = rows.as_measured_at(poses)
            slopes = rows.derivative(poses, twists) / rows.scales[:, :, None]
            slopes = slopes.reshape(len(chunk), len(self.setup.targets), -1, len(x))
            slopes = self._shared_out(slopes, self._noise(chunk))
            parts.append(slopes.reshape(len(chunk), -1, len(x)))
        return np.concatenate(parts)

    def _shared_out(self, slopes: Array, noise: Array) -> Array:
        """The same where targets of one stop share the robot's repeatability r, shapes (n, targets, width, p), (n,).

        Of k targets with the noise s each, the mean has the variance s^2 / k (1 + (k - 1) rho), rho = r^2 / s^2. What
        they say of each other is exacter than s; a fit, to which rows are independent, makes no use of that.
        """
        k = slopes.shape[1]
        if k == 1 or not registry.get(self.kind).position or self.cell.sigma is not None:
            return slopes
        rho = (self._instrument.repeatability / noise) ** 2
        shared = slopes[:, :, :3].mean(axis=1, keepdims=True)
        less = 1.0 - 1.0 / np.sqrt(1.0 + (k - 1) * rho)
        result: Array = slopes.copy()
        result[:, :, :3] -= less[:, None, None, None] * shared
        return result

    @property
    def _instrument(self) -> TrackerNoise:
        """The noise of the cell's tracker, or of a usual one."""
        return TrackerNoise() if self.cell.tracker is None else self.cell.tracker.noise

    def _located(self, q: Array) -> Array:
        """The derivative of the targets' predicted positions, shape (n, 3 k, p).

        Distances do not tell where the base stands: what one rigid motion of all these positions does is left out.
        """
        x = np.zeros(len(self.kinematics.model))
        pairs = [self.kinematics.points_jacobian(x, self._samples(chunk)) for chunk in _chunks(q)]
        points = np.concatenate([one for one, _ in pairs])
        slopes = np.concatenate([one for _, one in pairs])
        if self.kind == "distance":
            slopes = without_rigid_motion(points, slopes)
        return slopes.reshape(len(q), -1, len(x))

    def _noise(self, q: Array) -> Array:
        """Standard deviation of one coordinate, or of the length from the anchor, at poses, shape (n,), [m]."""
        if self.cell.sigma is not None:
            return np.full(len(q), self.cell.sigma)
        tracker = self.cell.tracker
        if self.kind == "distance":
            return np.asarray(self._instrument.std(np.linalg.norm(self.expected(q)[:, 0], axis=1)))
        if tracker is None:
            return np.full(len(q), self._instrument.std(_USUAL_DISTANCE))
        poses = self.robot.poses(q) @ self.setup.T_tip_target[0]
        return np.asarray(
            tracker.noise.std(np.linalg.norm(poses[:, :3, 3] - tracker.position, axis=1))
        )


def planned_model(cell: Cell) -> str:
    """The parameter set that is planned for: the cell's, or what stands for ``"auto"``."""
    return PLANNED_FOR_AUTO if cell.model == AUTO else cell.model


def forecast(robot: Robot, cell: Cell, joints: ArrayLike, margin: float = 0.0) -> Forecast:
    """What a calibration measured at these poses will reach, over the joint ranges.

    Args:
        robot: The nominal robot.
        cell: Model, targets, frames, noise and priors; ``"auto"`` is taken as ``"placement"``.
        joints: shape (N, m), [rad] or [m], in the order of ``robot.joint_names``.
        margin: See `calib.design.candidates.planning_ranges`.

    Raises:
        ModelError: The model or the cell do not fit the robot, or a joint's value is missing.
        MeasurementError: No pose.
    """
    robot.chain_values(joints)
    q = np.atleast_2d(np.asarray(joints, dtype=np.float64))
    if not len(q):
        message = "A forecast needs poses; none was given."
        raise MeasurementError(message)
    sensitivity = Outlook.of(robot, cell).sensitivity
    everywhere = spread_between(planning_ranges(robot, cell.ranges, margin), _POSES)
    return forecast_of(sensitivity, Workspace.of(sensitivity, everywhere), q)


def forecast_of_table(robot: Robot, cell: Cell, measurements: Measurements) -> Forecast | None:
    """What a fit of a table's estimation rows can reach, by its poses alone; the target is registered.

    Args:
        robot: The nominal robot.
        cell: As for the fit; ``"auto"`` is taken as ``"placement"``.
        measurements: The table.

    Returns:
        None where rows are of several kinds, targets or set-ups, or of a kind whose poses are not free.

    Raises:
        MeasurementError: A joint's column is missing, or too few rows.
    """
    seen = measurements.select(measurements.estimation)
    kinds = set(seen.kinds)
    if (
        len(kinds) > 1
        or len(set(seen.targets)) > 1
        or len(set(seen.groups)) > 1
        or kinds - {*KINDS}
    ):
        return None
    rows, setup = rows_of(robot, measurements, cell)
    started = register(robot, setup, rows.select(measurements.estimation))
    known = replace(
        cell,
        kind=seen.kinds[0],
        T_frame_base=cell.T_frame_base if seen.kinds[0] != "distance" else started.T_frame_base[0],
        target=started.T_tip_target[0, :3, 3],
        targets={},
        frames={},
    )
    return forecast(robot, known, seen.joints_for(robot.joint_names))


def _checked_kind(cell: Cell) -> str:
    """The kind that is planned for.

    Raises:
        ModelError: One whose poses cannot be chosen freely, or a cell of several set-ups.
    """
    kind = cell.kind or KINDS[0]
    if kind not in KINDS:
        message = (
            f"Poses cannot be planned for the kind '{kind}': the target stays in its socket or plane, or two rows "
            f"belong together. Choose one of {choices(KINDS)}."
        )
        raise ModelError(message)
    if len(cell.frames) > 1:
        message = (
            f"The cell has the set-ups {choices(cell.frames)}; poses are planned for one set-up at a time. Give the "
            "one frame as frame_xyz_mm and frame_rpy_deg."
        )
        raise ModelError(message)
    if kind == "distance" and cell.T_frame_base is None and not cell.frames:
        message = (
            "To plan for distances, calib must know roughly where the anchor is: give the base in a frame at the "
            "anchor, frame_xyz_mm in the cell file."
        )
        raise ModelError(message)
    return kind


def _precision(outlook: Outlook) -> Array:
    """1 / tau^2 of each parameter's prior, shape (p,): its own, its family's, or 0."""
    priors, own = outlook.cell.priors, outlook.cell.parameter_priors
    result = np.zeros(len(outlook.kinematics.model))
    for k, parameter in enumerate(outlook.kinematics.model.parameters):
        shared = priors.sizes != "off" and parameter.family in FAMILIES
        size = priors.of(parameter.family) if shared else None
        size = own.get(parameter.name, size)
        result[k] = 0.0 if size is None else 1.0 / size**2
    return read_only(result)


def _chunks(q: Array) -> list[Array]:
    """Joint values in pieces that need little memory."""
    return [q[i : i + _CHUNK] for i in range(0, len(q), _CHUNK)]
