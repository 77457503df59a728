"""What a calibration will reach, before anything is measured: the fit's own rows, error model, noise and priors.

The parameters' covariance after a fit of the linearised measurements, C = (diag(1 / tau^2) + sum A_i^T A_i)^-1, gives
the standard deviation of each parameter, and that of a predicted position, sqrt(tr(J C J^T)). One calibration's rms
error over the workspace is a draw: rms^2 = x^T B x with x ~ N(0, C), a sum of chi-squares weighted by the eigenvalues
of C B. It knows nothing of errors that the model lacks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular

import calib.data.kinds as registry
from calib.data.cell import AUTO, Cell, Tracker
from calib.data.columns import DEFAULT_TARGET
from calib.data.measurements import Measurements
from calib.design.candidates import Note, planning_ranges
from calib.design.inspection import GENERIC_TARGET, table_of_poses
from calib.errors import ModelError, choices
from calib.estimate.task import Task
from calib.model.families import FAMILIES
from calib.model.kinematics import Kinematics, Samples
from calib.model.observability import Observability, analyse
from calib.registration.registration import register
from calib.registration.rows import Rows
from calib.registration.setup import Setup
from calib.registration.table_rows import FIRST_SIGMA_ANGLE, rows_and_setup
from calib.registration.table_setup import measurement_setup
from calib.result.prediction import without_rigid_motion
from calib.robot.gravity import gravity_loads
from calib.robot.kernel import over_blocks
from calib.robot.ranges import spread_between
from calib.robot.robot import Robot, read_only
from calib.units import Array

#: What `auto` is planned for: the largest geometry, so that every smaller one is covered.
PLANNED_FOR_AUTO = "placement"

#: Without a prior a direction that no pose tells is held by this much [m and rad], as in a fit.
LEASH = 1.0

#: An instrument of which nothing is said, and its distance [m].
_USUAL, _USUAL_DISTANCE = Tracker(np.zeros(3)), 3.0

#: Poses over which a forecast without a plan is made.
_POSES = 4096

#: Share of calibrations whose rms lies inside the range.
_RANGE = 0.90


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivity:
    """A robot in a cell, as the fit would see it; p is the number of parameters, k that of targets."""

    cell: Cell
    kind: str  #: What is measured at each pose.
    setup: Setup  #: Frames and targets; a target that was not given stands at a general place.
    kinematics: Kinematics  #: Of the nominal robot, under the model that the fit will use.
    precision: Array  #: shape (p,), 1 / tau^2 of each parameter's prior, its own or its family's, or of the leash.
    notes: tuple[Note, ...]  #: What was assumed.

    @classmethod
    def of(cls, robot: Robot, cell: Cell) -> Sensitivity:
        """The fit's model of a robot in a cell."""
        kind = _checked_kind(cell)
        cell = replace(cell, distances=())
        # Of a table that has one pose, with a row for each target.
        targets = tuple(cell.targets) or (DEFAULT_TARGET,)
        groups = (next(iter(cell.frames), ""),) * len(targets)
        table = table_of_poses(robot, kind, np.zeros((len(targets), len(robot.inputs))))
        table = replace(table, targets=targets, groups=groups)
        setup = measurement_setup(cell, table, np.full(len(targets), registry.names().index(kind)))
        notes = []
        if not np.all(setup.target_given):
            T_tip_target = setup.T_tip_target.copy()
            T_tip_target[~setup.target_given, :3, 3] = GENERIC_TARGET
            setup = setup.placed(setup.T_frame_base, T_tip_target)
            notes.append(Note("generic_target", tuple(GENERIC_TARGET)))
        if kind == "pose" and cell.sigma_angle is None:
            notes.append(Note("orientation_noise", (FIRST_SIGMA_ANGLE,)))
        auto = cell.model == AUTO
        name = PLANNED_FOR_AUTO if auto else cell.model
        model = Task(robot, cell, setup, name, allow_absent=auto).error_model()
        model = setup.aligned(model)
        for wanted in () if auto else (*cell.parameter_priors, *cell.bounds):
            model.index(wanted)
        precision = np.zeros(len(model))
        for k, parameter in enumerate(model.parameters):
            shared = cell.priors.source != "off" and parameter.family in FAMILIES
            size = cell.priors.of(parameter.family) if shared else None
            size = cell.parameter_priors.get(parameter.name, size)
            precision[k] = 1.0 / (LEASH if size is None else size) ** 2
        kinematics = Kinematics(robot, model, setup.T_frame_base, setup.T_tip_target)
        return cls(cell, kind, setup, kinematics, read_only(precision), tuple(notes))

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
        poses = self.kinematics.poses(np.zeros(len(self.names)), self._samples(q))
        return np.asarray(poses[:, :3, 3].reshape(len(q), -1, 3))

    def _samples(self, q: Array) -> Samples:
        """Every target at every pose, pose by pose."""
        k, robot = len(self.setup.targets), self.kinematics.robot
        load = None
        if any(p.factor and p.factor.loaded for p in self.kinematics.model.parameters):
            load = np.repeat(
                gravity_loads(robot, q, self.cell.payload, self.cell.gravity), k, axis=0
            )
        frame, target = np.zeros(k * len(q), dtype=np.int_), np.tile(np.arange(k), len(q))
        return Samples(np.repeat(q, k, axis=0), frame, target, load)

    def measured(self, q: Array) -> Array:
        """The derivative of what is measured at poses, shape (n, d, p), in standard deviations of the noise per unit.

        Where k targets of one stop share the robot's repeatability r and have the noise s each, the mean has the
        variance s^2 / k (1 + (k - 1) rho), rho = r^2 / s^2. What they say of each other is exacter than s; a fit, to
        which rows are independent, makes no use of that.
        """
        x, k, noise = np.zeros(len(self.names)), len(self.setup.targets), self.noise(q)
        kind, samples = registry.get(self.kind), self._samples(q)
        poses, twists = self.kinematics.twists(x, samples)
        n = len(samples)
        rows = Rows(
            samples=samples,
            kinds=np.full(n, registry.names().index(self.kind)),
            measured=np.zeros((n, kind.size)),
            partner=np.full(n, -1),
            sigma=np.repeat(noise, k),
            sigma_angle=np.full(n, self.cell.sigma_angle or FIRST_SIGMA_ANGLE),
            poses=np.arange(n),
            blocks=np.arange(n),
        ).as_measured_at(poses)
        slopes = rows.derivative(poses, twists) / rows.scales[:, :, None]
        slopes = slopes.reshape(len(q), k, -1, len(x))
        if k > 1 and kind.position and self.cell.sigma is None:
            rho = ((self.cell.tracker or _USUAL).noise.repeatability / noise) ** 2
            less = 1.0 - 1.0 / np.sqrt(1.0 + (k - 1) * rho)
            shared = slopes[:, :, :3].mean(axis=1, keepdims=True)
            slopes[:, :, :3] -= less[:, None, None, None] * shared
        return np.asarray(slopes.reshape(len(q), -1, len(x)))

    def located(self, q: Array) -> Array:
        """The derivative of the targets' predicted positions at poses, shape (n, 3 k, p), [m per unit].

        Distances do not tell where the base stands: what one rigid motion of all these positions does is left out.
        """
        x = np.zeros(len(self.names))
        poses, slopes = self.kinematics.twists(x, self._samples(q), rotation=False)
        if not registry.get(self.kind).position:
            slopes = without_rigid_motion(poses[:, :3, 3], slopes)
        return np.asarray(slopes.reshape(len(q), -1, len(x)))

    def noise(self, q: Array) -> Array:
        """Standard deviation of one coordinate, or of the length from the anchor, at poses, shape (n,), [m]."""
        tracker = self.cell.tracker
        if self.cell.sigma is not None:
            return np.full(len(q), self.cell.sigma)
        if not registry.get(self.kind).position:
            away = np.linalg.norm(self.expected(q)[:, 0], axis=1)
        elif tracker is None:
            away = np.full(len(q), _USUAL_DISTANCE)
        else:
            poses = self.kinematics.robot.poses(q) @ self.setup.T_tip_target[0]
            away = np.linalg.norm(poses[:, :3, 3] - tracker.position, axis=1)
        return np.asarray((tracker or _USUAL).noise.std(away))

    def analysed(self, q: Array, measured: Array) -> Observability:
        """Rank and indices of what is `measured` at poses; in metres, as a fit's own analysis finds them."""
        sigma = np.repeat(self.noise(q), measured.shape[1])[:, None]
        return analyse(measured.reshape(len(sigma), -1) * sigma, self.names, self.units)


