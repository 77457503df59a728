"""Extrapolation: how much larger errors beyond the measured joint values are than a fit's covariance says."""

from __future__ import annotations

import numpy as np

from calib.estimate.fitting import Fitted
from calib.numerics.likelihood import GaussianPriors
from calib.registration.rows import Rows
from calib.units import Mask

#: The share of the rows at each end of a joint's measured values that are predicted by the others.
_OUTER = 0.2

#: With fewer rows at an end it is left out.
_FEWEST_OUTER = 3


def extrapolation(fitted: Fitted) -> float:
    """By how many times the squared error of extrapolated predictions exceeds what the covariance says; 1 or more.

    Rows at one end of a joint's values are predicted by a linear fit to the others, for both ends of each joint: beyond
    their noise, |r|^2 - sigma^2, they should be off by tr(A C A^T). What the model lacks does not average out over the
    rows as noise does, so of many rows the covariance knows too little of it.
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
        of_parameters = np.einsum("ndp,pq,ndq->nd", A[mask], C, A[mask], optimize=True)
        beyond += float(np.sum(counts * (r[mask] ** 2 - 1.0)))
        expected += float(np.sum(counts * of_parameters))
    return max(beyond / expected, 1.0) if expected > 0.0 else 1.0


def _outer_rows(rows: Rows, alive: Mask) -> list[Mask]:
    """The rows at each end of each joint's values, whole pairs, where there are enough and others beside them."""
    masks = []
    for q in rows.joints.T:
        low, high = np.quantile(q[alive], [_OUTER, 1.0 - _OUTER])
        for outer in (q <= low, q >= high):
            mask = rows.with_partners(outer)
            if low < high and _FEWEST_OUTER <= np.sum(mask) < 0.5 * len(rows):
                masks.append(mask)
    return masks
