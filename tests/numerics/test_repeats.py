"""Scatter and correlation of repeats against the textbook, and without bias on drawn errors."""

from __future__ import annotations

import numpy as np
import pytest

from calib.numerics.repeats import pose_means, scatter_of_repeats
from tests.residuals import lengths_and_angles


def measured(rng, counts, *, shared=1.0, noise=1.0, columns=3):
    """Residuals of poses with so many repeats each, what they share and what they do not."""
    poses = np.repeat(np.arange(len(counts)), counts)
    b = shared * rng.normal(size=(len(counts), columns))
    return b[poses] + noise * rng.normal(size=(len(poses), columns)), poses


def everything(residual):
    return lengths_and_angles(np.ones(residual.shape)), np.ones(len(residual))


def test_the_textbook_s_anova_with_unequal_groups():
    """One component, by the formulas: MSW, MSB and n0 = (N - sum n^2 / N) / (k - 1)."""
    groups = [[1.0, 2.0, 3.0], [5.0, 7.0], [4.0], [0.0, 1.0, 1.0, 2.0]]
    y = np.concatenate(groups)[:, None]
    poses = np.repeat([3, 1, 7, 0], [len(g) for g in groups])
    used, weights = everything(y)
    grand = y.mean()
    msw = sum(np.sum((np.array(g) - np.mean(g)) ** 2) for g in groups) / (10 - 4)
    msb = sum(len(g) * (np.mean(g) - grand) ** 2 for g in groups) / 3
    n0 = (10 - (9 + 4 + 1 + 16) / 10) / 3
    shared = (msb - msw) / n0
    found = scatter_of_repeats(y, used, poses, weights)
    assert found.within["m"] == pytest.approx(np.sqrt(msw))
    assert found.freedom == pytest.approx(6.0)
    assert found.rho == pytest.approx(shared / (shared + msw))


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_no_bias_with_unequal_repeats(share):
    rng = np.random.default_rng(0)
    counts = rng.integers(1, 7, 200)
    found = []
    for _ in range(60):
        e, poses = measured(rng, counts, shared=np.sqrt(share), noise=np.sqrt(1 - share))
        used = rng.random(e.shape) < 0.9
        channels = lengths_and_angles(used)
        result = scatter_of_repeats(np.where(used, e, np.nan), channels, poses, np.ones(len(e)))
        found.append((result.rho, result.within["m"]))
    rho, within = np.mean(found, axis=0)
    # At 0 half of the estimates are cut off below.
    assert rho == pytest.approx(share, abs=0.015)
    assert within == pytest.approx(np.sqrt(1 - share), rel=0.02)


def test_parameters_of_the_fit_are_allowed_for():
    """30 poses and 36 parameters: without their number rho is far too small."""
    rng = np.random.default_rng(3)
    naive, right = [], []
    for _ in range(100):
        e, poses = measured(rng, [5] * 30, shared=np.sqrt(0.6), noise=np.sqrt(0.4))
        A = np.repeat(rng.normal(size=(30, 3, 36)), 5, axis=0).reshape(-1, 36)
        r = e.ravel() - A @ np.linalg.lstsq(A, e.ravel(), rcond=None)[0]
        arguments = (r.reshape(-1, 3), lengths_and_angles(np.ones(e.shape)), poses, np.ones(len(e)))
        naive.append(scatter_of_repeats(*arguments).rho)
        right.append(scatter_of_repeats(*arguments, fitted=36).rho)
    assert np.mean(naive) < 0.5
    assert np.mean(right) == pytest.approx(0.6, abs=0.02)


def test_rows_count_by_their_weights():
    """By hand: two poses of two repeats; of the first pose one counts half, and outliers not at all."""
    y = np.array([0.0, 4.0, 11.0, 13.0, 1e3, 1e3])[:, None]
    weights = np.array([1.0, 0.5, 1.0, 1.0, 0.0, 0.0])
    poses = np.array([0, 0, 1, 1, 1, 2])
    used = lengths_and_angles(np.ones(y.shape))
    found = scatter_of_repeats(y, used, poses, weights)
    # The first pose has the mean 4/3 with squares of 16/3 where 2/3 are expected of a unit variance.
    variance = (16 / 3 + 2) / (2 / 3 + 1)
    assert found.within["m"] == pytest.approx(np.sqrt(variance))
    assert found.freedom == pytest.approx(1.5**2 / 1.25 - 1 + 1)
    between = 1.5 * 2 / 3.5 * (12 - 4 / 3) ** 2
    noise = 1.25 / 1.5 + 2 / 2 - 3.25 / 3.5
    shared = (between - noise * variance) / (3.5 - (1.5**2 + 2**2) / 3.5)
    assert found.rho == pytest.approx(shared / (shared + variance))
    # Only how the weights compare counts.
    light = scatter_of_repeats(y, used, poses, 0.1 * weights)
    assert light.within["m"] == pytest.approx(found.within["m"])
    assert light.freedom == pytest.approx(found.freedom)
    assert light.rho == pytest.approx(found.rho)


