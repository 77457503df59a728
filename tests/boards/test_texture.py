"""Patterns against those that OpenCV draws, and edges between pixels."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calib.boards.drawing import black_rectangles
from calib.boards.texture import texture
from tests.boards.boards import CHARUCO_BOARD, CHESS_BOARD, OLD_BOARD, TAG_BOARD


def dictionary(board):
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))


def opencv_charuco(board):
    theirs = cv2.aruco.CharucoBoard(
        (board.columns, board.rows), board.square, board.marker, dictionary(board)
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
        theirs = cv2.aruco.generateImageMarker(dictionary(board), 10 + tag, 32) / 255.0
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
