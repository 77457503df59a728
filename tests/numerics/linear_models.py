"""LinearProblem models of scalars with known errors, for tests of likelihood and REML."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.basics.channels import Channels
from calib.fit.estimate.linear import LinearProblem
from calib.numerics.likelihood import GaussianPriors

P = 14


FAMILIES = np.arange(P) // 6 == np.arange(2)[:, None]  # the last two parameters are flat


MEMBERS = FAMILIES.astype(float)


FLAT = GaussianPriors(np.zeros(P), np.zeros(P))


def data_of(rng, n, noise, tau):
    """Rows of three scalars; `noise` one number, or one for each of two instruments: the third column and the rest."""
    A = rng.normal(size=(n, 3, P))
    x = np.concatenate(
        [tau[0] * rng.normal(size=6), tau[1] * rng.normal(size=6), rng.normal(size=2)]
    )
    sigma = np.broadcast_to(noise, 2)[[0, 0, 1]]
    return A, A @ x + sigma * rng.normal(size=(n, 3))


def instruments_of(A, count):
    result = np.zeros(A.shape[:2], dtype=int)
    result[:, 2] = count - 1
    return result


def normal_of(A, y, weights, instruments, known=None, held=None):
    """The normal equations, as the linearised problem at 0 makes them; held: a row of C that is a condition."""
    columns = np.concatenate([A, y[:, :, None]], axis=2).transpose(2, 1, 0).copy()
    p, count = A.shape[2], int(instruments.max()) + 1
    C, z = (np.zeros((0, p)), np.zeros(0)) if known is None else known
    x = np.zeros(p)
    channels = Channels(("m",) * count, (False,) * count, instruments)
    held = np.zeros(p) if held is None else held
    linear = LinearProblem(x, columns, channels, (0.0,) * count, C, z, held)
    return linear.normal_equations(weights[None], np.zeros((count, 2)))


def linearised(A, y, count=1, weights=None, known=None, held=None):
    weights = np.ones(len(A)) if weights is None else weights
    return normal_of(A, y, weights, instruments_of(A, count), known, held)


def log_likelihood_at(data, known, noise, prior_std):
    """The log likelihood as it is computed, at some sizes."""
    own = (1.0 / np.array([prior_std]) ** 2) @ FAMILIES
    known = replace(known, precision=known.precision + own)
    return data.log_likelihood(np.array([noise]), known, own)[0]


def further_knowledge(rng):
    """A prior of given size and mean on one of the flat parameters, and two constraints."""
    held, centre = np.zeros(P), np.zeros(P)
    held[13], centre[13] = 25.0, 0.7
    C, z = rng.normal(size=(2, P)), rng.normal(size=2)
    return held, centre, C, z