def test_repeats_without_any_residual_share_nothing():
    y = np.zeros((4, 3))
    used, weights = everything(y)
    found = scatter_of_repeats(y, used, np.array([0, 0, 1, 1]), weights)
    assert (found.within, found.freedom, found.rho) == ({"m": 0.0}, 6.0, 0.0)


def test_without_repeats_nothing_is_known_of_their_scatter():
    y = np.random.default_rng(0).normal(size=(4, 3))
    used, weights = everything(y)
    found = scatter_of_repeats(y, used, np.arange(4), weights)
    assert np.isnan(found.within["m"])
    assert (found.freedom, found.rho) == (0.0, 0.0)


def test_a_fit_that_reproduces_the_mean_of_every_pose_leaves_no_correlation_to_see():
    e, poses = measured(np.random.default_rng(1), [3] * 10, shared=2.0, columns=1)
    used, weights = everything(e)
    assert scatter_of_repeats(e, used, poses, weights, fitted=9).rho > 0.1
    assert scatter_of_repeats(e, used, poses, weights, fitted=10).rho == 0.0


def test_the_mean_of_repeats_has_the_variance_of_one_row():
    """Sum of w v over the root of the sum of w, in the order of the poses' numbers."""
    values = np.array([[1.0, 2.0], [5.0, 6.0], [3.0, -4.0]])
    weights, poses = np.array([0.25, 1.0, 0.5]), np.array([7, 2, 7])
    expected = [[5.0, 6.0], np.array([0.25 + 1.5, 0.5 - 2.0]) / np.sqrt(0.75)]
    means, first = pose_means(values, weights, poses)
    np.testing.assert_allclose(means, expected)
    np.testing.assert_array_equal(first, [1, 0])
    stacked, _ = pose_means(values[:, :, None], weights, poses)
    np.testing.assert_array_equal(stacked, means[:, :, None])


def test_correlation_does_not_depend_on_the_units_of_lengths_and_angles():
    rng = np.random.default_rng(5)
    e, poses = measured(rng, [3] * 20, shared=1.0, noise=0.5, columns=6)
    units = np.array([1e-3, 1e-3, 1e-3, 20.0, 20.0, 20.0])
    used, weights = everything(e)
    one_unit = scatter_of_repeats(e / np.sqrt(_mean_squares(e)), used, poses, weights)
    two_units = scatter_of_repeats(e * units, used, poses, weights)
    assert two_units.rho == pytest.approx(one_unit.rho)
    plain = scatter_of_repeats(e, used, poses, weights)
    assert two_units.within["m"] == pytest.approx(plain.within["m"] * 1e-3)
    assert two_units.within["rad"] == pytest.approx(plain.within["rad"] * 20.0)


def test_lengths_and_angles_count_alike_towards_the_correlation():
    """As two lengths do that were divided by their weighted rms."""
    rng = np.random.default_rng(6)
    e, poses = measured(rng, [3] * 8, columns=2)
    e *= [1e-3, 20.0]
    weights = rng.uniform(0.2, 1.0, len(e))
    nothing = np.full((len(e), 2), np.nan)
    both = np.column_stack([e[:, 0], nothing, e[:, 1], nothing])
    found = scatter_of_repeats(both, lengths_and_angles(np.isfinite(both)), poses, weights)
    alike = e / np.sqrt(np.average(e**2, axis=0, weights=weights))
    expected = scatter_of_repeats(alike, lengths_and_angles(alike != 0.0), poses, weights)
    assert found.rho == pytest.approx(expected.rho)


def _mean_squares(e):
    """Of lengths in the first three columns, and of angles in the others."""
    return np.repeat([np.mean(e[:, :3] ** 2), np.mean(e[:, 3:] ** 2)], 3)
