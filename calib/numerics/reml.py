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

from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.numerics.likelihood import GaussianPriors, NormalEquations, diagonals

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

    #: (C,), lowest noise of each instrument, in units of the given sigma
    smallest_noise: tuple[float, ...]
    #: (K,), lowest and highest prior standard deviation of each family, in its parameters' unit
    prior_std: tuple[tuple[float, float], ...]
    #: Standard deviation of a normal prior on log noise about 0 (the given noise), which decides where rows are too few
    #: to separate noise from errors of the robot
    noise_spread: float = np.inf


def prior_std_by_reml(
    data: NormalEquations,
    families: Mask,
    start: tuple[Array, Array],
    priors: GaussianPriors,
    limits: VarianceLimits,
) -> tuple[Array, Array]:
    """Estimate noise and prior standard deviations of B fits, by damped Fisher scoring on their logarithms.

    Args:
        data: Normal equations of B linear fits with C instruments and p parameters, in units of the given sigma.
        families: shape (K, p), True for the parameters of each family; (0, p) to estimate the noise alone.
        start: noise of each instrument, shape (B, C), in units of the given sigma, and prior standard deviations,
            shape (B, K), in the unit of each family's parameters, to begin with.
        priors: Normal priors of the p parameters besides those of the families; they stay as they are.
        limits: Bounds of the result.

    Returns:
        The noise of each instrument, shape (B, C), in units of the given sigma, and the prior standard deviation of
        each family, shape (B, K), in its parameters' unit.
    """
    start_noise, _ = start
    bounds = _LogBounds.of(start_noise, limits)
    posterior = _LogPosterior.of(data, families, priors, limits.noise_spread)
    logs = _maximum(posterior, bounds, np.log(np.hstack(start)))
    instruments = start_noise.shape[1]
    values = np.exp(logs)
    return values[:, :instruments], values[:, instruments:]


def _maximum(posterior: _LogPosterior, bounds: _LogBounds, start: Array) -> Array:
    """Maximise a function of the logarithms of noise and prior standard deviations, by damped Fisher scoring.

    Args:
        posterior: The function of the logarithms that is maximised, of B fits.
        bounds: Bounds of the logarithms of the same fits.
        start: shape (B, C + K), log noise and log prior standard deviations to begin with.

    Returns:
        shape (B, C + K), the logarithms of each fit where it converged, or after the last step.
    """
    logs = bounds.clipped(start)
    last_step = np.zeros_like(logs)
    moving = np.arange(len(logs))  # the fits that have not converged
    for _ in range(_ITERATIONS):
        before = logs[moving]
        bounds_of_moving = bounds.of_fits(moving)
        step = _scoring_step(posterior.of_fits(moving), bounds_of_moving, before)
        # The expected information may be too small by half: then full steps overshoot, to and fro.
        step = np.where(step * last_step[moving] < 0.0, 0.5 * step, step)
        after = bounds_of_moving.clipped(before + step)
        last_step[moving] = step
        logs[moving] = after
        change = np.abs(after - before).max(axis=1)
        moving = moving[change >= _CONVERGED]
        if not len(moving):
            break
    return logs


@dataclass(frozen=True, slots=True, eq=False)
class _LogBounds:
    """Bounds of the logarithms of noise and prior standard deviations, of B fits."""

    #: (C + K,), shared by all fits
    lowest: Array
    #: (B, C + K)
    highest: Array

    @classmethod
    def of(cls, noise: Array, limits: VarianceLimits) -> _LogBounds:
        """Take the logarithms of limits.

        Args:
            noise: shape (B, C), noise from which each fit starts, in units of the given sigma.
            limits: Bounds of noise and prior standard deviations.
        """
        low = [low for low, _ in limits.prior_std]
        high = [high for _, high in limits.prior_std]
        lowest = np.log(np.array([*limits.smallest_noise, *low]))
        high_of_fits = np.tile(high, (len(noise), 1))
        return cls(lowest, np.log(np.hstack([_HIGHEST_NOISE * noise, high_of_fits])))

    def of_fits(self, which: Integers) -> _LogBounds:
        """Select the bounds of some of the B fits, by their numbers from 0."""
        return _LogBounds(self.lowest, self.highest[which])

    def clipped(self, logs: Array) -> Array:
        """Move logarithms, shape (B, C + K), to the bound that they are beyond."""
        return np.clip(logs, self.lowest, self.highest)

    def stop(self, logs: Array, score: Array) -> Mask:
        """Find logarithms at a bound whose score points beyond it.

        Args:
            logs: shape (B, C + K), logarithms of noise and prior standard deviations.
            score: shape (B, C + K), gradient of the log-likelihood by them.

        Returns:
            shape (B, C + K), True for logarithms that cannot rise, or fall, as the score wants them to.
        """
        stopped_low = (logs <= self.lowest) & (score < 0)
        stopped_high = (logs >= self.highest) & (score > 0)
        return np.asarray(stopped_low | stopped_high)


