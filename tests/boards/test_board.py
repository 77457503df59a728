"""Boards: corners as OpenCV has them, and descriptions that do not make a board."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from calib.boards.board import APRILTAG, CHARUCO, CHESSBOARD, Board
from calib.errors import CalibError


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
