"""Expected error: against draws of calibrations and of estimated noise."""

from __future__ import annotations

import numpy as np
import pytest

from calib.verbs.measure.expectation import Expectation


def problem(size: int = 7, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """A covariance C and a mean square B, neither diagonal, with very different eigenvalues."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((size, size)) * np.geomspace(1e-5, 1e-3, size)[:, None]
    slope = rng.standard_normal((3, size)) * np.geomspace(1.0, 0.01, size)
    return root @ root.T, slope.T @ slope


def errors(C: np.ndarray, B: np.ndarray, count: int = 200_000) -> np.ndarray:
    x = np.random.default_rng(2).multivariate_normal(np.zeros(len(C)), C, count, method="cholesky")
    return np.sqrt(np.einsum("ni,ij,nj->n", x, B, x))


@pytest.mark.parametrize("seed", range(4))
def test_of_known_noise_it_is_that_of_drawn_calibrations(seed: int):
    C, B = problem(seed=seed)
    drawn = errors(C, B)
    expected = Expectation.of(C, B, np.inf)
    assert expected.error == pytest.approx(np.sqrt(np.mean(drawn**2)), rel=0.01)
    assert np.mean(drawn <= expected.high) == pytest.approx(0.95, abs=0.01)
    assert np.mean(drawn <= expected.low) == pytest.approx(0.05, abs=0.01)


@pytest.mark.parametrize("freedom", [1.0, 3.0, 10.0, 40.0])
def test_of_estimated_noise_the_limit_holds_as_often(freedom: float):
    """The noise is 1, estimated as s; the limit is made of s alone, and shall hold over errors and estimates."""
    C, B = problem()
    drawn = errors(C, B)
    s = np.sqrt(np.random.default_rng(3).chisquare(freedom, len(drawn)) / freedom)
    unit = Expectation.of(C, B, freedom)
    # All scales with the estimated noise: `Expectation.of(s^2 C, B, nu)` is s times the one of C.
    scaled = Expectation.of(2.0**2 * C, B, freedom)
    assert scaled.high == pytest.approx(2.0 * unit.high, rel=1e-9)
    assert np.mean(drawn <= s * unit.high) == pytest.approx(0.95, abs=0.01)
    assert np.mean(drawn <= s * unit.low) == pytest.approx(0.05, abs=0.01)


def test_the_less_is_known_of_the_noise_the_wider_it_is():
    C, B = problem()
    limits = [Expectation.of(C, B, nu) for nu in (1.0, 2.0, 5.0, 20.0, 100.0, np.inf)]
    highs = [limit.high for limit in limits]
    assert highs == sorted(highs, reverse=True)
    assert all(limit.low < limit.error < limit.high for limit in limits)
    assert len({limit.error for limit in limits}) == 1
    assert Expectation.of(C, B, 0.0).high == limits[0].high


def test_more_information_is_never_worse():
    C, B = problem()
    information = np.linalg.inv(C)
    before = Expectation.of(C, B, 10.0)
    rng = np.random.default_rng(7)
    for _ in range(5):
        A = 1e3 * rng.standard_normal((3, len(C)))
        information = information + A.T @ A
        after = Expectation.of(np.linalg.inv(information), B, 10.0)
        assert after.error < before.error
        assert after.low <= before.low
        assert after.high <= before.high
        before = after


def test_positions_that_nothing_moves_have_no_error():
    C, _ = problem()
    expected = Expectation.of(C, np.zeros_like(C), 5.0)
    assert (expected.error, expected.low, expected.high) == (0.0, 0.0, 0.0)


def test_one_parameter_is_the_quantile_of_a_normal():
    expected = Expectation.of(np.array([[4e-10]]), np.array([[1.0]]), np.inf)
    assert expected.error == pytest.approx(2e-5)
    assert expected.high == pytest.approx(1.959964 * 2e-5, rel=0.02)
    assert expected.low == pytest.approx(0.0627068 * 2e-5, rel=0.1)
