"""Restricted likelihood: against brute force over the measurements' own covariance, and against known sizes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from calib.numerics.likelihood import GaussianPriors, NormalEquations
from calib.numerics.reml import VarianceLimits, prior_std_by_reml, score_and_information
from tests.numerics.linear_models import (
    FAMILIES,
    FLAT,
    MEMBERS,
    data_of,
    further_knowledge,
    linearised,
    log_likelihood_at,
)


def several(found):
    """Problems one after the other as one of several."""
    names = ("H", "g", "yy", "count")
    parts = (np.concatenate([getattr(one, name) for one in found]) for name in names)
    return NormalEquations(*parts, found[0].known, found[0].held)


def reml(data, noise, prior_std=(0.01, 0.01), smallest=1e-6, families=FAMILIES):
    """Noise (B, C) and prior standard deviations (B, K) that are estimated from one start."""
    B, C = data.count.shape
    start = np.tile(noise, (B, 1)), np.tile(np.array(prior_std, dtype=float), (B, 1))
    limits = VarianceLimits((smallest,) * C, ((1e-7, 0.1),) * len(families))
    return prior_std_by_reml(data, families, start, FLAT, limits)


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
    score, information = (f[0] for f in score_and_information(data, MEMBERS, known, logs[None]))

    def value(v):
        prior_std = np.exp(v)
        return log_likelihood_at(data, known, tuple(prior_std[:count]), tuple(prior_std[count:]))

    for k in range(count + 2):
        e = 1e-3 * np.eye(count + 2)[k]
        slope = (
            8 * (value(logs + e) - value(logs - e)) - (value(logs + 2 * e) - value(logs - 2 * e))
        ) / 12e-3
        assert score[k] == pytest.approx(slope, rel=1e-6, abs=1e-6)
    assert np.all(np.linalg.eigvalsh(information) > 0.0)
    np.testing.assert_allclose(information, information.T)


@pytest.mark.parametrize("count", [1, 2])
def test_information_is_half_the_trace_of_the_projected_derivatives(count):
    """By the covariance V of all scalars: 1/2 tr(P V_i P V_j), where P is V^-1 less what the flat parameters take."""
    A, y = data_of(np.random.default_rng(4), 8, 0.1, (0.3, 0.1))
    noise, prior_std = np.array([0.1, 0.25])[:count], np.array([0.3, 0.1])
    logs = np.log([*noise, *prior_std])
    data = linearised(A, y, count)
    _, information = score_and_information(data, MEMBERS, FLAT, logs[None])

    columns = A.reshape(-1, A.shape[2])
    instrument = np.tile([0, 0, count - 1], len(A))
    derivatives = [np.diag(2.0 * noise[c] ** 2 * (instrument == c)) for c in range(count)]
    for family, std in zip(FAMILIES, prior_std, strict=True):
        derivatives.append(2.0 * std**2 * columns[:, family] @ columns[:, family].T)
    W = np.linalg.inv(sum(derivatives) / 2.0)
    flat = columns[:, ~FAMILIES.any(axis=0)]
    P = W - W @ flat @ np.linalg.solve(flat.T @ W @ flat, flat.T @ W)
    expected = [[0.5 * np.trace(P @ Vi @ P @ Vj) for Vj in derivatives] for Vi in derivatives]
    np.testing.assert_allclose(information[0], expected, rtol=1e-8)


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
    scores, information = score_and_information(
        several(drawn), MEMBERS, FLAT, np.tile(logs, (1500, 1))
    )
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


@pytest.mark.parametrize("spread", [0.1, 1.0, np.inf])
def test_noise_has_a_normal_prior_on_its_logarithm(spread):
    """The estimates have the highest product of likelihood and prior, by a search of another kind."""
    A, y = data_of(np.random.default_rng(11), 6, 4.0, (2.0, 3.0))
    data = linearised(A, y)

    def loss(logs):
        noise, *prior_std = np.exp(logs)
        likelihood = log_likelihood_at(data, FLAT, (noise,), tuple(prior_std))
        return 0.5 * (logs[0] / spread) ** 2 - likelihood

    limits = VarianceLimits((1e-3,), ((1e-3, 1e3),) * 2, noise_spread=spread)
    noise, prior_std = prior_std_by_reml(
        data, FAMILIES, (np.ones((1, 1)), np.ones((1, 2))), FLAT, limits
    )
    options = {"xatol": 1e-6, "fatol": 1e-9, "maxiter": 5000}
    best = minimize(loss, np.zeros(3), method="Nelder-Mead", options=options).x
    found = np.log([noise[0, 0], *prior_std[0]])
    np.testing.assert_allclose(found, best, atol=2e-3)
    # The errors are four times the given noise; a narrow prior keeps it near that all the same.
    expected = 0.0 if spread == 0.1 else np.log(4.0)
    assert found[0] == pytest.approx(expected, abs=0.5)


def test_estimates_stay_at_bounds_beyond_which_the_likelihood_rises():
    data = linearised(*data_of(np.random.default_rng(12), 20, 0.02, (0.05, 0.02)))
    start = np.array([[0.1]]), np.array([[0.01, 0.01]])
    limits = VarianceLimits((0.1,), ((1e-7, 0.02), (1e-7, 0.1)))
    noise, prior_std = prior_std_by_reml(data, FAMILIES, start, FLAT, limits)
    assert noise[0, 0] == pytest.approx(0.1)
    assert prior_std[0, 0] == pytest.approx(0.02)
    logs = np.log(np.hstack([noise, prior_std]))
    score, _ = score_and_information(data, MEMBERS, FLAT, logs)
    assert score[0, 0] < 0.0 < score[0, 1]
    assert score[0, 2] == pytest.approx(0.0, abs=1e-6)


def test_a_likelihood_that_is_only_compared_is_nearly_the_highest():
    """By less than a hundredth; a family that is not there has vanished all the same."""
    rng = np.random.default_rng(7)
    for _ in range(10):
        A, y = data_of(rng, 20, (0.1, 0.2), (0.3, 0.0))
        data = linearised(A, y, 2)
        start = np.full((1, 2), 0.2), np.full((1, 2), 0.05)
        limits = VarianceLimits((1e-6, 1e-6), ((1e-7, 1.0),) * 2)
        settled = prior_std_by_reml(data, FAMILIES, start, FLAT, limits)
        nearly = prior_std_by_reml(data, FAMILIES, start, FLAT, limits, only_compared=True)
        highest, compared = (
            log_likelihood_at(data, FLAT, tuple(noise[0]), tuple(prior_std[0]))
            for noise, prior_std in (settled, nearly)
        )
        assert compared == pytest.approx(highest, abs=1e-2)
        if settled[1][0, 1] < 1e-4:
            assert nearly[1][0, 1] < 1e-4
