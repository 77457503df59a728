"""Extrapolation: how far errors beyond the measured joint values exceed those that a fit's covariance says."""

from __future__ import annotations

import numpy as np

from calib.estimate.fitting import Fitted
from calib.numerics.likelihood import GaussianPriors
from calib.registration.rows import Rows
from calib.units import Array, Mask

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
    problem, estimate = fitted.estimate.problem, fitted.estimate
    masks = _outer_rows(problem.rows, estimate.weights > 0.0)
    if not masks:
        return 1.0
    linear = problem.linear(estimate.x)
    noise = np.tile(estimate.noise, (len(masks), 1))
    weights = np.where(np.array(masks), 0.0, problem.weights)
    priors = GaussianPriors(problem.precision, problem.centre)
    x, covariance, _ = linear.fit(weights, problem.rho, noise, priors)
    whitened = linear.residual(x) / linear.noise_by_scalar(noise)
    A = linear.A / linear.noise_by_scalar(noise[:1])[0][:, :, None]
    beyond, expected = 0.0, 0.0
    for mask, r, C in zip(masks, whitened, covariance, strict=True):
        counts = linear.used[mask] * problem.weights[mask][:, None]
        beyond += float(np.sum(counts * (r[mask] ** 2 - 1.0)))
        expected += float(np.sum(counts * _variances(A[mask], C)))
    return max(beyond / expected, 1.0) if expected > 0.0 else 1.0


def _variances(A: Array, C: Array) -> Array:
    """Variance of each predicted scalar, (n, D), by parameters of covariance C (p, p) and derivative A (n, D, p)."""
    return np.asarray(np.einsum("ndp,pq,ndq->nd", A, C, A, optimize=True))


def _outer_rows(rows: Rows, weighted: Mask) -> list[Mask]:
    """Find the rows at each end of each joint's values, whole pairs, where there are enough and others beside them.

    Args:
        rows: N rows.
        weighted: Rows with a weight in the fit, shape (N,); the ends are those of their values.

    Returns:
        A mask of shape (N,) for each end.
    """
    masks = []
    for q in rows.joints.T:
        low, high = np.quantile(q[weighted], [_OUTER, 1.0 - _OUTER])
        for outer in (q <= low, q >= high):
            mask = rows.with_partners(outer)
            if low < high and _FEWEST_OUTER <= np.sum(mask) < 0.5 * len(rows):
                masks.append(mask)
    return masks
