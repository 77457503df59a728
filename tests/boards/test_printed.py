"""Prints: scale, warp and the places of corners."""

from __future__ import annotations

import numpy as np
import pytest

from calib.boards.board import APRILTAG, CHARUCO, Board
from calib.boards.printed import Print, draw_print, print_scale, rescaled
from calib.errors import CalibError
from tests.boards.boards import CHARUCO_BOARD, CHESS_BOARD

BOARD = Board(
    pattern=CHARUCO, columns=10, rows=7, square=0.025, marker=0.019, dictionary="DICT_5X5_100"
)
TAGS = Board(
    pattern=APRILTAG,
    columns=6,
    rows=4,
    square=0.046,
    marker=0.036,
    dictionary="DICT_APRILTAG_36h11",
)


@pytest.mark.parametrize(
    ("board", "text", "drawn", "squares"),
    [
        (BOARD, "249.3 mm", 0.25, 10),
        (BOARD, "17.4cm", 0.175, 7),
        (BOARD, "25.1 mm", 0.025, 1),
        (BOARD, "99.7 mm / 4", 0.1, 4),
        (BOARD, "8.5 in / 9", 0.225, 9),
        (TAGS, "265 mm", 0.266, None),
        (TAGS, "229.5 mm/5", 0.23, 5),
    ],
)
def test_what_was_measured(board, text, drawn, squares):
    scale = print_scale(board, text)
    assert scale.drawn == pytest.approx(drawn)
    assert scale.squares == squares


def test_the_scale_and_its_standard_deviation():
    scale = print_scale(BOARD, "249.3 mm")
    assert scale.scale == pytest.approx(0.9972)
    assert scale.sigma == pytest.approx(0.3 / 249.3)
    board = rescaled(BOARD, scale)
    assert (board.square, board.marker, board.sigma_scale) == (0.02493, 0.018947, 0.0012)
    large = Board(
        pattern=CHARUCO, columns=10, rows=7, square=0.2, marker=0.15, dictionary="DICT_5X5_100"
    )
    assert print_scale(large, "2 m").sigma == 5e-4


@pytest.mark.parametrize(
    "text",
    [
        "213 mm",
        "249.3",
        "249.3 mm / 11",
        "249.3 mm / 0",
        "0 mm",
        "-3 mm",
        "/",
        "",
        "25 mm / 1.5",
        "3 deg",
    ],
)
def test_what_is_no_length_of_the_print(text):
    with pytest.raises(CalibError, match="--measured"):
        print_scale(BOARD, text)


def test_a_print_is_as_described_unless_told_otherwise():
    np.testing.assert_array_equal(Print(CHESS_BOARD).corners, CHESS_BOARD.corners)


def test_scale_stretches_within_the_plane_only():
    corners = Print(CHESS_BOARD, scale=(1.01, 0.98), warp=(1e-3, 0.0)).corners
    np.testing.assert_allclose(
        corners[:, :2], [1.01, 0.98] * CHESS_BOARD.corners[:, :2], rtol=1e-14
    )


def test_warp_lifts_the_middle_and_leaves_the_edges():
    printed = Print(CHESS_BOARD, warp=(2e-3, -3e-3))
    width, height = CHESS_BOARD.size
    x = np.array([0.5, 0.0, 0.5, 0.0, 0.25]) * width
    y = np.array([0.5, 0.5, 0.0, 0.0, 0.5]) * height
    expected = [-1e-3, -3e-3, 2e-3, 0.0, 0.75 * 2e-3 - 3e-3]
    np.testing.assert_allclose(printed.surface(x, y), expected, atol=1e-15)
    np.testing.assert_allclose(printed.points(x, y)[:, 2], expected, atol=1e-15)


def test_offsets_move_single_corners():
    offsets = np.zeros((35, 3))
    offsets[3] = [1e-4, -2e-4, 3e-4]
    moved = Print(CHESS_BOARD, offsets=offsets).corners - CHESS_BOARD.corners
    np.testing.assert_allclose(moved, offsets, atol=1e-17)


def test_between_corners_the_print_is_displaced_bilinearly():
    offsets = np.zeros((35, 3))
    offsets[0] = [1e-4, -2e-4, 0.0]
    printed = Print(CHESS_BOARD, offsets=offsets)
    square = CHESS_BOARD.square
    # The first corner, beyond it, half a square along x, half a square along both, the next corner.
    x = np.array([1.0, 0.2, 1.5, 1.5, 2.0]) * square
    y = np.array([1.0, 0.3, 1.0, 1.5, 1.0]) * square
    expected = np.outer([1.0, 1.0, 0.5, 0.25, 0.0], offsets[0, :2])
    np.testing.assert_allclose(printed.displacement(x, y), expected, atol=1e-15)
    assert not Print(CHESS_BOARD).displacement(x, y).any()


def test_drawn_prints_have_the_spread_that_the_description_states():
    prints = [draw_print(CHARUCO_BOARD, seed) for seed in range(400)]
    scales = np.array([printed.scale for printed in prints])
    warps = np.array([printed.warp for printed in prints])
    offsets = np.array([printed.offsets for printed in prints])
    assert abs(scales.mean() - 1.0) < 4 * 0.003 / 28
    np.testing.assert_allclose(scales.std(axis=0), CHARUCO_BOARD.sigma_scale, rtol=0.15)
    np.testing.assert_allclose(warps.std(axis=0), CHARUCO_BOARD.sigma_warp, rtol=0.15)
    np.testing.assert_allclose(offsets[..., :2].std(), CHARUCO_BOARD.sigma_corner, rtol=0.02)
    assert not offsets[..., 2].any()
    assert draw_print(CHARUCO_BOARD, 3).scale == prints[3].scale
