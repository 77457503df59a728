"""Chessboards: the corner that is the first, and boards that look alike from two sides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.boards.board import Board
from calib.boards.corners.chessboards import (
    find_chessboard,
    is_ambiguous,
    is_part_of_larger,
    size_of_chessboard,
)
from calib.boards.opencv import opencv
from calib.errors import CalibError
from tests.boards.board_views import CHESS_BOARD, View, render

#: Looks the same after half a turn.
EVEN = Board(pattern="chessboard", columns=8, rows=6, square=0.03)

#: Looks another way after a quarter.
SQUARE = Board(pattern="chessboard", columns=6, rows=6, square=0.03)


@pytest.mark.parametrize("roll", [0, 100, 170, -80])
def test_black_at_the_origin_says_which_corner_is_first(roll: float):
    view = View(tilt=(15, 10, roll))
    found = find_chessboard(render(CHESS_BOARD, view), CHESS_BOARD)
    assert found is not None
    planar_map, pixels = found
    assert np.abs(pixels - view.corners(CHESS_BOARD)).max() < 1.0
    assert np.abs(planar_map.project(CHESS_BOARD.corners[:, :2]) - pixels).max() < 1.0


@pytest.mark.slow
def test_an_even_board_has_its_x_axis_to_the_right():
    assert is_ambiguous(EVEN)
    assert not is_ambiguous(CHESS_BOARD)
    for roll in (0, 170):
        view = View(tilt=(15, 10, roll))
        found = find_chessboard(render(EVEN, view), EVEN)
        assert found is not None
        true = view.corners(EVEN) if roll == 0 else view.corners(EVEN)[::-1]
        assert np.abs(found[1] - true).max() < 1.0


def test_a_square_board_is_turned_to_its_black_corner():
    view = View(tilt=(15, 10, 80))
    found = find_chessboard(render(SQUARE, view), SQUARE)
    assert found is not None
    error = min(
        np.abs(found[1] - view.corners(SQUARE)).max(),
        np.abs(found[1] - view.corners(SQUARE)[::-1]).max(),
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
    assert is_part_of_larger(grey, smaller, found[0])
    found = find_chessboard(image, CHESS_BOARD)
    assert found is not None
    assert not is_part_of_larger(grey, CHESS_BOARD, found[0])


def test_the_size_of_another_board():
    assert size_of_chessboard(render(CHESS_BOARD, View(tilt=(15, 10, 0)))) == (8, 5)


def test_too_few_columns():
    with pytest.raises(CalibError, match="'board' is a chessboard of 8 columns and 3 rows"):
        find_chessboard(np.zeros((10, 10), np.uint8), replace(CHESS_BOARD, rows=3))
