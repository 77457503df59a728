"""Extrapolation: how far errors beyond the measured joint values exceed those that a fit's covariance says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.fit.estimate.fitting import Fitted
from calib.fit.estimate.linear import LinearProblem
from calib.fit.registration.rows import Rows
from calib.numerics.likelihood import GaussianPriors

#: The share of the rows at each end of a joint's measured values that are predicted by the others.
_OUTER = 0.2

#: An end with fewer rows is not used: their errors say little.
_FEWEST_OUTER = 3


def extrapolation(fitted: Fitted) -> float:
    """Compare errors of extrapolated predictions with those expected by a fit's covariance.

    Rows at one end of a joint's values are predicted by a linear fit to the others, for both ends of each joint: beyond
    their noise, |r|^2 - sigma^2, they should be off by tr(A C A^T). What the model lacks does not average out over the
    rows as noise does, so of many rows the covariance knows too little of it.

    Args:
        fitted: The fit to N rows.

    Returns:
        The ratio of squared errors, 1 or more; 1 where no end has enough rows.
    """
    estimate = fitted.estimate
    problem = estimate.problem
    masks = _outer_rows(problem.rows, estimate.weights > 0.0)
    if not masks:
        return 1.0
    linear = problem.linear(estimate.x)
    noise_by_scalar = linear.noise_by_scalar(np.array([estimate.noise]))[0]
    A = linear.A / noise_by_scalar[:, :, None]
    beyond, expected = 0.0, 0.0
    for mask, inner in zip(masks, _fits_to_others(fitted, linear, masks), strict=True):
        counts = linear.used[mask] * problem.weights[mask][:, None]
        excess = inner.residual[mask] ** 2 - 1.0
        variances = _variances(A[mask], inner.covariance)
        beyond += float(np.sum(counts * excess))
        expected += float(np.sum(counts * variances))
    if not expected > 0.0:
        return 1.0
    return max(beyond / expected, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class _FitToOthers:
    """A fit to the rows that are not at one end of a joint's values; N rows of up to D scalars, p parameters."""

    #: (N, D), residual of all rows, measured minus predicted, over the noise of each scalar
    residual: Array
    #: (p, p), covariance of the parameters
    covariance: Array


def _fits_to_others(
    fitted: Fitted, linear: LinearProblem, masks: Sequence[Mask]
) -> list[_FitToOthers]:
    """Fit the linearised problem without the rows of each mask, at noise and priors of the fit to all rows.

    Args:
        fitted: The fit to all N rows.
        linear: Its problem, linearised at its solution.
        masks: True for the rows that a fit leaves out, each of shape (N,).

    Returns:
        A fit for each mask, in their order.
    """
    problem = fitted.estimate.problem
    noise = np.tile(fitted.estimate.noise, (len(masks), 1))
    weights = np.where(np.array(masks), 0.0, problem.weights)
    priors = GaussianPriors(problem.prior_precision, problem.prior_mean)
    x, covariance, _ = linear.fit(weights, problem.stop_shares, noise, priors)
    residual = linear.residual(x) / linear.noise_by_scalar(noise)
    return [_FitToOthers(r, C) for r, C in zip(residual, covariance, strict=True)]


def _variances(A: Array, C: Array) -> Array:
    """Variance of each predicted scalar, diag(A C A^T).

    Args:
        A: Derivative of n rows of D scalars by p parameters, shape (n, D, p), in units of each scalar's noise.
        C: Covariance of the parameters, shape (p, p).

    Returns:
        Variances, shape (n, D), in units of each scalar's noise squared.
    """
    return np.asarray(np.einsum("ndp,pq,ndq->nd", A, C, A, optimize=True))


def _outer_rows(rows: Rows, weighted: Mask) -> list[Mask]:
    """Find the rows at each end of each joint's values, whole pairs, where there are enough and others beside them.

    Args:
        rows: N rows.
        weighted: Rows with a weight in the fit, shape (N,); the ends are those of their values.

    Returns:
        A mask of shape (N,), True at the rows of the end, for each end that is used.
    """
    masks = []
    for q in rows.joints.T:
        low, high = np.quantile(q[weighted], [_OUTER, 1.0 - _OUTER])
        if not low < high:
            continue
        for outer in (q <= low, q >= high):
            mask = rows.with_partners(outer)
            if _FEWEST_OUTER <= np.sum(mask) < 0.5 * len(rows):
                masks.append(mask)
    return masks
