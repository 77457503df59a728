"""study: plan, measure, fit and verify many times, each time on a robot with errors of its own.

One trial draws a true robot, sends it to the poses, measures it there with noise, calibrates the nominal robot with
these measurements alone, and asks both robots for the target's position at poses that were not measured: the error
there is known, because the truth is. Trials are independent and can run in any executor of `concurrent.futures`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, as_completed
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

from calib.errors import CalibError, ModelError
from calib.identify.calibration import Calibration, calibrate
from calib.identify.fitting import Fitted
from calib.identify.foresight import Outlook
from calib.identify.spread import without_rigid_motion
from calib.measure.candidates import draw, planning_ranges
from calib.measure.cell import Cell
from calib.measure.forecast import Forecast, Workspace
from calib.measure.forecast import forecast as forecast_of
from calib.measure.kinds import LENGTHS
from calib.measure.planning import choose_poses
from calib.measure.scenario import DEFAULT_TRACKER, Scenario
from calib.measure.simulation import Simulated, VirtualCell
from calib.measure.surroundings import Tracker
from calib.model.robot import rigid_inverse

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

#: Poses at which a trial is verified, and the seed that they are drawn with.
VERIFIED = 500
_VERIFY_SEED = 19790401

#: Candidates that each trial's plan is chosen from: it is made anew each time.
PLAN_CANDIDATES = 2000

#: So many trials' random poses are forecast: 15 of them are worth up to a tenth more or less than others.
_FORECASTS = 9

#: What of a stated region should hold the truth.
_LEVEL = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class Trials:
    """What is done each time.

    Attributes:
        scenario: What robots and disturbances are drawn.
        cell: What the fit is told; its model too.
        poses: shape (N, m), poses to measure, the same each time; None: ``count`` others each time.
        sets: ``"estimate"`` or ``"validate"`` for each of ``poses``.
        count: Poses to fit, where they are made each time.
        validation: Random poses to validate with, besides.
        planned: Whether they are planned, or drawn at random.
        criterion: Of the plan.
        validate: Whether each fit is cross-validated, for its verdict.
        solver: Of the fit.
    """

    scenario: Scenario
    cell: Cell
    poses: Array | None = None
    sets: tuple[str, ...] = ()
    count: int = 30
    validation: int = 0
    planned: bool = False
    criterion: str = "V"
    validate: bool = True
    solver: str = "lm"


@dataclass(frozen=True, slots=True)
class Trial:
    """One robot, calibrated and verified.

    Attributes:
        seed: Of everything that was drawn.
        nominal_rms: Error of the nominal robot, frame and target where they truly are, over the poses of the
            verification [m].
        rms: Error of what the calibrated robot predicts there [m].
        max: The largest [m].
        stated_rms: What the fit itself says of its error there [m].
        covered: Share of these positions inside the 95 % ellipsoid that the fit states.
        sigma: Noise that the fit found, with the larger model where there is one [m].
        model: The parameter set that was fitted.
        verdict: The verdict's word; "" without one.
        outliers: How many rows are outliers in truth.
        flagged: How many of these the fit named.
        false_alarms: How many others it named.
    """

    seed: int
    nominal_rms: float
    rms: float
    max: float
    stated_rms: float
    covered: float
    sigma: float
    model: str
    verdict: str
    outliers: int
    flagged: int
    false_alarms: int


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """Many trials.

    Attributes:
        trials: In the order of their seeds.
        failures: Seed and reason of those that ended with an error.
        forecast: What was to be expected: of the first trial's poses, or where poses are random of those in the middle
            of several trials'; None where the robots' errors or what is fitted have no forecast.
    """

    trials: tuple[Trial, ...]
    failures: tuple[tuple[int, str], ...]
    forecast: Forecast | None

    def values(self, name: str) -> Array:
        """One figure of all trials, shape (trials,)."""
        return np.array([getattr(trial, name) for trial in self.trials], dtype=np.float64)

    @property
    def rms(self) -> float:
        """Root mean square over the trials of the calibrated robots' rms error [m]."""
        return float(np.sqrt(np.mean(self.values("rms") ** 2)))

    @property
    def nominal_rms(self) -> float:
        """The same of the nominal robots [m]."""
        return float(np.sqrt(np.mean(self.values("nominal_rms") ** 2)))

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
    """Do the trials.

    Args:
        trials: What is done each time.
        count: How many; 2 or more, for a spread.
        seed: Trial i has the seed ``seed + i``: the same seed makes the same study, in any executor.
        executor: Where to run them; None: here, one after the other.
        progress: Called after each trial.

    Raises:
        CalibError: Fewer than two trials, a seed below 0, or all of them failed: with the first one's reason.
    """
    if count < 2 or seed < 0:
        message = (
            f"A study of {count} trials with seed {seed} was asked for; it takes 2 trials or more, 200 for figures to "
            "two digits, and a seed of 0 or more."
        )
        raise CalibError(message)
    seeds = range(seed, seed + count)
    done: dict[int, Trial | str] = {}
    for one, result in _results(trials, seeds, executor):
        done[one] = result
        if progress is not None:
            progress(len(done), count)
    found = tuple(t for s in seeds if isinstance(t := done[s], Trial))
    failures = tuple((s, t) for s in seeds if isinstance(t := done[s], str))
    if not found:
        message = (
            f"None of the {count} trials came to an end. The first one's reason: {failures[0][1]}"
        )
        raise CalibError(message)
    return Study(found, failures, _forecast(trials, seed, count))


