"""Restricted likelihood and posterior against brute force over the measurements' own covariance."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from calib.numerics.likelihood import GaussianPriors, diagonals, pseudo_inverse
from tests.numerics.linear_models import (
    FAMILIES,
    FLAT,
    P,
    data_of,
    further_knowledge,
    instruments_of,
    linearised,
    log_likelihood_at,
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
        mine.append(log_likelihood_at(data, known, noise, prior_std))
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
        mine.append(log_likelihood_at(data, FLAT, noise, prior_std))
        dense.append(both + 0.5 * np.log(of_held))
    np.testing.assert_allclose(np.diff(mine), np.diff(dense), rtol=1e-8)


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


def test_the_determinant_of_the_scalars_own_covariance_takes_half_its_logarithm():
    data = linearised(*data_of(np.random.default_rng(2), 10, 0.1, (0.05, 0.05)))
    of_both = [
        log_likelihood_at(replace(data, log_det=log_det), FLAT, (0.1,), (0.05, 0.05))
        for log_det in (0.0, 3.0)
    ]
    assert of_both[1] - of_both[0] == pytest.approx(-1.5)


def test_a_direction_of_no_more_than_rounding_has_no_inverse():
    """Of two parameters that are one to rounding, as of a matrix that is singular, or regular, or empty."""
    for rounding in (0.0, 1e-15):
        M = np.array([[1.0, 1.0 - rounding], [1.0 - rounding, 1.0]])
        np.testing.assert_allclose(pseudo_inverse(M), np.full((2, 2), 0.25), rtol=1e-9)
    regular = np.array([[1.0, 0.6], [0.6, 1.0]])
    np.testing.assert_allclose(pseudo_inverse(regular), np.array([[1.0, -0.6], [-0.6, 1.0]]) / 0.64)
    assert pseudo_inverse(np.zeros((0, 0))).shape == (0, 0)


def test_without_some_rows_the_equations_are_those_of_the_others():
    rng = np.random.default_rng(5)
    A, y = data_of(rng, 12, (0.1, 0.2), (0.3, 0.1))
    of_all = linearised(A, y, 2)
    others = of_all.without(linearised(A[:4], y[:4], 2))
    expected = linearised(A[4:], y[4:], 2)
    for name in ("H", "g", "yy", "count"):
        np.testing.assert_allclose(getattr(others, name), getattr(expected, name), atol=1e-9)


@pytest.mark.parametrize("turn", [False, True])
def test_diagonals_are_those_of_the_matrices_themselves(turn):
    M = np.arange(18.0).reshape(2, 3, 3)
    seen = M.transpose(0, 2, 1) if turn else M
    diagonals(seen)[...] += 100.0
    np.testing.assert_array_equal(M[:, [0, 1, 2], [0, 1, 2]], [[100, 104, 108], [109, 113, 117]])
