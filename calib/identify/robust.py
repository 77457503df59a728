"""Robust weights: which rows do not belong to the others.

A row is judged by how far it lies from what the *other* rows predict, in units of that prediction's own standard
deviation, so that a row with leverage cannot hide. With K = A C A^T / sigma^2, the leverage of a row of weight 1,

    score^2 = r^T (I + (1 - w) K)^-1 (I - w K)^-1 r / sigma^2

which is the squared deleted residual over its covariance, and score^2 / 3 follows F(3, dof) for a good row.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri

Array = NDArray[np.float64]

#: The median of the norm of a 3-D standard normal vector.
_MEDIAN_NORM = 1.5381722544550522

#: A good row keeps its full weight with this probability.
_FULL = 0.99

#: The probability that any row at all of a clean table is flagged.
_FALSE_ALARM = 0.01


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


def scores(residual: Array, jacobian: Array, covariance: Array, weights: Array) -> Array:
    """The score of each row, shape (N,); see the module's text.

    Args:
        residual: shape (N, 3), in units of each row's sigma.
        jacobian: shape (N, 3, p), likewise.
        covariance: shape (p, p), of the parameters.
        weights: shape (N,).
    """
    leverage = jacobian @ covariance @ jacobian.transpose(0, 2, 1)
    values, vectors = np.linalg.eigh(leverage)
    along = np.einsum("nij,ni->nj", vectors, residual)
    w = weights[:, None]
    spread = (1.0 + (1.0 - w) * values) * np.maximum(1.0 - w * values, 1e-9)
    result: Array = np.sqrt(np.sum(along**2 / spread, axis=1))
    return result


def median_noise(row_scores: Array) -> float:
    """The noise that makes the median score what it is for normal noise: a scale that outliers cannot move."""
    return float(np.median(row_scores) / _MEDIAN_NORM)


def cauchy_weights(row_scores: Array) -> Array:
    """1 / (1 + (s / 3.4)^2): never quite 0, for the first rounds, while the fit may still be wrong for all rows."""
    result: Array = 1.0 / (1.0 + (row_scores / 3.4) ** 2)
    return result
