"""Monte Carlo beside the linear law, with all sources stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.record import Record
from calib.uncertainty.monte_carlo import monte_carlo

#: Each of them alone, far larger than all others but of joints, which are as large.
ALONE = {
    "resolution": {"resolution": np.radians(0.02)},
    "lost motion": {"lost_motion": np.radians(0.02)},
    "drift": {"drift": 1e-3},
    "repeatability": {"repeatability": 1e-3},
    "temperature": {"temperature": (10.0, 60.0), "arm_expansion": 1e-4},
}


@pytest.fixture(scope="module")
def found(tracked, points):
    """Of the result as it is, at few poses."""
    calls = []
    samples = tracked.samples(points[:4])
    result = monte_carlo(tracked, samples, tolerance=0.02, progress=lambda *of: calls.append(of))
    return result, calls


def test_the_linear_law_agrees(found):
    result, _ = found
    assert result.ratio == pytest.approx(1.0, abs=0.04)
    assert result.linear.orientation == pytest.approx(result.orientation, rel=0.08)
    assert 0.0 < result.standard_error < 0.02


def test_progress_is_told(found):
    result, calls = found
    assert [done for done, _ in calls] == list(range(1, len(calls) + 1))
    assert result.trials == 1000 * len(calls)


def test_a_seed_gives_the_same_trials(tracked, points):
    samples = tracked.samples(points[:2])
    one, same, other = (
        monte_carlo(tracked, samples, seed=seed, tolerance=1.0).position for seed in (3, 3, 4)
    )
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


@pytest.mark.parametrize("name", list(ALONE))
def test_each_statement_is_drawn_by_its_distribution(with_statements, points, name):
    """Even distributions have shorter tails than the linear law's normal ones: of one number, 0.9545 of its limit."""
    result = with_statements(Record(), **ALONE[name])
    found = monte_carlo(result, result.samples(points[:3]), tolerance=0.02)
    if name == "temperature":
        grown = (
            25.0
            * 1e-4
            * np.linalg.norm(result.predict(points[:3]) - result.T_frame_base[:3, 3], axis=1)
        )
        assert found.position == pytest.approx(0.9545 * grown, rel=0.03)
        assert found.ratio == pytest.approx(2.0 / np.sqrt(3.0) / 0.9545, rel=0.03)
    elif name == "lost motion":  # a few even distributions, of the joints with the longest arms
        assert 1.0 < found.ratio < 1.1
    else:
        assert found.ratio == pytest.approx(1.0, abs=0.04)


def without_uncertainty(result):
    """The result, as if its parameters were exact."""
    model = replace(
        result.geometry,
        covariance=np.zeros(result.covariance.shape),
        scale=None,
        scatter=None,
        undetermined_families=None,
    )
    return replace(result, geometry=model)


def test_trials_are_drawn_until_u_is_known_as_asked_and_in_few_blocks_at_least(tracked, points):
    loose, close = (
        monte_carlo(tracked, tracked.samples(points[:1]), tolerance=tolerance)
        for tolerance in (1.0, 0.01)
    )
    assert loose.trials == 5000
    assert close.standard_error <= 0.01


def test_without_uncertainty_nothing_is_drawn(tracked, points):
    exact = without_uncertainty(tracked)
    found = monte_carlo(exact, exact.samples(points[:2]), tolerance=1.0)
    assert found.position == pytest.approx(0.0, abs=1e-12)


def test_errors_of_joints_are_as_long_in_the_base_as_in_a_frame(with_statements, points):
    result = without_uncertainty(with_statements(Record(), **ALONE["resolution"]))
    samples = result.samples(points[:2])
    in_frame, in_base = (
        monte_carlo(result, samples, in_base=in_base, tolerance=0.05) for in_base in (False, True)
    )
    assert in_base.position == pytest.approx(in_frame.position, rel=1e-9)
    assert in_base.orientation == pytest.approx(in_frame.orientation, rel=1e-9)
    assert in_base.position == pytest.approx(in_base.linear.position, rel=0.1)
