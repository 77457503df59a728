"""Scores and weights against their definitions and their distribution."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, f as f_distribution

from calib.numerics.scores import Limits, deleted_norms, median_noise, point_scores


def linear_rows(rng, n=25, p=12, noise=0.3, d=3):
    A = rng.normal(size=(n, d, p))
    x = rng.normal(size=p)
    return A, A @ x + noise * rng.normal(size=(n, d)), noise


def scores(residual, jacobian, covariance, weights, used):
    ones = np.ones((1, *residual.T.shape))
    norms = deleted_norms(
        residual.T[None], jacobian.transpose(2, 1, 0), covariance[None], weights[None], ones
    )
    return point_scores(norms[0], np.sum(used, axis=1))


def every(A):
    return np.ones(A.shape[:2], dtype=bool)


def fit_rows(A, y, weights):
    root = np.sqrt(weights)[:, None]
    flat = (A * root[:, :, None]).reshape(-1, A.shape[2])
    x = np.linalg.lstsq(flat, (y * root).ravel())[0]
    return x, np.linalg.inv(flat.T @ flat)


@pytest.mark.parametrize(
    ("rows", "size"),
    [(25, 1.0), (6, 1.0), (25, 300.0)],
    ids=["many rows", "few rows", "a row of great leverage"],
)
@pytest.mark.parametrize("weight", [1.0, 0.4, 1e-3, 0.0])
def test_the_score_is_the_deleted_residual_over_its_covariance(weight, rows, size):
    """Against the fit that really leaves the row out, whichever way its leverage is taken."""
    A, y, noise = linear_rows(np.random.default_rng(0), n=rows)
    A[4], y[4] = size * A[4], size * y[4]
    weights = np.ones(len(A))
    weights[4] = weight
    x, inverse = fit_rows(A, y, weights)
    found = scores((y - A @ x) / noise, A / noise, inverse * noise**2, weights, every(A))
    for row in (4, rows - 1):
        left = np.arange(len(A)) != row
        x_left, inverse_left = fit_rows(A[left], y[left], weights[left])
        deleted = y[row] - A[row] @ x_left
        covariance = noise**2 * (np.eye(3) + A[row] @ inverse_left @ A[row].T)
        expected = np.sqrt(deleted @ np.linalg.solve(covariance, deleted))
        assert found[row] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("d", [1, 2, 6])
@pytest.mark.parametrize("n", [60, 120])
def test_rows_of_any_number_of_scalars_are_told_as_points(d, n):
    """The same share of good rows lies beyond any score, whatever the rows hold."""
    rng = np.random.default_rng(3)
    found = []
    for _ in range(100):
        A, y, noise = linear_rows(rng, n=n, p=8, d=d)
        x, inverse = fit_rows(A, y, np.ones(n))
        found.append(
            scores((y - A @ x) / noise, A / noise, inverse * noise**2, np.ones(n), every(A))
        )
    flat = np.concatenate(found)
    for probability in (0.5, 0.9, 0.99):
        assert np.mean(flat**2 < chi2.ppf(probability, 3)) == pytest.approx(probability, abs=0.015)


@pytest.mark.parametrize("d", [1, 3, 6])
def test_median_noise_does_not_see_outliers(d):
    rng = np.random.default_rng(2)
    clean = np.linalg.norm(rng.normal(size=(20000, d)), axis=1)
    used = np.ones((20000, d), dtype=bool)
    kept = np.ones((1, 20000), dtype=bool)
    assert median_noise(2.5 * clean[None], used, kept)[0] == pytest.approx(2.5, rel=0.02)
    spoilt = 2.5 * clean
    spoilt[:2000] = 1e6
    assert median_noise(spoilt[None], used, kept)[0] < 3.2


def test_limits_are_quantiles_of_f_and_keep_the_false_alarm_for_the_whole_table():
    limits = Limits.of(30, 60.0)
    assert f_distribution.sf(limits.flagged**2 / 3, 3, 60) == pytest.approx(0.01 / 30)
    assert f_distribution.sf(limits.full**2 / 3, 3, 60) == pytest.approx(0.01)
    assert Limits.of(1000, 60.0).flagged > limits.flagged
    assert Limits.of(30, 3.0).flagged > limits.flagged


def test_weights_fall_from_one_to_zero_between_the_limits():
    limits = Limits.of(30, 60.0)
    grid = np.linspace(0, 2 * limits.flagged, 400)
    weights = limits.weights(grid)
    assert np.all(weights[grid <= limits.full] == 1.0)
    assert np.all(weights[grid >= limits.flagged] == 0.0)
    assert np.all(np.diff(weights) <= 0.0)


def test_weights_fall_in_a_straight_line_between_the_limits():
    limits = Limits(np.array(2.0), np.array(4.0))
    scores = np.array([0.0, 1.9, 2.0, 2.2, 2.5, 3.0, 3.5, 3.9, 4.0, 40.0])
    expected = [1.0, 1.0, 1.0, 0.9, 0.75, 0.5, 0.25, 0.05, 0.0, 0.0]
    np.testing.assert_allclose(limits.weights(scores), expected, atol=1e-12)
    # Of two tables at once, each by its own.
    both = Limits(np.array([[2.0], [1.0]]), np.array([[4.0], [5.0]]))
    np.testing.assert_allclose(both.weights(np.array([[3.0], [2.0]])), [[0.5], [0.75]])


def test_a_row_that_nothing_else_checks_is_not_judged():
    """It alone determines a parameter, with a leverage of one, or of more by rounding, and so leaves no residual."""
    jacobian = np.array([[[1.0, 0.0, 0.0]], [[0.0, 1.0, 1.0]]])
    for rounding in (0.0, 1e-13, -1e-13):
        covariance = np.diag([1.0 + rounding, 0.5])[None]
        residual, ones = np.array([[[0.0, 0.3, -0.3]]]), np.ones((1, 1, 3))
        found = deleted_norms(residual, jacobian, covariance, np.ones((1, 3)), ones)
        # The others are 0.6 apart, and twice their variance is that of the difference.
        np.testing.assert_allclose(
            found, [[0.0, 0.6 / np.sqrt(2.0), 0.6 / np.sqrt(2.0)]], atol=1e-9
        )


def test_the_median_noise_is_of_the_rows_that_a_fit_has_and_that_measure_something():
    """The median of a normal number's size is 0.6745; of an even number of rows the middle two are averaged."""
    norms = np.array([[5.0, 1.0, 2.0, 4.0, 9.0], [5.0, 1.0, 2.0, 4.0, 9.0]])
    used = np.array([[True], [True], [True], [True], [False]])
    kept = np.array([[True, True, True, True, True], [True, False, True, True, True]])
    found = median_noise(norms, used, kept)
    np.testing.assert_allclose(found, np.array([3.0, 4.0]) / 0.67448975, rtol=1e-7)


def test_scores_of_points_stay_and_those_of_rows_without_scalars_are_zero():
    norms, scalars = np.array([3.0, 9.0, 7.0]), np.array([3, 1, 0])
    found = point_scores(norms, scalars)
    assert chi2.logsf(found[1] ** 2, 3) == pytest.approx(chi2.logsf(9.0**2, 1))
    np.testing.assert_array_equal(found[[0, 2]], [3.0, 0.0])


def test_scores_grow_as_norms_do_where_no_tail_is_left():
    found = point_scores(np.array([100.0, 110.0]), np.array([1, 1]))
    assert found[1] - found[0] == pytest.approx(10.0)
    assert found[0] == pytest.approx(100.0, abs=1.0)


def test_fewer_than_ten_rows_and_no_freedom_have_the_limits_of_ten_rows_and_one():
    assert Limits.of(3, 60.0).flagged == Limits.of(10, 60.0).flagged < Limits.of(11, 60.0).flagged
    assert Limits.of(30, 0.2).flagged == Limits.of(30, 1.0).flagged > Limits.of(30, 1.9).flagged
