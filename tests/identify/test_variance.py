"""Restricted likelihood: against brute force, and against known sizes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from calib.identify.variance import Linearised, Sizes, precision_of, sizes_by_reml

P = 14
FAMILIES = (np.arange(P) < 6, (np.arange(P) >= 6) & (np.arange(P) < 12))  # the last two are flat


def data_of(rng, n, noise, tau):
    A = rng.normal(size=(n, 3, P))
    x = np.concatenate(
        [tau[0] * rng.normal(size=6), tau[1] * rng.normal(size=6), rng.normal(size=2)]
    )
    return A, A @ x + noise * rng.normal(size=(n, 3))


def restricted_cost(logs, A, y):
    """Minus the restricted log likelihood, from the covariance of y itself."""
    flat, target = A.reshape(-1, P), y.ravel()
    noise, first, second = np.exp(logs)
    V = noise**2 * np.eye(len(target))
    for members, size in zip(FAMILIES, (first, second), strict=True):
        V += size**2 * flat[:, members] @ flat[:, members].T
    F = flat[:, 12:]
    Vi = np.linalg.inv(V)
    information = F.T @ Vi @ F
    projected = Vi - Vi @ F @ np.linalg.solve(information, F.T @ Vi)
    return 0.5 * (
        np.linalg.slogdet(V)[1] + np.linalg.slogdet(information)[1] + target @ projected @ target
    )


@pytest.mark.parametrize("seed", range(5))
def test_the_maximum_is_that_of_the_likelihood_written_out(seed):
    rng = np.random.default_rng(seed)
    A, y = data_of(rng, 12, 0.05, (0.02, 0.005))
    found = sizes_by_reml(
        Linearised.of(A, y, np.ones(12)), FAMILIES, Sizes(0.3, (0.01, 0.01)), smallest_noise=1e-6
    )
    brute = minimize(
        restricted_cost,
        np.log([0.05, 0.02, 0.005]),
        args=(A, y),
        method="L-BFGS-B",
        bounds=[(np.log(1e-4), 0), (np.log(1e-7), np.log(0.1)), (np.log(1e-7), np.log(0.1))],
    )
    mine = restricted_cost(np.log([found.noise, *found.families]), A, y)
    assert mine <= brute.fun + 1e-4
    assert found.noise == pytest.approx(np.exp(brute.x[0]), rel=0.02)


def test_sizes_are_right_in_the_mean():
    rng = np.random.default_rng(7)
    found = []
    for _ in range(200):
        A, y = data_of(rng, 15, 0.02, (0.05, 0.02))
        sizes = sizes_by_reml(
            Linearised.of(A, y, np.ones(15)),
            FAMILIES,
            Sizes(0.1, (0.01, 0.01)),
            smallest_noise=1e-6,
        )
        found.append([sizes.noise**2, *(size**2 for size in sizes.families)])
    mean = np.sqrt(np.mean(found, axis=0))
    np.testing.assert_allclose(mean, [0.02, 0.05, 0.02], rtol=0.08)


def test_a_family_that_is_not_there_shrinks_to_nothing():
    rng = np.random.default_rng(8)
    shares = []
    for _ in range(50):
        A, y = data_of(rng, 40, 0.02, (0.05, 0.0))
        sizes = sizes_by_reml(
            Linearised.of(A, y, np.ones(40)),
            FAMILIES,
            Sizes(0.1, (0.01, 0.01)),
            smallest_noise=1e-6,
        )
        shares.append(sizes.families[1])
    # Half of the time the likelihood is highest at zero; the rest stays far below the noise of one row.
    assert np.mean(np.array(shares) < 1e-4) > 0.3
    assert np.max(shares) < 0.01


def test_noise_alone_is_the_unbiased_estimate():
    rng = np.random.default_rng(9)
    A, y = data_of(rng, 30, 0.1, (0.05, 0.05))
    found = sizes_by_reml(Linearised.of(A, y, np.ones(30)), (), Sizes(1.0, ()), smallest_noise=1e-9)
    flat, target = A.reshape(-1, P), y.ravel()
    squares = np.linalg.lstsq(flat, target)[1][0]
    assert found.noise == pytest.approx(np.sqrt(squares / (90 - P)), rel=1e-3)


def test_posterior_is_the_ridge_solution_and_survives_a_singular_matrix():
    rng = np.random.default_rng(10)
    A, y = data_of(rng, 20, 0.1, (0.05, 0.05))
    precision = precision_of(FAMILIES, (0.05, 0.02), P)
    mean, covariance = Linearised.of(A, y, np.ones(20)).posterior(0.1, precision)
    flat = A.reshape(-1, P)
    M = flat.T @ flat / 0.01 + np.diag(precision)
    np.testing.assert_allclose(covariance, np.linalg.inv(M), rtol=1e-8, atol=1e-14)
    np.testing.assert_allclose(mean, np.linalg.solve(M, flat.T @ y.ravel() / 0.01), rtol=1e-8)
    doubled = A.copy()
    doubled[:, :, 1] = doubled[:, :, 0]
    mean, covariance = Linearised.of(doubled, y, np.ones(20)).posterior(0.1, np.zeros(P))
    assert np.all(np.isfinite(mean))
    np.testing.assert_allclose(mean[0], mean[1])
    assert np.all(np.isfinite(covariance))


def test_a_row_of_weight_zero_counts_for_nothing():
    rng = np.random.default_rng(11)
    A, y = data_of(rng, 20, 0.1, (0.05, 0.05))
    weights = np.ones(20)
    weights[3] = 0.0
    y[3] = 1e6
    left = np.arange(20) != 3
    mine, other = Linearised.of(A, y, weights), Linearised.of(A[left], y[left], np.ones(19))
    np.testing.assert_allclose(mine.H, other.H)
    np.testing.assert_allclose(mine.g, other.g)
    assert mine.count == other.count == 57
