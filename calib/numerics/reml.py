"""Noise and prior standard deviations by restricted maximum likelihood (REML: H. D. Patterson, R. Thompson, 1971).

The noise sigma_c of each instrument c and the prior standard deviation tau_f of each family f of parameters, with
x_k ~ N(0, tau_f^2), maximise the restricted likelihood of `calib.numerics.likelihood`; parameters of the measurement
setup are flat. With the posterior covariance C and mean m, and H_c = A_c^T W A_c, its gradient is

    dL/dlog tau_f = sum_k (m_k^2 + C_kk) / tau_f^2 - n_f,
    dL/dlog sigma_c = |y - A m|_c^2 / sigma_c^2 + tr(H_c C) / sigma_c^2 - N_c

for families of n_f parameters and instruments of N_c scalars. The maximum is found by Fisher scoring: Newton steps with
the expected information in place of the second derivative. Letters of shapes: see `calib.numerics.likelihood`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.numerics.likelihood import GaussianPriors, NormalEquations, diagonals
from calib.units import Array, Integers, Mask

#: The most scoring steps.
_ITERATIONS = 30

#: By so much the logarithm of a standard deviation falls at most in one step.
_STEP_DOWN = 3.0

#: By so much it rises at most in one step: prior standard deviations that vanish are met from above.
_STEP_UP = 1.0

#: A step that raises the log-likelihood by less is not taken.
_NO_RISE = 1e-12

#: Logarithms that change by less have converged.
_CONVERGED = 1e-4

#: Damping of the information matrix, as a share of its diagonal.
_DAMPING = 1e-3

#: Damping of the information matrix where its diagonal is zero.
_LEAST_DAMPING = 1e-9

#: The noise rises to at most so many times the one it starts from.
_HIGHEST_NOISE = 1e6


@dataclass(frozen=True, slots=True)
class VarianceLimits:
    """Bounds of the standard deviations that are estimated, and the prior of the noise."""

    #: (C,), of each instrument, in units of the given sigma
    smallest_noise: tuple[float, ...]
    # (K,), lowest and highest of each family, in its parameters' unit
    prior_std: tuple[tuple[float, float], ...]
    #: Standard deviation of a normal prior on log noise about 0 (the given
    noise_spread: float = np.inf
    # noise), which decides where rows are too few to separate noise from errors of the robot


def prior_std_by_reml(
    data: NormalEquations,
    families: Mask,
    start: tuple[Array, Array],
    priors: GaussianPriors,
    limits: VarianceLimits,
) -> tuple[Array, Array]:
    """Estimate noise and prior standard deviations of B fits, by damped Fisher scoring on their logarithms.

    Args:
        data: Normal equations of the fits, in units of the given sigma.
        families: shape (K, p), which parameters belong to each family; (0, p) to estimate the noise alone.
        start: noise, shape (B, C), and prior standard deviations, shape (B, K), to begin with.
        priors: Priors besides those of the families, which stay as they are.
        limits: Bounds of the result.

    Returns:
        The noise of each instrument, shape (B, C), in units of the given sigma, and the prior standard deviation of
        each family, shape (B, K), in its parameters' unit.
    """
    C = start[0].shape[1]
    lowest, highest = _log_bounds(start[0], limits)
    logs = np.clip(np.log(np.hstack(start)), lowest, highest)
    members = np.asarray(families, dtype=np.float64).reshape(-1, data.g.shape[2])
    precision = np.broadcast_to(priors.precision, (len(logs), members.shape[1]))
    of_noise_prior = np.where(np.arange(logs.shape[1]) < C, 1.0 / limits.noise_spread**2, 0.0)
    last_step = np.zeros_like(logs)
    moving = np.arange(len(logs))  # the fits that have not converged
    for _ in range(_ITERATIONS):
        before = logs[moving]
        own_priors = GaussianPriors(precision[moving], priors.centre)
        score, information = score_and_information(
            _some_fits(data, moving), members, own_priors, before
        )
        score -= of_noise_prior * before
        diagonals(information)[...] += of_noise_prior
        at_low = (before <= lowest) & (score < 0)
        at_high = (before >= highest[moving]) & (score > 0)
        step = _scoring_step(score, information, at_low | at_high)
        # The expected information may be too small by half: then full steps overshoot, to and fro.
        step = np.where(step * last_step[moving] < 0.0, 0.5 * step, step)
        after = np.clip(before + step, lowest, highest[moving])
        last_step[moving] = step
        logs[moving] = after
        moving = moving[np.abs(after - before).max(axis=1) >= _CONVERGED]
        if not len(moving):
            break
    values = np.exp(logs)
    return values[:, :C], values[:, C:]


def _log_bounds(noise: Array, limits: VarianceLimits) -> tuple[Array, Array]:
    """Logarithms of the bounds: lowest, shape (C + K,), and highest, shape (B, C + K)."""
    low = [low for low, _ in limits.prior_std]
    high = np.tile([high for _, high in limits.prior_std], (len(noise), 1))
    lowest = np.log(np.array([*limits.smallest_noise, *low]))
    return lowest, np.log(np.hstack([_HIGHEST_NOISE * noise, high]))


def _some_fits(data: NormalEquations, which: Integers) -> NormalEquations:
    """The normal equations of some of the B fits, by their numbers."""
    return NormalEquations(
        H=data.H[which],
        g=data.g[which],
        yy=data.yy[which],
        count=data.count[which],
        known=data.known,
        held=data.held,
    )


def _scoring_step(score: Array, information: Array, at_bound: Mask) -> Array:
    """A damped Newton step of the logarithms, limited in length, shape (B, C + K); both arrays are overwritten.

    Args:
        score: shape (B, C + K), gradient of the log-likelihood.
        information: shape (B, C + K, C + K), its expected negative second derivative.
        at_bound: shape (B, C + K), logarithms at a bound whose score points beyond it: they stay there.
    """
    pivots = diagonals(information)
    pivots += _DAMPING * pivots + _LEAST_DAMPING
    score[at_bound] = 0.0
    information[at_bound[:, :, None] | at_bound[:, None]] = 0.0
    pivots[at_bound] = 1.0
    step = np.linalg.solve(information, score[:, :, None])[:, :, 0]
    step = np.clip(step, -_STEP_DOWN, _STEP_UP)
    # A prior standard deviation that vanishes may be arbitrarily small: its steps do not raise the likelihood.
    step[np.abs(np.sum(step * score, axis=1)) < _NO_RISE] = 0.0
    return np.asarray(step)


def score_and_information(
    data: NormalEquations, members: Array, priors: GaussianPriors, logs: Array
) -> tuple[Array, Array]:
    """Differentiate the restricted log-likelihood of B fits by log noise and log prior standard deviation.

    Args:
        data: Normal equations of the fits.
        members: shape (K, p), 1 for the parameters of each family, else 0.
        priors: Priors besides those of the families.
        logs: shape (B, C + K), log noise (in units of the given sigma) and log prior standard deviations.

    Returns:
        The gradient, shape (B, C + K), and the expected information (the mean of the negative second derivative),
        shape (B, C + K, C + K).
    """
    B, C, p = data.g.shape
    noise, prior_std = np.split(np.exp(logs), [C], axis=1)
    family_precision = (1.0 / prior_std**2) @ members
    precision = priors.precision + family_precision
    mean, covariance = data.posterior(noise, GaussianPriors(precision, priors.centre))
    HC = (data.H @ covariance[:, None]) / np.square(noise)[:, :, None, None]
    HC_T = HC.swapaxes(2, 3)
    trace = np.trace(HC, axis1=2, axis2=3)
    score = np.empty(logs.shape)
    information = np.empty((*logs.shape, logs.shape[1]))
    score[:, :C] = data.residual_square(mean) / np.square(noise) + trace - data.count
    products = HC.reshape(B, C, p * p) @ HC_T.reshape(B, C, p * p).swapaxes(1, 2)
    information[:, :C, :C] = 2.0 * products
    diagonals(information)[:, :C] += 2.0 * (data.count - 2.0 * trace)
    if len(members):
        square = (mean**2 + diagonals(covariance)) @ members.T
        score[:, C:] = square / prior_std**2 - members.sum(axis=1)
        score[:, C:] += _score_of_held(data.held_variance(family_precision), members)
        mixed = (covariance[:, None] * HC_T).sum(axis=3) @ members.T
        information[:, :C, C:] = 2.0 * mixed / prior_std[:, None] ** 2
        information[:, C:, :C] = information[:, :C, C:].swapaxes(1, 2)
        information[:, C:, C:] = _information_of_families(covariance, family_precision, members)
    return score, information


def _score_of_held(variance: Array, members: Array) -> Array:
    """Gradient by log prior standard deviation of the density that is divided out for a held combination, (B, K).

    Args:
        variance: shape (B, p), see `NormalEquations.held_variance`.
        members: shape (K, p), 1 for the parameters of each family, else 0.
    """
    return np.asarray((variance @ members.T) / (1.0 + variance.sum(axis=1, keepdims=True)))


def _information_of_families(covariance: Array, family_precision: Array, members: Array) -> Array:
    """Expected information of the log prior standard deviations, shape (B, K, K).

    Args:
        covariance: shape (B, p, p), of the parameters.
        family_precision: shape (B, p), 1 / tau^2; 0 for parameters of no family.
        members: shape (K, p), 1 for the parameters of each family, else 0.
    """
    root = np.sqrt(family_precision)
    # I - C / tau^2, by which the data reduce the prior variance, scaled to be symmetric.
    reduction = covariance * (-root[:, :, None] * root[:, None])
    diagonals(reduction)[...] += root > 0.0
    return np.asarray(2.0 * (members @ reduction**2 @ members.T))
