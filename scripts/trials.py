"""Trials of calibrations: virtual robots, each with errors of its own, are measured, calibrated and verified.

A true robot is drawn and measured with noise, the nominal robot is calibrated with these measurements alone, and both
are asked for the target's position at poses that were not measured. The error there is known, because the truth is.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtri

from calib.basics.arrays import Array, rigid_inverse
from calib.basics.jobs import batch_size, run
from calib.data.cell import Cell, Tracker
from calib.fit.estimate.fitting import Fitted
from calib.model.kinematics import Samples
from calib.numerics.errors import rms
from calib.numerics.rigid_motion import without_rigid_motion
from calib.result.calibrate import calibrate
from calib.result.table_fits import fit_table
from calib.robot.gravity import gravity_loads
from calib.verbs.plan.forecast import Forecast, Workspace
from calib.verbs.plan.sensitivity import Sensitivity
from calib.verbs.simulate.scenario import DEFAULT_TRACKER, Scenario
from calib.verbs.simulate.truth import Truth

#: Poses at which each trial is verified, and the seed that they are drawn with.
VERIFIED = 500
_VERIFY_SEED = 19790401

#: Probability that a stated region should hold the truth.
_LEVEL = 0.95

#: Trials whose random poses are forecast: 15 poses are worth up to a tenth more or less than others.
_FORECASTS = 9


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """Task of each trial."""

    #: Robots and disturbances that are drawn.
    scenario: Scenario
    #: The cell that the fit is given; its model too.
    cell: Cell
    #: Shape (N, m), poses to measure, the same each time [rad] or [m]; None: ``count`` random ones each time.
    poses: Array | None = None
    #: Poses to fit, where they are drawn each time.
    count: int = 30
    #: Whether each fit is cross-validated.
    validate: bool = True

    def poses_of(self, seed: int) -> Array:
        """Return the poses of one trial, shape (N, m), [rad] or [m]."""
        return self.scenario.random_poses(self.count, seed) if self.poses is None else self.poses


@dataclass(frozen=True, slots=True)
class Trial:
    """Figures of one robot, calibrated and verified."""

    #: Of everything that was drawn.
    seed: int
    #: Rms error of the nominal robot, frame and target where they truly are, over the poses of the verification [m].
    nominal_rms: float
    #: Rms error of the calibrated robot's predictions there [m].
    rms: float
    #: Rms error there that the fit states [m].
    stated_rms: float
    #: Share of these positions inside the 95 % ellipsoid that the fit states.
    covered: float


@dataclass(frozen=True, slots=True, eq=False)
class Trials:
    """Figures of many robots."""

    #: In the order of their seeds.
    trials: tuple[Trial, ...]
    #: Of the first trial's poses, or where poses are random the median of several trials'; None without noise.
    forecast: Forecast | None

    def values(self, name: str) -> Array:
        """Return one figure of all trials, by its name in `Trial`, shape (trials,)."""
        return np.array([getattr(trial, name) for trial in self.trials], dtype=np.float64)

    @property
    def rms(self) -> float:
        """Root mean square over the trials of the calibrated robots' rms error [m]."""
        return rms(self.values("rms"))

    @property
    def rms_error(self) -> float:
        """Standard error of `rms`, from the spread of the trials [m]."""
        squares = self.values("rms") ** 2
        return float(np.std(squares, ddof=1) / np.sqrt(len(squares)) / (2.0 * self.rms))


def run_trials(task: Task, count: int, seed: int = 0, executor: Executor | None = None) -> Trials:
    """Run trials; trial i has the seed ``seed + i``, in any executor.

    Args:
        task: What is done each time.
        count: Number of trials, 2 or more, for a spread.
        seed: Of the first trial.
        executor: One of `concurrent.futures`; None: here, one after the other.
    """
    seeds = range(seed, seed + count)
    done = dict(run(run_trial, task, seeds, executor, batch=batch_size(count)))
    trials = tuple(done[number] for number in range(count))
    return Trials(trials, _median_forecast(task, seeds))