def _checked_kind(cell: Cell) -> str:
    """The kind that is planned for: one whose poses can be chosen freely, in one set-up."""
    name = cell.kind or "point"
    kind, free = registry.get(name), [one for one in registry.names() if registry.get(one).free]
    unplaced = kind.own_frame and cell.T_frame_base is None and not cell.frames
    if unplaced or len(cell.frames) > 1 or not kind.free:
        raise ModelError(
            f"Poses are planned for the kinds {choices(free)}, in one set-up; of one with a frame of its own, such as "
            f"distances, give the base in it (frame_xyz_mm in the cell file). Here the kind is '{name}'."
        )
    return name


class Workspace(NamedTuple):
    """The poses over which accuracy is forecast: what `Sensitivity` says of them, and the rank of all of them."""

    measured: Array
    located: Array
    rank: int

    @classmethod
    def of(cls, sensitivity: Sensitivity, q: Array) -> Workspace:
        """At joint values, shape (n, m), [rad] or [m]."""
        measured, located = sensitivity.measured(q), sensitivity.located(q)
        return cls(measured, located, sensitivity.analysed(q, measured).rank)


@dataclass(frozen=True, slots=True, eq=False)
class Forecast:
    """What a calibration at some poses will reach.

    The variances are of what is measured over the workspace, as the calibrated robot predicts it, in variances of the
    noise.
    """

    names: tuple[str, ...]  #: The parameters.
    units: tuple[str, ...]  #: Of each.
    parameter_std: Array  #: shape (p,), expected standard deviation after the fit, in the units.
    identifiable: NDArray[np.bool_]  #: shape (p,), whether these poses tell a parameter by itself.
    poses: int  #: Number of poses.
    rms: float  #: Expected rms error of a predicted position over the workspace [m].
    rms_low: float  #: The rms of 90 % of calibrations lies between this one
    rms_high: float  #: and this one [m].
    max: float  #: Largest standard deviation of a predicted position over the workspace [m].
    sigma: float  #: Noise of one measured coordinate, rms over the poses [m].
    rank: int  #: How many parameters the poses tell apart.
    columns: int  #: How many there are.
    workspace_rank: int  #: What the poses of the whole workspace could tell.
    mean_variance: float
    worst_variance: float
    indices: dict[str, float]  #: O1 to O5.

    @classmethod
    def of(cls, sensitivity: Sensitivity, workspace: Workspace, q: Array) -> Forecast:
        """What a fit of measurements at these poses, shape (N, m), [rad] or [m], will reach over a workspace."""
        measured = sensitivity.measured(q)
        root = covariance_root(measured, sensitivity.precision)
        variance, relative, squares = _spreads(workspace, root)
        # The squared rms is x^T B x with x ~ N(0, 1) of the independent errors.
        draws = _chi_squares(len(squares)) @ np.maximum(np.linalg.eigvalsh(squares), 0.0)
        low, high = np.sqrt(np.quantile(draws, [0.5 - 0.5 * _RANGE, 0.5 + 0.5 * _RANGE]))
        sigma = sensitivity.noise(q)
        seen = sensitivity.analysed(q, measured)
        return cls(
            names=sensitivity.names,
            units=sensitivity.units,
            parameter_std=read_only(np.linalg.norm(root, axis=1)),
            identifiable=seen.identifiable,
            poses=len(q),
            rms=float(np.sqrt(np.mean(variance))),
            rms_low=float(low),
            rms_high=float(high),
            max=float(np.sqrt(np.max(variance))),
            sigma=float(np.sqrt(np.mean(sigma**2))),
            rank=seen.rank,
            columns=len(sensitivity.names),
            workspace_rank=workspace.rank,
            mean_variance=float(np.mean(relative)),
            worst_variance=float(np.max(relative)),
            indices=dict(seen.indices),
        )