@dataclass(frozen=True, slots=True, eq=False)
class _LogPosterior:
    """Restricted log-likelihood of B fits, with a normal prior on the logarithm of their noise."""

    #: Normal equations of the B fits
    data: NormalEquations
    #: (K, p), 1 for the parameters of each family, else 0
    members: Array
    #: Priors besides those of the families; precision of shape (B, p)
    priors: GaussianPriors
    #: (C + K,), precision of the normal prior about 0 on each logarithm; 0 for prior standard deviations
    log_precision: Array

    @classmethod
    def of(
        cls,
        data: NormalEquations,
        families: Mask,
        priors: GaussianPriors,
        noise_spread: float,
    ) -> _LogPosterior:
        """Combine the data with the prior on the noise.

        Args:
            data: Normal equations of the B fits.
            families: shape (K, p), True for the parameters of each family.
            priors: Priors besides those of the families; precision of shape (B, p) or (p,).
            noise_spread: Standard deviation of the prior on log noise; infinite for no prior.
        """
        B, C, p = data.g.shape
        members = np.asarray(families, dtype=np.float64).reshape(-1, p)
        is_noise = np.arange(C + len(members)) < C
        log_precision = np.where(is_noise, 1.0 / noise_spread**2, 0.0)
        precision = np.broadcast_to(priors.precision, (B, p))
        return cls(data, members, GaussianPriors(precision, priors.centre), log_precision)

    def of_fits(self, which: Integers) -> _LogPosterior:
        """Select some of the B fits, by their numbers from 0."""
        priors = GaussianPriors(self.priors.precision[which], self.priors.centre)
        return replace(self, data=_some_fits(self.data, which), priors=priors)

    def score_and_information(self, logs: Array) -> tuple[Array, Array]:
        """Differentiate by the logarithms of noise and prior standard deviations.

        Args:
            logs: shape (B, C + K), log noise, in units of the given sigma, and log prior standard deviations.

        Returns:
            The gradient, shape (B, C + K), and the expected information (the mean of the negative second derivative),
            shape (B, C + K, C + K).
        """
        score, information = score_and_information(self.data, self.members, self.priors, logs)
        score -= self.log_precision * logs
        diagonals(information)[...] += self.log_precision
        return score, information


def _some_fits(data: NormalEquations, which: Integers) -> NormalEquations:
    """The normal equations of some of the B fits, by their numbers from 0."""
    return NormalEquations(
        H=data.H[which],
        g=data.g[which],
        yy=data.yy[which],
        count=data.count[which],
        known=data.known,
        held=data.held,
    )


def _scoring_step(posterior: _LogPosterior, bounds: _LogBounds, logs: Array) -> Array:
    """A damped Newton step of the logarithms, limited in length; those stopped by a bound stay there.

    Args:
        posterior: The function of the logarithms that is maximised, of B fits.
        bounds: Bounds of the logarithms of the same fits.
        logs: shape (B, C + K), log noise and log prior standard deviations before the step.

    Returns:
        shape (B, C + K), change of each logarithm.
    """
    score, information = posterior.score_and_information(logs)
    at_bound = bounds.stop(logs, score)
    score[at_bound] = 0.0
    pivots = diagonals(information)
    pivots += _DAMPING * pivots + _LEAST_DAMPING
    information[at_bound[:, :, None] | at_bound[:, None]] = 0.0
    pivots[at_bound] = 1.0
    newton_step = np.linalg.solve(information, score[:, :, None])[:, :, 0]
    step = np.clip(newton_step, -_STEP_DOWN, _STEP_UP)
    # A prior standard deviation that vanishes may be arbitrarily small: its steps do not raise the likelihood.
    rise = np.sum(step * score, axis=1)
    step[np.abs(rise) < _NO_RISE] = 0.0
    return np.asarray(step)


