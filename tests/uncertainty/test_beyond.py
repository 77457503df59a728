"""What a variance exceeds a known one by, against draws of its posterior."""

from __future__ import annotations

import numpy as np
import pytest

from calib.uncertainty.beyond import variance_beyond


def drawn(observed, freedom, known):
    """u^2 and its freedom by many draws of the variance, of which those below the known part are thrown away."""
    chi_square = np.random.default_rng(2).chisquare(freedom, 300_000)
    left = freedom * observed / chi_square - known
    left = left[left >= 0.0]
    own = 4.0 + 2.0 * left.mean() ** 2 / left.var()
    return left.mean() * (own - 2.0) / own, own


@pytest.mark.parametrize(
    ("observed", "freedom", "known"),
    [(2.0, 20.0, 0.5), (1.0, 30.0, 1.0), (0.8, 30.0, 1.0), (3.0, 60.0, 1.0)],
)
def test_it_agrees_with_draws(observed, freedom, known):
    variance, own = variance_beyond(observed, freedom, known)
    expected, expected_own = drawn(observed, freedom, known)
    assert variance == pytest.approx(expected, rel=0.02)
    assert own == pytest.approx(expected_own, rel=0.08)


def test_without_another_cause_it_is_the_variance_itself():
    assert variance_beyond(4.0, 12.0, 0.0) == (4.0, 12.0)


def test_few_degrees_of_freedom_count_as_five():
    assert variance_beyond(4.0, 2.0, 0.0) == (4.0, 5.0)


def test_a_known_variance_is_subtracted():
    assert variance_beyond(4.0, np.inf, 1.0) == (3.0, np.inf)
    assert variance_beyond(1.0, np.inf, 4.0) == (0.0, np.inf)


def test_a_difference_that_vanishes_by_chance_leaves_something():
    """Nearly all of it goes where far less was observed than is known to be there."""
    equal, _ = variance_beyond(1.0, 50.0, 1.0)
    less, _ = variance_beyond(0.7, 50.0, 1.0)
    nothing, _ = variance_beyond(1e-3, 50.0, 1.0)
    assert 0.05 < equal < 0.3
    assert 0.0 < less < equal
    assert nothing < 0.05


def test_many_degrees_of_freedom_leave_the_difference():
    assert variance_beyond(4.0, 1e4, 1.0)[0] == pytest.approx(3.0, rel=1e-3)
    # So many that no spread is left but rounding.
    assert variance_beyond(4.0, 1e18, 1.0) == (3.0, 1e18)
