"""Whether two estimates of one robot differ by more than their noise.

What both are off by is their noise and what their priors pull them by, and sizes of priors are found from the data, so
that two fits of one robot may pull differently: one may find that there are no errors of some kind, and leave these at
zero. Both are brought to common priors first. A result is x with the covariance C = (H + P)^-1, where H is what the
data know and P the priors' precision, and the data push against the priors by s, which is P x where x is the least of
all squares. Under other priors Q that would be, to first order,

    C_q = (C^-1 + Q - P)^-1,        x_q = x + C_q (s - Q x).

With Q no sharper than either of both, and never so sharp that it would hide a drift, the difference of an unchanged
robot's estimates, the robot drawn from that prior, has the covariance

    V = N_a + N_b + (C_b Q - C_a Q) Q^-1 (C_b Q - C_a Q)^T,        N = C_q - C_q Q C_q,

which is less than C_a + C_b, most of all where the data know little and both say what the prior says. Combinations are
tested that the data know better than the prior, C_a + C_b < Q^-1. On the k of them d^T V^-1 d / k has the F
distribution with k and nu degrees of freedom, because the noise was estimated; nu is that of B. L. Welch, The
generalization of Student's problem, Biometrika 34, 1947, by traces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.linalg import eigh

from calib.identify.result import Calibration
from calib.model.observability import steps
from calib.model.parameters import FRAME, TARGET

Array = NDArray[np.float64]

#: A difference is called a drift below this probability: one comparison in a hundred of an unchanged robot says so.
LEVEL = 0.01

#: Smallest probability told; below it distributions have no digits.
_LEAST = 1e-300

#: A combination takes part where the share of its variance that the data leave over, C / (C + S), is below this.
_KNOWN = 0.5

#: Priors are taken to be no wider than this many steps of 1 mm and 1 mrad when it comes to what the data know.
_WIDEST = 10.0

#: How large a drift the common priors leave room for, in the same steps.
_ROOM = 0.2


def own_parameters(c: Calibration) -> NDArray[np.int_]:
    """Which parameters are the robot's own: those of frames and targets left out."""
    return np.flatnonzero(~c.model.family(FRAME, TARGET))


def own_names(c: Calibration) -> tuple[str, ...]:
    """The names of these."""
    return tuple(c.model.names[k] for k in own_parameters(c))


def own_steps(c: Calibration) -> Array:
    """What arms are typically wrong by in each of these."""
    return steps([c.model.units[k] for k in own_parameters(c)])


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
    def spread(self) -> Array:
        """The covariance of the coordinates, shape (r, r)."""
        return np.asarray(self.effect @ self.covariance @ self.effect.T)

    @classmethod
    def of(cls, one: Calibration, other: Calibration, effect: Array) -> Estimated:
        """A result's own parameters under priors that both share, and that leave room for a drift.

        Args:
            one: The result.
            other: The one that it is compared with.
            effect: shape (r, p), of its own parameters.
        """
        own, step = own_parameters(one), own_steps(one)
        precision = _precision(one)
        of_other = dict(zip(other.model.names, _precision(other), strict=True))
        shared = [min(precision[k], of_other.get(one.model.names[k], np.inf)) for k in own]
        # Never wider than anything an arm may err by either: with priors off there is none.
        widest, least = 1.0 / (_WIDEST * step) ** 2, 1.0 / (_ROOM * step) ** 2
        common = precision.copy()
        common[own] = np.clip(shared, widest, least)
        common[_at_bound(one)] = 0.0
        C = _under(one, precision, common)
        noise, of_own = C - (C * common) @ C, C[np.ix_(own, own)]
        push = np.array([one.parameters[k].push for k in own])
        return cls(
            effect=effect,
            covariance=of_own,
            noise=noise[np.ix_(own, own)],
            pull=of_own * common[own],
            prior=1.0 / np.clip(shared, widest, least),
            freedom=one.freedom,
            shift=of_own @ (push - common[own] * one.x[own]),
        )


