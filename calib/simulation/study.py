"""study: plan, measure, fit and verify many times, each time on a robot with errors of its own.

One trial draws a true robot, measures it with noise, calibrates the nominal robot with these measurements alone, and
asks both for the target's position at poses that were not measured: the error there is known, because the truth is.
"""

from __future__ import annotations

from collections import Counter
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.special import fdtri

from calib.data.cell import Cell, Tracker
from calib.design.candidates import draw, planning_ranges
from calib.design.choice import PlanRequest, choose_poses
from calib.design.forecast import Forecast, Workspace
from calib.design.sensitivity import Sensitivity
from calib.diagnosis.reasons import NO
from calib.errors import CalibError, ModelError
from calib.estimate.fitting import Fitted
from calib.jobs import Progress, batch_size, run
from calib.model.kinematics import Samples
from calib.numerics.errors import rms
from calib.numerics.rigid_motion import without_rigid_motion
from calib.result.calibrate import calibrate
from calib.result.fits import fit_table
from calib.robot.gravity import gravity_loads
from calib.robot.robot import rigid_inverse
from calib.simulation.scenario import DEFAULT_TRACKER, Scenario, Simulated
from calib.simulation.truth import Truth
from calib.units import Array

#: The result file's kind and version.
SCHEMA = "study 1"

#: The units of a trial's figures, as suffixes of their keys.
_UNITS = dict.fromkeys(("nominal_rms", "rms", "max", "stated_rms", "sigma"), "_m")

#: Poses at which a trial is verified, and the seed that they are drawn with.
VERIFIED = 500
_VERIFY_SEED = 19790401

#: Candidates that each trial's plan is chosen from: it is made anew each time.
_CANDIDATES = 2000

#: What of a stated region should hold the truth.
_LEVEL = 0.95

#: So many trials' random poses are forecast: 15 of them are worth up to a tenth more or less than others.
_FORECASTS = 9


@dataclass(frozen=True, slots=True, eq=False)
class Trials:
    """What is done each time."""

    scenario: Scenario  #: What robots and disturbances are drawn
    cell: Cell  #: What the fit is told; its model too
    #: shape (N, m), poses to measure, the same each time; None: ``count`` others each time
    poses: Array | None = None
    sets: tuple[str, ...] = ()  #: ``"estimate"`` or ``"validate"`` for each of ``poses``
    count: int = 30  #: Poses to fit, where they are made each time
    validation: int = 0  #: Random poses to validate with, besides
    planned: bool = False  #: Whether they are planned, or drawn at random
    criterion: str = "V"  #: Of the plan
    validate: bool = True  #: Whether each fit is cross-validated, for its verdict
    solver: str = "lm"  #: Of the fit

    @property
    def fitted(self) -> int:
        """Number of poses that are fitted each time."""
        return self.count if self.poses is None else self.sets.count("estimate")

    def poses_of(self, seed: int) -> tuple[Array, tuple[str, ...]]:
        """The poses of one trial, and the set of each: given, planned, or random by the seed; and to validate with.

        Collisions are not looked at, for the robot is a virtual one.
        """
        given, robot = self.poses, self.scenario.robot
        if given is None and self.planned:
            sensitivity = Sensitivity.of(robot, self.cell)
            ranges = planning_ranges(robot, self.scenario.cell.ranges, 0.0)
            given = choose_poses(
                sensitivity,
                draw(robot, ranges, [], max(_CANDIDATES, self.count), seed),
                PlanRequest(self.count, 0, self.criterion, ladder=False, seed=seed),
                restarts=1,
            ).planned
        return self.scenario.poses(seed, self.count, self.validation, given, self.sets)


