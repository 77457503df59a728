"""Whether two estimates differ by more than their noise, and which difference would have shown.

Both estimates are of one robot. What they are off by is their noise and what their priors pull them by, and sizes of
priors are found from the data, so that two fits of one robot may pull differently: one may find that there are no
errors of some kind, and leave these at zero. Both are brought to common priors first. A result is x with the covariance
C = (H + P)^-1, where H is what the data know and P the priors' precision, and the data push against the priors by s,
which is P x where x is the least of all squares. Under other priors Q that would be, to first order,

    C_q = (C^-1 + Q - P)^-1,        x_q = x + C_q (s - Q x).

With Q no sharper than either of both, and never so sharp that it would hide a drift, the difference of an unchanged
robot's estimates, the robot drawn from that prior, has the covariance

    V = N_a + N_b + (C_b Q - C_a Q) Q^-1 (C_b Q - C_a Q)^T,        N = C_q - C_q Q C_q,

which is less than C_a + C_b, most of all where the data know little and both say what the prior says. Combinations are
tested that the data know better than the prior, C_a + C_b < Q^-1. On the k of them d^T V^-1 d / k has the F
distribution with k and nu degrees of freedom, because the noise was estimated; nu is that of B. L. Welch, The
generalization of Student's problem, Biometrika 34, 1947, by traces. A change u of the robot changes x_b by
(1 - C_b Q) u.
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
    """One estimate under the common priors, in the coordinates of the test.

    Attributes:
        effect: shape (r, p), what a unit of each of p parameters does to each of r coordinates.
        covariance: shape (p, p), C of these parameters.
        noise: shape (p, p), the part of C that is the noise's: C - C P C over all parameters of the fit.
        pull: shape (p, p), C P.
        prior: shape (p,), variance of the prior of each parameter.
        freedom: Degrees of freedom that the noise was estimated with.
        shift: shape (p,), how far the estimate lies from that of the result, x_q - x; not used by the test itself.
    """

    effect: Array
    covariance: Array
    noise: Array
    pull: Array
    prior: Array
    freedom: float
    shift: Array

    @property
    def response(self) -> Array:
        """What a unit of change of each parameter makes of the estimate's coordinates, shape (r, p)."""
        return np.asarray(self.effect - self.effect @ self.pull)

    @property
    def spread(self) -> Array:
        """The covariance of the coordinates, shape (r, r)."""
        return np.asarray(self.effect @ self.covariance @ self.effect.T)


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two estimates, and what the difference of an unchanged robot's spreads by.

    Attributes:
        a: One.
        b: The other, of the same coordinates.
        alike: Whether both have the same parameters under priors with the same mean; otherwise they are taken to err
            independently of each other, which is too much rather than too little.
    """

    a: Estimated
    b: Estimated
    alike: bool

    @property
    def covariance(self) -> Array:
        """V of the module's text, in the coordinates, shape (r, r)."""
        a, b = self.a, self.b
        if not self.alike:
            return a.spread + b.spread
        pull = b.pull - a.pull
        both = a.noise + b.noise + (pull * np.maximum(a.prior, b.prior)) @ pull.T
        return np.asarray(a.effect @ both @ a.effect.T)

    @property
    def joint(self) -> Array:
        """The covariance of (x_a, x_b) about a common truth, shape (p_a + p_b, p_a + p_b)."""
        a, b = self.a, self.b
        p = len(a.covariance)
        result = np.zeros((p + len(b.covariance),) * 2)
        result[:p, :p], result[p:, p:] = a.covariance, b.covariance
        if self.alike:
            prior = np.maximum(a.prior, b.prior)
            result[:p, :p] = a.noise + (a.pull * prior) @ a.pull.T
            result[p:, p:] = b.noise + (b.pull * prior) @ b.pull.T
            result[:p, p:] = (a.pull * prior) @ b.pull.T
            result[p:, :p] = result[:p, p:].T
        return result


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
        whitened: shape (k,), the difference in combinations of unit variance.
        sensing: shape (k, p), what a unit of change of each of b's parameters makes of these.
        told_from: The length of a change in these that is noticed with the probability `POWER`.
    """

    combinations: int
    chi_square: float
    freedom: float
    p: float
    sigma: float
    whitened: Array
    sensing: Array
    told_from: float

    @property
    def drifted(self) -> bool:
        """Whether the difference is more than chance."""
        return self.p < LEVEL

    def explained(self, k: int) -> Explanation:
        """How well a change of one parameter explains the difference, by generalised least squares.

        Args:
            k: Number of the parameter, of b's.
        """
        seen = self.sensing[:, k]
        length = float(np.linalg.norm(seen))
        if length == 0.0:
            return Explanation(0.0, float("inf"), self.chi_square, self.p)
        change = float(seen @ self.whitened) / length**2
        left = max(self.chi_square - (change * length) ** 2, 0.0)
        others = self.combinations - 1
        p = float(stats.f.sf(left / others, others, self.freedom)) if others else 1.0
        return Explanation(change, 1.0 / length, left, p)

    def shows_from(self, k: int) -> float:
        """Change of one parameter, of b's, that is noticed with the probability `POWER`; infinite if none is."""
        seen = float(np.linalg.norm(self.sensing[:, k]))
        return self.told_from / seen if seen > 0.0 else float("inf")


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


def drift_test(difference: Array, pair: Pair, floor: float) -> DriftTest:
    """Test a difference.

    Args:
        difference: shape (r,), b less a.
        pair: Both estimates.
        floor: Standard deviation of each coordinate that stands for rounding.
    """
    rounding = floor**2 * np.eye(len(difference))
    both = (pair.a, pair.b)
    posterior = pair.a.spread + pair.b.spread + rounding
    prior = np.asarray(sum((one.effect * one.prior) @ one.effect.T for one in both)) / 2.0
    share, vectors = eigh(posterior, posterior + prior) if len(difference) else _nothing()
    kept = vectors[:, share < _KNOWN]
    k = kept.shape[1]
    if k == 0:
        sensing = read_only(np.zeros((0, pair.b.effect.shape[1])))
        return DriftTest(0, 0.0, np.inf, 1.0, 0.0, read_only([]), sensing, np.inf)
    whitening = _whitening(kept, pair.covariance + rounding)
    whitened = whitening @ difference
    chi_square = float(whitened @ whitened)
    shares = [float(np.trace(whitening @ one.spread @ whitening.T)) for one in both]
    freedom = sum(shares) ** 2 / sum(
        s**2 / max(one.freedom, 1.0) for s, one in zip(shares, both, strict=True)
    )
    p = max(float(stats.f.sf(chi_square / k, k, freedom)), _LEAST)
    return DriftTest(
        combinations=k,
        chi_square=chi_square,
        freedom=freedom,
        p=p,
        sigma=max(float(stats.norm.isf(p)), 0.0),
        whitened=read_only(whitened),
        sensing=read_only(whitening @ pair.b.response),
        told_from=float(np.sqrt(noncentrality(k, freedom))),
    )


def _whitening(kept: Array, covariance: Array) -> Array:
    """What takes coordinates to some combinations of them, of unit variance, shape (k, r)."""
    values, axes = eigh(kept.T @ covariance @ kept)
    return np.asarray(((kept @ axes) / np.sqrt(np.maximum(values, 1e-12 * values[-1]))).T)


def _nothing() -> tuple[Array, Array]:
    """No combination of no coordinates."""
    return np.zeros(0), np.zeros((0, 0))
