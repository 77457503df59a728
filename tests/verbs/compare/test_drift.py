"""The drift test on linear problems whose truth is known: covariance, and rate of false alarms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from calib.verbs.compare.drift import (
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


def test_neither_units_nor_a_tight_prior_drown_other_parameters():
    """Two parameters that are nearly one, units of 1e-8 to 1e4, and another prior of 1e-9 on the third."""
    A = design(1)
    A[:, 1] = A[:, 0] + 1e-2 * A[:, 1]
    units = np.array([1e-8, 1.0, 1e-4, 1e4, 1.0])
    C = np.linalg.inv(A.T @ A + np.eye(5))
    change = np.array([0.0, 1.0, 1e18, 0.5, 2.0])
    free = np.ones(5, dtype=bool)
    found = covariance_under(C * np.outer(units, units), change / units**2, free)
    found /= np.outer(units, units)
    rest = [0, 1, 3, 4]
    others = np.linalg.inv((A.T @ A + np.diag(1.0 + change))[np.ix_(rest, rest)])
    np.testing.assert_allclose(found[np.ix_(rest, rest)], others, rtol=1e-6, atol=1e-12)
    assert found[2, 2] == pytest.approx(1e-18)


def test_what_two_estimates_share_is_the_wider_of_their_priors():
    a = Estimate(np.eye(1), np.array([[0.5]]), np.array([[0.2]]), np.array([1.0]), 9.0, np.zeros(1))
    b = Estimate(np.eye(1), np.array([[0.7]]), np.array([[0.3]]), np.array([4.0]), 9.0, np.zeros(1))
    expected = [[0.5 + 4.0 * 0.2**2, 4.0 * 0.2 * 0.3], [4.0 * 0.2 * 0.3, 0.7 + 4.0 * 0.3**2]]
    np.testing.assert_allclose(joint_covariance(a, b, alike=True), expected)
    np.testing.assert_allclose(joint_covariance(b, a, alike=True), np.flip(expected))


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


def of_one(variance: float, prior: float, freedom: float) -> Estimate:
    """One parameter, as far as the test of a difference looks at it."""
    C = np.array([[variance]])
    return Estimate(C, C, C / prior, np.array([prior]), freedom, np.zeros(1))


def judged_alone(a: Estimate, b: Estimate, difference: float, covariance: float = 0.0) -> DriftTest:
    """Of one prediction, which the second robot's parameter moves twice as far, with a rounding of 3."""
    joint = np.array([[1.0, covariance], [covariance, 1.0]])
    effects = np.array([[1.0]]), np.array([[2.0]])
    return drift_test(np.array([difference]), effects, (a, b), joint, floor=3.0)


def test_one_prediction_by_hand():
    """Variance: 1 + 2^2 - 2 2 c and 3^2 of the rounding; freedom by Welch, of variances 1 and 8."""
    a, b = of_one(1.0, 100.0, 5.0), of_one(2.0, 100.0, 10.0)
    found = judged_alone(a, b, 12.0, covariance=0.5)
    assert found.combinations == 1
    assert found.chi_square == pytest.approx(12.0**2 / (1.0 + 4.0 - 2.0 + 9.0))
    assert found.freedom == pytest.approx(9.0**2 / (1.0 / 5.0 + 8.0**2 / 10.0))
    assert found.p == pytest.approx(stats.f.sf(found.chi_square, 1, found.freedom))
    assert found.sigma == pytest.approx(stats.norm.isf(found.p))
    # Without a full degree of freedom there is one.
    unsure = judged_alone(a, replace(b, freedom=0.2), 12.0, covariance=0.5)
    assert unsure.freedom == pytest.approx(9.0**2 / (1.0 / 5.0 + 8.0**2))


def test_a_difference_of_less_than_chance_is_none_in_standard_deviations():
    a, b = of_one(1.0, 100.0, 1e6), of_one(2.0, 100.0, 1e6)
    small, large = judged_alone(a, b, 0.1), judged_alone(a, b, 40.0)
    assert small.p > 0.5
    assert (small.sigma, small.drifted) == (0.0, False)
    assert large.sigma == pytest.approx(np.sqrt(40.0**2 / 14.0), rel=0.02)
    assert large.drifted
    assert judged_alone(a, b, 1e9).sigma == pytest.approx(stats.norm.isf(1e-300))


def test_one_unchanged_robot_in_a_hundred_is_said_to_have_drifted():
    assert DriftTest(1, 7.0, 100.0, p=0.0099, sigma=2.3).drifted
    assert not DriftTest(1, 6.0, 100.0, p=0.0101, sigma=2.3).drifted


@pytest.mark.parametrize(("prior", "combinations"), [(3.0, 0), (5.0, 1)])
def test_what_the_prior_knows_better_is_not_tested(prior, combinations):
    """The data's variance is 1 + 8 + 3^2 = 18, the prior's (prior + 2^2 8) / 2."""
    found = judged_alone(of_one(1.0, prior, 9.0), of_one(2.0, 8.0, 9.0), 1.0)
    assert found.combinations == combinations
