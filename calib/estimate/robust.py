"""Robust weights: which rows do not belong to the others.

A row is judged by how far it lies from what the *other* rows predict, in units of that prediction's own standard
deviation, so that a row with leverage cannot hide. With K = A C A^T, the leverage of a row of weight 1, whitened,

    score^2 = r^T (I + (1 - w) K)^-1 (I - w K)^-1 r

which is the squared deleted residual over its covariance, and score^2 / d follows F(d, dof) for a good row of d
scalars. Scores are told as those of three scalars, whatever d is, so that one limit serves a whole table.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtrc, chdtri, fdtri

from calib.robot.kernel import over_blocks

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

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

    residual, shape (B, N, D), of B fits, and jacobian, shape (N, D, p), are in units of each scalar's sigma, and
    multiplied by factors, shape (B or 1, N, D); covariance has the shape (B, p, p), weights (B, N).
    """
    norms = np.empty(weights.shape)

    def work(own: slice) -> None:
        A = jacobian[own].transpose(2, 1, 0)
        p, D, n = A.shape
        spread = (covariance @ A.reshape(p, D * n)).reshape(-1, p, D, n)
        leverage: Array = np.empty((D, D, len(norms), n))
        for i in range(D):
            row = np.einsum("bpn,pjn->jbn", spread[:, :, i], A[:, : i + 1])
            leverage[i, : i + 1], leverage[: i + 1, i] = row, row
        f = factors[:, own].transpose(2, 0, 1)
        r = (residual[:, own].transpose(2, 0, 1) * f).reshape(D, -1)
        leverage *= f * f[:, None]
        found = _norms_of(r, leverage.reshape(D, D, -1), weights[:, own].ravel())
        norms[:, own] = found.reshape(-1, n)

    over_blocks(work, weights.shape[1])
    return norms


def _norms_of(r: Array, K: Array, w: Array) -> Array:
    """The norms of residuals, shape (D, B), with the leverages K, shape (D, D, B), and weights, shape (B,).

    (I + (1 - w) K) (I - w K) is symmetric and solved as it stands; where a row carries nearly all that is known of a
    direction, by the eigenvalues of K, none of which may then pass 1 / w.
    """
    kept = np.eye(len(r))[:, :, None] - w * K
    spread = kept + (1.0 - w) * np.einsum("ijb,jkb->ikb", K, kept)
    with np.errstate(all="ignore"):
        _, square = _eliminated(spread, r.copy())
    # The product of 1 - w k over the eigenvalues k of K is at most its smallest factor, and at least 1 - w trace K.
    if not np.all(w * np.einsum("iib->b", K) < 1.0 - _CARRIED):
        with np.errstate(all="ignore"):
            left, _ = _eliminated(kept, np.zeros_like(r))
        risky = ~(left >= _CARRIED) | (K.max(axis=(0, 1), initial=0.0) > 1.0 / _CARRIED)
        if risky.any():
            values, vectors = np.linalg.eigh(K[:, :, risky].T)
            along, w = np.einsum("nij,ni->nj", vectors, r[:, risky].T), w[risky, None]
            spread = (1.0 + (1.0 - w) * values) * np.maximum(1.0 - w * values, 1e-9)
            square[risky] = np.sum(along**2 / spread, axis=1)
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def _eliminated(M: Array, r: Array) -> tuple[Array, Array]:
    """The determinants of symmetric matrices, shape (D, D, B), and r^T M^-1 r; both arguments are overwritten."""
    determinant, square = np.ones(r.shape[1]), np.zeros(r.shape[1])
    for j in range(len(r)):
        pivot = M[j, j]
        determinant *= pivot
        square += r[j] ** 2 / pivot
        if j + 1 < len(r):
            ratio = M[j + 1 :, j] / pivot
            M[j + 1 :, j + 1 :] -= ratio[:, None] * M[j, j + 1 :]
            r[j + 1 :] -= ratio * r[j]
    return determinant, square


def as_of_a_point(row_scores: Array, scalars: NDArray[np.int_]) -> Array:
    """The scores, shape (..., N), that three scalars would have at the same probability; 0 without scalars.

    By the chi-squared distribution as far as its tail can be computed, and by the same step beyond.
    """
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
    """The noise that makes the median score of each fit what it is for normal noise, shape (B,).

    Of scores and rows kept, shape (B, N), with the scalars used, shape (N, D): outliers cannot move it.
    """
    scalars = np.sum(used, axis=1)
    typical = np.sqrt(chdtri(np.maximum(np.arange(used.shape[1] + 1), 1), 0.5))[scalars]
    there = kept & (scalars > 0)
    ordered = np.sort(np.where(there, row_scores / typical, np.inf), axis=1)
    count = there.sum(axis=1)[:, None]
    middle = np.hstack([(count - 1) // 2, count // 2])
    return np.asarray(np.take_along_axis(ordered, middle, axis=1).mean(axis=1))


def cauchy_weights(row_scores: Array) -> Array:
    """1 / (1 + (s / 3.4)^2): never quite 0, for the first rounds, while the fit may still be wrong for all rows."""
    return np.asarray(1.0 / (1.0 + (row_scores / 3.4) ** 2))