def run_trial(task: Task, seed: int) -> Trial:
    """Draw a robot, measure it, calibrate it and verify it, all with one seed."""
    scenario = task.scenario
    q = task.poses_of(seed)
    simulated = scenario.draw(seed).measure(q, seed)
    robot, table = scenario.robot, simulated.measurements
    if task.validate:
        in_memory = calibrate(robot, table, cell=task.cell).fit
        assert in_memory is not None
        fitted = in_memory.non_geometric or in_memory.geometry
    else:
        fits = fit_table(robot, table, task.cell)
        fitted = fits.non_geometric or fits.geometry

    error, J = _prediction_errors(task, simulated.truth, fitted)
    estimate = fitted.estimate
    JC = (J.reshape(-1, J.shape[2]) @ estimate.covariance).reshape(J.shape)
    covariance = JC @ J.transpose(0, 2, 1)
    weighted = np.linalg.solve(covariance, error[:, :, None])[:, :, 0]
    square = np.sum(error * weighted, axis=1)
    limit = 3.0 * fdtri(3, max(estimate.freedom, 1.0), _LEVEL)
    variance = np.trace(covariance, axis1=1, axis2=2)
    return Trial(
        seed=seed,
        nominal_rms=rms(simulated.truth.nominal_errors(verification_poses(scenario))),
        rms=rms(np.linalg.norm(error, axis=1)),
        stated_rms=float(np.sqrt(np.mean(variance))),
        covered=float(np.mean(square <= limit)),
    )


def verification_poses(scenario: Scenario) -> Array:
    """Return the random poses at which every trial is verified, shape (500, m), [rad] or [m]."""
    return scenario.random_poses(VERIFIED, _VERIFY_SEED)


def _prediction_errors(task: Task, truth: Truth, fitted: Fitted) -> tuple[Array, Array]:
    """Compute predicted minus true positions at the poses of the verification, and their derivative.

    Returns:
        Shape (N, 3) [m]; and by the fit's parameters, shape (N, 3, p).
    """
    scenario, cell = task.scenario, task.cell
    q = verification_poses(scenario)
    load = None
    if any(term.factor and term.factor.loaded for term in fitted.kinematics.model.terms):
        load = gravity_loads(scenario.robot, q, cell.payload, cell.gravity)
    samples = Samples.at(q, load)
    poses, J = fitted.kinematics.twists(fitted.estimate.x, samples, rotation=False)
    T_base_target = truth.tip_poses(q) @ truth.T_tip_target[0]
    if scenario.kind.position:
        T_frame_target = truth.T_frame_base[0] @ T_base_target
        return poses[:, :3, 3] - T_frame_target[:, :3, 3], J
    # Lengths do not tell where the base is: only the shape of all positions counts.
    T_base_frame = rigid_inverse(fitted.estimated_setup().T_frame_base[0])
    predicted = (T_base_frame @ poses)[:, :3, 3]
    difference = (predicted - T_base_target[:, :3, 3])[:, :, None]
    error = without_rigid_motion(predicted, difference)[:, :, 0]
    return error, without_rigid_motion(predicted, J)


def _median_forecast(task: Task, seeds: Sequence[int]) -> Forecast | None:
    """Forecast the first trial, or where poses are random several ones, of which the median is returned.

    The true noise counts, not that which the fit is given: where nothing says where the tracker is, it is at a usual
    distance. None without noise.
    """
    scenario = task.scenario
    if scenario.noise is None:
        return None
    true_sigma = {unit: std for unit, std in scenario.sigma.items() if std}
    sigma = {unit: std for unit, std in task.cell.sigma.items() if unit != "m"} | true_sigma
    tracker = Tracker(_tracker_position(scenario), noise=scenario.noise)
    sensitivity = Sensitivity.of(scenario.robot, replace(task.cell, sigma=sigma, tracker=tracker))
    workspace = Workspace.of(sensitivity, verification_poses(scenario))
    forecasts = []
    for seed in seeds[: _FORECASTS if task.poses is None else 1]:
        visited = np.repeat(task.poses_of(seed), scenario.visits, axis=0)
        forecasts.append(Forecast.of(sensitivity, workspace, visited))
    forecasts.sort(key=lambda forecast: forecast.rms)
    return forecasts[len(forecasts) // 2]


def _tracker_position(scenario: Scenario) -> Array:
    """Return the position of the tracker in the base, shape (3,), [m]: as given, its frame's origin, or the default."""
    if scenario.tracker is not None:
        return scenario.tracker
    cell = scenario.cell
    T_frame_base = next(iter(cell.frames.values()), cell.T_frame_base)
    return DEFAULT_TRACKER if T_frame_base is None else rigid_inverse(T_frame_base)[:3, 3]
