"""Bootstrap rows and profile intervals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from calib.errors import CalibError
from calib.result.uncertainty import bootstrap_indices, profile

BLOCKS = np.array(["b", "a", "a", "c", "b", "d", "d", "d"])


def test_blocks_are_drawn_whole_and_as_many_as_there_are():
    counts = bootstrap_indices(BLOCKS, 500, 0)
    assert counts.shape == (500, 8)
    assert not counts.flags.writeable
    for label in "abcd":
        rows = counts[:, label == BLOCKS]
        np.testing.assert_array_equal(rows, rows[:, :1].repeat(rows.shape[1], axis=1))
    first = [int(np.flatnonzero(label == BLOCKS)[0]) for label in "abcd"]
    np.testing.assert_array_equal(counts[:, first].sum(axis=1), np.full(500, 4))
    # Each is drawn as often as the others: binomial with 4 draws of a probability of 1/4.
    np.testing.assert_allclose(counts[:, first].mean(axis=0), 1.0, atol=0.16)
    np.testing.assert_allclose(counts[:, first].var(axis=0), 0.75, rtol=0.25)


def test_the_seed_decides():
    a = bootstrap_indices(BLOCKS, 20, 3)
    np.testing.assert_array_equal(a, bootstrap_indices(BLOCKS, 20, 3))
    assert np.any(a != bootstrap_indices(BLOCKS, 20, 4))
    assert len({tuple(row) for row in a}) > 10


def test_every_set_up_stays_in_every_sample():
    blocks, strata = np.arange(12), np.repeat([0, 1, 2], [2, 4, 6])
    counts = bootstrap_indices(blocks, 200, 1, strata=strata)
    for s, size in enumerate((2, 4, 6)):
        np.testing.assert_array_equal(counts[:, strata == s].sum(axis=1), np.full(200, size))


def test_no_rows_no_samples_of_rows():
    assert bootstrap_indices(np.zeros(0, dtype=int), 3, 0).shape == (3, 0)


def test_the_bootstrap_gives_the_standard_error_of_a_clustered_mean():
    rng = np.random.default_rng(5)
    poses = np.repeat(np.arange(200), 4)
    y = rng.normal(size=200)[poses] + 0.1 * rng.normal(size=800)
    counts = bootstrap_indices(poses, 800, 6)
    means = counts @ y / counts.sum(axis=1)
    by_pose = y.reshape(200, 4).mean(axis=1)
    assert np.std(means) == pytest.approx(np.std(by_pose) / np.sqrt(200), rel=0.12)


@pytest.mark.parametrize("level", [0.5, 0.95, 0.999])
@pytest.mark.parametrize("guess", [0.2, 1.0, 7.0])
def test_a_parabola_gives_the_normal_interval_whatever_the_first_step(level, guess):
    found = profile(lambda x: 40.0 + ((x - 3.0) / 0.5) ** 2, 3.0, 0.5 * guess, level)
    reach = 0.5 * stats.norm.ppf(0.5 + level / 2)
    assert found.low == pytest.approx(3.0 - reach, rel=1e-3)
    assert found.high == pytest.approx(3.0 + reach, rel=1e-3)
    assert found.level == level


def test_estimated_noise_gives_students_interval():
    found = profile(lambda x: x**2, 0.0, 1.0, freedom=5.0)
    assert found.high == pytest.approx(stats.t.ppf(0.975, 5), rel=1e-3)
    assert found.low == pytest.approx(-found.high, rel=1e-3)


def test_a_skew_cost_has_a_skew_interval():
    """The rate of an exponential: -2 log L = 2 n (rate mean - log rate)."""
    n, mean = 8, 2.0

    def cost(rate: float) -> float:
        return 2 * n * (rate * mean - np.log(rate)) if rate > 0 else np.inf

    found = profile(cost, 1 / mean, 1 / mean / np.sqrt(n))
    limit = cost(1 / mean) + stats.chi2.ppf(0.95, 1)
    assert cost(found.low) == pytest.approx(limit, abs=1e-2)
    assert cost(found.high) == pytest.approx(limit, abs=1e-2)
    assert found.high - 0.5 > 1.3 * (0.5 - found.low)


@pytest.mark.parametrize("bad", [np.inf, np.nan])
def test_where_the_fit_fails_the_interval_ends(bad):
    found = profile(lambda x: x**2 if x < 1.0 else bad, 0.0, 1.0)
    assert found.high == pytest.approx(1.0, abs=1e-3)
    assert found.low == pytest.approx(-1.96, abs=1e-2)


def test_ends_where_the_cost_does_not_rise_are_open():
    found = profile(lambda x: x**2 if x < 0 else 1.0 - np.exp(-x), 0.0, 1.0)
    assert found.high == np.inf
    assert found.low == pytest.approx(-1.96, abs=1e-2)
    flat = profile(lambda _: 5.0, 0.0, 1.0)
    assert (flat.low, flat.high) == (-np.inf, np.inf)


def test_a_lower_cost_elsewhere_becomes_the_estimate():
    found = profile(lambda x: (x - 4.0) ** 2, 0.0, 1.0)
    # The new start is near the least cost, not at it: the interval is as much wider or narrower.
    assert found.low < 4.0 < found.high
    assert abs(found.low - (4.0 - 1.96)) < 0.6
    assert abs(found.high - (4.0 + 1.96)) < 0.6


def test_a_cost_that_falls_for_ever_is_refused():
    with pytest.raises(CalibError, match=r"lower elsewhere .* Fit until it converges"):
        profile(lambda x: -10.0 * x, 0.0, 1.0)


@pytest.mark.parametrize("level", [0.0, 1.0, 95.0])
def test_levels_lie_between_0_and_1(level):
    with pytest.raises(CalibError, match=f"level of an interval is {level:g}"):
        profile(abs, 0.0, 1.0, level)


@pytest.mark.parametrize(
    ("value", "std"), [(0.0, 0.0), (0.0, np.inf), (np.nan, 1.0), (0.0, np.nan)]
)
def test_a_parameter_without_a_standard_deviation_has_no_profile(value, std):
    with pytest.raises(CalibError, match="may not be identifiable"):
        profile(abs, value, std)


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say():
    """The rate of a decay fitted to 12 noisy points, noise known: 300 runs."""
    rng = np.random.default_rng(9)
    t, held = np.linspace(0, 3, 12), 0
    for _ in range(300):
        y = 2.0 * np.exp(-0.8 * t) + 0.2 * rng.normal(size=12)

        def cost(rate: float, y: np.ndarray = y) -> float:
            shape = np.exp(-rate * t)
            return float(np.sum((y - shape * (shape @ y) / (shape @ shape)) ** 2) / 0.04)

        grid = np.linspace(0.2, 2.0, 300)
        best = grid[np.argmin([cost(rate) for rate in grid])]
        found = profile(cost, float(best), 0.1)
        held += found.low < 0.8 < found.high
    assert stats.binomtest(held, 300, 0.95).pvalue > 0.01
