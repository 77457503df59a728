"""The drift test on linear problems whose truth is known: covariance, and rate of false alarms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from calib.numerics.drift import (
    LEVEL,
    DriftTest,
    Estimate,
    covariance_under,
    drift_test,
    joint_covariance,
)

TAU = np.array([1.0, 1.0, 0.5, 0.5, 2.0])
FLOOR = 1e-9


def design(seed: int, count: int = 12) -> np.ndarray:
    """A Jacobian whose last column next to nothing is known of, in units of the noise."""
    A = np.random.default_rng(seed).normal(size=(count, 5)) * 2.0
    A[:, 4] *= 1e-4
    return A


def posterior(A: np.ndarray) -> Estimate:
    """What `x` of N(0, TAU^2) is known to by y = A x + noise of unit variance, with its coordinates the parameters."""
    P = np.diag(1.0 / TAU**2)
    C = np.linalg.inv(A.T @ A + P)
    return Estimate(C, C - C @ P @ C, C @ P, TAU**2, 1e6, np.zeros(5))


def means(A: np.ndarray, x: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Posterior means of many truths, shape (count, 5)."""
    y = x @ A.T + rng.normal(size=(len(x), len(A)))
    return y @ A @ posterior(A).covariance


@pytest.fixture(scope="module")
def many() -> tuple[Estimate, Estimate, np.ndarray, np.ndarray, np.ndarray]:
    """Two designs, and the estimates of 4000 unchanged robots by each, with the robots."""
    rng = np.random.default_rng(5)
    A, B = design(1), design(2)
    x = rng.normal(size=(4000, 5)) * TAU
    return posterior(A), posterior(B), means(A, x, rng), means(B, x, rng), x


def judged(a: Estimate, b: Estimate, difference: np.ndarray) -> list[DriftTest]:
    joint, one = joint_covariance(a, b, alike=True), np.eye(5)
    return [drift_test(d, (one, one), (a, b), joint, FLOOR) for d in difference]


def test_false_alarms_come_at_the_rate_told(many):
    a, b, of_a, of_b, _ = many
    found = judged(a, b, (of_b - of_a)[:1500])
    assert {one.combinations for one in found} == {4}  # the last one is not known
    assert stats.kstest([one.p for one in found], "uniform").pvalue > 1e-3
    assert np.mean([one.drifted for one in found]) == pytest.approx(LEVEL, abs=0.009)


def test_the_covariance_about_a_common_truth(many):
    a, b, of_a, of_b, x = many
    joint = joint_covariance(a, b, alike=True)
    size = np.sqrt(np.outer(joint.diagonal(), joint.diagonal()))
    found = np.cov(np.hstack([of_a - x, of_b - x]).T)
    np.testing.assert_allclose(found / size, joint / size, atol=0.08)
    both = np.hstack([-np.eye(5), np.eye(5)])
    V = both @ joint @ both.T
    np.testing.assert_allclose(np.cov((of_b - of_a).T), V, atol=0.05 * np.sqrt(V.diagonal().max()))
    assert V[4, 4] < 1e-3 < 0.1 * a.covariance[4, 4]  # both say what the prior says


def test_few_degrees_of_freedom_ask_for_more():
    a, b = posterior(design(1)), posterior(design(2))
    few = [replace(e, freedom=8.0) for e in (a, b)]
    difference = np.array([1.5, -0.5, 0.2, 0.1, 0.0])
    sure, unsure = judged(a, b, difference[None])[0], judged(*few, difference[None])[0]
    assert unsure.chi_square == pytest.approx(sure.chi_square)
    assert 8.0 < unsure.freedom <= 16.0
    assert unsure.p > 3.0 * sure.p


def test_nothing_known_in_common():
    a = posterior(1e-3 * design(1))
    (found,) = judged(a, a, np.ones((1, 5)))
    assert (found.combinations, found.p, found.drifted) == (0, 1.0, False)


def test_estimates_that_are_not_alike_err_independently():
    a, b = posterior(design(1)), posterior(design(2))
    joint = joint_covariance(a, b, alike=False)
    np.testing.assert_array_equal(joint[:5, :5], a.covariance)
    np.testing.assert_array_equal(joint[5:, 5:], b.covariance)
    assert not np.any(joint[:5, 5:])


def test_the_covariance_under_other_priors_is_that_of_the_normal_equations():
    A = design(1)
    precision, other = np.array([1.0, 2.0, 0.0, 4.0, 1.0]), np.array([3.0, 0.5, 1.0, 4.0, 2.0])
    C = np.linalg.inv(A.T @ A + np.diag(precision))
    free = np.ones(5, dtype=bool)
    expected = np.linalg.inv(A.T @ A + np.diag(other))
    np.testing.assert_allclose(
        covariance_under(C, other - precision, free), expected, rtol=1e-9, atol=1e-15
    )


def test_parameters_that_are_held_have_no_covariance():
    A = design(1)[:, :4]
    C = np.zeros((5, 5))
    C[:4, :4] = np.linalg.inv(A.T @ A + np.eye(4))
    free = np.array([True, True, True, True, False])
    found = covariance_under(C, np.full(5, 2.0), free)
    np.testing.assert_allclose(found[:4, :4], np.linalg.inv(A.T @ A + 3.0 * np.eye(4)), rtol=1e-9)
    assert not np.any(found[4])
    assert not np.any(found[:, 4])


def test_nothing_is_tested_where_nothing_differs_in_any_direction():
    a = posterior(design(1))
    empty = np.zeros((0, 5))
    found = drift_test(
        np.zeros(0), (empty, empty), (a, a), joint_covariance(a, a, alike=True), FLOOR
    )
    assert (found.combinations, found.p, found.drifted) == (0, 1.0, False)