def one_trial(trials: Trials, seed: int) -> Trial:
    """Plan, measure, fit and verify once.

    Args:
        trials: What is done.
        seed: Of everything that is drawn.

    Raises:
        CalibError: The poses, the scenario or the cell do not fit the robot, or the fit has no result.
    """
    virtual = trials.scenario.draw(seed)
    q, sets = _poses(trials, seed)
    simulated = virtual.measure(q, seed, sets)
    result = calibrate(
        trials.scenario.robot,
        simulated.measurements,
        cell=trials.cell,
        solver=trials.solver,
        validate=trials.validate,
    )
    return _verified(trials, virtual, simulated, result, seed)


def verification_poses(scenario: Scenario) -> Array:
    """The poses at which every trial is verified, shape (500, m), [rad] or [m]: random ones over the joint ranges."""
    return scenario.random_poses(VERIFIED, _VERIFY_SEED)


def _verified(
    trials: Trials, virtual: VirtualCell, simulated: Simulated, result: Calibration, seed: int
) -> Trial:
    """A calibration against the truth, at poses that it has not seen."""
    q = verification_poses(trials.scenario)
    truth = virtual.truth
    predicted = result.predict(q, larger=True)
    true = truth.points(q)
    if trials.scenario.kind in LENGTHS:
        # Lengths do not tell where the base stands: only the shape of all positions counts.
        true = (truth.tip_poses(q) @ truth.T_tip_target[0])[:, :3, 3]
        error = without_rigid_motion(predicted, (predicted - true)[:, :, None])[:, :, 0]
    else:
        error = predicted - true
    length = np.linalg.norm(error, axis=1)
    stated = _stated(trials, result, q, predicted)
    outliers = set(simulated.outlier_rows)
    named = {outlier.row for outlier in result.outliers}
    larger = result.larger
    return Trial(
        seed=seed,
        nominal_rms=float(np.sqrt(np.mean(truth.nominal_errors(q) ** 2))),
        rms=float(np.sqrt(np.mean(length**2))),
        max=float(np.max(length)),
        stated_rms=float(np.sqrt(np.mean(np.trace(stated, axis1=1, axis2=2)))),
        covered=_covered(result, stated, error),
        sigma=_sigma(result),
        model=result.model.name if larger is None else larger.name,
        verdict="" if result.verdict is None else result.verdict.use,
        outliers=len(outliers),
        flagged=len(outliers & named),
        false_alarms=len(named - outliers),
    )


def _stated(trials: Trials, result: Calibration, q: Array, predicted: Array) -> Array:
    """The covariances that the fit states for the predicted positions, shape (N, 3, 3), [m^2]."""
    fitted = _last(result)
    estimate = fitted.estimate
    _, J = fitted.kinematics.points_jacobian(estimate.x, result.samples(q))
    if trials.scenario.kind in LENGTHS:
        J = without_rigid_motion(predicted, J)
    return np.asarray(J @ estimate.covariance @ J.transpose(0, 2, 1))


def _covered(result: Calibration, stated: Array, error: Array) -> float:
    """The share of positions whose error lies inside the ellipsoid that the fit states."""
    square = np.sum(error * np.linalg.solve(stated, error[:, :, None])[:, :, 0], axis=1)
    limit = 3.0 * fdtri(3, max(_last(result).estimate.freedom, 1.0), _LEVEL)
    return float(np.mean(square <= limit))


