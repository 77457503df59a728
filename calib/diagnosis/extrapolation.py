"""Extrapolation: how far errors beyond the measured joint values exceed those that a fit's covariance says."""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Mask
from calib.fit.estimate.fitting import Fitted
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
    rows as noise does, so with many rows the covariance includes too little of it.

    Args:
        fitted: The fit to N rows.

    Returns:
        The ratio of squared errors, 1 or more; 1 if no end has enough rows.
    """
    estimate = fitted.estimate
    problem = estimate.problem
    masks = _outer_rows(problem.rows, estimate.weights > 0.0)
    if not masks:
        return 1.0

    # Fits without the rows of each mask, at noise and priors of the fit to all rows.
    linear = problem.linear(estimate.x)
    noise = np.tile(estimate.noise, (len(masks), 1))
    weights = np.where(np.array(masks), 0.0, problem.weights)
    priors = GaussianPriors(problem.prior_precision, problem.prior_mean)
    x, covariances, _ = linear.fit(weights, problem.stop_shares, noise, priors)
    residuals = linear.residual(x) / linear.noise_by_scalar(noise)

    A = linear.A / linear.noise_by_scalar(np.array([estimate.noise]))[0][:, :, None]
    beyond, expected = 0.0, 0.0
    for mask, residual, C in zip(masks, residuals, covariances, strict=True):
        counts = linear.used[mask] * problem.weights[mask][:, None]
        excess = residual[mask] ** 2 - 1.0
        variances = np.einsum("ndp,pq,ndq->nd", A[mask], C, A[mask], optimize=True)
        beyond += float(np.sum(counts * excess))
        expected += float(np.sum(counts * variances))
    if not expected > 0.0:
        return 1.0
    return max(beyond / expected, 1.0)


def _outer_rows(rows: Rows, weighted: Mask) -> list[Mask]:
    """Find the rows (N,) at each end of each joint's values, whole pairs, if there are enough and others beside them.

    The ends are those of the values of rows with a weight in the fit.
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
