"""Boards: corners as OpenCV has them, and descriptions that do not make a board."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calib.boards.board import (
    APRILTAG,
    CHARUCO,
    CHESSBOARD,
    Board,
    corner_signs,
    marker_outlines,
    white_squares,
)
from calib.errors import CalibError
from tests.boards.board_views import CHESS_BOARD, TAG_BOARD


def charuco(**changes):
    description = {
        "pattern": CHARUCO,
        "columns": 5,
        "rows": 7,
        "square": 0.034,
        "marker": 0.028,
        "dictionary": "DICT_6X6_250",
    }
    return Board(**(description | changes))


def test_charuco_corners_are_those_of_opencv():
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250)
    theirs = cv2.aruco.CharucoBoard((5, 7), 0.034, 0.028, dictionary).getChessboardCorners()
    np.testing.assert_allclose(charuco().corners, theirs, atol=1e-7)


def test_tag_corners_are_those_of_opencv():
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    theirs = cv2.aruco.GridBoard((4, 3), 0.03, 0.01, dictionary).getObjPoints()
    board = Board(
        pattern=APRILTAG,
        columns=4,
        rows=3,
        square=0.04,
        marker=0.03,
        dictionary="DICT_APRILTAG_36h11",
    )
    np.testing.assert_allclose(board.corners, np.reshape(theirs, (-1, 3)), atol=1e-7)
    np.testing.assert_allclose(board.size, (0.15, 0.11))


def test_chessboard_has_inner_corners_in_rows():
    board = Board(pattern=CHESSBOARD, columns=4, rows=3, square=0.02)
    assert board.corners.shape == (6, 3)
    np.testing.assert_allclose(board.corners[1], [0.04, 0.02, 0.0])
    np.testing.assert_allclose(board.centre, [0.04, 0.03, 0.0])


@pytest.mark.parametrize(
    "changes",
    [
        {"pattern": "dots"},
        {"columns": 1},
        {"square": 0.0},
        {"marker": 0.034},
        {"dictionary": ""},
    ],
)
def test_refuses_what_is_no_board(changes):
    with pytest.raises(CalibError):
        charuco(**changes)


@pytest.mark.parametrize(
    ("columns", "rows", "legacy"),
    [(5, 7, False), (5, 8, False), (5, 8, True), (6, 7, True), (6, 8, True)],
)
def test_markers_are_where_opencv_has_them(columns: int, rows: int, legacy: bool):
    board = Board(
        pattern="charuco",
        columns=columns,
        rows=rows,
        square=0.034,
        marker=0.028,
        dictionary="DICT_6X6_250",
        legacy=legacy,
    )
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250)
    theirs = cv2.aruco.CharucoBoard((columns, rows), 0.034, 0.028, dictionary)
    theirs.setLegacyPattern(legacy)
    expected = np.array(theirs.getObjPoints())[:, :, :2]
    np.testing.assert_allclose(marker_outlines(board), expected, atol=1e-7)
    np.testing.assert_allclose(board.corners, theirs.getChessboardCorners(), atol=1e-7)


def test_the_square_at_the_origin_is_black():
    # The first corner has black towards +x and +y, its neighbours in the row and below white.
    signs = corner_signs(CHESS_BOARD).reshape(4, 7)
    assert signs[0, 0] == -1
    assert signs[0, 1] == signs[1, 0] == 1


def test_tags_are_the_corners_of_the_board():
    corners = marker_outlines(TAG_BOARD)
    assert corners.shape == (12, 4, 2)
    np.testing.assert_allclose(corners[5, 2], [0.05 + 0.035, 0.05 + 0.035])
    assert marker_outlines(CHESS_BOARD).shape == (0, 4, 2)


def test_the_legacy_layout_matters_for_even_rows_only():
    even = Board(
        pattern="charuco", columns=4, rows=4, square=0.05, marker=0.042, dictionary="DICT_5X5_100"
    )
    legacy = replace(even, legacy=True)
    assert white_squares(legacy)[0, 0]
    assert not white_squares(replace(legacy, rows=5))[0, 0]
    np.testing.assert_allclose(marker_outlines(even)[0, 0], [0.054, 0.004])
    np.testing.assert_allclose(marker_outlines(legacy)[0, 0], [0.004, 0.004])
