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

Array = NDArray[np.float64]

#: A good row keeps its full weight with this probability.
_FULL = 0.99

#: The probability that any row at all of a clean table is flagged.
_FALSE_ALARM = 0.01

#: A row that leaves less than this of a direction to the others carries it nearly alone.
_CARRIED = 1e-4

#: Identities by their size, of the 1, 3 or 6 scalars that a row may have.
_IDENTITIES = tuple(np.eye(d) for d in range(7))

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


def deleted_norms(residual: Array, jacobian: Array, covariance: Array, weights: Array) -> Array:
    """How far each row lies from what the others predict, in standard deviations, shape (N,); see the module's text.

    Args:
        residual: shape (N, D), in units of each scalar's sigma.
        jacobian: shape (N, D, p), likewise.
        covariance: shape (p, p), of the parameters.
        weights: shape (N,).
    """
    # The first product as one of two matrices, not of N small ones.
    spread_rows = (jacobian.reshape(-1, len(covariance)) @ covariance).reshape(jacobian.shape)
    return norms_of(residual, spread_rows @ jacobian.transpose(0, 2, 1), weights)


def norms_of(residual: Array, leverage: Array, weights: Array) -> Array:
    """`deleted_norms` with the leverages K themselves, shape (N, D, D).

    (I + (1 - w) K) (I - w K) = I + (1 - 2 w) K - w (1 - w) K^2 is solved as it stands; where a row carries nearly all
    that is known of a direction, by the eigenvalues of K, none of which may then pass 1 / w.
    """
    w = weights[:, None, None]
    identity = _IDENTITIES[residual.shape[1]]
    kept = identity - w * leverage
    spread = (identity + (1.0 - w) * leverage) @ kept
    # The product of 1 - w k over the eigenvalues k of K is at most its smallest factor.
    risky = np.linalg.det(kept) < _CARRIED
    if leverage.max(initial=0.0) > 1.0 / _CARRIED:
        risky |= leverage.max(axis=(1, 2)) > 1.0 / _CARRIED
    some = bool(risky.any())
    if some:
        spread[risky] = identity
    solved = np.linalg.solve(spread, residual[:, :, None])[:, :, 0]
    result: Array = np.sqrt(np.maximum((residual * solved).sum(axis=1), 0.0))
    if some:
        result[risky] = _norms_by_eigenvalues(residual[risky], leverage[risky], weights[risky])
    return result


def _norms_by_eigenvalues(residual: Array, leverage: Array, weights: Array) -> Array:
    """`norms_of` with 1 - w k kept above 0."""
    values, vectors = np.linalg.eigh(leverage)
    along = np.einsum("nij,ni->nj", vectors, residual)
    w = weights[:, None]
    spread = (1.0 + (1.0 - w) * values) * np.maximum(1.0 - w * values, 1e-9)
    result: Array = np.sqrt(np.sum(along**2 / spread, axis=1))
    return result


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
