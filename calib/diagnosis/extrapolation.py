"""Extrapolation: by how much errors outside of the measured joint values exceed what a fit's covariance predicts.

Rows at one end of a joint's values are predicted by a linear fit to the others, for both ends of each joint. Beyond
their noise, |r|^2 - sigma^2, the predictions should be off by tr(A C A^T). Errors that the model lacks do not average
out over the rows as noise does, so of many rows the covariance is too small.
"""

from __future__ import annotations

import numpy as np

from calib.estimate.fitting import Fitted
from calib.numerics.likelihood import GaussianPriors
from calib.registration.rows import Rows
from calib.units import Mask

#: The share of the rows at each end of a joint's values that are predicted by the others.
_OUTER = 0.2

#: An end with fewer rows does not count.
_FEWEST_OUTER = 3

#: Nor does one with so large a share of the rows: the others are too few to predict them.
_MOST_OUTER = 0.5


def extrapolation(fitted: Fitted) -> float:
    """Return the squared error of extrapolated predictions over that which the covariance predicts, at least 1.

    Args:
        fitted: A fit; its weights, noise and priors are kept.
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
    noise_by_scalar = linear.noise_by_scalar(noise)
    whitened = linear.residual(x) / noise_by_scalar
    A = linear.A / linear.noise_by_scalar(noise[:1])[0][:, :, None]
    excess, expected = 0.0, 0.0
    for mask, r, C in zip(masks, whitened, covariance, strict=True):
        weight = linear.used[mask] * problem.weights[mask][:, None]
        variance = np.einsum("ndp,pq,ndq->nd", A[mask], C, A[mask], optimize=True)
        excess += float(np.sum(weight * (r[mask] ** 2 - 1.0)))
        expected += float(np.sum(weight * variance))
    return max(excess / expected, 1.0) if expected > 0.0 else 1.0


def _outer_rows(rows: Rows, alive: Mask) -> list[Mask]:
    """Masks of the rows at each end of each joint's values, whole pairs, where there are enough and others beside them.

    Args:
        rows: N rows.
        alive: shape (N,), rows with weight, whose joint values count.
    """
    masks = []
    for values in rows.joints.T:
        low, high = np.quantile(values[alive], [_OUTER, 1.0 - _OUTER])
        for outer in (values <= low, values >= high):
            mask = rows.with_partners(outer)
            if low < high and _FEWEST_OUTER <= np.sum(mask) < _MOST_OUTER * len(rows):
                masks.append(mask)
    return masks
