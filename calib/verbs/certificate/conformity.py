"""Conformity with a tolerance under measurement uncertainty: probabilities and risks (JCGM 106).

A deviation y was measured with the expanded uncertainty U of nu degrees of freedom, and T is its tolerance. With
Student's distribution function F, and the standard uncertainty u that belongs to U,

    u = U / t,    F_nu(t) = (1 + P) / 2,    P = 95.45 %
    p = F_nu((T - y) / u)                               probability that the true deviation is within T (7.2)
    1 - p                                               specific risk of accepting it (8)

Accepted is y <= T - w, with the guard band w = U of ISO 14253-1; then 1 - p <= 2.3 %. Of robots whose true deviations
are known beforehand as y0 with a standard deviation u0, the global risks are (9.3)

    R_C = P(Y > T and accepted) = integral of g0(Y) P(y <= T - w | Y) over Y > T       a wrong one is accepted
    R_P = P(Y <= T and not accepted)                                                  a right one is not accepted
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import quad
from scipy.special import ndtr, stdtr, stdtrit

from calib.basics.arrays import Array
from calib.uncertainty.coverage import PROBABILITY

#: A normal distribution ends here, in standard deviations: what is beyond is less than 1e-30.
_END = 12.0


@dataclass(frozen=True, slots=True)
class Risks:
    """Risks over all robots, of which a prior says how far they are off."""

    #: Probability that a robot is out of tolerance and is accepted
    consumer: float
    #: Probability that a robot is within tolerance and is not accepted
    producer: float


def coverage_quantile(freedom: ArrayLike) -> Array:
    """Return how many standard uncertainties U is along one direction: 2 if they are known, else Student's quantile.

    Args:
        freedom: shape (N,) or (), degrees of freedom of the standard uncertainty; infinite if it is known.
    """
    return np.asarray(stdtrit(np.asarray(freedom, dtype=np.float64), (1.0 + PROBABILITY) / 2.0))


def conformance_probability(
    deviation: ArrayLike, tolerance: float, uncertainty: ArrayLike, freedom: ArrayLike
) -> Array:
    """Return the probability that true deviations are within a tolerance.

    Args:
        deviation: shape (N,), what was measured, in some unit.
        tolerance: The largest deviation allowed, in that unit.
        uncertainty: shape (N,), expanded uncertainty of each, in that unit; where it is 0, the probability is 0 or 1.
        freedom: shape (N,), its degrees of freedom; infinite if it is known.

    Returns:
        shape (N,), 0 to 1.
    """
    nu = np.asarray(freedom, dtype=np.float64)
    margin = tolerance - np.asarray(deviation, dtype=np.float64)
    u = np.asarray(uncertainty, dtype=np.float64) / coverage_quantile(nu)
    with np.errstate(divide="ignore", invalid="ignore"):
        score = np.where(u > 0.0, margin / u, np.where(margin >= 0.0, np.inf, -np.inf))
    return np.asarray(stdtr(nu, score))


def global_risks(
    prior: tuple[float, float], tolerance: float, uncertainty: float, guard_band: float
) -> Risks:
    """Return the risks of accepting deviations up to a tolerance less a guard band, over all robots.

    Args:
        prior: Mean and standard deviation of the true deviations of such robots, in some unit.
        tolerance: The largest deviation allowed, in that unit.
        uncertainty: Standard uncertainty of a measured deviation, in that unit, above 0.
        guard_band: Distance of the limit of acceptance below the tolerance, in that unit.
    """
    mean, std = prior
    limit = (tolerance - guard_band - mean) / uncertainty
    ratio = std / uncertainty
    at_tolerance = (tolerance - mean) / std

    def density(z: float) -> float:
        return float(np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi))

    def integral(sign: float, low: float, high: float) -> float:
        """Integrate the density times the probability to be accepted (sign 1) or not (-1), where that changes too."""
        low, high = (float(np.clip(end, -_END, _END)) for end in (low, high))
        middle = float(np.clip(limit / ratio, low, high))
        halves = ((low, middle), (middle, high))
        parts = [
            quad(lambda z: density(z) * ndtr(sign * (limit - ratio * z)), *ends, epsabs=1e-14)[0]
            for ends in halves
        ]
        return float(sum(parts))

    return Risks(
        consumer=integral(1.0, at_tolerance, _END), producer=integral(-1.0, -_END, at_tolerance)
    )
