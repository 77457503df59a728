"""Fits without some rows, all folds at once, on the problem linearised at the fit to all rows.

Each fold goes through the same stages as a fit from the beginning (`calib.identify.estimate.staged`): weights by
medians, then noise and sizes by restricted likelihood. Registration and kinematics are not repeated: the stages see the
linearised problem only, without the fold's rows. Folds that have settled wait for the others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.identify.estimate import ROUNDS, Options, staged
from calib.identify.fold_stages import AllFolds, FoldStages, normal_of, products_of
from calib.identify.linear import Linear
from calib.identify.problem import Problem
from calib.identify.stage import SETTLED, Holds, Stage
from calib.identify.statistics import Mask
from calib.identify.streamed import Streamed, linearised
from calib.identify.variance import Known, Linearised

Array = NDArray[np.float64]

#: Numbers that the products of all rows may have together; above, the folds are fitted one after the other.
_MOST_NUMBERS = 4_000_000

#: Of many rows so small a share can be left out without finding weights, noise and sizes anew.
_SMALL_SHARE = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class FoldFits:
    """Solutions without each fold.

    Attributes:
        x: shape (F, p), parameters, counted from where those of the fit to all rows are.
        freedom: shape (F,), degrees of freedom of the first fit; where they are few no row loses its weight.
    """

    x: Array
    freedom: Array


def fold_fits(
    problem: Problem,
    linear: Linear | Streamed,
    x: Array,
    holds: Holds,
    masks: tuple[Mask, ...],
    options: Options,
) -> FoldFits:
    """Fit without each fold.

    Args:
        problem: Of all rows.
        linear: It linearised at x.
        x: shape (p,), the fit to all rows.
        holds: What holds the parameters.
        masks: The rows left out, each of shape (N,).
        options: Of the fit, without weights that stay.
    """
    if not isinstance(linear, Linear) or not _fits_in_memory(linear):
        if (
            isinstance(linear, Streamed)
            and max(float(np.mean(mask)) for mask in masks) < _SMALL_SHARE
        ):
            return _as_they_are(problem, linear, masks)
        return _one_by_one(problem, x, holds, masks, options)
    many = AllFolds.of(linear, holds, problem.rows, options)
    stages = many.shared(FoldStages.first(holds, ~np.array(masks), len(linear.smallest)))
    freedom = many.fit(stages)[2]
    active = np.arange(len(masks))
    # AllFolds with few degrees of freedom are told so, and not used.
    for _ in range(ROUNDS if options.robust else 0):
        before = stages.select(active)
        after = many.shared(many.by_median(before))
        stages = stages.put(active, after)
        active = active[after.moved(before) >= SETTLED]
        if not len(active):
            break
    active = np.arange(len(masks))
    for _ in range(ROUNDS):
        before = stages.select(active)
        after = many.shared(many.by_likelihood(before, robust=options.robust))
        stages = stages.put(active, after)
        active = active[~after.is_like(before)]
        if not len(active):
            break
    return FoldFits(many.posterior(many.data(stages.effective), stages)[0], freedom)


def fold_means(
    linear: Linear | Streamed,
    masks: tuple[Mask, ...],
    weights: Array,
    noise: tuple[float, ...],
    known: Known,
) -> Array:
    """Posterior means without each fold, at weights, noise and priors that stay, shape (F, p)."""
    if not isinstance(linear, Linear) or not _fits_in_memory(linear):
        each = [linear.data(np.where(mask, 0.0, weights)) for mask in masks]
    else:
        data = normal_of(*products_of(linear), np.where(np.array(masks), 0.0, weights))
        each = [Linearised(*one) for one in zip(data.H, data.g, data.yy, data.count, strict=True)]
    return np.array([data.posterior(noise, known)[0] for data in each])


def _fits_in_memory(linear: Linear) -> bool:
    """Whether each row can be multiplied out by itself."""
    N, _, p = linear.A.shape
    return bool(len(linear.smallest) * N * (p + 1) ** 2 <= _MOST_NUMBERS)


def _as_they_are(problem: Problem, linear: Streamed, masks: tuple[Mask, ...]) -> FoldFits:
    """`fold_fits` where a fold is a small share of many rows: weights, noise and sizes are those of all rows."""
    noise = linear.passes.noise_of(problem.scales)
    known = linear.known(problem.precision, problem.centre)
    found = fold_means(linear, masks, problem.weights, noise, known)
    return FoldFits(found, np.full(len(masks), np.inf))


def _one_by_one(
    problem: Problem, x: Array, holds: Holds, masks: tuple[Mask, ...], options: Options
) -> FoldFits:
    """`fold_fits` where there are many rows: one fold after the other, by the stages of a single fit."""
    found, freedoms = [], []
    for mask in masks:
        without = Problem.first(problem.kinematics, problem.rows.select(~mask), problem.distances)
        kept, rest = without.rows, linearised(without, x)
        first = Stage.first(without, holds).sharing(rest, kept.poses, options.repeats)
        *_, freedom = rest.fit(first.effective, first.noise, first.precision, holds.centre)
        last = staged(Stage.first(without, holds), lambda _, rest=rest: rest, kept, options)  # type: ignore[misc]
        known = rest.known(last.precision, holds.centre)
        found.append(rest.data(last.effective).posterior(last.noise, known)[0])
        freedoms.append(freedom)
    return FoldFits(np.array(found), np.array(freedoms))
