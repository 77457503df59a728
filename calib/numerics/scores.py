"""Scores of rows, their distance from what the other rows predict, and the weights that follow from them.

The score of a row is the norm of its deleted residual: measured minus predicted by a fit without the row, in standard
deviations of that difference. It needs no further fit. With the residual r and the leverage K = A C A^T of a row of
weight w, whitened, where A is the Jacobian of its prediction and C the covariance of the parameters,

    score^2 = r^T (I + (1 - w) K)^-1 (I - w K)^-1 r

For a good row of d scalars score^2 / d follows F(d, freedom) (D. A. Belsley, E. Kuh, R. E. Welsch: Regression
Diagnostics, 1980). Scores of rows with other than three scalars are converted to those of three, so that one limit
serves a table.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtrc, chdtri, fdtri

from calib.basics.arrays import Array, Mask

#: A good row keeps its full weight with this probability.
_FULL_WEIGHT = 0.99

#: Probability that any row of a table without outliers is flagged.
_FALSE_ALARM = 0.01

#: The false alarm is shared by this many rows, if the table has fewer.
_FEWEST_ROWS = 10

#: A row that leaves less than this share of a direction to the other rows determines it nearly alone.
_CARRIED = 1e-4

#: Smallest 1 - w K along a direction: only by rounding does K exceed 1 / w.
_LEAST_LEFT = 1e-9

#: Entries of Jacobians, carried over by the covariances of several fits, that are in memory at a time.
_AT_A_TIME = 262_144

#: Number of scalars of a point, to which all scores are converted.
_POINT = 3

#: Probability beyond which the tail of chi-squared is too thin to be inverted.
_THINNEST_TAIL = 1e-200


@dataclass(frozen=True, slots=True)
class Limits:
    """Scores between which the weight of a row falls from 1 to 0, of one table (scalars) or of B fits, shape (B, 1)."""

    #: Up to this score a row has full weight
    full: Array
    #: From this score on a row has no weight; above it, it is flagged as an outlier
    flagged: Array

    @classmethod
    def of(cls, rows: ArrayLike, freedom: ArrayLike) -> Limits:
        """Compute the limits of scores, as `point_scores` returns them for any rows, by quantiles of F(3, freedom).

        Args:
            rows: Number of rows, one number or shape (B, 1): the more rows, the rarer must be a false alarm of each.
            freedom: Degrees of freedom of the noise, one number or shape (B, 1); below 1 it counts as 1.
        """
        freedom = np.maximum(freedom, 1.0)
        good = 1.0 - _FALSE_ALARM / np.maximum(rows, _FEWEST_ROWS)
        full = np.sqrt(3.0 * fdtri(3.0, freedom, _FULL_WEIGHT))
        flagged = np.sqrt(3.0 * fdtri(3.0, freedom, good))
        return cls(full, flagged)

    def weights(self, scores: Array) -> Array:
        """Return weights that fall linearly from 1 at `full` to 0 at `flagged` (redescending).

        Args:
            scores: shape (N,), or (B, N) for limits of B fits.

        Returns:
            Weights of the same shape, between 0 and 1.
        """
        fall = (self.flagged - scores) / (self.flagged - self.full)
        return np.where(scores <= self.full, 1.0, np.clip(fall, 0.0, 1.0))


def deleted_norms(
    residual: Array,
    jacobian: Array,
    covariance: Array,
    weights: Array,
    factors: Array,
) -> Array:
    """Compute the norms of the deleted residuals of N rows in B fits; the module's text has the equation.

    Args:
        residual: shape (B, D, N), measured minus predicted, in units of each scalar's given sigma.
        jacobian: shape (p, D, N), of the prediction, in the same units; the fits share it.
        covariance: shape (B, p, p), of the parameters.
        weights: shape (B, N), of the rows in each fit; 0 for rows that it did not use.
        factors: shape (B or 1, D, N), by which residual and Jacobian are multiplied: 1 over the estimated noise.

    Returns:
        shape (B, N), in standard deviations. For d scalars its square is d times F(d, freedom) distributed.
    """
    p, D, N = jacobian.shape
    flat = jacobian.reshape(p, D * N)
    every_factor = np.broadcast_to(factors, residual.shape)
    norms = np.empty(weights.shape)
    together = max(_AT_A_TIME // max(flat.size, 1), 1)
    for first in range(0, len(covariance), together):
        fits = slice(first, first + together)
        factor = every_factor[fits].swapaxes(0, 1)
        carried = (covariance[fits] @ flat).reshape(-1, p, D, N)
        K = np.empty((D, D, len(carried), N))
        for i in range(D):
            for j in range(i + 1):
                products = np.einsum("bpn,pn->bn", carried[:, :, i], jacobian[:, j])
                K[i, j] = K[j, i] = products * factor[i] * factor[j]
        whitened = (residual[fits].swapaxes(0, 1) * factor).reshape(D, -1)
        of_rows = _norms_by_leverage(whitened, K.reshape(D, D, -1), weights[fits].ravel())
        norms[fits] = of_rows.reshape(-1, N)
    return norms


def _norms_by_leverage(r: Array, K: Array, w: Array) -> Array:
    """Return the norms (N,) of the deleted residuals of whitened residuals r (D, N), leverages K and weights w.

    K, shape (D, D, N), is that of rows with weight 1; w has the shape (N,).
    """
    # If a row determines a direction nearly alone, I - w K is nearly singular: then by the eigenvalues of K, none of
    # which counts for more than 1 / w.
    trace = np.einsum("iin->n", K)
    almost_alone = ~(w * trace < 1.0 - _CARRIED)
    risky = np.flatnonzero(almost_alone | (trace > 1.0 / _CARRIED))
    safe = K
    if len(risky):
        safe = K.copy()
        safe[:, :, risky] = 0.0
    spread = (1.0 - 2.0 * w) * safe
    mixed = w * (1.0 - w)
    if mixed.any():
        spread -= mixed * np.einsum("ikn,kjn->ijn", safe, safe)
    np.einsum("iin->in", spread)[...] += 1.0
    square = _quadratic_forms(spread, r.copy())
    if len(risky):
        values, vectors = np.linalg.eigh(K[:, :, risky].transpose(2, 0, 1))
        along = np.einsum("nij,in->nj", vectors, r[:, risky])
        part = w[risky, None]
        left = (1.0 + (1.0 - part) * values) * np.maximum(1.0 - part * values, _LEAST_LEFT)
        square[risky] = np.sum(along**2 / left, axis=1)
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def _quadratic_forms(S: Array, r: Array) -> Array:
    """Return r^T S^-1 r, (N,), of symmetric positive definite S (D, D, N) and r (D, N) by elimination; both change."""
    square = np.zeros(r.shape[1])
    for i in range(len(r)):
        square += r[i] * r[i] / S[i, i]
        for j in range(i + 1, len(r)):
            share = S[j, i] / S[i, i]
            r[j] -= share * r[i]
            S[j, i + 1 : j + 1] -= share * S[i + 1 : j + 1, i]
    return square


def point_scores(norms: Array, scalars: NDArray[np.int_]) -> Array:
    """Convert norms of rows with any number of scalars to the scores of points (three scalars).

    A score has the same tail probability by chi-squared with 3 degrees of freedom as the norm has with its own.

    Args:
        norms: shape (..., N), see `deleted_norms`.
        scalars: shape (N,), number of scalars of each row.

    Returns:
        Scores of the same shape; 0 for a row without scalars.
    """
    scores: Array = norms.copy()
    scores[..., scalars == 0] = 0.0
    for d in np.unique(scalars):
        if d in (0, _POINT):
            continue
        rows = scalars == d
        # Beyond the farthest norm that can be converted, scores grow as norms do.
        farthest = np.sqrt(chdtri(d, _THINNEST_TAIL))
        inner = np.minimum(norms[..., rows], farthest)
        converted = np.sqrt(chdtri(_POINT, chdtrc(d, inner**2)))
        scores[..., rows] = converted + (norms[..., rows] - inner)
    return scores


def median_noise(norms: Array, used: Mask, kept: Mask) -> Array:
    """Estimate the noise of B fits by the median of their rows' norms, which outliers hardly move.

    Args:
        norms: shape (B, N), norms of deleted residuals in units of the given sigma.
        used: shape (N, D), True for the scalars that the noise is estimated from.
        kept: shape (B, N), True for the rows of each fit.

    Returns:
        shape (B,), standard deviation in units of the given sigma: 1 where the median is that of normal noise.
    """
    scalars = np.sum(used, axis=1)
    numbers = np.maximum(np.arange(used.shape[1] + 1), 1)
    normal_median = np.sqrt(chdtri(numbers, 0.5))[scalars]
    counts = kept & (scalars > 0)
    ordered = np.sort(np.where(counts, norms / normal_median, np.inf), axis=1)
    count = counts.sum(axis=1)[:, None]
    middle = np.hstack([(count - 1) // 2, count // 2])
    return np.asarray(np.take_along_axis(ordered, middle, axis=1).mean(axis=1))
