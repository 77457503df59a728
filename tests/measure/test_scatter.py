"""What residuals say of the noise, and which points are gross."""

import numpy as np
import pytest

from calib.measure.scatter import FLOOR_M, Scatter, keep_all_but_gross, weights_of


def line_problem(x: np.ndarray, y: np.ndarray):
    """A straight line y = a + b x as the fits state their problems."""
    J = -np.column_stack([np.ones_like(x), x])[:, None, :]

    def problem(used: np.ndarray):
        a, b = np.linalg.lstsq(-J[used, 0], y[used], rcond=None)[0]
        return (y - a - b * x)[:, None], J, np.ones(len(x)), None

    return problem


def test_a_given_noise_holds_unless_the_residuals_are_larger():
    assert Scatter(1.1e-5, 30, 1e-5).sigma == 1e-5
    assert Scatter(0.5e-5, 30, 1e-5).sigma == 1e-5
    larger = Scatter(2e-5, 30, 1e-5)
    assert (larger.contradicted, larger.sigma, larger.dof) == (True, 2e-5, 30.0)
    assert Scatter(0.0, 30, None).sigma == FLOOR_M


def test_weights_have_the_unit_of_the_mean_variance():
    assert weights_of(None, 3) == pytest.approx([1, 1, 1])
    sigma = np.array([1.0, 2.0, 3.0])
    assert weights_of(sigma, 3) == pytest.approx(np.mean(sigma**2) / sigma**2)


def test_at_most_a_tenth_is_gross_and_noise_is_not():
    rng = np.random.default_rng(0)
    x = np.linspace(0.0, 1.0, 40)
    y = 1.0 + x + 0.01 * rng.normal(size=40)
    assert keep_all_but_gross(line_problem(x, y), 40, robust=True).all()
    y[[3, 30]] += [1.0, -2.0]
    used = keep_all_but_gross(line_problem(x, y), 40, robust=True)
    assert np.flatnonzero(~used).tolist() == [3, 30]
    assert keep_all_but_gross(line_problem(x, y), 40, robust=False).all()
    y[::3] += 5.0 * rng.normal(size=14)
    assert (~keep_all_but_gross(line_problem(x, y), 40, robust=True)).sum() <= 4


def test_the_level_is_that_of_the_whole_set():
    rng = np.random.default_rng(1)
    x = np.linspace(0.0, 1.0, 15)
    found = sum(
        not keep_all_but_gross(line_problem(x, rng.normal(size=15)), 15, robust=True).all()
        for _ in range(3000)
    )
    assert found <= 10  # 3 expected


def test_a_point_that_alone_holds_the_fit_is_not_judged():
    x = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    y = np.array([0.01, -0.01, 0.02, -0.02, 0.0, 50.0])
    assert keep_all_but_gross(line_problem(x, y), 6, robust=True).all()