def forecast(robot: Robot, cell: Cell, joints: ArrayLike) -> Forecast:
    """What a calibration measured at these poses will reach, over the joint ranges.

    ``joints`` is of shape (N, m), [rad] or [m]; the model ``"auto"`` is taken as ``"placement"``.
    """
    sensitivity = Sensitivity.of(robot, cell)
    everywhere = spread_between(planning_ranges(robot, cell.ranges, 0.0), _POSES)
    return Forecast.of(sensitivity, Workspace.of(sensitivity, everywhere), np.asarray(joints))


def forecast_of_table(robot: Robot, cell: Cell, measurements: Measurements) -> Forecast | None:
    """What a fit of a table's estimation rows can reach, by its poses alone; the target is registered.

    None where rows are of several kinds, targets or set-ups, or of a kind whose poses are not free.
    """
    seen = measurements.select(measurements.estimation)
    if (
        len(set(zip(seen.kinds, seen.targets, seen.groups, strict=True))) > 1
        or not registry.get(seen.kinds[0]).free
    ):
        return None
    rows, setup = rows_and_setup(robot, measurements, cell)
    rows = rows.select(measurements.estimation)
    started = register(robot.poses(rows.joints), setup, rows)
    known = replace(
        cell,
        kind=seen.kinds[0],
        T_frame_base=cell.T_frame_base if seen.kinds[0] != "distance" else started.T_frame_base[0],
        target=started.T_tip_target[0, :3, 3],
        targets={},
        frames={},
    )
    return forecast(robot, known, seen.joints_for(robot.joint_names))


