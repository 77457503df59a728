"""The F test beyond the range of a fit's regressors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from calib.identify.significance import CUT, even_factors, explained, norms_of, range_of


def deficient(rng: np.random.Generator, rows: int, rank: int, columns: int) -> np.ndarray:
    """Regressors of lower rank than they have columns, in units of very different size."""
    A = rng.normal(size=(rows, rank)) @ rng.normal(size=(rank, columns))
    return A * 10.0 ** rng.uniform(-3, 3, columns)


def ridge_residual(A: np.ndarray, y: np.ndarray) -> np.ndarray:
    """What a fit with priors leaves over."""
    return y - A @ np.linalg.solve(A.T @ A + np.diag(np.sum(A**2, axis=0)), A.T @ y)


def test_against_the_textbook():
    """Two nested linear models of full rank, squares by numpy's least squares."""
    rng = np.random.default_rng(0)
    A, Z, y = rng.normal(size=(40, 5)), rng.normal(size=(40, 3)), rng.normal(size=40)
    small = np.linalg.lstsq(A, y, rcond=None)[1][0]
    large = np.linalg.lstsq(np.hstack([A, Z]), y, rcond=None)[1][0]
    F = (small - large) / 3 / (large / 32)
    test = explained(A, y, Z)
    np.testing.assert_allclose(test.F, F, rtol=1e-10)
    assert test.p == pytest.approx(stats.f.sf(F, 3, 32), rel=1e-9)
    assert test.share == pytest.approx(1 - large / small, rel=1e-10)
    assert (test.columns, test.freedom) == (3, 32)
    assert test.chance == pytest.approx(3 / 35)


def test_priors_and_lost_rank_do_not_matter():
    rng = np.random.default_rng(1)
    A, Z, y = deficient(rng, 60, 7, 12), rng.normal(size=(60, 4)), rng.normal(size=60)
    full = explained(A, y, Z)
    fitted = explained(A, ridge_residual(A, y), Z)
    assert full.freedom == 60 - 7 - 4
    np.testing.assert_allclose(fitted.F, full.F, rtol=1e-6)


def test_probabilities_are_uniform_under_noise():
    rng = np.random.default_rng(2)
    p = []
    for _ in range(600):
        A, Z = deficient(rng, 45, 20, 26), rng.normal(size=(45, 6))
        p.append(explained(A, ridge_residual(A, rng.normal(size=45)), Z).p)
    assert stats.kstest(p, "uniform").pvalue > 0.01


def test_what_the_fit_reaches_is_not_found_again():
    rng = np.random.default_rng(3)
    A = rng.normal(size=(50, 6))
    Z = np.column_stack([A @ rng.normal(size=6), rng.normal(size=50), np.zeros(50)])
    assert explained(A, rng.normal(size=50), Z).columns == 1
    nothing = explained(A, rng.normal(size=50), A[:, :2])
    assert (nothing.columns, nothing.p, nothing.F, nothing.share) == (0, 1.0, 0.0, 0.0)


@pytest.mark.parametrize("rows", [6, 8, 9])
def test_too_few_rows_are_not_judged(rows):
    rng = np.random.default_rng(4)
    A, Z = rng.normal(size=(rows, 6)), rng.normal(size=(rows, 3))
    assert explained(A, rng.normal(size=rows), Z).p == 1.0


def test_one_degree_of_freedom_is_enough_to_be_judged():
    rng = np.random.default_rng(4)
    test = explained(rng.normal(size=(10, 6)), rng.normal(size=10), rng.normal(size=(10, 3)))
    assert (test.columns, test.freedom) == (3, 1)
    assert 0.0 < test.p < 1.0


def test_rounding_is_no_pattern():
    rng = np.random.default_rng(5)
    A, Z = rng.normal(size=(50, 6)), rng.normal(size=(50, 3))
    r = A @ rng.normal(size=6)
    assert explained(A, r + 1e-14 * Z[:, 0], Z).p == 1.0
    assert explained(A, np.zeros(50), Z).p == 1.0


def test_an_exact_pattern_is_certain():
    rng = np.random.default_rng(6)
    A, Z = rng.normal(size=(50, 6)), rng.normal(size=(50, 3))
    test = explained(A, Z[:, 1], Z)
    assert test.p < 1e-100
    assert test.share == pytest.approx(1.0)
    assert str(test) == "100 % of it (chance: 7 %, p < 1e-6)"


def test_no_regressors_at_all():
    rng = np.random.default_rng(7)
    assert explained(np.zeros((20, 0)), rng.normal(size=20), np.zeros((20, 0))).columns == 0
    assert explained(np.zeros((20, 0)), rng.normal(size=20), np.ones((20, 1))).freedom == 19


def test_components_are_brought_to_one_size():
    rng = np.random.default_rng(8)
    A, component = rng.normal(size=(3000, 20)), np.tile(np.arange(3), 1000)
    sizes = np.array([1.0, 3.0, 0.2])
    y = sizes[component] * rng.normal(size=3000)
    factors = even_factors(A, ridge_residual(A, y), component)
    by_component = np.array([factors[component == c][0] for c in range(3)])
    np.testing.assert_allclose(by_component * sizes, (by_component * sizes).mean(), rtol=0.08)


def test_a_component_that_the_fit_takes_up_does_no_harm():
    rng = np.random.default_rng(9)
    component = np.tile(np.arange(2), 30)
    A = np.eye(60)[:, component == 1]
    factors = even_factors(A, rng.normal(size=60), component)
    assert np.all(np.isfinite(factors))
    assert np.all(factors > 0.0)
    np.testing.assert_array_equal(even_factors(A, np.zeros(60), component), np.ones(60))


def test_the_basis_is_of_the_range():
    rng = np.random.default_rng(10)
    A = deficient(rng, 30, 4, 9)
    base = range_of(A, norms_of(A), CUT)
    assert base.shape == (30, 4)
    np.testing.assert_allclose(base @ (base.T @ A), A, atol=1e-9 * np.abs(A).max())
