"""One trial of a study: a robot with errors of its own is planned for, measured, calibrated and verified.

A true robot is drawn and measured with noise, the nominal robot is calibrated with these measurements alone, and both
are asked for the target's position at poses that were not measured: the error there is known, because the truth is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import fdtri

from calib.basics.arrays import Array, Mask, rigid_inverse
from calib.data.cell import Cell, Tracker
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import NO
from calib.errors import ModelError
from calib.fit.estimate.fitting import Fitted
from calib.model.kinematics import Samples
from calib.numerics.errors import rms
from calib.numerics.rigid_motion import without_rigid_motion
from calib.result.calibrate import calibrate
from calib.result.table_fits import fit_table
from calib.robot.gravity import gravity_loads
from calib.verbs.plan.candidates import draw, planning_ranges
from calib.verbs.plan.choice import PlanRequest, choose_poses
from calib.verbs.plan.forecast import Forecast, Workspace
from calib.verbs.plan.sensitivity import Sensitivity
from calib.verbs.simulate.camera.simulate import simulate_pictures
from calib.verbs.simulate.scenario import DEFAULT_TRACKER, Scenario
from calib.verbs.simulate.truth import Truth

#: Poses at which a trial is verified.
VERIFIED = 500

#: Seed that they are drawn with.
_VERIFY_SEED = 19790401

#: Candidates that each trial's plan is chosen from: it is made anew each time.
_CANDIDATES = 2000

#: Probability that a stated region should hold the truth.
_LEVEL = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class Trials:
    """Task of each trial."""

    #: Robots and disturbances that are drawn
    scenario: Scenario
    #: The cell that the fit is given; its model too
    cell: Cell
    #: shape (N, m), poses to measure, the same each time; None: ``count`` others each time
    poses: Array | None = None
    #: ``"estimate"`` or ``"validate"`` for each of ``poses``
    sets: tuple[str, ...] = ()
    #: Poses to fit, where they are made each time
    count: int = 30
    #: Random poses to validate with, besides
    validation: int = 0
    #: Whether they are planned, or drawn at random
    planned: bool = False
    #: Of the plan
    criterion: str = "V"
    #: Whether each fit is cross-validated, for its verdict
    validate: bool = True
    #: Of the fit
    solver: str = "lm"

    @property
    def fitted(self) -> int:
        """Number of poses that are fitted each time."""
        return self.count if self.poses is None else self.sets.count("estimate")

    def poses_of(self, seed: int) -> tuple[Array, tuple[str, ...]]:
        """Return the poses of one trial: given, planned, or random by the seed; and those to validate with.

        Collisions are not checked, for the robot is a virtual one.

        Returns:
            shape (N, m), [rad] or [m], and the set of each.
        """
        poses = self.poses
        if poses is None and self.planned:
            poses = self._plan(seed)
        return self.scenario.poses(seed, self.count, self.validation, poses, self.sets)

    def _plan(self, seed: int) -> Array:
        """Plan the poses of one trial, shape (count, m), [rad] or [m]."""
        robot = self.scenario.robot
        sensitivity = Sensitivity.of(robot, self.cell)
        ranges = planning_ranges(robot, self.scenario.cell.ranges, 0.0)
        pool = draw(robot, ranges, [], max(_CANDIDATES, self.count), seed)
        request = PlanRequest(self.count, 0, self.criterion, ladder=False, seed=seed)
        return choose_poses(sensitivity, pool, request, restarts=1).planned


@dataclass(frozen=True, slots=True)
class Trial:
    """Figures of one robot, calibrated and verified."""

    #: Of everything that was drawn
    seed: int
    #: Error of the nominal robot, frame and target where they truly are, over the poses of the verification [m]
    nominal_rms: float
    #: Error of the calibrated robot's predictions there [m]
    rms: float
    #: The largest [m]
    max: float
    #: Error there that the fit states [m]
    stated_rms: float
    #: Share of these positions inside the 95 % ellipsoid that the fit states
    covered: float
    sigma: (
        float  #: Noise that the fit estimated, with the non-geometric model where there is one [m]
    )
    #: The parameter set that was fitted
    model: str
    #: The verdict's word; "" without one
    verdict: str
    #: Number of rows that are outliers in truth
    outliers: int
    #: Number of these that the fit flagged
    flagged: int
    #: Number of others that it flagged
    false_alarms: int


def one_trial(trials: Trials, seed: int) -> Trial:
    """Plan, measure, fit and verify once, everything that is drawn with one seed.

    Args:
        trials: The task.
        seed: Of the random numbers.
    """
    simulated = _simulate(trials, seed)
    calibrated = _calibrate(trials, simulated)
    problem = calibrated.fitted.estimate.problem
    of_lengths = problem.scales[problem.rows.channels.where("m")]
    verified = _verify(trials, simulated.truth, calibrated.fitted)
    outliers = set(simulated.outlier_rows)
    return Trial(
        seed=seed,
        nominal_rms=rms(simulated.truth.nominal_errors(verification_poses(trials.scenario))),
        rms=rms(verified.errors),
        max=float(np.max(verified.errors)),
        stated_rms=verified.stated_rms,
        covered=float(np.mean(verified.inside)),
        sigma=float(np.median(of_lengths)) if of_lengths.size else float("nan"),
        model=calibrated.fitted.kinematics.model.name,
        verdict=calibrated.verdict,
        outliers=len(outliers),
        flagged=len(outliers & calibrated.flagged),
        false_alarms=len(calibrated.flagged - outliers),
    )


class _Measured(NamedTuple):
    """The simulated table of one trial, and the truth behind it."""

    #: The table
    measurements: Measurements
    #: The robot, the targets and the frames
    truth: Truth
    #: Row numbers of the outliers
    outlier_rows: tuple[int, ...]
    #: The cell that the fit is given
    cell: Cell


def _simulate(trials: Trials, seed: int) -> _Measured:
    """Draw and measure one virtual cell."""
    scenario = trials.scenario
    if scenario.kind.optical:
        pictures = simulate_pictures(
            scenario, trials.count, trials.validation, seed, trials.poses, trials.sets
        )
        cell = replace(
            trials.cell,
            cameras={"": pictures.cell.stated},
            boards={"": pictures.cell.printed.board},
        )
        return _Measured(pictures.measurements, pictures.cell.truth, pictures.outlier_rows, cell)
    q, sets = trials.poses_of(seed)
    simulated = scenario.draw(seed).measure(q, seed, sets)
    return _Measured(simulated.measurements, simulated.truth, simulated.outlier_rows, trials.cell)


@dataclass(frozen=True, slots=True, eq=False)
class _Calibrated:
    """Last fit of a calibration."""

    #: Of the non-geometric model, if any
    fitted: Fitted
    #: The verdict's word; "" without one
    verdict: str
    #: Numbers of the rows that it flags
    flagged: frozenset[int]


def _calibrate(trials: Trials, simulated: _Measured) -> _Calibrated:
    """Calibrate with a simulated table; without validation only the fits are made."""
    robot, table = trials.scenario.robot, simulated.measurements
    if trials.validate:
        result = calibrate(robot, table, cell=simulated.cell, solver=trials.solver)
        assert result.verdict is not None
        fitted = result.fit.non_geometric or result.fit.geometry
        flagged = frozenset(outlier.row for outlier in result.rows.outliers)
        return _Calibrated(fitted, result.verdict.use, flagged)
    fits = fit_table(robot, table, simulated.cell, solver=trials.solver)
    rows = np.array(table.rows)[table.estimation]
    flagged = frozenset(rows[fits.geometry.estimate.outliers].tolist())
    fitted = fits.non_geometric or fits.geometry
    return _Calibrated(fitted, NO if fits.mistake else "", flagged)


def verification_poses(scenario: Scenario) -> Array:
    """Return the poses at which every trial is verified: random ones over the joint ranges.

    Args:
        scenario: Has the robot and its ranges.

    Returns:
        shape (500, m), [rad] or [m].
    """
    return scenario.random_poses(VERIFIED, _VERIFY_SEED)


@dataclass(frozen=True, slots=True, eq=False)
class _Verified:
    """Predictions of a fit against the truth at N poses that it has not seen."""

    #: (N,), distance of the predicted target from the true one [m]
    errors: Array
    #: Error that the fit states [m]
    stated_rms: float
    #: (N,), whether the truth is inside the region that the fit states
    inside: Mask


def _verify(trials: Trials, truth: Truth, fitted: Fitted) -> _Verified:
    """Compare a fit's predictions with the truth.

    Args:
        trials: The task.
        truth: Of the virtual cell.
        fitted: The fit.
    """
    error, J = _prediction_errors(trials, truth, fitted)
    estimate = fitted.estimate
    JC = (J.reshape(-1, J.shape[2]) @ estimate.covariance).reshape(J.shape)
    covariance = JC @ J.transpose(0, 2, 1)
    weighted = np.linalg.solve(covariance, error[:, :, None])[:, :, 0]
    square = np.sum(error * weighted, axis=1)
    limit = 3.0 * fdtri(3, max(estimate.freedom, 1.0), _LEVEL)
    variance = np.trace(covariance, axis1=1, axis2=2)
    return _Verified(
        errors=np.asarray(np.linalg.norm(error, axis=1)),
        stated_rms=float(np.sqrt(np.mean(variance))),
        inside=np.asarray(square <= limit),
    )


def _prediction_errors(trials: Trials, truth: Truth, fitted: Fitted) -> tuple[Array, Array]:
    """Compute the errors of predicted positions at the poses of the verification.

    Args:
        trials: The task.
        truth: Of the virtual cell.
        fitted: The fit.

    Returns:
        Predicted minus true positions, shape (N, 3) [m], and their derivative by the parameters, shape (N, 3, p).
    """
    scenario, cell = trials.scenario, trials.cell
    q = verification_poses(scenario)
    load = None
    if any(term.factor and term.factor.loaded for term in fitted.kinematics.model.terms):
        load = gravity_loads(scenario.robot, q, cell.payload, cell.gravity)
    samples = Samples.at(q, load)
    poses, J = fitted.kinematics.twists(fitted.estimate.x, samples, rotation=False)
    T_base_target = truth.tip_poses(q) @ truth.T_tip_target[0]
    if scenario.kind.position or scenario.kind.optical:
        T_frame_target = truth.T_frame_base[0] @ T_base_target
        return poses[:, :3, 3] - T_frame_target[:, :3, 3], J
    # Lengths do not tell where the base is: only the shape of all positions counts.
    T_base_frame = rigid_inverse(fitted.estimated_setup().T_frame_base[0])
    predicted = (T_base_frame @ poses)[:, :3, 3]
    difference = (predicted - T_base_target[:, :3, 3])[:, :, None]
    error = without_rigid_motion(predicted, difference)[:, :, 0]
    return error, without_rigid_motion(predicted, J)


def forecast_of_trial(trials: Trials, seed: int) -> Forecast | None:
    """Forecast a calibration with one trial's poses, over the poses of the verification.

    By the true noise, not by what the fit is given: where nothing says where the tracker is, at a usual distance.

    Args:
        trials: The task.
        seed: Of the trial.

    Returns:
        The forecast; None without noise, for pictures, or for a cell that has none.
    """
    scenario = trials.scenario
    if scenario.noise is None or scenario.kind.optical:
        return None
    cell = replace(
        trials.cell,
        sigma=_further_sigma(trials),
        tracker=Tracker(_tracker_position(scenario), noise=scenario.noise),
    )
    try:
        sensitivity = Sensitivity.of(scenario.robot, cell)
    except ModelError:
        return None
    q, sets = trials.poses_of(seed)
    to_estimate = [set_name == "estimate" for set_name in sets]
    visited = np.repeat(q[to_estimate], scenario.visits, axis=0)
    workspace = Workspace.of(sensitivity, verification_poses(scenario))
    return Forecast.of(sensitivity, workspace, visited)


def _further_sigma(trials: Trials) -> dict[str, float]:
    """Return the noise of one scalar in units other than of length: the true one, or where that is 0 the cell's."""
    sigma = dict(trials.cell.sigma)
    sigma.pop("m", None)
    return sigma | {unit: std for unit, std in trials.scenario.sigma.items() if std}


def _tracker_position(scenario: Scenario) -> Array:
    """Return the position of the tracker in the base, shape (3,), [m]: as given, its frame's origin, or the default."""
    if scenario.tracker is not None:
        return scenario.tracker
    cell = scenario.cell
    T_frame_base = next(iter(cell.frames.values()), cell.T_frame_base)
    return DEFAULT_TRACKER if T_frame_base is None else rigid_inverse(T_frame_base)[:3, 3]
