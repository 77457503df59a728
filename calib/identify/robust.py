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
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri, fdtri

from calib.model.threads import over_blocks

Array = NDArray[np.float64]

#: A good row keeps its full weight with this probability.
_FULL = 0.99

#: The probability that any row at all of a clean table is flagged.
_FALSE_ALARM = 0.01

#: A row that leaves less than this of a direction to the others carries it nearly alone.
_CARRIED = 1e-4

#: Identities by their size, of the scalars that a row may have.
_IDENTITIES = tuple(np.eye(d)[:, :, None] for d in range(7))

#: The scalars of a point, for which scores are told.
_POINT = 3


@dataclass(frozen=True, slots=True)
class Limits:
    """Scores between which the weight falls from 1 to 0.

    Attributes:
        full: Below it a row counts in full.
        flagged: Above it a row does not count and is named as an outlier.
    """

    full: float
    flagged: float

    @classmethod
    def of(cls, rows: int, freedom: float) -> Limits:
        """The limits for a table.

        Args:
            rows: Number of rows.
            freedom: Degrees of freedom that the noise was estimated with.
        """
        freedom = max(freedom, 1.0)
        full = float(np.sqrt(3.0 * fdtri(3.0, freedom, _FULL)))
        flagged = float(np.sqrt(3.0 * fdtri(3.0, freedom, 1.0 - _FALSE_ALARM / max(rows, 10))))
        return cls(full, flagged)

    def weights(self, scores: Array) -> Array:
        """Redescending weights: 1, then falling linearly in influence to 0, shape (N,)."""
        fall = (self.flagged - scores) / (self.flagged - self.full)
        return np.where(scores <= self.full, 1.0, np.clip(fall, 0.0, 1.0))


def deleted_norms(
    residual: Array,
    jacobian: Array,
    covariance: Array,
    weights: Array,
    factors: Array | None = None,
) -> Array:
    """How far each row lies from what the others predict, in standard deviations, shape (N,); see the module's text.

    Args:
        residual: shape (N, D), in units of each scalar's sigma.
        jacobian: shape (N, D, p), likewise.
        covariance: shape (p, p), of the parameters.
        weights: shape (N,).
        factors: shape (N, D), what residual and jacobian are multiplied by; None for 1.
    """
    norms = np.empty(len(residual))

    def work(own: slice) -> None:
        A, r = jacobian[own].transpose(2, 1, 0), residual[own].T
        p, D, B = A.shape
        spread = (covariance @ A.reshape(p, D * B)).reshape(p, D, B)
        leverage = np.empty((D, D, B))
        for i in range(D):
            row = np.einsum("pb,pjb->jb", spread[:, i], A[:, : i + 1])
            leverage[i, : i + 1], leverage[: i + 1, i] = row, row
        if factors is not None:
            f = factors[own].T
            r, leverage = r * f, leverage * f * f[:, None]
        norms[own] = _norms_of(r, leverage, weights[own])

    over_blocks(work, len(norms))
    return norms


def _norms_of(r: Array, K: Array, w: Array) -> Array:
    """The norms of residuals, shape (D, B), with the leverages K, shape (D, D, B), and weights, shape (B,).

    (I + (1 - w) K) (I - w K) is symmetric and solved as it stands; where a row carries nearly all that is known of a
    direction, by the eigenvalues of K, none of which may then pass 1 / w.
    """
    kept = _IDENTITIES[len(r)] - w * K
    spread = kept + (1.0 - w) * np.einsum("ijb,jkb->ikb", K, kept)
    with np.errstate(all="ignore"):
        _, square = _eliminated(spread, r.copy())
    trace = np.einsum("iib->b", K)
    # The product of 1 - w k over the eigenvalues k of K is at most its smallest factor, and at least 1 - w trace K.
    if not np.all(w * trace < 1.0 - _CARRIED):
        with np.errstate(all="ignore"):
            left, _ = _eliminated(kept, np.zeros_like(r))
        risky = ~(left >= _CARRIED) | (K.max(axis=(0, 1), initial=0.0) > 1.0 / _CARRIED)
        if risky.any():
            square[risky] = _squares_by_eigenvalues(r[:, risky].T, K[:, :, risky].T, w[risky])
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


def _squares_by_eigenvalues(residual: Array, leverage: Array, weights: Array) -> Array:
    """The squares of the norms with 1 - w k kept above 0, of shapes (N, D), (N, D, D) and (N,)."""
    values, vectors = np.linalg.eigh(leverage)
    along = np.einsum("nij,ni->nj", vectors, residual)
    w = weights[:, None]
    spread = (1.0 + (1.0 - w) * values) * np.maximum(1.0 - w * values, 1e-9)
    return np.asarray(np.sum(along**2 / spread, axis=1))


def scores(
    residual: Array, jacobian: Array, covariance: Array, weights: Array, used: NDArray[np.bool_]
) -> Array:
    """The score of each row, shape (N,): `deleted_norms` told as those of a point; 0 for a row without scalars.

    Args:
        residual: shape (N, D), in units of each scalar's sigma.
        jacobian: shape (N, D, p), likewise.
        covariance: shape (p, p), of the parameters.
        weights: shape (N,).
        used: shape (N, D), which scalars there are.
    """
    norms = deleted_norms(residual, jacobian, covariance, weights)
    return as_of_a_point(norms, np.sum(used, axis=1))


def as_of_a_point(row_scores: Array, scalars: NDArray[np.int_]) -> Array:
    """The scores that three scalars would have at the same probability.

    By the chi-squared distribution as far as its tail can be computed, and by the same step beyond.
    """
    result: Array = row_scores.copy()
    result[scalars == 0] = 0.0
    for d in np.unique(scalars):
        if d in (0, _POINT):
            continue
        own = scalars == d
        farthest = _farthest(int(d))
        inner = np.minimum(row_scores[own], farthest)
        same = np.sqrt(chdtri(_POINT, chdtrc(d, inner**2)))
        result[own] = same + (row_scores[own] - inner)
    return result


def _farthest(d: int) -> float:
    """The score beyond which the tail of d scalars is too thin to be inverted."""
    return float(np.sqrt(chdtri(d, 1e-200)))


def median_noise(row_scores: Array, used: NDArray[np.bool_]) -> float:
    """The noise that makes the median score what it is for normal noise: a scale that outliers cannot move.

    Args:
        row_scores: shape (N,), norms in units of the sigma given.
        used: shape (N, D), which scalars each row has.
    """
    scalars = np.sum(used, axis=1)
    typical = np.sqrt(chdtri(np.maximum(np.arange(used.shape[1] + 1), 1), 0.5))[scalars]
    return median((row_scores / typical)[scalars > 0])


def median(values: Array) -> float:
    """`numpy.median` of some numbers, without what it does besides."""
    ordered, count = np.sort(values), len(values)
    return float(0.5 * (ordered[(count - 1) // 2] + ordered[count // 2]))


def cauchy_weights(row_scores: Array) -> Array:
    """1 / (1 + (s / 3.4)^2): never quite 0, for the first rounds, while the fit may still be wrong for all rows."""
    result: Array = 1.0 / (1.0 + (row_scores / 3.4) ** 2)
    return result
