"""Chessboards: the corner that is the first, and boards that look alike from two sides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.basics.arrays import Array
from calib.boards.board import Board, marker_outlines
from calib.boards.corners.chessboards import (
    find_chessboard,
    find_inner_corners,
    is_part_of_larger,
    size_of_chessboard,
    visible_corners,
    window_size,
)
from calib.boards.corners.markers import find_markers, place_board
from calib.boards.corners.saddles import Saddles
from calib.boards.opencv import opencv
from calib.errors import CalibError
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
    markers = find_markers(image, board.dictionary).of_ids(of_ids[0] + np.arange(of_ids[1]))
    layout = marker_outlines(board)[of_ids[0] :]
    placement = place_board(markers, layout, (image.shape[1], image.shape[0]))
    assert placement is not None
    used = placement.agrees
    points = layout[markers.ids[used]].reshape(-1, 2)
    pixels = markers.corners[used].reshape(-1, 2)
    grey = np.asarray(image, dtype=float)
    return find_inner_corners(grey, board, placement.map, points, pixels)[0]


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
    placement = place_board(markers, marker_outlines(CHARUCO_BOARD), view.size)
    assert placement is not None
    visible = visible_corners(CHARUCO_BOARD, placement.map, view.size)
    expected = view.corners(CHARUCO_BOARD)[:, 0] < view.size[0] - 3
    assert visible.tolist() == expected.tolist()
    assert 0 < visible.sum() < 24


#: Looks the same after half a turn.
EVEN = Board(pattern="chessboard", columns=8, rows=6, square=0.03)

#: Looks another way after a quarter.
SQUARE = Board(pattern="chessboard", columns=6, rows=6, square=0.03)


@pytest.mark.parametrize("roll", [0, 100, 170, -80])
def test_black_at_the_origin_says_which_corner_is_first(roll: float):
    view = View(tilt=(15, 10, roll))
    found = find_chessboard(render(CHESS_BOARD, view), CHESS_BOARD)
    assert found is not None
    assert not found.is_white_first
    assert np.abs(found.pixels - view.corners(CHESS_BOARD)).max() < 1.0
    assert np.abs(found.map.project(CHESS_BOARD.corners[:, :2]) - found.pixels).max() < 1.0


@pytest.mark.parametrize("roll", [0, 170])
@pytest.mark.parametrize("is_white", [False, True])
def test_an_even_board_has_its_x_axis_to_the_right(roll: float, is_white: bool):
    # The mirror image of a board of even columns begins with a white square.
    view = View(tilt=(15, 10, roll), mirrored=is_white)
    image = render(EVEN, view)
    found = find_chessboard(image, EVEN)
    assert found is not None
    assert found.is_white_first == is_white
    true = view.corners(EVEN) if roll == 0 else view.corners(EVEN)[::-1]
    assert np.abs(found.pixels - true).max() < 1.0
    saddles, _ = find_inner_corners(
        np.asarray(image, dtype=float),
        EVEN,
        found.map,
        EVEN.corners[:, :2],
        found.pixels,
        is_white_first=is_white,
    )
    assert saddles.exist.all()
    assert np.abs(saddles.pixels - true).max() < 0.15


def test_a_square_board_is_turned_to_its_black_corner():
    view = View(tilt=(15, 10, 80))
    found = find_chessboard(render(SQUARE, view), SQUARE)
    assert found is not None
    assert not found.is_white_first
    error = min(
        np.abs(found.pixels - view.corners(SQUARE)[order]).max() for order in SQUARE.orders_alike
    )
    assert error < 1.0


def test_a_board_that_is_cut_is_not_found():
    assert find_chessboard(render(CHESS_BOARD, View(middle=(0.2, 0, 0.35))), CHESS_BOARD) is None


@pytest.mark.skipif(
    int(opencv().__version__.split(".")[0]) < 5,
    reason="OpenCV 4 takes corners that skip columns for those of a smaller board",
)
def test_a_part_of_a_larger_board():
    image = render(CHESS_BOARD, View(tilt=(15, 10, 0)))
    smaller = replace(CHESS_BOARD, columns=6)
    found = find_chessboard(image, smaller)
    assert found is not None
    grey = np.asarray(image, dtype=float)
    assert is_part_of_larger(grey, smaller, found.map)
    found = find_chessboard(image, CHESS_BOARD)
    assert found is not None
    assert not is_part_of_larger(grey, CHESS_BOARD, found.map)


def test_the_size_of_another_board():
    assert size_of_chessboard(render(CHESS_BOARD, View(tilt=(15, 10, 0)))) == (8, 5)


def test_too_few_columns():
    with pytest.raises(CalibError, match="'board' is a chessboard of 8 columns and 3 rows"):
        find_chessboard(np.zeros((10, 10), np.uint8), replace(CHESS_BOARD, rows=3))
