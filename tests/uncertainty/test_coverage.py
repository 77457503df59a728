"""Lengths that error vectors stay below: exact in one, two and three equal directions, else against Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from calib.uncertainty.coverage import PROBABILITY, covered_length

#: The probability of two standard deviations along one direction, from tables.
K_2 = 0.954499736


def length(eigenvalues, freedom=np.inf):
    return float(covered_length(np.diag(eigenvalues)[None], np.array([freedom]))[0])


def test_it_is_the_probability_of_two_standard_deviations():
    assert pytest.approx(K_2, abs=1e-9) == PROBABILITY


@pytest.mark.parametrize("directions", [1, 2, 3])
def test_equal_directions_are_exact(directions):
    eigenvalues = [0.09] * directions + [0.0] * (3 - directions)
    expected = 0.3 * np.sqrt(stats.chi2.ppf(K_2, directions))
    assert length(eigenvalues) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("freedom", [3.0, 8.0, 40.0])
def test_one_direction_of_an_estimated_variance_is_students(freedom):
    expected = 0.3 * stats.t.ppf((1.0 + K_2) / 2.0, freedom)
    assert length([0.09, 0.0, 0.0], freedom) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("freedom", [5.0, 20.0])
def test_a_sphere_of_an_estimated_variance_is_fishers(freedom):
    expected = 0.3 * np.sqrt(3.0 * stats.f.ppf(K_2, 3, freedom))
    assert length([0.09] * 3, freedom) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("eigenvalues", [(4.0, 1.0, 0.25), (9.0, 0.1, 0.1), (1.0, 1.0, 0.01)])
@pytest.mark.parametrize("freedom", [10.0, np.inf])
def test_unequal_directions_agree_with_draws(eigenvalues, freedom):
    rng = np.random.default_rng(1)
    draws = np.sqrt(eigenvalues) * rng.standard_normal((150_000, 3))
    if np.isfinite(freedom):
        draws *= np.sqrt(freedom / rng.chisquare(freedom, len(draws)))[:, None]
    expected = np.quantile(np.linalg.norm(draws, axis=1), K_2)
    assert length(eigenvalues, freedom) == pytest.approx(expected, rel=0.02)


def test_the_axes_do_not_matter_and_nothing_is_nothing():
    turn = stats.special_ortho_group.rvs(3, random_state=1)
    turned = turn @ np.diag([4.0, 1.0, 0.25]) @ turn.T
    lengths = covered_length(np.stack([turned, np.zeros((3, 3))]), np.array([np.inf, 7.0]))
    assert lengths[0] == pytest.approx(length([4.0, 1.0, 0.25]))
    assert lengths[1] == 0.0
