"""Restricted likelihood: against brute force over the measurements' own covariance, and against known sizes."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from calib.estimate.linear import Linear
from calib.numerics.likelihood import NormalEquations, GaussianPriors
from calib.numerics.reml import _score, prior_std_by_reml

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
    x, used = np.zeros(p), instruments >= 0
    held = np.zeros(p) if held is None else held
    linear = Linear(x, columns, used, instruments, (0.0,) * count, C, z, held)
    return linear.data(weights[None], np.zeros((count, 2)))


def linearised(A, y, count=1, weights=None, known=None, held=None):
    weights = np.ones(len(A)) if weights is None else weights
    return normal_of(A, y, weights, instruments_of(A, count), known, held)


def several(found):
    """Problems one after the other as one of several."""
    names = ("H", "g", "yy", "count")
    parts = (np.concatenate([getattr(one, name) for one in found]) for name in names)
    return NormalEquations(*parts, found[0].known, found[0].held)


def reml(data, noise, prior_std=(0.01, 0.01), smallest=1e-6, families=FAMILIES, **further):
    """The sizes found from one start, shape (B, C) and (B, K)."""
    B, C = data.count.shape
    start = np.tile(noise, (B, 1)), np.tile(np.array(prior_std, dtype=float), (B, 1))
    bounds = further.pop("bounds", ((1e-7, 0.1),) * len(families))
    return prior_std_by_reml(
        data, families, *start, FLAT, smallest_noise=(smallest,) * C, bounds=bounds, **further
    )


def restricted_log_likelihood(noise, prior_std, A, y, held=None, C=None, z=None, centre=None):
    """From the covariance of y itself, a constant aside; held: precision of further priors, C x = z: constraints."""
    flat, target = A.reshape(-1, P), y.ravel()
    own = instruments_of(A, len(noise)).ravel()
    V = np.diag(np.array(noise)[own] ** 2)
    free = np.arange(P) >= 12
    if held is not None and np.any(held):
        k = np.flatnonzero(held)
        flat, target = np.vstack([flat, np.eye(P)[k]]), np.concatenate([target, centre[k]])
        V = np.block(
            [[V, np.zeros((len(V), len(k)))], [np.zeros((len(k), len(V))), np.diag(1 / held[k])]]
        )
    if C is not None:
        flat, target = np.vstack([flat, C]), np.concatenate([target, z])
        V = np.block(
            [[V, np.zeros((len(V), len(C)))], [np.zeros((len(C), len(V))), np.eye(len(C))]]
        )
    for members, size in zip(FAMILIES, prior_std, strict=True):
        V = V + size**2 * flat[:, members] @ flat[:, members].T
    F = flat[:, free]
    Vi = np.linalg.inv(V)
    information = F.T @ Vi @ F
    projected = Vi - Vi @ F @ np.linalg.solve(information, F.T @ Vi)
    return -0.5 * (
        np.linalg.slogdet(V)[1] + np.linalg.slogdet(information)[1] + target @ projected @ target
    )


def at(data, known, noise, prior_std):
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


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("more", [False, True])
def test_log_likelihood_against_the_dense_restricted_likelihood(count, more):
    """Their differences between any two sizes agree: each is known but for a constant."""
    rng = np.random.default_rng(0)
    A, y = data_of(rng, 10, (0.05, 0.2), (0.3, 0.1))
    known, further, constraints = FLAT, {}, None
    if more:
        held, centre, C, z = further_knowledge(rng)
        known, constraints = GaussianPriors(held, centre), (C, z)
        further = {"held": held, "centre": centre, "C": C, "z": z}
    data = linearised(A, y, count, known=constraints)
    mine, dense = [], []
    for noise, prior_std in product(
        [(0.05,) * count, (0.02, 0.3)[:count], (1.0, 0.1)[:count]], [(0.3, 0.1), (0.01, 2.0)]
    ):
        mine.append(at(data, known, noise, prior_std))
        dense.append(restricted_log_likelihood(noise, prior_std, A, y, **further))
    np.testing.assert_allclose(np.diff(mine), np.diff(dense), rtol=1e-9)


def test_what_is_held_is_a_condition_and_no_observation():
    """The likelihood of y given h x = 0: that of y and h x, over that of h x alone, whose variance the sizes are."""
    rng = np.random.default_rng(1)
    A, y = data_of(rng, 10, 0.05, (0.3, 0.1))
    held = np.where(FAMILIES[0], rng.normal(size=P), 0.0) / 1e-3
    C, z = held[None], np.zeros(1)
    data = linearised(A, y, known=(C, z), held=held)
    mine, dense = [], []
    for noise, prior_std in product([(0.05,), (0.2,)], [(0.3, 0.1), (0.01, 2.0)]):
        of_held = 1.0 + np.sum(held**2) * prior_std[0] ** 2
        both = restricted_log_likelihood(noise, prior_std, A, y, C=C, z=z)
        mine.append(at(data, FLAT, noise, prior_std))
        dense.append(both + 0.5 * np.log(of_held))
    np.testing.assert_allclose(np.diff(mine), np.diff(dense), rtol=1e-8)


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("more", [False, True])
def test_score_and_information_against_the_likelihood(count, more):
    """The score against differences; the information against the mean of the score's square over data drawn anew."""
    rng = np.random.default_rng(2)
    A, y = data_of(rng, 10, (0.1, 0.2), (0.3, 0.1))
    known, constraints = FLAT, None
    if more:
        held, centre, C, z = further_knowledge(rng)
        known, constraints = GaussianPriors(held, centre), (C, z)
    row = constraints[0][1] if more else None
    data = linearised(A, y, count, known=constraints, held=row)
    logs = np.log(np.array([*(0.07, 0.3)[:count], 0.2, 0.15]))
    score, information = (f[0] for f in _score(data, MEMBERS, known, logs[None]))

    def value(v):
        prior_std = np.exp(v)
        return at(data, known, tuple(prior_std[:count]), tuple(prior_std[count:]))

    for k in range(count + 2):
        e = 1e-3 * np.eye(count + 2)[k]
        slope = (
            8 * (value(logs + e) - value(logs - e)) - (value(logs + 2 * e) - value(logs - 2 * e))
        ) / 12e-3
        assert score[k] == pytest.approx(slope, rel=1e-6, abs=1e-6)
    assert np.all(np.linalg.eigvalsh(information) > 0.0)
    np.testing.assert_allclose(information, information.T)


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2])
def test_the_information_is_the_covariance_of_the_score(count):
    rng = np.random.default_rng(3)
    A, _ = data_of(rng, 10, 0.1, (0.3, 0.1))
    noise = (0.1, 0.25)[:count]
    logs = np.log([*noise, 0.3, 0.1])
    drawn = []
    for _ in range(1500):
        x = np.concatenate([0.3 * rng.normal(size=6), 0.1 * rng.normal(size=6), [0.5, -2.0]])
        sigma = np.array(noise)[[0, 0, count - 1]]
        drawn.append(linearised(A, A @ x + sigma * rng.normal(size=(10, 3)), count))
    scores, information = _score(several(drawn), MEMBERS, FLAT, np.tile(logs, (1500, 1)))
    information = information[0]
    covariance = np.cov(scores.T)
    np.testing.assert_allclose(np.mean(scores, axis=0), 0.0, atol=0.3)
    size = np.sqrt(np.diag(information))
    np.testing.assert_allclose(
        covariance / np.outer(size, size), information / np.outer(size, size), atol=0.1
    )