def score_and_information(
    data: NormalEquations,
    members: Array,
    priors: GaussianPriors,
    logs: Array,
) -> tuple[Array, Array]:
    """Differentiate the restricted log-likelihood of B fits by log noise and log prior standard deviation.

    Args:
        data: Normal equations of B linear fits with C instruments and p parameters, in units of the given sigma.
        members: shape (K, p), 1 for the parameters of each family, else 0.
        priors: Normal priors of the p parameters besides those of the families.
        logs: shape (B, C + K), log noise (in units of the given sigma) and log prior standard deviations.

    Returns:
        The gradient, shape (B, C + K), and the expected information (the mean of the negative second derivative),
        shape (B, C + K, C + K).
    """
    C = data.g.shape[1]
    noise, prior_std = np.split(np.exp(logs), [C], axis=1)
    family_precision = (1.0 / prior_std**2) @ members
    all_priors = GaussianPriors(priors.precision + family_precision, priors.centre)
    mean, covariance = data.posterior(noise, all_priors)
    HC = (data.H @ covariance[:, None]) / np.square(noise)[:, :, None, None]
    score = np.empty(logs.shape)
    information = np.empty((*logs.shape, logs.shape[1]))
    score[:, :C] = data.residual_square(mean) / np.square(noise) + _traces(HC) - data.count
    information[:, :C, :C] = _information_of_noise(HC, data.count)
    if len(members):
        score[:, C:] = _score_of_families(mean, covariance, prior_std, members)
        score[:, C:] += _score_of_held(data.held_variance(family_precision), members)
        mixed = _mixed_information(HC, covariance, members) / prior_std[:, None] ** 2
        information[:, :C, C:] = mixed
        information[:, C:, :C] = mixed.swapaxes(1, 2)
        information[:, C:, C:] = _information_of_families(covariance, family_precision, members)
    return score, information


def _traces(HC: Array) -> Array:
    """The traces tr(H_c C) / sigma_c^2, shape (B, C), of matrices of shape (B, C, p, p)."""
    return np.asarray(np.trace(HC, axis1=2, axis2=3))


def _information_of_noise(HC: Array, count: Array) -> Array:
    """Expected information of log noise, shape (B, C, C).

    It is 2 tr(H_c C H_d C) / (sigma_c sigma_d)^2, and 2 (N_c - 2 tr(H_c C) / sigma_c^2) more on the diagonal.

    Args:
        HC: shape (B, C, p, p), H_c C / sigma_c^2 of each instrument.
        count: shape (B, C), number N_c of scalars of each instrument, by weight.
    """
    B, C, p, _ = HC.shape
    flat = HC.reshape(B, C, p * p)
    flat_transposed = HC.swapaxes(2, 3).reshape(B, C, p * p)
    result = 2.0 * (flat @ flat_transposed.swapaxes(1, 2))
    diagonals(result)[...] += 2.0 * (count - 2.0 * _traces(HC))
    return np.asarray(result)


def _score_of_families(mean: Array, covariance: Array, prior_std: Array, members: Array) -> Array:
    """Gradient by log prior standard deviation, sum_k (m_k^2 + C_kk) / tau_f^2 - n_f, shape (B, K).

    Args:
        mean: shape (B, p), posterior mean m of the parameters.
        covariance: shape (B, p, p), posterior covariance C of the parameters.
        prior_std: shape (B, K), tau_f of each family.
        members: shape (K, p), 1 for the parameters of each family, else 0.
    """
    squares = (mean**2 + diagonals(covariance)) @ members.T
    return np.asarray(squares / prior_std**2 - members.sum(axis=1))


def _mixed_information(HC: Array, covariance: Array, members: Array) -> Array:
    """Expected information of log noise with log prior standard deviation, times tau_f^2, shape (B, C, K).

    It is twice the sum of (C H_c C)_kk / sigma_c^2 over the parameters k of the family.

    Args:
        HC: shape (B, C, p, p), H_c C / sigma_c^2 of each instrument.
        covariance: shape (B, p, p), posterior covariance C of the parameters.
        members: shape (K, p), 1 for the parameters of each family, else 0.
    """
    diagonal = (covariance[:, None] * HC.swapaxes(2, 3)).sum(axis=3)
    return np.asarray(2.0 * (diagonal @ members.T))


def _score_of_held(variance: Array, members: Array) -> Array:
    """Gradient by log prior standard deviation of the density that is divided out for a held combination, (B, K).

    Args:
        variance: shape (B, p), see `NormalEquations.held_variance`.
        members: shape (K, p), 1 for the parameters of each family, else 0.
    """
    total = variance.sum(axis=1, keepdims=True)
    return np.asarray((variance @ members.T) / (1.0 + total))


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
