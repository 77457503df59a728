"""The share of rows that count against its definition, and whether an arm moves along a path."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from calib.numerics.neighbours import MANY_ROWS, along_path, independent_share


def correlated(phi, shape, seed=0):
    """Errors of variance 1 with the correlation phi^k between rows k apart."""
    white = np.random.default_rng(seed).normal(size=(shape[0] + 2000, shape[1]))
    return lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], white, axis=0)[2000:]


@pytest.mark.parametrize("phi", [0.5, 0.9, 0.97])
def test_the_share_is_that_of_the_integrated_time(phi):
    runs = [(run, np.ones(run.shape)) for run in np.split(correlated(phi, (131_072, 3)), 32)]
    assert independent_share(runs) == pytest.approx((1.0 - phi) / (1.0 + phi), rel=0.15)


def test_rows_without_correlation_count_in_full():
    for seed in range(20):
        errors = np.random.default_rng(seed).normal(size=(20_000, 3))
        assert independent_share([(errors, np.ones(errors.shape))]) == 1.0


def test_errors_that_take_turns_count_in_full():
    errors = np.random.default_rng(0).normal(size=(20_000, 1))
    alternating = errors[1:] - errors[:-1]
    assert independent_share([(alternating, np.ones(alternating.shape))]) == 1.0


def test_what_has_no_weight_does_not_count():
    errors = correlated(0.9, (40_000, 3))
    expected = independent_share([(errors, np.ones(errors.shape))])
    lost = np.random.default_rng(1).uniform(size=(len(errors), 1)) < 0.1
    weights = np.broadcast_to(1.0 - lost, errors.shape)
    outliers = np.where(lost, 1e3, errors)
    assert independent_share([(outliers, weights)]) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(("pairs", "share"), [(15, 1.0), (17, 1.0 / 3.0)])
def test_a_correlation_is_certain_by_the_neighbours_that_were_measured(pairs, share):
    """Errors of every tenth row, which take turns, and of a few rows next to them, which are alike.

    Sixteen neighbours would tell a correlation of 1 by four standard deviations; tau is 1 + 2.
    """
    errors = np.repeat(np.tile([1.0, -1.0], 50), 10)[:, None]
    weights = np.zeros(errors.shape)
    weights[::10] = 1.0
    weights[1 : 10 * pairs : 10] = 1.0
    assert independent_share([(errors, weights)]) == pytest.approx(share, rel=1e-9)


def test_a_moving_arm_follows_a_path_and_drawn_poses_do_not():
    rng = np.random.default_rng(0)
    time = np.arange(MANY_ROWS + 1)[:, None] / 100.0
    moving = np.sin(0.3 * time * rng.uniform(0.5, 2.0, 6))
    assert along_path(moving)
    assert not along_path(rng.permutation(moving))
    assert not along_path(moving[:MANY_ROWS])
    standing = np.repeat(rng.uniform(-2.0, 2.0, (500, 6)), 21, axis=0)
    assert not along_path(standing + rng.normal(0.0, 1e-6, standing.shape))
