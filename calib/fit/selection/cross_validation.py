"""Cross-validation: how well a fit predicts rows that it has not used.

Each fold of rows is held out in turn and predicted by a fit to the others (`cross_validation`). The nominal robot is
treated alike: what the fit estimates of frames and targets is registered for it, without the fold
(`nominal_cross_validation`).

The problem linearised at the fit to all rows, y = A x + n, saves most of the fits. Candidates of the search are
compared on it alone (`linear_cross_validation`), at the weights, noise and prior standard deviations of the fit to all
rows. The cross-validation that is reported takes from it those folds for which it is accurate
(`held_out_residuals_linear`); there weights, noise and priors are estimated again in each fold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.basics.jobs import Progress
from calib.basics.progress import counted
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.linear import LinearProblem
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.stages import FEWEST_FREEDOM, Stage, Weighting, run_stages
from calib.fit.estimate.task import Task
from calib.fit.registration.registration import ENOUGH, nominal_setup
from calib.fit.registration.rows import Rows
from calib.fit.selection.folds import (
    Folds,
    held_out_residual,
    residual_after_registration,
    seen_only_by,
)
from calib.numerics.errors import CrossValidation
from calib.numerics.likelihood import GaussianPriors, diagonals

#: The linear problem is accurate if its residuals differ from the robot's by less than this share of the noise, rms.
_LINEAR = 1e-3

#: A fold is fitted from the beginning if it leaves a frame with fewer scalars than this: its pose then moves far.
_FEWEST_SCALARS = 18.0

#: From this number of rows on, a small fold hardly changes weights, noise and priors: those of the fit to all rows do.
_MANY = 1500

#: The same of corners in images, which have two scalars each.
_MANY_CORNERS = 1000

#: A fold is small if it holds out less than this share of the rows.
_SMALL_SHARE = 0.15

#: Steps that such a fold may take if the problem is not linear as far as it moves: each is far shorter than the last.
_STEPS_OF_MANY = 6

#: A fold that leaves the others less than this share of a direction determines it nearly alone: of sums that are exact
#: to 1e-16, their difference is then exact to 1e-12 of itself. Where normal equations are subtracted, diagonals alone
#: are compared: what one fold alone sees is a frame or target, whose own parameters show it. Of a combination of
#: parameters that others hardly see, priors hold what rounding leaves; that there are some is assumed, not tested.
_LEFT_TO_OTHERS = 1e-4

#: Rows of all folds together that are fitted at a time, for they are held in memory.
_AT_A_TIME = 4096


def cross_validation(
    fitted: Fitted,
    outliers: Mask,
    progress: Progress | None = None,
    *,
    by_poses: bool = False,
) -> CrossValidation:
    """Cross-validate the calibrated robot: hold out each fold in turn and predict it by a fit to the other rows.

    A fold is fitted on the problem linearised at the fit to all rows if that is accurate, else from the beginning.

    Args:
        fitted: Fit to all N rows.
        outliers: True for the rows to leave out of registrations and of the errors without outliers, shape (N,).
        progress: Called after each fold with the number of folds done and of all; None: nothing is called.
        by_poses: Whether poses are held out, also where whole stations could be.

    Returns:
        Residuals of the N rows, measured minus predicted without their fold, shape (N, D), in the units of the rows'
        channels, and their errors.

    Raises:
        MeasurementError: All rows are of one pose, or the others are too few for a fit.
        SolverError: The residual of a fit without a fold is not finite at its start.
    """
    rows = fitted.estimate.problem.rows
    folds = Folds.of_task(fitted.task, rows, by_poses=by_poses)
    by_linear_problem = held_out_residuals_linear(fitted, folds.masks, outliers)
    residuals = []
    refits = 0
    to_refit = len(folds.masks) - len(by_linear_problem)
    for k, mask in enumerate(folds.masks):
        residual = by_linear_problem.get(k)
        if residual is None:
            counted(refits, to_refit)
            refits += 1
            without_fold = fit(fitted.task, rows.select(~mask))
            residual = held_out_residual(without_fold, rows, mask, outliers)
        residuals.append(residual)
        if progress is not None:
            progress(k + 1, len(folds.masks))
    return folds.join(rows, residuals, outliers)


def nominal_cross_validation(task: Task, rows: Rows, outliers: Mask) -> CrossValidation:
    """Cross-validate the nominal robot: frames and targets that a fit estimates are registered without each fold.

    Args:
        task: The fit of the calibrated robot, which says what is estimated.
        rows: The N rows that were fitted.
        outliers: True for the rows that have no part in the errors without outliers, shape (N,), nor in registrations,
            unless they are more than half of a frame's.

    Returns:
        Residuals of the N rows, measured minus predicted by the nominal robot, shape (N, D), in the units of the rows'
        channels, and their errors.

    Raises:
        MeasurementError: All rows are of one pose, or the others are too few for the registration.
    """
    folds = Folds.of_task(task, rows)
    setup = task.setup.with_estimated_not_given()
    T_base_tip = task.robot.poses(rows.joints, rows.samples.chain)
    good = rows.evenly(ENOUGH) & rows.without(outliers)
    residuals = []
    registered = None
    for mask in folds.masks:
        used = ~mask & good
        registered = nominal_setup(T_base_tip[used], setup, rows.select(used), near=registered)
        T_held_out = T_base_tip[mask]
        residual = residual_after_registration(T_held_out, registered, rows, mask, used, outliers)
        residuals.append(residual)
    return folds.join(rows, residuals, outliers)


def linear_cross_validation(fitted: Fitted, outliers: Mask | None = None) -> CrossValidation:
    """Cross-validate on the linearised problem, with prior std, noise and weights of the fit to all rows.

    Args:
        fitted: Fit to N rows.
        outliers: True for the rows to leave out of the errors without outliers, shape (N,); None: those that the fit
            flagged. Fits use them all the same, at their weights.

    Returns:
        Residuals of the N rows, measured minus predicted without their fold, shape (N, D), in the units of the rows'
        channels, and their errors.

    Raises:
        MeasurementError: All rows are of one pose.
    """
    estimate = fitted.estimate
    problem = estimate.problem
    rows = problem.rows
    if outliers is None:
        outliers = estimate.outliers
    linear = problem.linear(estimate.solution.x)
    folds = Folds.of_task(fitted.task, rows)
    means = fold_posterior_means(fitted, linear, folds.masks)
    standardised = np.zeros(rows.used.shape)
    for mask, x in zip(folds.masks, means, strict=True):
        part = linear.select(mask)
        unseen = seen_only_by(fitted, mask)
        if np.any(unseen):
            # Parameters that only these rows see are fitted to them; a row without weight must not move the frame.
            row, _ = np.nonzero(part.used)
            root = np.sqrt(problem.weights[mask])[row]
            by_others = part.residual(np.where(unseen, 0.0, x))[part.used]
            columns = part.A[part.used][:, unseen]
            weighted_columns = columns * root[:, None]
            x[unseen], *_ = np.linalg.lstsq(weighted_columns, by_others * root, rcond=1e-9)
        standardised[mask] = part.residual(x)
    residual = rows.in_units(standardised)
    residuals = [residual[mask] for mask in folds.masks]
    return folds.join(rows, residuals, outliers)


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
    masks = np.array(masks)
    noise = np.array([fitted.estimate.noise])
    priors = GaussianPriors(problem.prior_precision, problem.prior_mean)
    if np.any(problem.stop_shares):
        weights = np.where(masks, 0.0, problem.weights)
        x, _, _ = linear.fit(weights, problem.stop_shares, np.tile(noise, (len(masks), 1)), priors)
        return np.asarray(x)

    of_all = linear.normal_equations(problem.weights[None], problem.stop_shares)
    (mean,), (covariance,) = of_all.posterior(noise, priors)
    means = np.empty((len(masks), len(mean)))
    is_small = np.sum(masks, axis=1) * linear.used.shape[1] < len(mean)
    if np.any(is_small):  # then few rows are to be whitened
        whiten = np.sqrt(problem.weights)[:, None] / linear.noise_by_scalar(noise)[0]
        A = linear.A * whiten[:, :, None]
        AC = A @ covariance
        r = linear.residual(mean) * whiten
    for k, mask in enumerate(masks):
        if is_small[k]:
            # With the whitened rows of the fold, x = x_all - C A^T (1 - A C A^T)^-1 r.
            A_fold, AC_fold = (M[mask].reshape(-1, len(mean)) for M in (A, AC))
            left = np.eye(len(A_fold)) - AC_fold @ A_fold.T
            if np.linalg.eigvalsh(left)[0] > _LEFT_TO_OTHERS:
                means[k] = mean - np.linalg.solve(left, r[mask].ravel()) @ AC_fold
                continue
        fold = linear.select(mask)
        of_fold = fold.normal_equations(problem.weights[None, mask], problem.stop_shares)
        of_others = of_all.without(of_fold)
        if np.any(diagonals(of_others.H[0]) < _LEFT_TO_OTHERS * diagonals(of_all.H[0])):
            # What only the fold sees must not be left with its rounding.
            of_others = linear.normal_equations(
                np.where(mask, 0.0, problem.weights)[None], problem.stop_shares
            )
        (means[k],), _ = of_others.posterior(noise, priors)
    return means


def held_out_residuals_linear(
    fitted: Fitted, masks: tuple[Mask, ...], outliers: Mask
) -> dict[int, Array]:
    """Return held-out residuals of the folds for which the linear problem is accurate.

    Args:
        fitted: Fit to all N rows.
        masks: For each fold, True for the rows that it holds out, each of shape (N,).
        outliers: Rows that have no part in a registration, shape (N,).

    Returns:
        Residuals of the fold's n rows, measured minus predicted by the robot itself, shape (n, D), in the units of the
        rows' channels, by the fold's index from 0. Folds that are not in it must be fitted from the beginning: too few
        rows are left, a parameter would exceed its bounds, or the robot is not linear that far. It is empty if a
        parameter of the fit is held at a bound, or its solver has no weights and priors.
    """
    estimate = fitted.estimate
    if not fitted.task.has_weights_and_priors or estimate.at_bound:
        return {}
    numbers = [k for k, mask in enumerate(masks) if _leaves_enough_rows(fitted, mask)]
    if not numbers:
        return {}
    linear = estimate.problem.linear(estimate.x)
    prior = PriorTerms.of(fitted.task, fitted.kinematics.model, fitted.setup)
    held_out = np.array([masks[k] for k in numbers])
    estimates, freedom = _fit_without_folds(fitted, linear, prior, held_out)
    low, high = prior.limits.T
    within_bounds = np.all((estimates >= low) & (estimates <= high), axis=1)
    admissible = (freedom > FEWEST_FREEDOM) & within_bounds

    rows = estimate.problem.rows
    residuals = {}
    for i in np.flatnonzero(admissible).tolist():
        k = numbers[i]
        mask, x = masks[k], estimates[i]
        steps = _STEPS_OF_MANY if _hardly_changes(fitted, held_out) else 0
        is_linear, residual = _compared(fitted, linear, x, mask)
        while not is_linear and steps:
            # At the weights of the fit to all rows a fold takes few more steps, each on the problem linearised anew.
            linear_there = estimate.problem.linear(x)
            x = fold_posterior_means(fitted, linear_there, mask[None])[0]
            is_linear, residual = _compared(fitted, linear_there, x, mask)
            steps -= 1
        within = np.all((x >= low) & (x <= high))
        if not within or not is_linear:
            continue

        residuals[k] = residual
        if np.any(seen_only_by(fitted, mask)):
            # Frames and targets that only the fold sees are registered to its rows.
            without_fold = replace(fitted, estimate=replace(estimate, x=x))
            residuals[k] = held_out_residual(without_fold, rows, mask, outliers)
    return residuals


def _compared(fitted: Fitted, linear: LinearProblem, x: Array, mask: Mask) -> tuple[bool, Array]:
    """Return whether a linear problem predicts what the robot does with parameters x, (p,); and the fold's residual.

    The latter is by the robot itself at the rows of the fold, a mask (N,). Compared are the others with a weight, of
    many rows some.
    """
    problem = fitted.estimate.problem
    counts = ~mask & (fitted.estimate.weights > 0.0)
    some = problem.rows.evenly(ENOUGH)  # for one mean
    rows = problem.rows.select(some)
    residual = rows.residual(fitted.kinematics.sightings(x, rows.samples))
    if np.all(some):
        of_fold = residual[mask]
    else:
        linear = linear.select(some)
        fold = problem.rows.select(mask)
        of_fold = fold.residual(fitted.kinematics.sightings(x, fold.samples))
    by_linear = rows.in_units(linear.residual(x)[:, : rows.width])
    kept = rows.used & counts[some, None]
    difference = ((by_linear - residual) / rows.scales_at(problem.noise))[kept]
    return bool(np.sqrt(np.mean(difference**2)) < _LINEAR), of_fold


def _hardly_changes(fitted: Fitted, masks: Mask) -> bool:
    """Return whether folds, (F, N), are so small parts of so many rows that weights, noise and priors stay."""
    rows = fitted.estimate.problem.rows
    many = _MANY_CORNERS if np.all(rows.is_image) else _MANY
    return len(rows) >= many and bool(masks.mean(axis=1).max() < _SMALL_SHARE)


def _leaves_enough_rows(fitted: Fitted, mask: Mask) -> bool:
    """Return whether the rows outside of a fold, (N,), are enough for all parameters and each frame, and of every kind.

    Frames that only the fold sees do not count.
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


def _fit_without_folds(
    fitted: Fitted,
    linear: LinearProblem,
    prior: PriorTerms,
    masks: Mask,
) -> tuple[Array, Array]:
    """Fit the linear problem to the rows outside of each of F folds, (F, N): parameters, (F, p), and freedom, (F,).

    Weights, noise and prior standard deviations are estimated again, unless the folds are small parts of many rows;
    then the degrees of freedom are not counted, but infinite.
    """
    rows = fitted.estimate.problem.rows
    if _hardly_changes(fitted, masks):
        not_counted = np.full(len(masks), np.inf)
        return fold_posterior_means(fitted, linear, masks), not_counted
    weighting = Weighting.of(fitted.task.cell.repeats, fitted.task.robust, rows)
    size = max(_AT_A_TIME // len(rows), 1)
    x, freedom = [], []
    for first in range(0, len(masks), size):
        kept = ~masks[first : first + size]
        stage = Stage.initial(prior, kept, len(linear.smallest_noise), weighting.start)
        stage, freedom_of_part = run_stages(stage, lambda _: linear, rows.poses, weighting)
        x.append(stage.fit(linear)[0])
        freedom.append(freedom_of_part)
    return np.concatenate(x), np.concatenate(freedom)