def _sigma(result: Calibration) -> float:
    """The noise of one length that the fit found, of the larger model where there is one [m]; NaN without lengths."""
    problem = _last(result).estimate.problem
    lengths = problem.scales[:, :3][problem.rows.used[:, :3]]
    return float(np.median(lengths)) if lengths.size else float("nan")


def _last(result: Calibration) -> Fitted:
    """The fit that `Calibration.predict` answers from."""
    return result.fitted if result.larger is None else result.larger.fitted


def _poses(trials: Trials, seed: int) -> tuple[Array, tuple[str, ...]]:
    """The poses of one trial, and the set of each."""
    q, sets = trials.poses, trials.sets
    if q is None:
        q = (
            _planned(trials, seed)
            if trials.planned
            else trials.scenario.random_poses(trials.count, seed)
        )
        sets = ("estimate",) * len(q)
    extra = trials.scenario.random_poses(trials.validation, seed, validation=True)
    return np.concatenate([q, extra]), (*sets, *("validate",) * len(extra))


def _planned(trials: Trials, seed: int) -> Array:
    """Poses that are planned for this trial; collisions are not looked at, for the robot is a virtual one."""
    robot = trials.scenario.robot
    sensitivity = Outlook.of(robot, trials.cell).sensitivity
    ranges = planning_ranges(robot, trials.scenario.cell.ranges, 0.0)
    pool = draw(robot, ranges, [], max(PLAN_CANDIDATES, trials.count), seed)
    chosen = choose_poses(
        sensitivity,
        pool,
        count=trials.count,
        criterion=trials.criterion,
        ladder=(),
        seed=seed,
        restarts=1,
    )
    return chosen.planned


def _forecast(trials: Trials, seed: int, count: int) -> Forecast | None:
    """What was to be expected of the trials' poses, over the poses of the verification; see `Study`."""
    random = trials.poses is None and not trials.planned
    found = [
        _forecast_of(trials, one)
        for one in range(seed, seed + min(count, _FORECASTS if random else 1))
    ]
    told = [one for one in found if one is not None]
    return sorted(told, key=lambda one: one.rms)[len(told) // 2] if told else None


def _forecast_of(trials: Trials, seed: int) -> Forecast | None:
    """What was to be expected of one trial's poses."""
    scenario, cell = trials.scenario, trials.cell
    if scenario.noise is None:
        return None
    # Not what the fit is told, but what there is.
    place = _tracker_place(scenario)
    cell = replace(
        cell,
        sigma=None,
        sigma_angle=scenario.sigma_angle or cell.sigma_angle,
        tracker=Tracker(place, noise=scenario.noise),
    )
    try:
        sensitivity = Outlook.of(scenario.robot, cell).sensitivity
    except ModelError:
        return None
    q, sets = _poses(trials, seed)
    visited = np.repeat(q[[one == "estimate" for one in sets]], scenario.visits, axis=0)
    return forecast_of(
        sensitivity, Workspace.of(sensitivity, verification_poses(scenario)), visited
    )


def _tracker_place(scenario: Scenario) -> Array:
    """Where the instrument stands in the base, shape (3,) [m]; where nothing says so, at a usual distance."""
    cell = scenario.cell
    T_frame_base = next(iter(cell.frames.values()), cell.T_frame_base)
    if scenario.tracker is not None:
        return scenario.tracker
    if T_frame_base is not None:
        return np.asarray(rigid_inverse(T_frame_base)[:3, 3])
    return DEFAULT_TRACKER


def _results(
    trials: Trials, seeds: range, executor: Executor | None
) -> Iterator[tuple[int, Trial | str]]:
    """Each seed's trial, or why it failed, as they come to an end."""
    if executor is None:
        for seed in seeds:
            yield seed, _guarded(trials, seed)
        return
    waiting: dict[Future[Trial | str], int] = {
        executor.submit(_guarded, trials, seed): seed for seed in seeds
    }
    try:
        for future in as_completed(waiting):
            yield waiting[future], future.result()
    finally:
        for future in waiting:
            future.cancel()


def _guarded(trials: Trials, seed: int) -> Trial | str:
    """A trial, or the reason why there is none."""
    try:
        return one_trial(trials, seed)
    except CalibError as error:
        return str(error)
