"""Viewpoints: within the limits, spread evenly over tilt, roll, distance and image."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kstest

from calib.verbs.plan.images.viewpoints import NUMBERS, viewpoints
from tests.verbs.plan.images.views import BOARD, sight


@pytest.fixture(scope="module")
def T() -> np.ndarray:
    return viewpoints(sight(), np.random.default_rng(1).uniform(size=(4000, NUMBERS)))


def test_they_are_poses_within_the_limits(T):
    np.testing.assert_allclose(
        T[:, :3, :3] @ T[:, :3, :3].swapaxes(1, 2), np.tile(np.eye(3), (4000, 1, 1)), atol=1e-12
    )
    assert np.linalg.det(T[:, :3, :3]) == pytest.approx(1.0)
    assert sight().in_focus(T).all()
    assert sight().is_facing(T).all()


def test_tilts_and_nearness_are_spread_evenly(T):
    seen = sight()
    assert kstest(seen.tilts(T) / seen.limits.tilt, "uniform").pvalue > 1e-3
    nearness = 1.0 / seen.distances(T)
    low, high = 1.0 / seen.limits.farthest, 1.0 / seen.limits.nearest
    assert kstest((nearness - low) / (high - low), "uniform").pvalue > 1e-3


def test_the_centre_of_the_board_is_anywhere_in_the_image(T):
    seen = sight()
    u, v = seen.pixels(seen.centres(T))
    assert kstest((u + 0.5) / 1280.0, "uniform").pvalue > 1e-3
    assert kstest((v + 0.5) / 960.0, "uniform").pvalue > 1e-3


def test_it_is_tilted_and_rolled_in_all_directions(T):
    # The normal about the line of sight, and the board's x about the normal.
    rays = T[:, :3, :3] @ BOARD.centre + T[:, :3, 3]
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    for vector in (T[:, :3, 2] - rays * np.sum(T[:, :3, 2] * rays, axis=1)[:, None], T[:, :3, 0]):
        angle = np.arctan2(vector[:, 1], vector[:, 0]) / (2.0 * np.pi) + 0.5
        counts = np.histogram(angle, bins=8, range=(0.0, 1.0))[0]
        assert counts.min() > 0.6 * 500