def _precision(c: Calibration) -> Array:
    """One over the variance of each parameter's prior, shape (p,); 0 without one."""
    prior = np.array([one.prior_std for one in c.parameters])
    return np.where(np.isnan(prior), 0.0, 1.0 / prior**2)


def _at_bound(c: Calibration) -> NDArray[np.bool_]:
    """Which parameters a bound stopped, shape (p,)."""
    return np.array([one.at_bound for one in c.parameters], dtype=bool)


def _under(one: Calibration, precision: Array, common: Array) -> Array:
    """The covariance under other priors, (C^-1 + Q - P)^-1, shape (p, p). Parameters at a bound stay there."""
    free = np.flatnonzero(~_at_bound(one))
    block = np.ix_(free, free)
    scale = np.sqrt(np.diag(one.covariance)[free])
    scale = np.where(scale > 0.0, scale, 1.0)
    correlation = one.covariance[block] / np.outer(scale, scale)
    M = np.linalg.pinv(correlation, rcond=1e-14, hermitian=True)
    M += np.diag((common - precision)[free] * scale**2)
    # Scaled anew, so that what had been held tightly does not drown the rest.
    size = 1.0 / np.sqrt(np.maximum(np.diag(M), 1e-12))
    inverse = np.linalg.pinv(M * np.outer(size, size), rcond=1e-13, hermitian=True)
    C = np.zeros_like(one.covariance)
    C[block] = inverse * np.outer(size * scale, size * scale)
    return C


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
class DriftTest:
    """The test of one difference.

    Attributes:
        combinations: Number k of combinations that the data of both know.
        chi_square: d^T V^-1 d over them.
        freedom: Degrees of freedom nu of the noise.
        p: Probability of such a difference, or a larger one, where nothing has changed.
        sigma: The same as standard deviations of a normal distribution, one-sided; 0 where p > 0.5.
    """

    combinations: int
    chi_square: float
    freedom: float
    p: float
    sigma: float

    @property
    def drifted(self) -> bool:
        """Whether the difference is more than chance."""
        return self.p < LEVEL


def drift_test(difference: Array, pair: Pair, floor: float) -> DriftTest:
    """Test a difference.

    Args:
        difference: shape (r,), b less a.
        pair: Both estimates.
        floor: Standard deviation of each coordinate that stands for rounding.
    """
    nothing = DriftTest(0, 0.0, np.inf, 1.0, 0.0)
    if not len(difference):
        return nothing
    rounding = floor**2 * np.eye(len(difference))
    both = (pair.a, pair.b)
    posterior = pair.a.spread + pair.b.spread + rounding
    prior = np.asarray(sum((one.effect * one.prior) @ one.effect.T for one in both)) / 2.0
    share, vectors = eigh(posterior, posterior + prior)
    kept = vectors[:, share < _KNOWN]
    k = kept.shape[1]
    if k == 0:
        return nothing
    whitening = _whitening(kept, pair.covariance + rounding)
    chi_square = float(np.sum((whitening @ difference) ** 2))
    shares = [float(np.trace(whitening @ one.spread @ whitening.T)) for one in both]
    freedom = sum(shares) ** 2 / sum(
        s**2 / max(one.freedom, 1.0) for s, one in zip(shares, both, strict=True)
    )
    p = max(float(stats.f.sf(chi_square / k, k, freedom)), _LEAST)
    return DriftTest(k, chi_square, freedom, p, sigma=max(float(stats.norm.isf(p)), 0.0))


def _whitening(kept: Array, covariance: Array) -> Array:
    """What takes coordinates to some combinations of them, of unit variance, shape (k, r)."""
    values, axes = eigh(kept.T @ covariance @ kept)
    return np.asarray(((kept @ axes) / np.sqrt(np.maximum(values, 1e-12 * values[-1]))).T)
