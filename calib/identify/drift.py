"""Whether two estimates differ by more than their noise, and which difference would have shown.

Both estimates are those of one robot, x_a and x_b, found under priors of precision P_a and P_b with the covariances
C_a and C_b. What an estimate is off by is its noise and what its prior pulls it by,

    x_a - x = noise of covariance (C_a - C_a P_a C_a)  -  C_a P_a x,

and x is the same for both, drawn from a prior of covariance S. So the difference of an unchanged robot's has

    V = (C_a - C_a P_a C_a) + (C_b - C_b P_b C_b) + (C_b P_b - C_a P_a) S (C_b P_b - C_a P_a)^T,

which is less than C_a + C_b, most of all where the data know little and both results say what the priors say. Only
combinations that the data know better than the prior take part in the test: those with C_a + C_b < S. On the k of
them d^T V^-1 d / k has the F distribution with k and nu degrees of freedom, because the noise was estimated; nu is that
of B. L. Welch, The generalization of Student's problem, Biometrika 34, 1947, by traces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats
from scipy.linalg import eigh

from calib.model.robot import read_only

Array = NDArray[np.float64]

#: A difference is called a drift below this probability: one comparison in a hundred of an unchanged robot says so.
LEVEL = 0.01

#: The probability with which a drift of the size told would be noticed.
POWER = 0.9

#: Smallest probability told; below it distributions have no digits.
_LEAST = 1e-300

#: A combination takes part where the share of its variance that the data leave over, C / (C + S), is below this.
_KNOWN = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Estimated:
    """One estimate in the coordinates of the test.

    Attributes:
        effect: shape (r, p), what a unit of each of p parameters does to each of r coordinates.
        covariance: shape (p, p), C of these parameters.
        noise: shape (p, p), the part of C that is the noise's: C - C P C over all parameters of the fit.
        pull: shape (p, p), C P.
        prior: shape (p,), variance of the prior of each parameter.
        freedom: Degrees of freedom that the noise was estimated with.
    """

    effect: Array
    covariance: Array
    noise: Array
    pull: Array
    prior: Array
    freedom: float

    @property
    def spread(self) -> Array:
        """The covariance of the coordinates, shape (r, r)."""
        return np.asarray(self.effect @ self.covariance @ self.effect.T)


@dataclass(frozen=True, slots=True)
class Explanation:
    """What one change explains of a difference.

    Attributes:
        change: Its size, in its unit.
        std: Standard deviation of that; infinite where the data do not know it.
        left: The chi-square that is left.
        p: Probability of that much or more, where nothing else has changed.
    """

    change: float
    std: float
    left: float
    p: float


@dataclass(frozen=True, slots=True, eq=False)
class DriftTest:
    """The test of one difference.

    Attributes:
        combinations: Number k of combinations that the data of both know.
        chi_square: d^T V^-1 d over them.
        freedom: Degrees of freedom nu of the noise.
        p: Probability of such a difference, or a larger one, where nothing has changed.
        sigma: The same as standard deviations of a normal distribution, one-sided; 0 where p > 0.5.
        whitening: shape (k, r), takes coordinates to combinations of unit variance.
        whitened: shape (k,), the difference in these.
        covariance: shape (r, r), V.
    """

    combinations: int
    chi_square: float
    freedom: float
    p: float
    sigma: float
    whitening: Array
    whitened: Array
    covariance: Array

    @property
    def drifted(self) -> bool:
        """Whether the difference is more than chance."""
        return self.p < LEVEL

    def explained(self, effect: Array) -> Explanation:
        """How well one change, of unknown size, explains the difference: the generalised least squares of it.

        Args:
            effect: shape (r,), what a unit of the change does to the coordinates.
        """
        seen = self.whitening @ effect
        length = float(np.linalg.norm(seen))
        if length == 0.0:
            return Explanation(0.0, float("inf"), self.chi_square, self.p)
        std = 1.0 / length
        change = float(seen @ self.whitened) / length**2
        left = max(self.chi_square - (change / std) ** 2, 0.0)
        k = self.combinations - 1
        p = float(stats.f.sf(left / k, k, self.freedom)) if k else 1.0
        return Explanation(change, std, left, p)

    def smallest_factor(self, effect: Array) -> float:
        """By what a change must be multiplied to be noticed with the probability `POWER`; infinite if it never is.

        Args:
            effect: shape (r,), what the change does to the coordinates.
        """
        seen = float(np.linalg.norm(self.whitening @ effect)) if self.combinations else 0.0
        return np.sqrt(noncentrality(self.combinations, self.freedom)) / seen if seen else np.inf


def noncentrality(k: int, freedom: float) -> float:
    """The noncentrality with which F(k, freedom) exceeds its quantile of `LEVEL` with the probability `POWER`."""
    limit = float(stats.f.isf(LEVEL, k, freedom))

    def missing(value: float) -> float:
        """How much power is missing."""
        return float(stats.ncf.sf(limit, k, freedom, value)) - POWER

    highest = 10.0 + 10.0 * k
    while missing(highest) < 0.0:
        highest *= 2.0
    return float(optimize.brentq(missing, 0.0, highest, xtol=1e-3))


def shared_covariance(a: Estimated, b: Estimated) -> Array:
    """V of the module's text where both have the same parameters under priors with the same mean, shape (r, r)."""
    pull = b.pull - a.pull
    both = a.noise + b.noise + (pull * np.maximum(a.prior, b.prior)) @ pull.T
    return np.asarray(a.effect @ both @ a.effect.T)


def drift_test(
    difference: Array, a: Estimated, b: Estimated, covariance: Array, floor: float
) -> DriftTest:
    """Test a difference.

    Args:
        difference: shape (r,), b less a.
        a: One estimate.
        b: The other.
        covariance: shape (r, r), V; `shared_covariance`, or the sum of both where they share no prior.
        floor: Standard deviation of each coordinate that stands for rounding.
    """
    rounding = floor**2 * np.eye(len(difference))
    posterior = a.spread + b.spread + rounding
    prior = np.asarray(sum((one.effect * one.prior) @ one.effect.T for one in (a, b))) / 2.0
    share, vectors = eigh(posterior, posterior + prior)
    kept = vectors[:, share < _KNOWN]
    k, V = kept.shape[1], covariance + rounding
    if k == 0:
        nothing = read_only(np.zeros((0, len(difference))))
        return DriftTest(0, 0.0, np.inf, 1.0, 0.0, nothing, read_only([]), read_only(V))
    values, axes = eigh(kept.T @ V @ kept)
    whitening = ((kept @ axes) / np.sqrt(np.maximum(values, 1e-12 * values[-1]))).T
    whitened = whitening @ difference
    chi_square = float(whitened @ whitened)
    shares = [float(np.trace(whitening @ one.spread @ whitening.T)) for one in (a, b)]
    total = sum(shares)
    freedom = total**2 / sum(
        s**2 / max(one.freedom, 1.0) for s, one in zip(shares, (a, b), strict=True)
    )
    p = max(float(stats.f.sf(chi_square / k, k, freedom)), _LEAST)
    return DriftTest(
        k,
        chi_square,
        freedom,
        p,
        max(float(stats.norm.isf(p)), 0.0),
        read_only(whitening),
        read_only(whitened),
        read_only(V),
    )
