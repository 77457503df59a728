"""Variance components by restricted maximum likelihood."""

from __future__ import annotations

import numpy as np

from calib.numerics.likelihood import Normal, Priors, diagonal
from calib.units import Array, Mask

#: How far a size's logarithm may fall and rise in a step, how often; a rise in likelihood that is none.
_STEP_DOWN, _STEP_UP, _ITERATIONS, _NO_RISE = 3.0, 1.0, 30, 1e-12


def prior_std_by_reml(
    data: Normal,
    families: Mask,
    noise: Array,
    prior_std: Array,
    priors: Priors,
    *,
    smallest_noise: tuple[float, ...],
    bounds: tuple[tuple[float, float], ...],
    noise_spread: float = np.inf,
) -> tuple[Array, Array]:
    """Noise (B, C) and sizes (B, K) that maximise the likelihood, by damped Fisher scoring on their logarithms.

    families, (K, p), says which parameters belong to each; noise and sizes are where to begin. noise_spread is the
    standard deviation of a normal prior on log sigma, which decides where rows are too few to tell noise from error.
    """
    C = noise.shape[1]
    lowest = np.log(np.array([*smallest_noise, *(low for low, _ in bounds)]))
    highest = np.tile([high for _, high in bounds], (len(noise), 1))
    highest = np.log(np.hstack([1e6 * noise, highest]))
    logs = np.clip(np.log(np.hstack([noise, prior_std])), lowest, highest)
    members = np.asarray(families, dtype=np.float64).reshape(-1, data.g.shape[2])
    spread = np.where(np.arange(logs.shape[1]) < C, 1.0 / noise_spread**2, 0.0)
    last, going = np.zeros_like(logs), np.arange(len(logs))
    precision = np.broadcast_to(priors.precision, (len(logs), members.shape[1]))
    for _ in range(_ITERATIONS):
        at, high = logs[going], highest[going]
        H, g, yy, count = (values[going] for values in (data.H, data.g, data.yy, data.count))
        some = Normal(H, g, yy, count, data.known, data.held)
        score, information = _score(some, members, Priors(precision[going], priors.centre), at)
        score -= spread * at
        pivots = diagonal(information)
        pivots += spread
        pivots += 1e-3 * pivots + 1e-9
        # A family at its lower bound with a score that points below it stays there.
        held = ((at <= lowest) & (score < 0)) | ((at >= high) & (score > 0))
        score[held] = 0.0
        information[held[:, :, None] | held[:, None]] = 0.0
        pivots[held] = 1.0
        step = np.linalg.solve(information, score[:, :, None])[:, :, 0]
        step = np.clip(step, -_STEP_DOWN, _STEP_UP)
        # Where a size vanishes nothing tells how small it is: steps that raise the likelihood no more are not taken.
        step[np.abs(np.sum(step * score, axis=1)) < _NO_RISE] = 0.0
        # The expected information may be too small by half: then full steps overshoot, to and fro.
        last[going] = step = np.where(step * last[going] < 0.0, 0.5 * step, step)
        logs[going] = moved = np.clip(at + step, lowest, high)
        going = going[np.abs(moved - at).max(axis=1) >= 1e-4]
        if not len(going):
            break
    values = np.exp(logs)
    return values[:, :C], values[:, C:]


def _score(data: Normal, members: Array, priors: Priors, logs: Array) -> tuple[Array, Array]:
    """Gradient of the log likelihood in log sizes, and its expected information."""
    B, C, p = data.g.shape
    values = np.exp(logs)
    noise, prior_std = values[:, :C], values[:, C:]
    own = (1.0 / prior_std**2) @ members
    m, covariance = data.posterior(noise, Priors(priors.precision + own, priors.centre))
    HC = (data.H @ covariance[:, None]) / np.square(noise)[:, :, None, None]
    turned = HC.swapaxes(2, 3)
    trace = np.trace(HC, axis1=2, axis2=3)
    score, information = np.empty(logs.shape), np.empty((*logs.shape, logs.shape[1]))
    score[:, :C] = data.residual_square(m) / np.square(noise) + trace - data.count
    crossed = HC.reshape(B, C, p * p) @ turned.reshape(B, C, p * p).swapaxes(1, 2)
    information[:, :C, :C] = 2.0 * crossed
    diagonal(information)[:, :C] += 2.0 * (data.count - 2.0 * trace)
    if len(members):
        both = (covariance[:, None] * turned).sum(axis=3)
        square = (m**2 + diagonal(covariance)) @ members.T
        score[:, C:] = square / prior_std**2 - members.sum(axis=1)
        of_held = data.held_variance(own)
        score[:, C:] += (of_held @ members.T) / (1.0 + of_held.sum(axis=1, keepdims=True))
        information[:, :C, C:] = 2.0 * (both @ members.T) / prior_std[:, None] ** 2
        information[:, C:, :C] = information[:, :C, C:].swapaxes(1, 2)
        root = np.sqrt(own)  # 1 / tau, 0 for those of no family
        block = covariance * (-root[:, :, None] * root[:, None])
        diagonal(block)[...] += root > 0.0
        information[:, C:, C:] = 2.0 * (members @ block**2 @ members.T)
    return score, information
