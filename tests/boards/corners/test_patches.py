"""Weights around a corner, and interpolated values."""

from __future__ import annotations

import numpy as np
import pytest

from calib.boards.corners.patches import interpolated, normal_matrix, patch_at, window_weights

#: A window that is sheared and narrow.
WINDOW = np.array([[3.0, 0.5], [0.8, 1.5]])


def test_across_an_edge_the_weights_are_even():
    for axis in (0, 1):
        along = WINDOW[:, axis] / np.hypot(*WINDOW[:, axis])
        across = np.array([-along[1], along[0]])
        for distance in (1.0, 2.5):
            offsets = distance * along + np.array([[-0.05], [0.05]]) * across
            before, behind = window_weights(offsets[None], WINDOW)[0]
            assert before == pytest.approx(behind, rel=1e-3)


def test_weights_end_where_the_window_does():
    along_x = WINDOW[:, 0]
    offsets = np.array([[0.0 * along_x, 2.79 * along_x, 2.81 * along_x]])
    weights = window_weights(offsets, WINDOW)[0]
    assert weights[0] == 1.0
    assert weights[1] > 0.0
    assert weights[2] == 0.0


def test_a_patch_has_central_differences():
    u, v = np.meshgrid(np.arange(40.0), np.arange(30.0))
    patch = patch_at(3.0 * u - 2.0 * v, np.array([20.3, 14.8]), WINDOW)
    assert patch is not None
    np.testing.assert_allclose(patch.gradients, np.broadcast_to([3.0, -2.0], patch.gradients.shape))
    total = patch.weights.sum()
    np.testing.assert_allclose(normal_matrix(patch), total * np.array([[9, -6], [-6, 4]]))
    # Offsets are from the place to the pixels.
    np.testing.assert_allclose((patch.offsets + np.array([20.3, 14.8])) % 1.0, 0.0, atol=1e-9)


@pytest.mark.parametrize("place", [(2.0, 15.0), (38.0, 15.0), (20.0, 1.0), (np.nan, 3.0)])
def test_a_patch_that_leaves_the_image_is_none(place: tuple[float, float]):
    assert patch_at(np.zeros((30, 40)), np.array(place), WINDOW) is None


def test_interpolation_is_exact_for_a_parabola_and_averages_noise():
    u, v = np.meshgrid(np.arange(40.0), np.arange(30.0))
    places = np.array([[10.3, 12.9], [20.0, 7.5]])
    values, gain = interpolated(u**2 + u * v, places)
    np.testing.assert_allclose(values, places[:, 0] ** 2 + places[:, 0] * places[:, 1])
    noise = np.random.default_rng(0).normal(size=(400, 400))
    rows = np.arange(5.0, 390.0, 5.0)
    many = np.stack(np.meshgrid(rows + 0.5, rows), axis=-1).reshape(-1, 2)
    values, gain = interpolated(noise, many)
    assert np.var(values) == pytest.approx(gain[0], rel=0.1)
    assert gain[0] == pytest.approx(0.6406, abs=1e-3)