@dataclass(frozen=True, slots=True)
class Trial:
    """One robot, calibrated and verified."""

    seed: int  #: Of everything that was drawn
    #: Error of the nominal robot, frame and target where they truly are, over the poses of the verification [m]
    nominal_rms: float
    rms: float  #: Error of what the calibrated robot predicts there [m]
    max: float  #: The largest [m]
    stated_rms: float  #: What the fit itself says of its error there [m]
    covered: float  #: Share of these positions inside the 95 % ellipsoid that the fit states
    sigma: float  #: Noise that the fit found, with the non-geometric model where there is one [m]
    model: str  #: The parameter set that was fitted
    verdict: str  #: The verdict's word; "" without one
    outliers: int  #: How many rows are outliers in truth
    flagged: int  #: How many of these the fit named
    false_alarms: int  #: How many others it named


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """Many trials."""

    trials: tuple[Trial, ...]  #: In the order of their seeds
    failures: tuple[tuple[int, str], ...]  #: Seed and reason of those that ended with an error
    #: What was to be expected: of the first trial's poses, or where poses are random of those in the middle of
    #: several trials'; None where the robots' errors or what is fitted have no forecast
    forecast: Forecast | None

    def values(self, name: str) -> Array:
        """One figure of all trials, shape (trials,)."""
        return np.array([getattr(trial, name) for trial in self.trials], dtype=np.float64)

    @property
    def rms(self) -> float:
        """Root mean square over the trials of the calibrated robots' rms error [m]."""
        return rms(self.values("rms"))

    @property
    def nominal_rms(self) -> float:
        """The same of the nominal robots [m]."""
        return rms(self.values("nominal_rms"))

    @property
    def rms_error(self) -> float:
        """Standard error of `rms`, from the spread of the trials [m]."""
        squares = self.values("rms") ** 2
        return float(np.std(squares, ddof=1) / np.sqrt(len(squares)) / (2.0 * self.rms))

    def range(self, name: str, share: float = 0.90) -> tuple[float, float]:
        """Between which values a share of the trials lies."""
        tail = 0.5 * (1.0 - share)
        low, high = np.quantile(self.values(name), [tail, 1.0 - tail])
        return float(low), float(high)

    def counts(self, name: str) -> dict[str, int]:
        """How many trials ended with each word of ``verdict`` or ``model``, the most frequent first."""
        return dict(Counter(getattr(trial, name) for trial in self.trials).most_common())


