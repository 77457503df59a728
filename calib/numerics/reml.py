"""Noise and prior standard deviations by restricted maximum likelihood (REML: H. D. Patterson, R. Thompson, 1971).

The noise sigma_c of each channel c and the prior standard deviation tau_f of each family f of parameters, with
x_k ~ N(0, tau_f^2), maximise the restricted likelihood of `calib.numerics.likelihood`; parameters of the measurement
setup are flat. With the posterior covariance C and mean m, and H_c = A_c^T W A_c, its gradient is

    dL/dlog tau_f = sum_k (m_k^2 + C_kk) / tau_f^2 - n_f,
    dL/dlog sigma_c = |y - A m|_c^2 / sigma_c^2 + tr(H_c C) / sigma_c^2 - N_c

for families of n_f parameters and channels of N_c scalars. The maximum is found by Fisher scoring: Newton steps with
the expected information in place of the second derivative. Letters of shapes: see `calib.numerics.likelihood`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.numerics.likelihood import GaussianPriors, NormalEquations, diagonals

#: The most scoring steps.
_ITERATIONS = 30

#: The most by which the logarithm of a standard deviation falls in one step.
_STEP_DOWN = 3.0

#: The most by which it rises in one step: less, because vanishing prior standard deviations are approached from above.
_STEP_UP = 1.0

#: A step that promises to raise the log-likelihood by less is not taken.
_NO_RISE = 1e-12

#: Logarithms whose steps are shorter have converged.
_CONVERGED = 1e-4

#: The same if the likelihood is only compared with that of other models: a step this short no longer takes a standard
#: deviation that vanishes, whose steps are longer than half.
_NEARLY_CONVERGED = 0.1

#: And the step promises to raise the log-likelihood by less. Steps shrink like a geometric series, of a ratio up to
#: 0.9, so all that follow add no more than a few times that: next to nothing beside a unit.
_LITTLE_RISE = 1e-3

#: Damping of the information matrix, as a share of its diagonal.
_DAMPING = 1e-3

#: Damping of the information matrix if its diagonal is zero.
_LEAST_DAMPING = 1e-9

#: Highest noise, over the noise that the search starts from.
_HIGHEST_NOISE = 1e6


@dataclass(frozen=True, slots=True)
class VarianceLimits:
    """Bounds of the standard deviations that are estimated, and the prior of the noise."""

    #: (C,), lowest noise of each channel
    smallest_noise: tuple[float, ...]
    #: (K,), lowest and highest prior standard deviation of each family, in its parameters' unit
    prior_std: tuple[tuple[float, float], ...]
    #: Standard deviation of a normal prior on log noise about 0 (the given noise), which decides if rows are too few to
    #: separate noise from errors of the robot
    noise_spread: float = np.inf


def prior_std_by_reml(
    data: NormalEquations,
    families: Mask,
    start: tuple[Array, Array],
    priors: GaussianPriors,
    limits: VarianceLimits,
    *,
    only_compared: bool = False,
) -> tuple[Array, Array]:
    """Estimate noise and prior standard deviations of B fits, by damped Fisher scoring on their logarithms.

    Args:
        data: Normal equations of B linear fits.
        families: shape (K, p), True for the parameters of each family; (0, p) to estimate the noise alone.
        start: Noise of each channel, shape (B, C), and prior standard deviations, shape (B, K), in the unit of each
            family's parameters, to begin with.
        priors: Normal priors of the p parameters besides those of the families; they stay as they are.
        limits: Bounds of the result.
        only_compared: Whether the likelihood of the result is only compared with that of other models: it is then
            below the highest by no more than a few times `_LITTLE_RISE`.

    Returns:
        The noise of each channel, shape (B, C), and the prior standard deviation of each family, shape (B, K), in its
        parameters' unit.
    """
    B, C, p = data.g.shape
    members = np.asarray(families, dtype=np.float64).reshape(-1, p)
    precision = np.broadcast_to(priors.precision, (B, p))
    # Of the normal prior about 0 on each logarithm of noise.
    is_noise = np.arange(C + len(members)) < C
    log_precision = np.where(is_noise, 1.0 / limits.noise_spread**2, 0.0)
    low = [low for low, _ in limits.prior_std]
    high = np.tile([high for _, high in limits.prior_std], (B, 1))
    lowest = np.log(np.array([*limits.smallest_noise, *low]))
    highest = np.log(np.hstack([_HIGHEST_NOISE * start[0], high]))

    logs = np.clip(np.log(np.hstack(start)), lowest, highest)
    last_step = np.zeros_like(logs)
    moving = np.arange(B)  # the fits that have not converged
    still_moving = moving
    for _ in range(_ITERATIONS):
        before = logs[moving]
        priors_of_moving = GaussianPriors(precision[moving], priors.centre)
        score, information = score_and_information(data, members, priors_of_moving, before)
        score -= log_precision * before
        diagonals(information)[...] += log_precision
        stopped_low = (before <= lowest) & (score < 0)
        stopped_high = (before >= highest[moving]) & (score > 0)
        at_bound = stopped_low | stopped_high

        # A damped Newton step, limited; 0 for what is at its bound.
        pivots = diagonals(information)
        pivots += _DAMPING * pivots + _LEAST_DAMPING
        if at_bound.any():
            score[at_bound] = 0.0
            information[at_bound[:, :, None] | at_bound[:, None]] = 0.0
            pivots[at_bound] = 1.0
        newton_step = np.linalg.solve(information, score[:, :, None])[:, :, 0]
        step = np.minimum(np.maximum(newton_step, -_STEP_DOWN), _STEP_UP)
        # A prior standard deviation that vanishes may be arbitrarily small: its steps do not raise the likelihood.
        rise = np.sum(step * score, axis=1)
        step[np.abs(rise) < _NO_RISE] = 0.0
        # The expected information may be too small by half: then full steps overshoot, to and fro.
        step = np.where(step * last_step[moving] < 0.0, 0.5 * step, step)
        after = np.minimum(np.maximum(before + step, lowest), highest[moving])
        last_step[moving] = step
        logs[moving] = after
        change = np.abs(after - before).max(axis=1)
        converged = change < _CONVERGED
        if only_compared:
            converged |= (change < _NEARLY_CONVERGED) & (rise < _LITTLE_RISE)
        if np.all(converged):
            break
        if np.any(converged):
            still_moving = np.flatnonzero(~converged)
            moving, data = moving[still_moving], data.of_fits(still_moving)
    values = np.exp(logs)
    return values[:, :C], values[:, C:]


def score_and_information(
    data: NormalEquations,
    members: Array,
    priors: GaussianPriors,
    logs: Array,
) -> tuple[Array, Array]:
    """Differentiate the restricted log-likelihood of B fits by log noise and log prior standard deviation.

    Args:
        data: Normal equations of B linear fits.
        members: shape (K, p), 1 for the parameters of each family, 0 for others.
        priors: Normal priors of the p parameters besides those of the families.
        logs: shape (B, C + K), log noise and log prior standard deviations.

    Returns:
        The gradient, shape (B, C + K), and the expected information (the mean of the negative second derivative),
        shape (B, C + K, C + K).
    """
    C = data.g.shape[1]
    values = np.exp(logs)
    noise, prior_std = values[:, :C], values[:, C:]
    family_precision = (1.0 / prior_std**2) @ members
    all_priors = GaussianPriors(priors.precision + family_precision, priors.centre)
    mean, covariance = data.posterior(noise, all_priors)
    HC = data.H @ covariance[:, None]
    HC /= np.square(noise)[:, :, None, None]
    B, _, p, _ = HC.shape
    flat = HC.reshape(B, C, p * p)
    traces = np.trace(HC, axis1=2, axis2=3)  # tr(H_c C) / sigma_c^2
    score = np.empty(logs.shape)
    information = np.empty((*logs.shape, logs.shape[1]))
    score[:, :C] = data.residual_square(mean) / np.square(noise) + traces - data.count
    # Of log noise: 2 tr(H_c C H_d C) / (sigma_c sigma_d)^2, and 2 (N_c - 2 tr(H_c C) / sigma_c^2) more on the diagonal.
    flat_transposed = HC.swapaxes(2, 3).reshape(B, C, p * p)
    of_noise = 2.0 * (flat @ flat_transposed.swapaxes(1, 2))
    diagonals(of_noise)[...] += 2.0 * (data.count - 2.0 * traces)
    information[:, :C, :C] = of_noise
    if len(members):
        squares = (mean**2 + diagonals(covariance)) @ members.T
        score[:, C:] = squares / prior_std**2 - members.sum(axis=1)
        # The density that is divided out for a combination that is held.
        if data.held.any():
            held = data.held_variance(family_precision)
            score[:, C:] += (held @ members.T) / (1.0 + held.sum(axis=1, keepdims=True))

        # Of log noise with log prior standard deviation: 2 sum_k (C H_c C)_kk / (sigma_c tau_f)^2.
        diagonal = (covariance[:, None] * HC.swapaxes(2, 3)).sum(axis=3)
        mixed = 2.0 * (diagonal @ members.T) / prior_std[:, None] ** 2
        information[:, :C, C:] = mixed
        information[:, C:, :C] = mixed.swapaxes(1, 2)

        # I - C / tau^2, by which the data reduce the prior variance, scaled to be symmetric.
        root = np.sqrt(family_precision)
        reduction = -root[:, :, None] * root[:, None]
        reduction *= covariance
        diagonals(reduction)[...] += root > 0.0
        reduction *= reduction
        information[:, C:, C:] = 2.0 * (members @ reduction @ members.T)
    return score, information
