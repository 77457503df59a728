"""Corners are found at steep angles, through a bending lens, and beside markers that were not read."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.basics.arrays import Array
from calib.boards.board import Board
from calib.boards.corners.growth import grow, visible_corners, window_size
from calib.boards.corners.markers import find_markers
from calib.boards.corners.placing import place
from calib.boards.corners.saddles import Saddles
from calib.boards.layout import marker_outlines
from tests.boards.board_views import CHARUCO_BOARD, CHESS_BOARD, View, render

#: Sixty degrees, noise and a slight blur, from all sides, near and far.
STEEP = [
    View(tilt=(0, 60, 0), noise=3, blur=0.8),
    View(tilt=(60, 0, 10), noise=3, blur=0.8),
    View(tilt=(-60, 0, 45), noise=3, blur=0.8),
    View(tilt=(0, -60, 100), noise=4, blur=1.0),
    View(tilt=(0, 60, 0), noise=2, blur=0.8, middle=(0, 0, 0.6)),
    View(tilt=(0, 60, 70), noise=3, blur=0.8, middle=(0.02, 0.01, 0.4)),
]


def corners_of(image: Array, board: Board, of_ids: tuple[int, int] = (0, 17)) -> Saddles:
    """The corners, grown from some of the markers."""
    markers = find_markers(image, board.dictionary).of_ids(*of_ids)
    layout = marker_outlines(board)[of_ids[0] :]
    placement = place(markers, layout, (image.shape[1], image.shape[0]))
    assert placement is not None
    used = placement.agrees
    points = layout[markers.ids[used]].reshape(-1, 2)
    pixels = markers.corners[used].reshape(-1, 2)
    grey = np.asarray(image, dtype=float)
    return grow(grey, board, placement.map, points, pixels)[0]


@pytest.mark.slow
def test_steep_views():
    errors = []
    found = 0
    for view in STEEP:
        saddles = corners_of(render(CHARUCO_BOARD, view), CHARUCO_BOARD)
        found += saddles.exist.sum()
        errors.append((saddles.pixels - view.corners(CHARUCO_BOARD))[saddles.exist])
    assert found >= 0.95 * 24 * len(STEEP)
    rms = np.sqrt(np.mean(np.sum(np.concatenate(errors) ** 2, axis=1)))
    assert rms < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [(20, 10, 30), (60, 0, 30)], ids=["frontal", "steep"])
def test_a_lens_that_bends(tilt: tuple[float, float, float]):
    view = View(tilt=tilt, distortion=(-0.35, 0.12), focal=400, middle=(0, 0, 0.2))
    saddles = corners_of(render(CHARUCO_BOARD, view), CHARUCO_BOARD)
    assert saddles.exist.all()
    error = saddles.pixels - view.corners(CHARUCO_BOARD)
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 0.15


def test_two_markers_are_enough():
    view = View(tilt=(20, 10, 30))
    saddles = corners_of(render(CHARUCO_BOARD, view), CHARUCO_BOARD, (7, 2))
    assert saddles.exist.all()
    assert np.abs(saddles.pixels - view.corners(CHARUCO_BOARD)).max() < 0.1


def test_hidden_corners_are_not_made_up():
    view = View(tilt=(20, 10, 30))
    image = np.array(render(CHARUCO_BOARD, view))
    corners = view.corners(CHARUCO_BOARD)
    u, v = np.rint(corners[9]).astype(int)
    image[v - 12 : v + 13, u - 12 : u + 13] = 90
    saddles = corners_of(image, CHARUCO_BOARD)
    assert np.flatnonzero(~saddles.exist).tolist() == [9]


def test_windows_stay_off_the_markers():
    assert window_size(CHARUCO_BOARD) == pytest.approx(0.7 * 0.004)
    assert window_size(replace(CHARUCO_BOARD, marker=0.029)) == pytest.approx(0.04 * 0.03)
    assert window_size(replace(CHARUCO_BOARD, marker=0.01)) == pytest.approx(0.14 * 0.03)
    assert window_size(CHESS_BOARD) == pytest.approx(0.14 * 0.03)


def test_corners_inside_the_picture():
    view = View(middle=(0.12, 0, 0.35))
    image = render(CHARUCO_BOARD, view)
    markers = find_markers(image, CHARUCO_BOARD.dictionary)
    placement = place(markers, marker_outlines(CHARUCO_BOARD), view.size)
    assert placement is not None
    visible = visible_corners(CHARUCO_BOARD, placement.map, view.size)
    expected = view.corners(CHARUCO_BOARD)[:, 0] < view.size[0] - 3
    assert visible.tolist() == expected.tolist()
    assert 0 < visible.sum() < 24
