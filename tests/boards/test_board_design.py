"""Boards that are chosen for a paper, and those that do not fit."""

from __future__ import annotations

from itertools import product

import pytest

from calib.boards.board import APRILTAG, BODY, CHARUCO, CHESSBOARD, PATTERNS
from calib.boards.board_design import design
from calib.boards.board_page import PAPERS, module_size, sheet_for
from calib.errors import CalibError


def size(board):
    return board.columns, board.rows, round(1e3 * board.square, 3), round(1e3 * board.marker, 3)


@pytest.mark.parametrize(
    ("pattern", "expected"),
    [
        (CHARUCO, (10, 7, 25, 19)),
        (CHESSBOARD, (10, 7, 25, 0)),
        (APRILTAG, (6, 4, 46, 36)),
    ],
)
def test_the_default_board_for_a4(pattern, expected):
    assert size(design("a4", pattern=pattern)) == expected


@pytest.mark.parametrize(("pattern", "paper"), [*product(sorted(set(PATTERNS) - {BODY}), PAPERS)])
def test_squares_are_as_large_as_fits(pattern, paper):
    board = design(paper, pattern=pattern)
    assert sheet_for(board, paper) is not None
    with pytest.raises(CalibError, match=f"largest squares that fit are {1e3 * board.square:g} mm"):
        design(
            paper,
            pattern=pattern,
            columns=board.columns,
            rows=board.rows,
            square=board.square + 0.001,
        )


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        # Upright with 7 of the 8 rows that fit, for rows are odd; lying it would be 8 x 5.
        ({"square": 0.03}, (6, 7, 30, 23)),
        ({"square": 0.04, "columns": 4}, (4, 5, 40, 31)),
        # Columns and rows together are odd.
        ({"pattern": CHESSBOARD, "square": 0.03}, (8, 5, 30, 0)),
        ({"pattern": CHESSBOARD, "square": 0.03, "rows": 6}, (5, 6, 30, 0)),
        ({"pattern": APRILTAG, "square": 0.05}, (5, 3, 50, 40)),
    ],
)
def test_of_squares_of_a_size_as_many_as_fit(given, expected):
    board = design("a4", **given)
    assert size(board) == expected
    assert sheet_for(board, "a4") is not None


def test_a_marker_leaves_a_module_white_around_it():
    for millimetres in range(8, 60):
        board = design("none", square=millimetres / 1e3)
        gap = (board.square - board.marker) / 2
        assert gap >= module_size(board) - 1e-9
        larger = board.marker + 0.001
        assert (board.square - larger) / 2 < larger / 7


def test_the_dictionary_grows_with_the_board():
    assert design("a3", columns=21, rows=11).dictionary == "DICT_5X5_250"
    assert design("a4", first_marker=90).dictionary == "DICT_5X5_250"
    with pytest.raises(CalibError, match="Large enough are 'DICT_5X5_100'"):
        design("a4", columns=15, rows=11, dictionary="DICT_5X5_50")


@pytest.mark.parametrize(
    ("given", "paper", "text"),
    [
        ({"pattern": "charuko"}, "a4", "did you mean 'charuco'"),
        ({}, "a5", "paper 'a5'"),
        ({"pattern": BODY}, "a4", "described in a file"),
        ({"columns": 0}, "a4", "1 or more columns and rows, not 0"),
        ({"rows": -2, "square": 0.03}, "a4", "1 or more columns and rows, not -2"),
        ({"first_marker": -1}, "a4", "the first with the id -1"),
        ({"pattern": CHESSBOARD, "marker": 0.01}, "a4", "has no marker"),
        ({"columns": 100, "rows": 100}, "a4", "5000 markers"),
        ({"pattern": CHESSBOARD, "columns": 100, "rows": 100}, "a4", "do not fit"),
        ({"marker": 0.03}, "a4", "more than the marker's 30 mm"),
        ({"square": 0.2}, "a4", "does not fit on a4"),
        ({"square": 0.02, "marker": 0.02}, "a4", "smaller than the squares"),
        ({"dictionary": "DICT_5X5_99"}, "a4", "did you mean"),
    ],
)
def test_what_cannot_be_drawn(given, paper, text):
    with pytest.raises(CalibError, match=text):
        design(paper, **given)
