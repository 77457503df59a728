"""Sensitivity: how what is measured at a pose, and where the targets are, change with the parameters of the fit.

The same rows, error model, noise and priors as the fit's, before anything is measured.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import calib.kinds as registry
from calib.errors import ModelError, choices
from calib.families import FAMILIES
from calib.identify.fitting import Task, model_of
from calib.identify.inspection import GENERIC_TARGET, any_measurement
from calib.identify.rigid_motion import without_rigid_motion
from calib.identify.rows import Rows
from calib.identify.setup import (
    FIRST_SIGMA_ANGLE,
    Setup,
    along_own_axes,
    setup_of,
    targets_along_tip,
)
from calib.measure.cell import AUTO, Cell
from calib.measure.columns import DEFAULT_TARGET
from calib.measure.measurements import Measurements
from calib.measure.noise import TrackerNoise
from calib.model.kinematics import Kinematics, Samples
from calib.model.robot import Robot, read_only
from calib.model.torques import gravity_load

Array = NDArray[np.float64]

#: What `auto` is planned for: the largest geometry, so that every smaller one is covered.
PLANNED_FOR_AUTO = "placement"

#: The distance of an instrument of which nothing is said [m].
_USUAL_DISTANCE = 3.0

#: Poses whose derivatives are computed together.
_CHUNK = 8192


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivity:
    """A robot in a cell, as the fit would see it; p is the number of parameters, k that of targets.

    Attributes:
        robot: The nominal robot.
        cell: The cell.
        kind: What is measured at each pose.
        setup: Frames and targets; a target that was not given stands at a general place.
        kinematics: Under the model that the fit will use.
        precision: shape (p,), 1 / tau^2 of each parameter's prior, its own or its family's; 0 where there is none.
        notes: What was assumed, in sentences.
    """

    robot: Robot
    cell: Cell
    kind: str
    setup: Setup
    kinematics: Kinematics
    precision: Array
    notes: tuple[str, ...]

    @classmethod
    def of(cls, robot: Robot, cell: Cell) -> Sensitivity:
        """The fit's model of a robot in a cell.

        Raises:
            ModelError: An unknown parameter set or parameter, or a kind or cell that cannot be planned for.
        """
        kind = _checked_kind(cell)
        cell = replace(cell, distances=())
        setup = _one_pose(robot, cell, kind)
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
        return cls(robot, cell, kind, setup, kinematics, _precision(kinematics, cell), tuple(notes))

    @property
    def model(self) -> str:
        """The name of the parameter set."""
        return self.kinematics.model.name

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters."""
        return self.kinematics.model.names

    @property
    def units(self) -> tuple[str, ...]:
        """Of each parameter."""
        return self.kinematics.model.units

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

    def measured(self, q: Array) -> Array:
        """The derivative of what is measured at poses, shape (n, d, p), in standard deviations of the noise per unit.

        Args:
            q: shape (n, m), [rad] or [m].
        """
        x = np.zeros(len(self.kinematics.model))
        parts = []
        for chunk in _chunks(q):
            noise = self.noise(chunk)
            samples = self._samples(chunk)
            poses, twists = self.kinematics.twists(x, samples)
            rows = self._rows(samples, np.repeat(noise, len(self.setup.targets)))
            rows = rows.as_measured_at(poses)
            slopes = rows.derivative(poses, twists) / rows.scales[:, :, None]
            slopes = slopes.reshape(len(chunk), len(self.setup.targets), -1, len(x))
            slopes = self._shared_out(slopes, noise)
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

    def located(self, q: Array) -> Array:
        """The derivative of the targets' predicted positions, shape (n, 3 k, p), [m per unit].

        Distances do not tell where the base stands: what one rigid motion of all these positions does is left out.

        Args:
            q: shape (n, m), [rad] or [m].
        """
        x = np.zeros(len(self.kinematics.model))
        pairs = [self.kinematics.points_jacobian(x, self._samples(chunk)) for chunk in _chunks(q)]
        points = np.concatenate([one for one, _ in pairs])
        slopes = np.concatenate([one for _, one in pairs])
        if not registry.get(self.kind).position:
            slopes = without_rigid_motion(points, slopes)
        return slopes.reshape(len(q), -1, len(x))

    def noise(self, q: Array) -> Array:
        """Standard deviation of one coordinate, or of the length from the anchor, at poses, shape (n,), [m].

        Args:
            q: shape (n, m), [rad] or [m].
        """
        if self.cell.sigma is not None:
            return np.full(len(q), self.cell.sigma)
        tracker = self.cell.tracker
        if not registry.get(self.kind).position:
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


def _checked_kind(cell: Cell) -> str:
    """The kind that is planned for.

    Raises:
        ModelError: One whose poses cannot be chosen freely, or a cell of several set-ups.
    """
    kind = cell.kind or "point"
    if not registry.get(kind).free:
        free = [name for name in registry.names() if registry.get(name).free]
        raise ModelError(
            f"Poses cannot be planned for the kind '{kind}': the target stays in its socket or plane, or two rows "
            f"belong together. Choose one of {choices(free)}."
        )
    if len(cell.frames) > 1:
        raise ModelError(
            f"The cell has the set-ups {choices(cell.frames)}; poses are planned for one set-up at a time. Give the "
            "one frame as frame_xyz_mm and frame_rpy_deg."
        )
    if registry.get(kind).own_frame and cell.T_frame_base is None and not cell.frames:
        place = registry.get(kind).place.lower()
        raise ModelError(
            f"To plan for rows of the kind '{kind}', calib must know roughly where the {place} is: give the base in a "
            f"frame at the {place}, frame_xyz_mm in the cell file."
        )
    return kind


def _one_pose(robot: Robot, cell: Cell, kind: str) -> Setup:
    """Frames and targets of a table that has one pose, with a row for each target."""
    names = tuple(cell.targets) or (DEFAULT_TARGET,)
    count = len(names)
    table = Measurements(
        joint_names=robot.joint_names,
        joints=np.zeros((count, len(robot.inputs))),
        kinds=(kind,) * count,
        **any_measurement(kind, count),
        targets=names,
        groups=(next(iter(cell.frames), ""),) * count,
        prismatic=tuple(joint.name for joint in robot.inputs if joint.type == "prismatic"),
    )
    return setup_of(cell, table, np.full(count, registry.names().index(kind)))


def _precision(kinematics: Kinematics, cell: Cell) -> Array:
    """1 / tau^2 of each parameter's prior, shape (p,): its own, its family's, or 0."""
    result = np.zeros(len(kinematics.model))
    for k, parameter in enumerate(kinematics.model.parameters):
        shared = cell.priors.sizes != "off" and parameter.family in FAMILIES
        size = cell.priors.of(parameter.family) if shared else None
        size = cell.parameter_priors.get(parameter.name, size)
        result[k] = 0.0 if size is None else 1.0 / size**2
    return read_only(result)


def _chunks(q: Array) -> list[Array]:
    """Joint values in pieces that need little memory."""
    return [q[i : i + _CHUNK] for i in range(0, len(q), _CHUNK)]
