"""What residuals say of the noise, and which points are gross."""

import numpy as np
import pytest

from calib.base_frame.scatter import FLOOR_M, Fit, Scatter, all_but_gross


def line_problem(x: np.ndarray, y: np.ndarray):
    """A straight line y = a + b x as the fits state their problems."""
    J = -np.column_stack([np.ones_like(x), x])[:, None, :]

    def problem(used: np.ndarray):
        a, b = np.linalg.lstsq(-J[used, 0], y[used], rcond=None)[0]
        return Fit((y - a - b * x)[:, None], J, None)

    return problem


def test_a_given_noise_holds_unless_the_residuals_are_larger():
    assert Scatter(1.1e-5, 30, 1e-5).sigma == 1e-5
    assert Scatter(0.5e-5, 30, 1e-5).sigma == 1e-5
    larger = Scatter(2e-5, 30, 1e-5)
    assert (larger.contradicted, larger.sigma, larger.dof) == (True, 2e-5, 30.0)
    assert Scatter(0.0, 30, None).sigma == FLOOR_M


def test_at_most_a_tenth_is_gross_and_noise_is_not():
    rng = np.random.default_rng(0)
    x = np.linspace(0.0, 1.0, 40)
    y = 1.0 + x + 0.01 * rng.normal(size=40)
    assert all_but_gross(line_problem(x, y), np.ones(40)).all()
    y[[3, 30]] += [1.0, -2.0]
    used = all_but_gross(line_problem(x, y), np.ones(40))
    assert np.flatnonzero(~used).tolist() == [3, 30]
    y[::3] += 5.0 * rng.normal(size=14)
    assert (~all_but_gross(line_problem(x, y), np.ones(40))).sum() <= 4


@pytest.mark.slow
def test_the_level_is_that_of_the_whole_set():
    rng = np.random.default_rng(1)
    x = np.linspace(0.0, 1.0, 15)
    found = sum(
        not all_but_gross(line_problem(x, rng.normal(size=15)), np.ones(15)).all()
        for _ in range(3000)
    )
    assert found <= 10  # 3 expected


def test_a_point_that_alone_holds_the_fit_is_not_judged():
    x = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    y = np.array([0.01, -0.01, 0.02, -0.02, 0.0, 50.0])
    assert all_but_gross(line_problem(x, y), np.ones(6)).all()
