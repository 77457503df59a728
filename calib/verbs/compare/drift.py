"""Test of the difference of two estimates of one robot: has it drifted, or is the difference noise?

Two fits of one robot may be pulled differently by their priors, so both are brought to common priors first. A result is
x with the covariance C = (H + P)^-1, where H is the information of the data and P the priors' precision, and s is minus
the gradient of half the data's squares, the pull of the data against the priors. Under other priors Q, to first order,

    C_q = (C^-1 + Q - P)^-1,        x_q = x + C_q (s - Q x).

With Q no sharper than either of both, and never so sharp that it would hide a drift, the difference of an unchanged
robot's estimates, the robot drawn from that prior, has the covariance

    V = N_a + N_b + (C_b Q - C_a Q) Q^-1 (C_b Q - C_a Q)^T,        N = C_q - C_q Q C_q.

Tested are the k combinations that the data know better than the prior, C_a + C_b < Q^-1: on them d^T V^-1 d / k has the
F distribution with k and nu degrees of freedom, because the noise was estimated; nu is that of B. L. Welch, Biometrika
34, 1947, by traces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, eigh
from scipy.special import fdtrc, ndtri

from calib.basics.arrays import Array, Mask

#: A difference is called a drift below this p-value: one comparison in a hundred of an unchanged robot is.
LEVEL = 0.01

#: A combination is tested if the share of its variance that the data leave, C / (C + S), is below this.
_KNOWN = 0.5

#: Probabilities below this have no digits.
_SMALLEST_P = 1e-300


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """A result's p robot parameters under common priors of precision Q."""

    #: (p, p), C
    covariance: Array
    #: (p, p), its part from noise, C - C Q C over all parameters of the fit
    noise: Array
    #: (p, p), C Q
    pull: Array
    #: (p,), the variance of each prior, 1 / Q
    prior: Array
    #: Degrees of freedom of the noise
    freedom: float
    #: (p,), change of the estimate by the change of priors, x_q - x
    shift: Array


@dataclass(frozen=True, slots=True)
class DriftTest:
    """The test of a difference."""

    #: Number k of combinations of parameters that both data know
    combinations: int
    #: d^T V^-1 d over them
    chi_square: float
    #: Degrees of freedom nu of the noise
    freedom: float
    #: The probability of such a difference, or a larger one, if nothing has changed
    p: float
    #: The same as one-sided standard deviations of a normal distribution; 0 where p > 0.5
    sigma: float

    @property
    def drifted(self) -> bool:
        """True if the difference is more than chance."""
        return self.p < LEVEL


#: The test of nothing.
_NOT_TESTED = DriftTest(combinations=0, chi_square=0.0, freedom=np.inf, p=1.0, sigma=0.0)


def covariance_under(covariance: Array, change: Array, free: Mask) -> Array:
    """Return the covariance of estimates under other priors, (C^-1 + Q - P)^-1.

    Args:
        covariance: C under the priors of the fit, shape (n, n).
        change: Precision of the other priors less that of the fit's, Q - P, shape (n,).
        free: False for parameters that are held, whose rows and columns are zero, shape (n,).

    Returns:
        shape (n, n).
    """
    block = np.ix_(free, free)
    scale = np.sqrt(np.diag(covariance)[free])
    scale = np.where(scale > 0.0, scale, 1.0)
    scaled = covariance[block] / np.outer(scale, scale)
    M = np.linalg.pinv(scaled, rcond=1e-14, hermitian=True)
    M += np.diag(change[free] * scale**2)
    # Scaled again, so that parameters that had been held tightly do not drown the others.
    size = 1.0 / np.sqrt(np.maximum(np.diag(M), 1e-12))
    inverse = np.linalg.pinv(M * np.outer(size, size), rcond=1e-13, hermitian=True)
    result = np.zeros_like(covariance)
    result[block] = inverse * np.outer(size * scale, size * scale)
    return result


def joint_covariance(a: Estimate, b: Estimate, *, alike: bool) -> Array:
    """Return the covariance of two estimates (x_a, x_b) of one robot about the truth.

    Args:
        a: The first estimate, of p_a parameters.
        b: The second, of p_b.
        alike: Whether both are of the same parameters under priors of the same mean. If not, they are taken to err
            independently: too much, not too little.

    Returns:
        shape (p_a + p_b, p_a + p_b).
    """
    if not alike:
        return np.asarray(block_diag(a.covariance, b.covariance))
    pull = np.vstack([a.pull, b.pull])
    prior = np.maximum(a.prior, b.prior)
    return np.asarray(block_diag(a.noise, b.noise) + (pull * prior) @ pull.T)


def drift_test(
    difference: Array,
    effects: tuple[Array, Array],
    estimates: tuple[Estimate, Estimate],
    joint: Array,
    floor: float,
) -> DriftTest:
    """Test a difference of two results' predictions.

    Args:
        difference: Predictions of b less those of a, shape (r,), in any coordinates.
        effects: Derivatives of the predictions of a and of b by their own parameters, shapes (r, p_a) and (r, p_b).
        estimates: The estimates a and b, under common priors.
        joint: Covariance of both about the truth, shape (p_a + p_b, p_a + p_b), see `joint_covariance`.
        floor: Rounding of each coordinate, standard deviation, in the unit of the difference.

    Returns:
        The test; of no combinations, with p = 1, if there is no difference or the data know nothing.
    """
    if not len(difference):
        return _NOT_TESTED
    effect_a, effect_b = effects
    a, b = estimates
    rounding = floor**2 * np.eye(len(difference))

    # Combinations of coordinates that the data know better than the prior, as columns, (r, k).
    by_data_a = effect_a @ a.covariance @ effect_a.T
    by_data_b = effect_b @ b.covariance @ effect_b.T
    by_prior_a = (effect_a * a.prior) @ effect_a.T
    by_prior_b = (effect_b * b.prior) @ effect_b.T
    by_data = by_data_a + by_data_b + rounding
    share, vectors = eigh(by_data, by_data + (by_prior_a + by_prior_b) / 2.0)
    kept = vectors[:, share < _KNOWN]
    k = kept.shape[1]
    if k == 0:
        return _NOT_TESTED

    # W, (k, r), with W V W^T = 1, makes them independent, of variance 1.
    signed = np.hstack([-effect_a, effect_b])
    covariance = signed @ joint @ signed.T + rounding
    values, axes = eigh(kept.T @ covariance @ kept)
    root = np.sqrt(np.maximum(values, 1e-12 * values[-1]))
    W = np.asarray(((kept @ axes) / root).T)

    # Welch's degrees of freedom of the sum of the variances by both data.
    variance_a = float(np.trace(W @ by_data_a @ W.T))
    variance_b = float(np.trace(W @ by_data_b @ W.T))
    per_freedom_a = variance_a**2 / max(a.freedom, 1.0)
    per_freedom_b = variance_b**2 / max(b.freedom, 1.0)
    freedom = (variance_a + variance_b) ** 2 / (per_freedom_a + per_freedom_b)

    chi_square = float(np.sum((W @ difference) ** 2))
    p = max(float(fdtrc(k, freedom, chi_square / k)), _SMALLEST_P)
    sigma = max(-float(ndtri(p)), 0.0)
    return DriftTest(k, chi_square, freedom, p, sigma)
