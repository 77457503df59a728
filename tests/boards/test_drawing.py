"""Rectangles and grey pictures of a board against the pictures that OpenCV draws."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calib.boards.board import APRILTAG, CHARUCO, CHESSBOARD, Board
from calib.boards.drawing import black_rectangles, marker_rectangles, texture
from tests.boards.board_views import KALIBR_BOARD, pattern
from tests.boards.boards import CHARUCO_BOARD, CHESS_BOARD, OLD_BOARD, TAG_BOARD

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


def test_rectangles_of_a_marker_do_not_overlap():
    rectangles = marker_rectangles("DICT_4X4_50", 0)
    # 20 bits of the border, and those of the marker that are black.
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    black = np.sum(cv2.aruco.generateImageMarker(dictionary, 0, 6) == 0)
    assert np.sum(rectangles[:, 2] * rectangles[:, 3]) * 36 == pytest.approx(black)


def opencv_dictionary(board):
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))


def opencv_charuco(board):
    theirs = cv2.aruco.CharucoBoard(
        (board.columns, board.rows), board.square, board.marker, opencv_dictionary(board)
    )
    theirs.setLegacyPattern(board.legacy)
    return theirs


@pytest.mark.parametrize(
    "board",
    [CHARUCO_BOARD, OLD_BOARD, replace(OLD_BOARD, legacy=False)],
    ids=["new", "old", "even"],
)
def test_charuco_is_what_opencv_draws(board):
    # 28 pixels a square, 14 a marker of 5 + 2 cells: all edges are between pixels.
    board = replace(board, marker=board.square / 2.0)
    size = (28 * board.columns, 28 * board.rows)
    theirs = opencv_charuco(board).generateImage(size, marginSize=0) / 255.0
    drawn = texture(board, board.square / 28, 0.0).white
    np.testing.assert_allclose(drawn, theirs, atol=1e-5)


def test_tags_are_those_of_opencv():
    # 32 pixels a tag of 6 + 2 cells.
    board = replace(TAG_BOARD, square=0.06, marker=0.03)
    pixel = board.marker / 32
    drawn = texture(board, pixel, 0.0).white
    for tag in range(12):
        row, column = divmod(tag, 4)
        part = drawn[64 * row : 64 * row + 32, 64 * column : 64 * column + 32]
        theirs = cv2.aruco.generateImageMarker(opencv_dictionary(board), 10 + tag, 32) / 255.0
        np.testing.assert_allclose(part, theirs, atol=1e-5)


def test_black_covers_as_much_as_the_rectangles_do():
    for board in (CHARUCO_BOARD, CHESS_BOARD, TAG_BOARD):
        drawn = texture(board, 0.00077, 0.0105)
        area = np.prod(black_rectangles(board)[:, 2:], axis=1).sum()
        np.testing.assert_allclose((1.0 - drawn.white).sum() * drawn.pixel**2, area, rtol=1e-5)


def test_an_edge_within_a_pixel_shows_as_grey():
    drawn = texture(CHESS_BOARD, CHESS_BOARD.square / 10.4, 0.0)
    assert drawn.white[5, 9] == pytest.approx(0.0, abs=1e-6)
    assert drawn.white[5, 10] == pytest.approx(0.6, abs=1e-5)
    assert drawn.white[5, 11] == pytest.approx(1.0)
    assert drawn.place(np.array([CHESS_BOARD.square])) == pytest.approx(10.4 - 0.5)


def test_an_aprilgrid_is_drawn_as_kalibr_has_it():
    # A bit is 4 mm, a pixel is 1 mm.
    drawn = texture(KALIBR_BOARD, 1e-3, KALIBR_BOARD.square).white
    height, width = drawn.shape
    np.testing.assert_allclose(drawn, pattern(KALIBR_BOARD, 1e3)[:height, :width], atol=1e-6)


@pytest.mark.parametrize("kind", ["circles", "asymmetric_circles"])
def test_circles_are_drawn_with_their_area_about_their_centres(kind):
    board = Board(pattern=kind, columns=3, rows=3, square=0.03, marker=0.02)
    x, y, width, height = black_rectangles(board).T
    area = width * height
    assert area.sum() == pytest.approx(9 * np.pi * 0.01**2, rel=1e-9)
    nearest = np.argmin(
        np.hypot(
            *(np.stack([x + width / 2, y + height / 2])[:, :, None] - board.corners.T[:2, None])
        ),
        axis=1,
    )
    for k, corner in enumerate(board.corners):
        strips = nearest == k
        middle = np.array([x[strips] + width[strips] / 2, y[strips] + height[strips] / 2])
        np.testing.assert_allclose(
            middle @ area[strips] / area[strips].sum(), corner[:2], atol=1e-9
        )
        assert width[strips].max() == pytest.approx(0.02, rel=1e-3)
