"""Cross-validation on the problem linearised at the fit to all rows: y = A x + n, without a new fit for each fold.

Two uses. Candidates of the search are compared by `linear_cross_validation`, at the weights, noise and prior standard
deviations of the fit to all rows. The cross-validation that is reported takes from `held_out_residuals_linear` those
folds for which the linear problem is accurate; there weights, noise and priors are estimated anew in each fold.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.fit.estimate.fitting import Fitted
from calib.fit.estimate.linear import LinearProblem
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.stages import FEWEST_FREEDOM, Stage, Weighting, run_stages
from calib.fit.estimate.task import PAPER
from calib.fit.registration.rows import Rows
from calib.fit.selection.folds import Folds
from calib.fit.selection.held_out import held_out_residual, seen_only_by
from calib.numerics.errors import CrossValidation
from calib.numerics.likelihood import GaussianPriors

#: The linear problem is accurate where its residuals differ from the robot's by less than this share of the noise, rms.
_LINEAR = 1e-3

#: A fold is fitted anew where it leaves a frame with fewer scalars than this: places then move far.
_FEWEST_SCALARS = 18.0

#: From this number of rows on, a small fold hardly changes weights, noise and priors: those of the fit to all rows do.
_MANY = 1500

#: A fold is small if it holds out less than this share of the rows.
_SMALL_SHARE = 0.15

#: Rows of all folds together that are fitted at a time, for they are held in memory.
_AT_A_TIME = 4096


def linear_cross_validation(fitted: Fitted, outliers: Mask | None = None) -> CrossValidation:
    """Cross-validate on the linearised problem, with prior std, noise and weights of the fit to all rows.

    Args:
        fitted: Fit to N rows.
        outliers: True for the rows to leave out of the errors without outliers, shape (N,); None: those that the fit
            flagged.

    Returns:
        Residuals of the N rows, measured minus predicted without their fold, shape (N, D), [m] and [rad], and their
        errors.
    """
    estimate = fitted.estimate
    problem = estimate.problem
    rows = problem.rows
    if outliers is None:
        outliers = estimate.outliers
    linear = problem.linear(estimate.x)
    folds = Folds.of_task(fitted.task, rows)
    means = fold_posterior_means(fitted, linear, folds.masks)
    residuals = []
    for mask, x in zip(folds.masks, means, strict=True):
        part = linear.select(mask)
        own_places = seen_only_by(fitted, mask)
        if np.any(own_places):
            x = _with_own_places(part, x, own_places, problem.weights[mask])
        residuals.append(_in_units(rows.select(mask), part.residual(x)))
    return folds.joined(rows, residuals, outliers)


def _in_units(rows: Rows, standardised: Array) -> Array:
    """Return residuals of some rows of a table, shape (n, D), as wide as the table, in their units.

    Args:
        rows: These n rows, which may have fewer columns than the table.
        standardised: shape (n, D), as `Rows.standardised` has them.
    """
    result = np.zeros(standardised.shape)
    result[:, : rows.width] = rows.in_units(standardised[:, : rows.width])
    return result


def _with_own_places(part: LinearProblem, x: Array, own_places: Mask, weights: Array) -> Array:
    """Return parameters with those of places that only these rows see fitted to these rows.

    Args:
        part: The linear problem of the n held-out rows alone.
        x: The p parameters by the other rows, offsets from the registered start [m, rad, ...], shape (p,).
        own_places: True for the parameters of places (frames and targets) to fit, shape (p,).
        weights: Weights of the held-out rows, shape (n,). A row without weight must not move the frame of the others.

    Returns:
        A copy of ``x`` with the fitted entries replaced, shape (p,).
    """
    row, _ = np.nonzero(part.used)
    root = np.sqrt(weights)[row]
    by_others = part.residual(np.where(own_places, 0.0, x))[part.used]
    columns = part.A[part.used][:, own_places]
    weighted_columns = columns * root[:, None]
    own, *_ = np.linalg.lstsq(weighted_columns, by_others * root, rcond=1e-9)
    result = x.copy()
    result[own_places] = own
    return np.asarray(result)


def fold_posterior_means(
    fitted: Fitted, linear: LinearProblem, masks: Sequence[Mask] | Mask
) -> Array:
    """Return the parameters by the rows outside of each fold, at weights, noise and priors of the fit to all rows.

    Args:
        fitted: Fit to N rows with p parameters.
        linear: Its problem, linearised.
        masks: For each of F folds, True for the rows that it holds out, each of shape (N,).

    Returns:
        Offsets from the registered start like ``fitted.estimate.x``, shape (F, p).
    """
    problem = fitted.estimate.problem
    weights = np.where(np.array(masks), 0.0, problem.weights)
    noise = np.tile(fitted.estimate.noise, (len(masks), 1))
    priors = GaussianPriors(problem.precision, problem.centre)
    x, _, _ = linear.fit(weights, problem.rho, noise, priors)
    return np.asarray(x)


def held_out_residuals_linear(
    fitted: Fitted, masks: tuple[Mask, ...], outliers: Mask
) -> dict[int, Array]:
    """Return held-out residuals of the folds for which the linear problem is accurate.

    Args:
        fitted: Fit to all N rows.
        masks: For each fold, True for the rows that it holds out, each of shape (N,).
        outliers: Rows that have no part in a registration, shape (N,).

    Returns:
        Residuals, shape (n, D), [m] and [rad], by the fold's index from 0. Folds that are not in it must be fitted
        anew: too few rows are left, a parameter would exceed its bounds, or the robot is not linear that far.
    """
    estimate = fitted.estimate
    if fitted.task.solver == PAPER or estimate.at_bound:
        return {}
    candidates = {k: mask for k, mask in enumerate(masks) if _leaves_enough_rows(fitted, mask)}
    if not candidates:
        return {}
    linear = estimate.problem.linear(estimate.x)
    residuals = {}
    for k, x in _admissible_estimates(fitted, linear, candidates).items():
        residual = _residual_without_fold(fitted, linear, x, masks[k], outliers)
        if residual is not None:
            residuals[k] = residual
    return residuals


def _admissible_estimates(
    fitted: Fitted, linear: LinearProblem, masks: Mapping[int, Mask]
) -> dict[int, Array]:
    """Estimate the parameters without each fold; keep estimates within bounds and with enough degrees of freedom.

    Args:
        fitted: Fit to all N rows with p parameters.
        linear: Its problem, linearised at its solution.
        masks: By the index of each of one or more folds, True for the rows that it holds out, shape (N,).

    Returns:
        Offsets from the registered start like ``fitted.estimate.x``, shape (p,), by the index of the fold.
    """
    prior = PriorTerms.of(fitted.task, fitted.kinematics.model, fitted.setup)
    held_out = np.array(list(masks.values()))
    x, freedom = _fold_estimates(fitted, linear, prior, held_out)
    low, high = prior.limits.T
    within_bounds = np.all((x >= low) & (x <= high), axis=1)
    admissible = (freedom > FEWEST_FREEDOM) & within_bounds
    return {k: x[i] for i, k in enumerate(masks) if admissible[i]}


def _residual_without_fold(
    fitted: Fitted,
    linear: LinearProblem,
    x: Array,
    held_out: Mask,
    outliers: Mask,
) -> Array | None:
    """Return the held-out residual of one fold, or None if the linear problem is not accurate at its estimate.

    Frames and targets that only the held-out rows see are registered to these rows.

    Args:
        fitted: Fit to all N rows with p parameters.
        linear: Its problem, linearised at its solution.
        x: Parameters without the fold, offsets like ``fitted.estimate.x``, shape (p,).
        held_out: True for the n rows of the fold, shape (N,).
        outliers: True for the rows that have no part in a registration, shape (N,).

    Returns:
        Measured minus predicted of the held-out rows, shape (n, D), [m] and [rad].
    """
    residual = _accurate_residual(fitted, linear, x, held_out)
    if residual is None:
        return None
    if not np.any(seen_only_by(fitted, held_out)):
        return residual[held_out]
    estimate = fitted.estimate
    without_fold = replace(fitted, estimate=replace(estimate, x=x))
    return held_out_residual(without_fold, estimate.problem.rows, held_out, outliers)


def _leaves_enough_rows(fitted: Fitted, mask: Mask) -> bool:
    """Tell if the rows outside of a fold are many for the parameters, in each frame, and of every kind.

    Args:
        fitted: Fit to all N rows.
        mask: True for the rows that are held out, shape (N,).
    """
    rows = fitted.estimate.problem.rows
    kept = rows.used & ~mask[:, None]
    scalars = np.sum(kept, axis=1)
    if np.sum(scalars) < len(fitted.kinematics.model) + FEWEST_FREEDOM:
        return False
    in_frame = np.bincount(rows.samples.frame, scalars)
    if np.any((in_frame > 0.0) & (in_frame < _FEWEST_SCALARS)):
        return False
    return len(np.unique(rows.kind[~mask])) == len(np.unique(rows.kind))


def _fold_estimates(
    fitted: Fitted,
    linear: LinearProblem,
    prior: PriorTerms,
    masks: Mask,
) -> tuple[Array, Array]:
    """Return the parameters by the rows outside of each fold.

    Weights, noise and prior standard deviations are estimated anew, unless the folds are small parts of many rows.

    Args:
        fitted: Fit to all N rows with p parameters.
        linear: Its problem, linearised at its solution.
        prior: Priors of the p parameters as given, before the fit.
        masks: For each of F folds, True for the rows that it holds out, shape (F, N).

    Returns:
        Offsets from the registered start like ``fitted.estimate.x``, shape (F, p), and degrees of freedom that each
        fold leaves for the noise, shape (F,); infinite where they were not counted.
    """
    rows = fitted.estimate.problem.rows
    largest_share = masks.mean(axis=1).max()
    if len(rows) >= _MANY and largest_share < _SMALL_SHARE:
        not_counted = np.full(len(masks), np.inf)
        return fold_posterior_means(fitted, linear, masks), not_counted
    weighting = Weighting.of(fitted.task.cell.repeats, fitted.task.robust, rows)
    size = max(_AT_A_TIME // len(rows), 1)
    x, freedom = [], []
    for first in range(0, len(masks), size):
        kept = rows.checked & ~masks[first : first + size]
        stage = Stage.initial(prior, kept, len(linear.smallest_noise), weighting.start)
        stage, freedom_of_part = run_stages(stage, lambda _: linear, rows.poses, weighting)
        x.append(stage.fit(linear)[0])
        freedom.append(freedom_of_part)
    return np.concatenate(x), np.concatenate(freedom)


def _accurate_residual(fitted: Fitted, linear: LinearProblem, x: Array, mask: Mask) -> Array | None:
    """Return the residual at parameters of a fold, or None if the linear problem is not accurate there.

    It is compared with the robot itself at the rows that the fold keeps.

    Args:
        fitted: Fit to all N rows.
        linear: Its problem, linearised at its solution.
        x: Parameters without the fold, offsets like ``fitted.estimate.x``, shape (p,).
        mask: True for the rows that are held out, shape (N,).

    Returns:
        Measured minus predicted of all rows, shape (N, D), [m] and [rad].
    """
    estimate = fitted.estimate
    problem = estimate.problem
    rows = problem.rows
    residual = problem.residual(x)
    linear_residual = rows.in_units(linear.residual(x))
    difference = (linear_residual - residual) / problem.scales
    kept_rows = rows.checked & ~mask & (estimate.weights > 0.0)
    kept = rows.used & kept_rows[:, None]
    if np.sqrt(np.mean(difference[kept] ** 2)) < _LINEAR:
        return residual
    return None
