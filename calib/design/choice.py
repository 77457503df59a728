"""The choice of poses to measure, out of candidates, under the model that the fit will use, and what they will give."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.design.candidates import Pool
from calib.design.forecast import Forecast, Workspace, held, parameter_weight
from calib.design.optimal import (
    RESTARTS,
    Basis,
    check_criterion,
    choose,
    grow,
    information,
    short_list,
)
from calib.design.sensitivity import Sensitivity
from calib.errors import ModelError
from calib.model.robot import read_only

Array = NDArray[np.float64]
Indices = NDArray[np.int_]
Progress = Callable[[int, int], None]

#: Candidates among which the steps of the ladder are chosen: enough to show where more poses stop paying.
_LADDER_POOL = 2000

#: Draws of random poses, of which the median is shown.
_RANDOM = 9

#: Poses that differ by less than this in every joint are the same one [rad or m].
_SAME = 1e-3

#: More poses than this are chosen from one start: there are many choices that are as good.
_MANY = 100

#: Poses of a plan at most: exchanging thousands takes hours, and nothing is gained that random ones do not have.
MOST_POSES = 300

#: Steps of the ladder that is made where none is asked for, in poses of the plan.
_RUNGS = (0.5, 0.67, 0.83, 1.0, 1.33, 1.67, 2.0, 3.0)


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """What was chosen out of a pool.

    Attributes:
        planned: shape (N, m), the poses to fit, [rad] or [m].
        validation: shape (V, m), others, drawn at random.
        forecast: Of the fit of taken poses and planned ones.
        before: Of the poses taken alone; None without.
        at_random: Of as many random poses, the median of several draws.
        ladder: Of other numbers of planned poses, in rising order.
    """

    planned: Array
    validation: Array
    forecast: Forecast
    before: Forecast | None
    at_random: Forecast
    ladder: tuple[tuple[int, Forecast], ...]


def choose_poses(
    sensitivity: Sensitivity,
    pool: Pool,
    *,
    count: int,
    validation: int = 0,
    criterion: str = "V",
    taken: Array | None = None,
    ladder: Sequence[int] | None = None,
    seed: int = 0,
    restarts: int = RESTARTS,
    progress: Progress | None = None,
) -> Choice:
    """Choose poses from a pool of candidates.

    Args:
        sensitivity: Of the model that the fit will use.
        pool: The candidates, and where accuracy is wanted.
        count: Poses to fit.
        validation: Poses to validate with, beside them.
        criterion: See `calib.design.optimal`.
        taken: shape (T, m), poses that were measured already; they count, and are not planned again.
        ladder: Numbers of poses to forecast; None: some from half to three times ``count``; empty: none.
        seed: The same seed makes the same choice.
        restarts: Random starts of the exchange; one is a few percent worse than several.
        progress: Called after each step.

    Raises:
        ModelError: No such criterion, fewer candidates than poses, or fewer poses than the model needs.
    """
    check_criterion(criterion)
    taken = np.zeros((0, pool.q.shape[1])) if taken is None else taken
    q = _without(pool.q, taken)
    check_numbers(count, validation, len(q))
    measured = sensitivity.measured(q)
    workspace = Workspace.of(sensitivity, pool.workspace)
    rungs = _rungs(ladder, count, len(q), _fewest(workspace, measured.shape[1], len(taken)))
    _check_enough(workspace, measured.shape[1], count, len(taken), sensitivity)
    steps = 2 + len(rungs)

    def done(step: int) -> None:
        if progress is not None:
            progress(step, steps)

    known = information(sensitivity.measured(taken)) if len(taken) else 0.0 * workspace.mean_square
    weight = {
        "D": None,
        "A": parameter_weight(sensitivity.units),
        "V": workspace.mean_square,
    }[criterion]
    mean = information(measured) / len(measured)
    basis = Basis.of(mean, held(sensitivity.precision), weight, known)
    blocks = basis.blocks(measured)
    done(1)
    chosen = choose(blocks, basis, count, seed, restarts if count <= _MANY else 1)
    done(2)

    def foreseen(indices: Indices) -> Forecast:
        return Forecast.of(sensitivity, workspace, np.concatenate([taken, q[indices]]))

    rng = np.random.default_rng([seed, 1])
    others = rng.permutation(np.setdiff1d(np.arange(len(q)), chosen))
    plan = foreseen(chosen)
    steps_of_ladder: list[tuple[int, Forecast]] = []
    short = short_list(blocks, basis, max(_LADDER_POOL, *rungs, 0))
    at = np.zeros(0, dtype=np.int_)
    for step, number in enumerate(rungs):
        if number == count:
            steps_of_ladder.append((count, plan))
        else:
            at = grow(blocks[short], basis, at, number)
            steps_of_ladder.append((number, foreseen(short[at])))
        done(3 + step)
    return Choice(
        planned=read_only(q[chosen]),
        validation=read_only(q[others[:validation]]),
        forecast=plan,
        before=Forecast.of(sensitivity, workspace, taken) if len(taken) else None,
        at_random=_median(
            [foreseen(rng.choice(len(q), count, replace=False)) for _ in range(_RANDOM)]
        ),
        ladder=tuple(steps_of_ladder),
    )


def _without(q: Array, taken: Array) -> Array:
    """The candidates but those that were measured already, all joints within `_SAME`, whole turns aside."""
    again = np.zeros(len(q), dtype=bool)
    for pose in taken:
        gap = np.remainder(q - pose + np.pi, 2.0 * np.pi) - np.pi
        again |= np.all(np.abs(gap) < _SAME, axis=1)
    return q[~again]


def _median(forecasts: list[Forecast]) -> Forecast:
    """The one in the middle, by the expected rms error."""
    return sorted(forecasts, key=lambda one: one.rms)[len(forecasts) // 2]


def check_numbers(count: int, validation: int, candidates: int) -> None:
    """Refuse numbers of poses that cannot be.

    Raises:
        ModelError: Below one pose, below no validation poses, or more than there are candidates.
    """
    if count < 1 or validation < 0:
        raise ModelError(
            f"{count} poses and {validation} validation poses were asked for; it takes 1 pose or more, and 0 or more "
            "to validate."
        )
    if count + validation > candidates:
        raise ModelError(
            f"{count} poses and {validation} to validate were asked for, but only {candidates} candidates can be "
            "measured. Draw more candidates, ask for fewer poses, or drop a condition."
        )
    if count + validation > MOST_POSES:
        raise ModelError(
            f"{count} poses and {validation} to validate were asked for; a plan has at most {MOST_POSES}. So many "
            "random ones do as well: calib simulate --count draws them."
        )


def _fewest(workspace: Workspace, scalars: int, taken: int) -> int:
    """The fewest planned poses whose numbers, with those taken, are as many as what can be told apart."""
    return max(1, -(-workspace.rank // scalars) - taken)


def _check_enough(
    workspace: Workspace, scalars: int, count: int, taken: int, sensitivity: Sensitivity
) -> None:
    """Refuse fewer poses than the parameters need.

    Raises:
        ModelError: There are fewer.
    """
    fewest = _fewest(workspace, scalars, taken)
    if count < fewest:
        before = f" with the {taken} measured already" if taken else ""
        raise ModelError(
            f"{count} poses give {scalars * (count + taken)} numbers{before}, and the model '{sensitivity.model}' has "
            f"{workspace.rank} parameters that can be told apart: at least {fewest} poses are needed, and twice as "
            "many are wise. Ask for more poses, or choose a smaller --model."
        )


def _rungs(ladder: Sequence[int] | None, count: int, candidates: int, fewest: int) -> list[int]:
    """The numbers of poses to forecast, in rising order, ``count`` among them if there are any.

    Raises:
        ModelError: A number that cannot be.
    """
    if ladder is None:
        wanted = {round(share * count) for share in _RUNGS}
        most = min(candidates, MOST_POSES)
        return sorted(n for n in {*wanted, count} if fewest <= n <= most)
    wrong = [n for n in ladder if not fewest <= n <= candidates]
    if wrong:
        raise ModelError(
            f"A forecast for {wrong[0]} poses was asked for; it takes at least {fewest}, so many does the model need, "
            f"and at most {candidates}, the candidates that can be measured."
        )
    return sorted({*ladder, count}) if ladder else []