def covariance_root(measured: Array, precision: Array) -> Array:
    """A root of the parameters' covariance after measurements, C = root root^T, shape (p, p).

    By a QR decomposition of the measurements, shape (n, d, p), and the priors below each other: what a fine instrument
    tells, and what nothing but the leash holds, are too far apart for their squares.
    """
    rows = [measured.reshape(-1, measured.shape[2]), np.diag(np.sqrt(precision))]
    R = np.linalg.qr(np.concatenate(rows), mode="r")
    return np.asarray(solve_triangular(R, np.eye(len(R))))


def _spreads(workspace: Workspace, root: Array) -> tuple[Array, Array, Array]:
    """What errors of the covariance C = root root^T do over a workspace of n poses with k targets.

    Args:
        workspace: The poses.
        root: shape (p, p), in the parameters' units.

    Returns:
        The variance of each target's position, shape (n k,) [m^2]; of what is measured at each pose, shape (n,), in
        variances of the noise; and root^T B root, shape (p, p) [m^2], with the mean B of J^T J over the positions.
    """
    p = len(root)

    def work(own: slice) -> tuple[Array, Array, Array]:
        """The same of a part of the poses, the last one as a sum."""
        moves = workspace.located[own].reshape(-1, p) @ root
        seen = workspace.measured[own]
        changes = (seen.reshape(-1, p) @ root).reshape(len(seen), -1)
        by_target = moves.reshape(-1, 3 * p)
        variance = np.einsum("nk,nk->n", by_target, by_target)
        return variance, np.einsum("nk,nk->n", changes, changes), moves.T @ moves

    variances, relatives, squares = zip(*over_blocks(work, len(workspace.located)), strict=True)
    variance = np.concatenate(variances)
    return variance, np.concatenate(relatives), np.sum(squares, axis=0) / len(variance)


def information(A: Array) -> Array:
    """Sum of A_i^T A_i, shape (p, p), of A of shape (n, d, p)."""
    flat = A.reshape(-1, A.shape[2])
    return np.asarray(flat.T @ flat)


@lru_cache(maxsize=4)
def _chi_squares(count: int) -> Array:
    """The same 20,000 draws of so many independent chi-squares every time; drawing takes longer than a forecast."""
    return np.random.default_rng(20170401).chisquare(1, size=(20_000, count))
