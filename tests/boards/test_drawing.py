"""The rectangles of a board against the pictures that OpenCV draws."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from calib.boards.board import APRILTAG, CHARUCO, CHESSBOARD, Board
from calib.boards.drawing import black_rectangles, is_white, marker_corners, marker_rectangles

#: Whole pixels for squares, margins of markers and bits of 5 x 5 and 6 x 6 dictionaries.
PIXELS_PER_MM = 1.0


def flat(board):
    """The board seen from the front, its black rectangles painted one by one."""
    scale = 1e3 * PIXELS_PER_MM
    width, height = (length * scale for length in board.size)
    image = np.full((round(height), round(width)), 255, np.uint8)
    rectangles = black_rectangles(board) * scale
    rectangles[:, 2:] += rectangles[:, :2]
    # Edges that neighbours share are rounded alike, or white lines would lie between them.
    for left, top, right, bottom in np.floor(rectangles + 0.5 + 1e-6).astype(int):
        image[top:bottom, left:right] = 0
    return image


def charuco(columns, rows, *, legacy=False, first=0):
    return Board(
        pattern=CHARUCO,
        columns=columns,
        rows=rows,
        square=0.050,
        marker=0.042,
        dictionary="DICT_5X5_100",
        first_marker=first,
        legacy=legacy,
    )


@pytest.mark.parametrize(("columns", "rows"), [(5, 7), (6, 7), (5, 4), (4, 6)])
@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("first", [0, 11])
def test_a_charuco_board_is_that_of_opencv(columns, rows, legacy, first):
    board = charuco(columns, rows, legacy=legacy, first=first)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    ids = first + np.arange(board.markers)
    theirs = cv2.aruco.CharucoBoard((columns, rows), 50.0, 42.0, dictionary, ids)
    theirs.setLegacyPattern(legacy)
    expected = theirs.generateImage((50 * columns, 50 * rows))
    np.testing.assert_array_equal(flat(board), expected)


def test_a_grid_of_tags_is_that_of_opencv():
    board = Board(
        pattern=APRILTAG,
        columns=3,
        rows=2,
        square=0.060,
        marker=0.040,
        dictionary="DICT_APRILTAG_36h11",
        first_marker=7,
    )
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    theirs = cv2.aruco.GridBoard((3, 2), 40.0, 20.0, dictionary, 7 + np.arange(6))
    np.testing.assert_array_equal(flat(board), theirs.generateImage((160, 100)))


def test_a_chessboard_begins_black():
    board = Board(pattern=CHESSBOARD, columns=3, rows=3, square=0.02)
    expected = [[0, 0, 0.02, 0.02], [0.04, 0, 0.02, 0.02], [0.02, 0.02, 0.02, 0.02]]
    expected += [[0, 0.04, 0.02, 0.02], [0.04, 0.04, 0.02, 0.02]]
    np.testing.assert_allclose(black_rectangles(board), expected)


def test_the_legacy_layout_matters_for_even_rows_only():
    assert is_white(charuco(4, 4, legacy=True))[0, 0]
    assert not is_white(charuco(4, 5, legacy=True))[0, 0]
    np.testing.assert_allclose(marker_corners(charuco(4, 4))[0], [0.054, 0.004])
    np.testing.assert_allclose(marker_corners(charuco(4, 4, legacy=True))[0], [0.004, 0.004])


def test_rectangles_of_a_marker_do_not_overlap():
    rectangles = marker_rectangles("DICT_4X4_50", 0)
    # 20 bits of the border, and those of the marker that are black.
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    black = np.sum(cv2.aruco.generateImageMarker(dictionary, 0, 6) == 0)
    assert np.sum(rectangles[:, 2] * rectangles[:, 3]) * 36 == pytest.approx(black)
