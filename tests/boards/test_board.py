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
    ("columns", "rows", "orders"),
    [(4, 3, 1), (10, 8, 2), (7, 5, 2), (4, 4, 2), (5, 5, 4)],
)
def test_chessboards_that_look_the_same_turned(columns, rows, orders):
    board = Board(pattern=CHESSBOARD, columns=columns, rows=rows, square=0.02)
    alike = board.orders_alike
    assert len(alike) == orders
    assert board.looks_same_turned == (orders > 1)
    # Numbered in each of these orders, corners are a turned copy of the board, with the same colours.
    about_middle = (board.corners - board.centre)[:, :2]
    for order in alike:
        R, _, _, _ = np.linalg.lstsq(about_middle, about_middle[order], rcond=None)
        np.testing.assert_allclose(about_middle @ R, about_middle[order], atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1.0)
        # A quarter of a turn exchanges the axes, and with them the sign.
        sign = 1.0 if abs(R[0, 0]) > 0.5 else -1.0
        np.testing.assert_array_equal(corner_signs(board)[order], sign * corner_signs(board))
    assert not charuco().looks_same_turned
    assert not TAG_BOARD.looks_same_turned


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


#: Tags of 80 mm, 24 mm apart.
KALIBR = Board(
    pattern="aprilgrid",
    columns=3,
    rows=2,
    square=0.104,
    marker=0.08,
    dictionary="DICT_APRILTAG_36h11",
)


def test_an_aprilgrid_is_that_of_kalibr():
    # Tags from the lower left; each corner by its tag and the corner in it, from the lower right.
    by_tag = KALIBR.corners.reshape(6, 4, 3)[:, :, :2]
    np.testing.assert_allclose(by_tag[0], [[0.08, 0.184], [0, 0.184], [0, 0.104], [0.08, 0.104]])
    np.testing.assert_allclose(by_tag[1] - by_tag[0], [[0.104, 0.0]] * 4, atol=1e-12)
    np.testing.assert_allclose(by_tag[3] - by_tag[0], [[0.0, -0.104]] * 4, atol=1e-12)
    np.testing.assert_allclose(KALIBR.size, (0.288, 0.184))
    # Towards +x, +y of a tag's lower right corner is the small square, which is black.
    assert corner_signs(KALIBR)[:4].tolist() == [-1.0, 1.0, -1.0, 1.0]
    assert not KALIBR.looks_same_turned
    assert (KALIBR.border, KALIBR.marker_kind) == (2, "DICT_APRILTAG_36h11/2")


@pytest.mark.parametrize(
    "changes",
    [
        {"marker": 0.0},
        {"marker": 0.03},
        {"rows": 2},
        {"pattern": "asymmetric_circles", "marker": 0.03},
    ],
)
def test_refuses_what_is_no_grid_of_circles(changes):
    grid = {"pattern": "circles", "columns": 5, "rows": 4, "square": 0.02, "marker": 0.01}
    Board(**grid)
    with pytest.raises(CalibError):
        Board(**(grid | changes))
