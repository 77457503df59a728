"""Statistics of rows: errors, what repeats of a pose share, and which rows do not belong to the others.

Repeats: e = b + w with var b = s_b^2 shared by a pose and var w = s_w^2 its own; rho = s_b^2 / (s_b^2 + s_w^2) by
moments from the mean squares within and between poses. Outliers: with the leverage K = A C A^T of a row of weight 1,
whitened, score^2 = r^T (I + (1 - w) K)^-1 (I - w K)^-1 r, the squared deleted residual over its covariance; score^2 / d
follows F(d, dof) for a good row of d scalars. Scores are told as those of three scalars, so that one limit serves a
table.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtrc, chdtri, fdtri

from calib.robot.kernel import over_blocks
from calib.units import Array, Mask

#: A good row keeps its full weight with this probability; and that with which any row of a clean table is flagged.
_FULL, _FALSE_ALARM = 0.99, 0.01


#: A row that leaves less than this of a direction to the others carries it nearly alone; and the scalars of a point,
#: for which scores are told.
_CARRIED, _POINT = 1e-4, 3


@dataclass(frozen=True, slots=True)
class Limits:
    """Scores between which the weight falls from 1 to 0; of one table or of several, shape (B, 1)."""

    full: Array  # Below it a row counts in full
    flagged: Array  # Above it a row does not count and is named as an outlier

    @classmethod
    def of(cls, rows: ArrayLike, freedom: ArrayLike) -> Limits:
        """The limits for a table."""
        freedom, clean = np.maximum(freedom, 1.0), 1.0 - _FALSE_ALARM / np.maximum(rows, 10)
        return cls(*(np.sqrt(3.0 * fdtri(3.0, freedom, p)) for p in (_FULL, clean)))

    def weights(self, scores: Array) -> Array:
        """Redescending weights: 1, then falling linearly in influence to 0, of the scores' shape."""
        fall = (self.flagged - scores) / (self.flagged - self.full)
        return np.where(scores <= self.full, 1.0, np.clip(fall, 0.0, 1.0))


def deleted_norms(
    residual: Array, jacobian: Array, covariance: Array, weights: Array, factors: Array
) -> Array:
    """How far each row lies from what the others predict, in standard deviations, shape (B, N); see the module's text.

    residual (B, N, D) and jacobian (N, D, p) are in units of each scalar's sigma, and multiplied by factors (B or 1, N,
    D); covariance (B, p, p), weights (B, N).
    """
    norms = np.empty(weights.shape)

    def work(own: slice) -> None:
        A, f = jacobian[own], factors[:, own]
        n, D, p = A.shape
        spread = (A.reshape(n * D, p) @ covariance).reshape(-1, n, D, p)
        K = (spread @ A.swapaxes(1, 2)) * (f[..., None] * f[..., None, :])
        norms[:, own] = _norms_of(residual[:, own] * f, K, weights[:, own])

    over_blocks(work, weights.shape[1])
    return norms


def _norms_of(r: Array, K: Array, w: Array) -> Array:
    """The norms of residuals (B, N, D), with the leverages K (B, N, D, D) and weights (B, N).

    Where a row carries nearly all that is known of a direction, by the eigenvalues of K, none beyond 1 / w.
    """
    w, trace = w[..., None], np.trace(K, axis1=-2, axis2=-1)
    risky = ~(w[..., 0] * trace < 1.0 - _CARRIED) | (K.max(axis=(-2, -1)) > 1.0 / _CARRIED)
    kept = np.eye(K.shape[-1]) - w[..., None] * np.where(risky[..., None, None], 0.0, K)
    spread = kept + (1.0 - w[..., None]) * (K @ kept)
    square = np.sum(r * np.linalg.solve(spread, r[..., None])[..., 0], axis=-1)
    if risky.any():
        values, vectors = np.linalg.eigh(K[risky])
        along, w = np.einsum("nij,ni->nj", vectors, r[risky]), w[risky]
        spread = (1.0 + (1.0 - w) * values) * np.maximum(1.0 - w * values, 1e-9)
        square[risky] = np.sum(along**2 / spread, axis=1)
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def as_of_a_point(row_scores: Array, scalars: NDArray[np.int_]) -> Array:
    """The scores (..., N) that three scalars would have at the same chi-squared probability; 0 without scalars."""
    result: Array = row_scores.copy()
    result[..., scalars == 0] = 0.0
    for d in np.unique(scalars):
        if d in (0, _POINT):
            continue
        own = scalars == d
        farthest = np.sqrt(chdtri(d, 1e-200))  # beyond it the tail is too thin to be inverted
        inner = np.minimum(row_scores[..., own], farthest)
        same = np.sqrt(chdtri(_POINT, chdtrc(d, inner**2)))
        result[..., own] = same + (row_scores[..., own] - inner)
    return result


def median_noise(row_scores: Array, used: Mask, kept: Mask) -> Array:
    """The noise that makes the median score (B, N) of the rows kept what it is for normal noise, shape (B,)."""
    scalars = np.sum(used, axis=1)
    typical = np.sqrt(chdtri(np.maximum(np.arange(used.shape[1] + 1), 1), 0.5))[scalars]
    there = kept & (scalars > 0)
    ordered = np.sort(np.where(there, row_scores / typical, np.inf), axis=1)
    count = there.sum(axis=1)[:, None]
    middle = np.hstack([(count - 1) // 2, count // 2])
    return np.asarray(np.take_along_axis(ordered, middle, axis=1).mean(axis=1))
