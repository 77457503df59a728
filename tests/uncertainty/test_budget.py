"""Budgets: lines that add up to the whole, and what would halve it."""

from __future__ import annotations

import numpy as np
import pytest

from calib.uncertainty.at_poses import Contribution, Distribution, PoseUncertainty, Source
from calib.uncertainty.budget import Budget, budget_poses


def uncertainty_of(**stds):
    """Uncertainty at one pose by sources along x, of known standard deviations [mm]."""
    parts = []
    for name, std in stds.items():
        C = np.zeros((1, 6, 6))
        C[0, 0, 0] = (1e-3 * std) ** 2
        parts.append(Contribution(Source[name.upper()], C, Distribution.NORMAL, np.inf))
    return PoseUncertainty(np.eye(4)[None], tuple(parts))


def test_the_lines_add_up_to_the_whole(tracked):
    for everywhere in (False, True):
        budget = tracked.budget(everywhere=everywhere)
        assert budget.poses == 200
        squares = sum(line.position_std**2 for line in budget.lines)
        assert np.sqrt(squares) == pytest.approx(budget.position_std, rel=1e-9)
        squares = sum(line.orientation_std**2 for line in budget.lines)
        assert np.sqrt(squares) == pytest.approx(budget.orientation_std, rel=1e-9)
        assert sum(line.share for line in budget.lines) == pytest.approx(1.0)
        assert [line.share for line in budget.lines] == sorted(
            (line.share for line in budget.lines), reverse=True
        )
        assert budget.dominant is budget.lines[0].source
        assert 1.6 < budget.factor < 2.5


def test_the_whole_is_that_of_the_poses(tracked, points):
    uncertainty = tracked.uncertainty(points)
    budget = tracked.budget(points)
    assert budget.position == pytest.approx(np.sqrt(np.mean(uncertainty.position**2)))
    assert budget.orientation == pytest.approx(np.sqrt(np.mean(uncertainty.orientation**2)))
    assert budget.poses == len(points)


def test_poses_are_those_of_the_measured_ranges_or_of_the_limits(tracked):
    low, high = tracked.rows.ranges.T
    inside = budget_poses(tracked)
    assert np.all((inside >= low) & (inside <= high))
    assert np.ptp(inside, axis=0) == pytest.approx(high - low, rel=0.05)
    assert np.ptp(budget_poses(tracked, everywhere=True), axis=0) == pytest.approx(
        2 * np.pi * np.array([2, 2, 1, 2, 2, 1]), rel=0.55
    )


def test_a_single_source_that_halves_the_whole_is_named():
    """3 and 1 mm: without the first, 1 of 3.2 mm is left."""
    budget = Budget.of(uncertainty_of(scale=3.0, model=1.0))
    assert budget.halving == (Source.SCALE,)
    assert budget.without[Source.SCALE] == pytest.approx(2e-3, rel=1e-6)
    assert budget.without[Source.MODEL] == pytest.approx(6e-3, rel=1e-6)
    assert np.isinf(budget.rows_factor)


def test_the_smallest_set_is_named_if_none_does_alone():
    budget = Budget.of(uncertainty_of(scale=2.0, model=1.9, drift=1.0, resolution=0.2))
    assert set(budget.halving) == {Source.SCALE, Source.MODEL}


def test_four_times_as_many_rows_halve_what_noise_alone_makes():
    budget = Budget.of(uncertainty_of(instrument=2.0, frame=1.0, target=1.0))
    assert budget.rows_factor == pytest.approx(4.0, rel=1e-2)


def test_more_rows_are_needed_beside_other_sources():
    """(4 + 0.25) / 4 is aimed at: 4 / n + 0.25 = 1.0625."""
    budget = Budget.of(uncertainty_of(instrument=2.0, model=0.5))
    assert budget.rows_factor == pytest.approx(4.0 / 0.8125, rel=1e-2)
    assert np.isinf(Budget.of(uncertainty_of(instrument=1.0, model=1.0)).rows_factor)


def test_nothing_that_is_taken_away_makes_it_worse(tracked):
    budget = tracked.budget()
    assert max(budget.without.values()) <= budget.position


def test_nothing_is_uncertain():
    budget = Budget.of(uncertainty_of())
    assert budget.lines == ()
    assert budget.dominant is None
    assert budget.position == 0.0
    assert np.isnan(budget.factor)
