"""Fits without some rows, on the problem linearised at the fit to all rows.

Each fold goes through the same stages as a fit from the beginning (`calib.identify.estimate.staged`): weights by
medians, then noise and sizes by restricted likelihood. Registration and kinematics are not repeated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.identify.estimate import staged
from calib.identify.linear import Linear
from calib.identify.options import Options
from calib.identify.problem import Problem
from calib.identify.stage import Stage
from calib.identify.statistics import Mask
from calib.identify.variance import Known

Array = NDArray[np.float64]

#: Of so many rows so small a share can be left out without finding weights, noise and sizes anew.
_MANY, _SMALL_SHARE = 1500, 0.15


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
    noise: tuple[float, ...],
    linear: Linear,
    masks: Sequence[Mask],
    options: Options,
) -> FoldFits:
    """Fit without each fold.

    Args:
        problem: Of all rows, in its last form.
        noise: Of each instrument, as the fit to all rows found it.
        linear: The problem linearised there.
        masks: The rows left out, each of shape (N,).
        options: Of the fit, without weights that stay.
    """
    if len(linear) >= _MANY and max(float(np.mean(mask)) for mask in masks) < _SMALL_SHARE:
        known = linear.known(problem.precision, problem.centre)
        found = fold_means(linear, masks, problem.weights, noise, known)
        return FoldFits(found, np.full(len(masks), np.inf))
    x, freedoms = [], []
    for mask in masks:
        rest, poses = linear.select(~mask), problem.rows.poses[~mask]
        first = Stage.first(options.holds, len(rest), len(rest.smallest))
        shared = first.sharing(rest, poses, options.repeats)
        freedoms.append(rest.fit(shared.effective, shared.noise, shared.known(rest))[2])
        last = staged(first, lambda _, rest=rest: rest, poses, options)  # type: ignore[misc]
        x.append(rest.data(last.effective).posterior(last.noise, last.known(rest))[0])
    return FoldFits(np.array(x), np.array(freedoms))


def fold_means(
    linear: Linear,
    masks: Sequence[Mask],
    weights: Array,
    noise: tuple[float, ...],
    known: Known,
) -> Array:
    """Posterior means without each fold, at weights, noise and priors that stay, shape (F, p)."""
    each = (linear.data(np.where(mask, 0.0, weights)) for mask in masks)
    return np.array([data.posterior(noise, known)[0] for data in each])
