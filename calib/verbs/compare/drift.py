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

#: A combination takes part where the share of its variance that the data leave, C / (C + S), is below this.
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
    # Scaled anew, so that what had been held tightly does not drown the others.
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
        The test; of no combinations, with p = 1, where there is no difference or the data know nothing.
    """
    if not len(difference):
        return _NOT_TESTED
    by_data = _covariances_by_data(effects, estimates)
    by_prior = _covariance_by_prior(effects, estimates)
    rounding = floor**2 * np.eye(len(difference))
    kept = _known_combinations(by_data[0] + by_data[1] + rounding, by_prior)
    if kept.shape[1] == 0:
        return _NOT_TESTED
    covariance = _covariance_of_difference(effects, joint) + rounding
    whitening = _whitening(kept, covariance)
    a, b = estimates
    freedom = _welch_freedom(whitening, by_data, (a.freedom, b.freedom))
    return _f_test(whitening @ difference, freedom)


def _covariances_by_data(
    effects: tuple[Array, Array], estimates: tuple[Estimate, Estimate]
) -> tuple[Array, Array]:
    """Return the covariance of the predictions of each estimate, C of the parameters, shapes (r, r).

    Args:
        effects: Derivatives of r predictions by the parameters of a and of b, shapes (r, p_a) and (r, p_b).
        estimates: The estimates a and b.
    """
    effect_a, effect_b = effects
    a, b = estimates
    by_a = effect_a @ a.covariance @ effect_a.T
    by_b = effect_b @ b.covariance @ effect_b.T
    return by_a, by_b


def _covariance_by_prior(
    effects: tuple[Array, Array], estimates: tuple[Estimate, Estimate]
) -> Array:
    """Return the covariance of the predictions by the prior alone, the mean of both, shape (r, r).

    Args:
        effects: Derivatives of r predictions by the parameters of a and of b, shapes (r, p_a) and (r, p_b).
        estimates: The estimates a and b.
    """
    effect_a, effect_b = effects
    a, b = estimates
    by_a = (effect_a * a.prior) @ effect_a.T
    by_b = (effect_b * b.prior) @ effect_b.T
    return np.asarray((by_a + by_b) / 2.0)


def _covariance_of_difference(effects: tuple[Array, Array], joint: Array) -> Array:
    """Return the covariance of the predictions of b less those of a, shape (r, r).

    Args:
        effects: Derivatives of the predictions by the parameters of a and of b, shapes (r, p_a) and (r, p_b).
        joint: Covariance of both estimates, shape (p_a + p_b, p_a + p_b).
    """
    effect_a, effect_b = effects
    signed = np.hstack([-effect_a, effect_b])
    return np.asarray(signed @ joint @ signed.T)


def _f_test(whitened: Array, freedom: float) -> DriftTest:
    """Test that k independent numbers of mean zero have the variance 1, known with some degrees of freedom.

    Args:
        whitened: shape (k,), combinations of the difference in their standard deviations.
        freedom: Degrees of freedom of the noise from which these were estimated.
    """
    k = len(whitened)
    chi_square = float(np.sum(whitened**2))
    p = max(float(fdtrc(k, freedom, chi_square / k)), _SMALLEST_P)
    sigma = max(-float(ndtri(p)), 0.0)
    return DriftTest(k, chi_square, freedom, p, sigma)


def _known_combinations(posterior: Array, prior: Array) -> Array:
    """Return the combinations of coordinates that the data know better than the prior, as columns, shape (r, k).

    Args:
        posterior: Covariance by the data of both results, shape (r, r).
        prior: Covariance by the prior, shape (r, r).
    """
    share, vectors = eigh(posterior, posterior + prior)
    return np.asarray(vectors[:, share < _KNOWN])


def _whitening(kept: Array, covariance: Array) -> Array:
    """Return the matrix W, shape (k, r), with W V W^T = 1, by which kept combinations become independent.

    Args:
        kept: shape (r, k), combinations of coordinates, as columns.
        covariance: shape (r, r), V, of the coordinates.
    """
    values, axes = eigh(kept.T @ covariance @ kept)
    root = np.sqrt(np.maximum(values, 1e-12 * values[-1]))
    return np.asarray(((kept @ axes) / root).T)


def _welch_freedom(
    whitening: Array, by_data: tuple[Array, Array], freedoms: tuple[float, float]
) -> float:
    """Return Welch's degrees of freedom of the sum of two variances.

    Args:
        whitening: shape (k, r), turns r predictions into k independent ones of variance 1.
        by_data: Covariance of the predictions of each of two results by its data, shapes (r, r).
        freedoms: Degrees of freedom of each result's noise; at least one is assumed.
    """
    of_a, of_b = by_data
    a = float(np.trace(whitening @ of_a @ whitening.T))
    b = float(np.trace(whitening @ of_b @ whitening.T))
    freedom_a, freedom_b = (max(freedom, 1.0) for freedom in freedoms)
    return (a + b) ** 2 / (a**2 / freedom_a + b**2 / freedom_b)