def study(
    trials: Trials,
    count: int,
    seed: int = 0,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Study:
    """Do so many trials, 2 or more, for a spread; trial i has the seed ``seed + i``, in any executor.

    The executor is one of `concurrent.futures`, or Dask's ``Client.get_executor()``; None: here, one after the other.

    Raises:
        CalibError: Fewer than two trials, all of them failed (with the first one's reason), or a worker was killed.
    """
    if count < 2:
        raise CalibError(f"A study of {count} trials was asked for; it takes 2 or more.")
    done: dict[int, Trial | str] = {}
    seeds = range(seed, seed + count)
    for number, result in run(_guarded, trials, seeds, executor, batch=batch_size(count)):
        done[seeds[number]] = result
        if progress is not None:
            progress(len(done), count)
    found = tuple(t for s in seeds if isinstance(t := done[s], Trial))
    failures = tuple((s, t) for s in seeds if isinstance(t := done[s], str))
    if not found:
        raise CalibError(
            f"None of the {count} trials came to an end. The first one's reason: {failures[0][1]}"
        )
    random = trials.poses is None and not trials.planned
    several = [_forecast(trials, one) for one in seeds[: _FORECASTS if random else 1]]
    told = sorted((one for one in several if one is not None), key=lambda one: one.rms)
    return Study(found, failures, told[len(told) // 2] if told else None)


def study_table(found: Study, trials: Trials, seed: int) -> dict[str, Any]:
    """The study as a table for a JSON file, SI units, the unit in the keys; what there is not is NaN."""
    return {
        "schema": SCHEMA,
        "seed": seed,
        "poses": {"count": trials.fitted, "planned": trials.planned},
        "fit_model": trials.cell.model,
        "true_model": trials.scenario.model,
        "nominal_rms_m": found.nominal_rms,
        "rms_m": found.rms,
        "rms_standard_error_m": found.rms_error,
        "forecast_rms_m": found.forecast and found.forecast.rms,
        "failures": [{"seed": one, "reason": reason} for one, reason in found.failures],
        "trials": [
            {name + _UNITS.get(name, ""): value for name, value in asdict(trial).items()}
            for trial in found.trials
        ],
    }


def one_trial(trials: Trials, seed: int) -> Trial:
    """Plan, measure, fit and verify once, everything that is drawn with one seed."""
    virtual = trials.scenario.draw(seed)
    q, sets = trials.poses_of(seed)
    made = virtual.measure(q, seed, sets)
    fitted, verdict, named = _calibrated(trials, made)
    outliers = set(made.outlier_rows)
    problem = fitted.estimate.problem
    lengths = problem.scales[:, :3][problem.rows.used[:, :3]]
    return Trial(
        seed=seed,
        **_verified(trials, made.truth, fitted),
        sigma=float(np.median(lengths)) if lengths.size else float("nan"),
        model=fitted.kinematics.model.name,
        verdict=verdict,
        outliers=len(outliers),
        flagged=len(outliers & named),
        false_alarms=len(named - outliers),
    )


def _guarded(trials: Trials, seed: int) -> Trial | str:
    """A trial, or the reason why there is none."""
    try:
        return one_trial(trials, seed)
    except CalibError as error:
        return str(error)


def _calibrated(trials: Trials, made: Simulated) -> tuple[Fitted, str, frozenset[int]]:
    """The last fit of a calibration, of the non-geometric model if any; the verdict's word; the rows it flags.

    Without validation the fits alone are made, not all that is said of them, and the word is "".
    """
    robot, table = trials.scenario.robot, made.measurements
    if trials.validate:
        result = calibrate(robot, table, cell=trials.cell, solver=trials.solver)
        assert result.verdict is not None
        assert result.fit is not None
        fitted = result.fit.non_geometric or result.fit.geometry
        return fitted, result.verdict.use, frozenset(outlier.row for outlier in result.outliers)
    fits = fit_table(robot, table, trials.cell, solver=trials.solver)
    rows = np.array(table.rows)[table.estimation]
    flagged = frozenset(rows[fits.geometry.estimate.outliers].tolist())
    return fits.non_geometric or fits.geometry, NO if fits.mistake else "", flagged


def verification_poses(scenario: Scenario) -> Array:
    """The poses at which every trial is verified, shape (500, m), [rad] or [m]: random ones over the joint ranges."""
    return scenario.random_poses(VERIFIED, _VERIFY_SEED)


def _verified(trials: Trials, truth: Truth, fitted: Fitted) -> dict[str, float]:
    """A calibration against the truth at poses that it has not seen: fields of `Trial`."""
    scenario, cell, estimate = trials.scenario, trials.cell, fitted.estimate
    q = verification_poses(scenario)
    T_base_target = truth.tip_poses(q) @ truth.T_tip_target[0]
    load = None
    if any(term.factor and term.factor.loaded for term in fitted.kinematics.model.terms):
        load = gravity_loads(scenario.robot, q, cell.payload, cell.gravity)
    poses, J = fitted.kinematics.twists(estimate.x, Samples.at(q, load), rotation=False)
    if scenario.kind.position:
        error = poses[:, :3, 3] - (truth.T_frame_base[0] @ T_base_target)[:, :3, 3]
    else:  # lengths do not tell where the base stands: only the shape of all positions counts
        predicted = (rigid_inverse(fitted.placed().T_frame_base[0]) @ poses)[:, :3, 3]
        moved = (predicted - T_base_target[:, :3, 3])[:, :, None]
        error = without_rigid_motion(predicted, moved)[:, :, 0]
        J = without_rigid_motion(predicted, J)
    length = np.linalg.norm(error, axis=1)
    stated = (J.reshape(-1, J.shape[2]) @ estimate.covariance).reshape(J.shape)
    stated = stated @ J.transpose(0, 2, 1)
    square = np.sum(error * np.linalg.solve(stated, error[:, :, None])[:, :, 0], axis=1)
    inside = square <= 3.0 * fdtri(3, max(estimate.freedom, 1.0), _LEVEL)
    return {
        "nominal_rms": rms(truth.nominal_errors(q)),
        "rms": rms(length),
        "max": float(np.max(length)),
        "stated_rms": float(np.sqrt(np.mean(np.trace(stated, axis1=1, axis2=2)))),
        "covered": float(np.mean(inside)),
    }


def _forecast(trials: Trials, seed: int) -> Forecast | None:
    """What was to be expected of one trial's poses, over the poses of the verification.

    By what there is, not by what the fit is told: where nothing says where the tracker stands, at a usual distance.
    """
    scenario, cell = trials.scenario, trials.cell
    if scenario.noise is None:
        return None
    place = scenario.tracker
    if place is None:
        T = next(iter(scenario.cell.frames.values()), scenario.cell.T_frame_base)
        place = DEFAULT_TRACKER if T is None else rigid_inverse(T)[:3, 3]
    cell = replace(
        cell,
        sigma=None,
        sigma_angle=scenario.sigma_angle or cell.sigma_angle,
        tracker=Tracker(place, noise=scenario.noise),
    )
    try:
        sensitivity = Sensitivity.of(scenario.robot, cell)
    except ModelError:
        return None
    q, sets = trials.poses_of(seed)
    visited = np.repeat(q[[one == "estimate" for one in sets]], scenario.visits, axis=0)
    return Forecast.of(
        sensitivity, Workspace.of(sensitivity, verification_poses(scenario)), visited
    )
