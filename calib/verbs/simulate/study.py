"""study: plan, measure, fit and verify many times, each time on a robot with errors of its own."""

from __future__ import annotations

from collections import Counter
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from calib.basics.arrays import Array
from calib.basics.jobs import Progress, batch_size, run
from calib.errors import CalibError
from calib.numerics.errors import rms
from calib.verbs.plan.forecast import Forecast
from calib.verbs.simulate.trial import Trial, Trials, forecast_of_trial, one_trial

#: Kind and version of the file.
SCHEMA = "study 1"

#: Suffixes of the keys of a trial's figures that have a unit.
_UNITS = dict.fromkeys(("nominal_rms", "rms", "max", "stated_rms", "sigma"), "_m")

#: Trials whose random poses are forecast: 15 poses are worth up to a tenth more or less than others.
_FORECASTS = 9


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """Results of many trials."""

    #: In the order of their seeds
    trials: tuple[Trial, ...]
    #: Seed and reason of those that ended with an error
    failures: tuple[tuple[int, str], ...]
    #: Of the first trial's poses, or where poses are random the median of several trials'; None where the robots'
    #: errors or what is fitted have no forecast
    forecast: Forecast | None

    def values(self, name: str) -> Array:
        """Return one figure of all trials, by its name in `Trial`, shape (trials,)."""
        return np.array([getattr(trial, name) for trial in self.trials], dtype=np.float64)

    @property
    def rms(self) -> float:
        """Root mean square over the trials of the calibrated robots' rms error [m]."""
        return rms(self.values("rms"))

    @property
    def nominal_rms(self) -> float:
        """Root mean square over the trials of the nominal robots' rms error [m]."""
        return rms(self.values("nominal_rms"))

    @property
    def rms_error(self) -> float:
        """Standard error of `rms`, from the spread of the trials [m]."""
        squares = self.values("rms") ** 2
        return float(np.std(squares, ddof=1) / np.sqrt(len(squares)) / (2.0 * self.rms))

    def range(self, name: str, share: float = 0.90) -> tuple[float, float]:
        """Return between which values of a figure the middle share of the trials lies.

        Args:
            name: Of the figure, in `Trial`.
            share: 0 to 1.
        """
        tail = 0.5 * (1.0 - share)
        low, high = np.quantile(self.values(name), [tail, 1.0 - tail])
        return float(low), float(high)

    def counts(self, name: str) -> dict[str, int]:
        """Count the trials by their ``"verdict"`` or ``"model"``, the most frequent first."""
        return dict(Counter(getattr(trial, name) for trial in self.trials).most_common())


def study(
    trials: Trials,
    count: int,
    seed: int = 0,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Study:
    """Run trials; trial i has the seed ``seed + i``, in any executor.

    Args:
        trials: What is done each time.
        count: Number of trials, 2 or more, for a spread.
        seed: Of the first trial.
        executor: One of `concurrent.futures`, or Dask's ``Client.get_executor()``; None: here, one after the other.
        progress: Called with the trials done and all.

    Returns:
        The results.

    Raises:
        CalibError: Fewer than two trials, all of them failed (with the first one's reason), or a worker was killed.
    """
    if count < 2:
        raise CalibError(f"A study of {count} trials was asked for; it takes 2 or more.")
    seeds = range(seed, seed + count)
    results: dict[int, Trial | str] = {}
    for number, result in run(_guarded, trials, seeds, executor, batch=batch_size(count)):
        results[seeds[number]] = result
        if progress is not None:
            progress(len(results), count)
    done, failures = [], []
    for trial_seed in seeds:
        result = results[trial_seed]
        if isinstance(result, Trial):
            done.append(result)
        else:
            failures.append((trial_seed, result))
    if not done:
        raise CalibError(
            f"None of the {count} trials came to an end. The first one's reason: {failures[0][1]}"
        )
    return Study(tuple(done), tuple(failures), _forecast(trials, seeds))


def _forecast(trials: Trials, seeds: range) -> Forecast | None:
    """Return the forecast of the first trial's poses, or where poses are random the median of several trials'."""
    are_random = trials.poses is None and not trials.planned
    several = [forecast_of_trial(trials, s) for s in seeds[: _FORECASTS if are_random else 1]]
    forecasts = [forecast for forecast in several if forecast is not None]
    forecasts.sort(key=lambda forecast: forecast.rms)
    return forecasts[len(forecasts) // 2] if forecasts else None


def _guarded(trials: Trials, seed: int) -> Trial | str:
    """Return a trial, or the reason why there is none."""
    try:
        return one_trial(trials, seed)
    except CalibError as error:
        return str(error)


def study_table(results: Study, trials: Trials, seed: int) -> dict[str, Any]:
    """Return a study as a table for a JSON file, SI units, the unit in the keys; what there is not is NaN.

    Args:
        results: The study.
        trials: What was done each time.
        seed: Of the first trial.
    """
    failures = [{"seed": failed, "reason": reason} for failed, reason in results.failures]
    return {
        "schema": SCHEMA,
        "seed": seed,
        "poses": {"count": trials.fitted, "planned": trials.planned},
        "fit_model": trials.cell.model,
        "true_model": trials.scenario.model,
        "nominal_rms_m": results.nominal_rms,
        "rms_m": results.rms,
        "rms_standard_error_m": results.rms_error,
        "forecast_rms_m": results.forecast and results.forecast.rms,
        "failures": failures,
        "trials": [_trial_table(trial) for trial in results.trials],
    }


def _trial_table(trial: Trial) -> dict[str, Any]:
    """Return the figures of a trial, the unit in the keys."""
    return {name + _UNITS.get(name, ""): value for name, value in asdict(trial).items()}
