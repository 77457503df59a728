"""Whether two estimates differ by more than their noise, and which difference would have shown.

Both estimates are those of one robot, x_a and x_b, found under priors of precision P_a and P_b with the covariances
C_a and C_b. What an estimate is off by is its noise and what its prior pulls it by,

    x_a - x = noise of covariance (C_a - C_a P_a C_a)  -  C_a P_a x,

and x is the same for both, drawn from a prior of covariance S. So the difference of an unchanged robot's has

    V = (C_a - C_a P_a C_a) + (C_b - C_b P_b C_b) + (C_b P_b - C_a P_a) S (C_b P_b - C_a P_a)^T,

which is less than C_a + C_b, most of all where the data know little and both results say what the priors say. On the
k combinations that are tested, d^T V^-1 d / k has the F distribution with k and nu degrees of freedom, because the
noise was estimated; nu is that of B. L. Welch, The generalization of Student's problem, Biometrika 34, 1947, by traces.

Which combinations these are, and which drift would show, must not depend on a prior that was found to be next to
nothing: where a robot is right already, its estimates stay at zero however well the data know them, and would not
if it drifted. So both are asked of *reference* estimates from the same data under priors that leave room for a
drift. A combination is tested where these have C_a + C_b < (S_a + S_b) / 2: the data know it better than the priors.
A change u of the robot changes x_b by (1 - C_b P_b) u.
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

#: A change whose estimate keeps less than this share of what the data know of it is not told.
_UNSEEN = 0.03

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
        whitening: shape (k, r), takes coordinates to combinations of unit variance.
        whitened: shape (k,), the difference in these.
        response: shape (r, p), what a unit of change of each of b's parameters makes of the coordinates.
        sensing: shape (k, p), the same in combinations of unit variance, by the reference estimates.
        told_from: The length of a change in these that is noticed with the probability `POWER`.
    """

    combinations: int
    chi_square: float
    freedom: float
    p: float
    sigma: float
    whitening: Array
    whitened: Array
    response: Array
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
        seen = self.whitening @ self.response[:, k]
        length = float(np.linalg.norm(seen))
        if length < _UNSEEN * self.sensitivity(k) or length == 0.0:
            return Explanation(0.0, float("inf"), self.chi_square, self.p)
        change = float(seen @ self.whitened) / length**2
        left = max(self.chi_square - (change * length) ** 2, 0.0)
        others = self.combinations - 1
        p = float(stats.f.sf(left / others, others, self.freedom)) if others else 1.0
        return Explanation(change, 1.0 / length, left, p)

    def sensitivity(self, k: int) -> float:
        """How many standard deviations a unit of change of one parameter, of b's, would be, once it showed at all."""
        return float(np.linalg.norm(self.sensing[:, k]))

    def shows_from(self, k: int) -> float:
        """Change of one parameter, of b's, that is noticed with the probability `POWER`; infinite if none is."""
        seen = self.sensitivity(k)
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


def drift_test(difference: Array, found: Pair, reference: Pair, floor: float) -> DriftTest:
    """Test a difference.

    Args:
        difference: shape (r,), b less a.
        found: Both estimates.
        reference: What they would be under priors that leave room for a drift.
        floor: Standard deviation of each coordinate that stands for rounding.
    """
    rounding = floor**2 * np.eye(len(difference))
    pair = (reference.a, reference.b)
    posterior = pair[0].spread + pair[1].spread + rounding
    prior = np.asarray(sum((one.effect * one.prior) @ one.effect.T for one in pair)) / 2.0
    share, vectors = eigh(posterior, posterior + prior) if len(difference) else _nothing()
    kept = vectors[:, share < _KNOWN]
    k = kept.shape[1]
    response = read_only(found.b.response)
    if k == 0:
        none = read_only(np.zeros((0, len(difference))))
        sensing = read_only(np.zeros((0, response.shape[1])))
        return DriftTest(0, 0.0, np.inf, 1.0, 0.0, none, read_only([]), response, sensing, np.inf)
    whitening = _whitening(kept, found.covariance + rounding)
    whitened = whitening @ difference
    chi_square = float(whitened @ whitened)
    of_reference = _whitening(kept, reference.covariance + rounding)
    shares = [float(np.trace(of_reference @ one.spread @ of_reference.T)) for one in pair]
    freedom = sum(shares) ** 2 / sum(
        s**2 / max(one.freedom, 1.0) for s, one in zip(shares, pair, strict=True)
    )
    p = max(float(stats.f.sf(chi_square / k, k, freedom)), _LEAST)
    return DriftTest(
        combinations=k,
        chi_square=chi_square,
        freedom=freedom,
        p=p,
        sigma=max(float(stats.norm.isf(p)), 0.0),
        whitening=read_only(whitening),
        whitened=read_only(whitened),
        response=response,
        sensing=read_only(of_reference @ reference.b.response),
        told_from=float(np.sqrt(noncentrality(k, freedom))),
    )


def _whitening(kept: Array, covariance: Array) -> Array:
    """What takes coordinates to some combinations of them, of unit variance, shape (k, r)."""
    values, axes = eigh(kept.T @ covariance @ kept)
    return np.asarray(((kept @ axes) / np.sqrt(np.maximum(values, 1e-12 * values[-1]))).T)


def _nothing() -> tuple[Array, Array]:
    """No combination of no coordinates."""
    return np.zeros(0), np.zeros((0, 0))
