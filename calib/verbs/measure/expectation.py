"""Expectation: how accurate a calibration by the rows so far is, by their information.

With A_i the whitened derivative of what is measured at stop i, P the prior precision of the parameters and B the mean
square of the derivative of the positions that count,

    C = (P + sum_i A_i^T A_i)^-1,        rms^2 = x^T B x  with  x ~ N(0, C)

is the squared error of one calibration over the positions: a sum of chi-squares weighted by the eigenvalues of C B. The
noise is estimated with nu degrees of freedom, so that the sum is multiplied by nu / chi^2(nu): the limit below which
the error is with a given probability is wider the less is known of the noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from calib.basics.arrays import Array
from calib.basics.values import Value
from calib.verbs.measure.aim import CONFIDENCE

#: Random draws of the error of a calibration.
_DRAWS = 8000


@dataclass(frozen=True, slots=True)
class Expectation(Value):
    """The expected error of a calibration, rms over the positions that count [m]."""

    #: Its root mean square over calibrations
    error: float
    #: 5 % of calibrations are better
    low: float
    #: 95 % of calibrations are better
    high: float

    @classmethod
    def of(cls, covariance: Array, mean_square: Array, freedom: float) -> Expectation:
        """Return the expected error by the covariance of the parameters.

        Args:
            covariance: C, shape (p, p).
            mean_square: B, shape (p, p), [m^2 per units].
            freedom: Degrees of freedom of the noise; infinite if it is known.
        """
        values = np.linalg.eigvals(covariance @ mean_square).real
        weights = np.sort(np.maximum(values, 0.0))[::-1]
        error = float(np.sqrt(weights.sum()))
        squares = _chi_squares(len(weights)) @ weights
        if np.isfinite(freedom):
            squares = squares * _inverse_chi_square(max(freedom, 1.0))
        low, high = np.sqrt(np.quantile(squares, [1.0 - CONFIDENCE, CONFIDENCE]))
        return cls(error, float(low), float(high))


@lru_cache(maxsize=8)
def _chi_squares(count: int) -> Array:
    """Return draws of independent chi-squares of one degree of freedom, (draws, count), always the same ones."""
    return np.random.default_rng(20260101).chisquare(1, size=(_DRAWS, count))


def _inverse_chi_square(freedom: float) -> Array:
    """Return draws of nu / chi^2(nu), shape (draws,), always the same ones."""
    return np.asarray(freedom / np.random.default_rng(20260102).chisquare(freedom, size=_DRAWS))
