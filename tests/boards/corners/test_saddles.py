"""Corners of squares to a hundredth of a pixel, and none where the colours are others."""

from __future__ import annotations

import numpy as np
import pytest

from calib.basics.arrays import Array
from calib.boards.board import Board, corner_signs
from calib.boards.corners.growth import window_size
from calib.boards.corners.planar_map import fit_planar_map
from calib.boards.corners.saddles import Saddles, find_saddles
from tests.boards.board_views import CHARUCO_BOARD, CHESS_BOARD, View, render


def windows(board: Board, view: View) -> Array:
    """The windows around the true corners."""
    points = board.corners[:, :2]
    planar_map = fit_planar_map(points, view.corners(board), view.size)
    return window_size(board) * planar_map.jacobians(points, 0.25 * board.square)


def saddles(board: Board, view: View, offset: float = 0.0, sign: float = 1.0) -> Saddles:
    """The saddles next to the true corners."""
    image = np.asarray(render(board, view), dtype=float)
    expected = view.corners(board) + offset
    return find_saddles(image, expected, windows(board, view), sign * corner_signs(board))


@pytest.mark.parametrize("board", [CHARUCO_BOARD, CHESS_BOARD], ids=["charuco", "chessboard"])
@pytest.mark.parametrize(
    "view",
    [
        View(noise=0, tilt=(5, 3, 20)),
        View(noise=0, tilt=(5, 3, 20), blur=1.5),
        View(noise=0, tilt=(0, 60, 20), blur=0.8),
    ],
    ids=["frontal", "blurred", "steep"],
)
def test_without_noise_a_corner_is_exact(board: Board, view: View):
    found = saddles(board, view, offset=1.5)
    assert found.exist.all()
    error = found.pixels - view.corners(board)
    assert np.sqrt(np.mean(error**2)) < 0.013
    assert np.abs(error.mean(axis=0)).max() < 0.005


def test_other_colours_are_no_corner():
    assert not saddles(CHARUCO_BOARD, View(noise=0, tilt=(5, 3, 20)), sign=-1.0).exist.any()


def test_one_edge_or_nothing_is_no_corner():
    image = np.full((60, 60), 50.0)
    window = 3.0 * np.eye(2)[None]
    place = np.array([[30.0, 30.0]])
    assert not find_saddles(image, place, window, np.ones(1)).exist.any()
    image[:, 30:] = 200.0
    assert not find_saddles(image, place, window, np.ones(1)).exist.any()


def test_a_corner_at_the_image_s_edge_is_none():
    image = np.full((60, 60), 50.0)
    image[:3, :30] = 200.0
    image[3:, 30:] = 200.0
    window = 3.0 * np.eye(2)[None]
    sign = np.ones(1)
    assert not find_saddles(image, np.array([[29.5, 2.5]]), window, sign).exist.any()
    inside = np.roll(image, 20, axis=0)
    inside[:20, :30] = 200.0
    inside[:20, 30:] = 50.0
    found = find_saddles(inside, np.array([[29.0, 23.0]]), window, sign)
    np.testing.assert_allclose(found.pixels, [[29.5, 22.5]], atol=0.01)
