"""The measured print: over the whole pattern, one square, or several."""

from __future__ import annotations

import pytest

from calib.boards.board import APRILTAG, CHARUCO, Board
from calib.boards.print_scale import print_scale, rescaled
from calib.errors import CalibError

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