@pytest.mark.parametrize("noise", [(0.02,), (0.02, 0.3)])
def test_sizes_and_the_noise_of_each_instrument_are_right_in_the_mean(noise):
    rng, tau = np.random.default_rng(7), (0.05, 0.02)
    count = len(noise)
    drawn = [linearised(*data_of(rng, 15, (*noise, *noise)[:2], tau), count) for _ in range(200)]
    found = np.hstack(reml(several(drawn), (0.1,) * count))
    np.testing.assert_allclose(np.sqrt(np.mean(found**2, axis=0)), [*noise, *tau], rtol=0.1)


def test_a_family_that_is_not_there_shrinks_to_nothing():
    rng = np.random.default_rng(8)
    drawn = [linearised(*data_of(rng, 40, 0.02, (0.05, 0.0))) for _ in range(50)]
    shares = reml(several(drawn), (0.1,))[1][:, 1]
    # Half of the time the likelihood is highest at zero; the rest stays far below the noise of one row.
    assert np.mean(shares < 1e-4) > 0.3
    assert np.max(shares) < 0.01


def test_posterior_is_the_ridge_solution_and_survives_a_singular_matrix():
    rng = np.random.default_rng(10)
    A, y = data_of(rng, 20, 0.1, (0.05, 0.05))
    precision = np.array([0.05, 0.02]) ** -2 @ FAMILIES
    noise = np.array([[0.1]])
    mean, covariance = (
        f[0] for f in linearised(A, y).posterior(noise, GaussianPriors(precision, np.zeros(P)))
    )
    flat = A.reshape(-1, P)
    M = flat.T @ flat / 0.01 + np.diag(precision)
    np.testing.assert_allclose(covariance, np.linalg.inv(M), rtol=1e-8, atol=1e-14)
    np.testing.assert_allclose(mean, np.linalg.solve(M, flat.T @ y.ravel() / 0.01), rtol=1e-8)
    doubled = A.copy()
    doubled[:, :, 1] = doubled[:, :, 0]
    mean, covariance = (f[0] for f in linearised(doubled, y).posterior(noise, FLAT))
    assert np.all(np.isfinite(mean))
    np.testing.assert_allclose(mean[0], mean[1])
    assert np.all(np.isfinite(covariance))
