"""A board in a picture: its corners, or the reason why there are none to use."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from calib.boards.board import Board
from calib.boards.corners.markers import find_markers, no_markers
from calib.boards.detection.board_search import BoardView, blur_of, reason_of_nothing, search_board
from tests.boards.board_views import (
    CHARUCO_BOARD,
    CHESS_BOARD,
    KALIBR_BOARD,
    SINGLE_TAG,
    TAG_BOARD,
    View,
    render,
)

NEAR = View(tilt=(10, 5, 20), middle=(0, 0, 0.4))


def view_of(board: Board, image: Any, fewest: int = 12) -> BoardView:
    markers = no_markers()
    if board.markers:
        markers = find_markers(image, board.dictionary, border=board.border)
    return search_board(image, board, markers, fewest)


@pytest.mark.parametrize(
    "board",
    [CHARUCO_BOARD, CHESS_BOARD, TAG_BOARD, KALIBR_BOARD, SINGLE_TAG],
    ids=["charuco", "chessboard", "apriltag", "aprilgrid", "single tag"],
)
def test_all_corners(board: Board):
    view = view_of(board, render(board, NEAR))
    assert view.is_used
    assert view.is_complete
    assert view.ids.tolist() == list(range(len(board.corners)))
    assert view.visible == len(board.corners)
    error = view.pixels - NEAR.corners(board)
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 0.06
    assert view.rms < 0.06
    assert 0.0 < view.sigma.max() < 0.06


def test_an_aprilgrid_that_is_steep_and_blurred():
    steep = View(tilt=(50, 10, 20), middle=(0, 0, 0.35), size=(1000, 800), blur=1.2, noise=4)
    view = view_of(KALIBR_BOARD, render(KALIBR_BOARD, steep))
    assert view.is_used
    # Corners of tags that were not read are found by those of others.
    assert len(view.ids) == 48
    assert view.misread == 0
    error = view.pixels - steep.corners(KALIBR_BOARD)
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 0.15


def test_a_board_that_is_cut():
    image = render(CHARUCO_BOARD, View(middle=(0.17, 0, 0.35)))
    view = view_of(CHARUCO_BOARD, image)
    assert view.reason == "cut"
    assert 4 <= len(view.ids) < 12
    assert view_of(CHARUCO_BOARD, image, fewest=4).is_used


def test_a_board_that_is_hidden():
    image = np.array(render(CHARUCO_BOARD, View()))
    image[:, 330:] = 120
    view = view_of(CHARUCO_BOARD, image, 20)
    assert view.reason == "few_corners"
    assert view.visible == 24


def test_no_board():
    image = np.full((480, 640), 120, np.uint8)
    image[100:200, 100:300] = 30
    for board in (CHARUCO_BOARD, CHESS_BOARD, TAG_BOARD):
        assert view_of(board, image).reason == "no_board"
        assert reason_of_nothing(image, board) == "no_board"


def test_a_mirrored_print():
    image = render(CHARUCO_BOARD, replace(NEAR, mirrored=True))
    assert view_of(CHARUCO_BOARD, image).reason == "no_board"
    assert reason_of_nothing(image, CHARUCO_BOARD) == "mirrored"


@pytest.mark.parametrize("blur", [6.0, 10.0])
def test_a_blurred_board(blur: float):
    image = render(CHARUCO_BOARD, replace(NEAR, blur=blur, noise=1.0))
    assert view_of(CHARUCO_BOARD, image).reason == "no_board"
    assert reason_of_nothing(image, CHARUCO_BOARD) == "blurred"


@pytest.mark.parametrize("blur", [1.0, 2.0, 4.0, 8.0])
def test_blur_is_measured(blur: float):
    image = cv2.GaussianBlur(render(CHARUCO_BOARD, replace(NEAR, noise=0.0)), (0, 0), blur)
    assert blur_of(image) == pytest.approx(np.hypot(blur, 0.6), rel=0.2)


def test_another_layout():
    described = replace(CHARUCO_BOARD, columns=5, rows=7)
    view = view_of(described, render(CHARUCO_BOARD, NEAR))
    assert view.reason == "layout"
    assert len(view.ids) == 0


def test_two_boards_of_the_same_markers():
    left = render(CHARUCO_BOARD, View(middle=(-0.12, 0, 0.6)))
    right = render(CHARUCO_BOARD, View(middle=(0.12, 0.01, 0.6), tilt=(20, 0, 30)))
    image = np.concatenate([left[:, :320], right[:, 320:]], axis=1)
    assert view_of(CHARUCO_BOARD, image).reason == "two_boards"
