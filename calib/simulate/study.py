"""study: plan, measure, fit and verify many times, each time on a robot with errors of its own.

One trial draws a true robot, sends it to the poses, measures it there with noise, calibrates the nominal robot with
these measurements alone, and asks both robots for the target's position at poses that were not measured: the error
there is known, because the truth is. Trials are independent and can run in any executor of `concurrent.futures`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.design.forecast import Forecast, Workspace
from calib.design.sensitivity import Sensitivity
from calib.errors import CalibError, ModelError
from calib.identify.jobs import batch_size, run
from calib.measure.surroundings import Tracker
from calib.model.robot import rigid_inverse
from calib.simulate.scenario import DEFAULT_TRACKER, Scenario
from calib.simulate.trial import (
    VERIFIED,
    Trial,
    Trials,
    one_trial,
    trial_poses,
    verification_poses,
)

__all__ = ["VERIFIED", "Study", "Trial", "Trials", "one_trial", "study", "verification_poses"]

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

#: The result file's kind and version.
SCHEMA = "study 1"

#: The units of a trial's figures, as suffixes of their keys.
_UNITS = dict.fromkeys(("nominal_rms", "rms", "max", "stated_rms", "sigma"), "_m")

#: So many trials' random poses are forecast: 15 of them are worth up to a tenth more or less than others.
_FORECASTS = 9


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
        executor: Where to run them; None: here, one after the other. Any of `concurrent.futures`, or Dask's
            ``Client.get_executor()``.
        progress: Called after each trial.

    Raises:
        CalibError: Fewer than two trials, a seed below 0, all of them failed (with the first one's reason), or a worker
            was killed.
    """
    if count < 2 or seed < 0:
        raise CalibError(
            f"A study of {count} trials with seed {seed} was asked for; it takes 2 trials or more, 200 for figures to "
            "two digits, and a seed of 0 or more."
        )
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
    return Study(found, failures, _forecast(trials, seed, count))


def study_table(found: Study, trials: Trials, seed: int) -> dict[str, Any]:
    """The study as a table for a JSON file, SI units, the unit in the keys; what there is not is NaN."""
    forecast = found.forecast
    return {
        "schema": SCHEMA,
        "seed": seed,
        "poses": {"count": trials.fitted, "planned": trials.planned},
        "fit_model": trials.cell.model,
        "true_model": trials.scenario.model,
        "nominal_rms_m": found.nominal_rms,
        "rms_m": found.rms,
        "rms_standard_error_m": found.rms_error,
        "forecast_rms_m": None if forecast is None else forecast.rms,
        "failures": [{"seed": one, "reason": reason} for one, reason in found.failures],
        "trials": [
            {name + _UNITS.get(name, ""): value for name, value in asdict(trial).items()}
            for trial in found.trials
        ],
    }


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
        sensitivity = Sensitivity.of(scenario.robot, cell)
    except ModelError:
        return None
    q, sets = trial_poses(trials, seed)
    visited = np.repeat(q[[one == "estimate" for one in sets]], scenario.visits, axis=0)
    return Forecast.of(
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


def _guarded(trials: Trials, seed: int) -> Trial | str:
    """A trial, or the reason why there is none."""
    try:
        return one_trial(trials, seed)
    except CalibError as error:
        return str(error)
