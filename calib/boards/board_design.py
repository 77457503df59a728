"""A board for a paper: what is not given is chosen so that the board is as large as fits and easy to find.

A ChArUco board gets an odd number of rows where the number is free, for then the layouts of all versions of OpenCV are
the same; a chessboard gets an even and an odd number, without which it looks the same after half a turn. A marker is
as large as leaves one of its bits white around it, which its detection needs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NoReturn

from calib.boards.board import APRILTAG, CHARUCO, CHESSBOARD, PATTERNS, Board
from calib.boards.dictionaries import DICTIONARIES
from calib.boards.paper import NO_PAPER, Sheet, margins, orientations, quiet_zone, sheet_for
from calib.errors import CalibError, choices, did_you_mean

#: Columns and rows of each pattern where none are given: 54 corners, 54 corners, 96 corners of 24 tags.
_COUNTS: Mapping[str, tuple[int, int]] = {CHARUCO: (10, 7), CHESSBOARD: (10, 7), APRILTAG: (6, 4)}

#: Dictionaries where none is given; the first that is large enough is taken.
_DICTIONARIES: Mapping[str, tuple[str, ...]] = {
    CHARUCO: ("DICT_5X5_100", "DICT_5X5_250", "DICT_5X5_1000"),
    CHESSBOARD: ("",),
    APRILTAG: ("DICT_APRILTAG_36h11", "DICT_APRILTAG_36h10"),
}

#: Side of a square where nothing limits it [mm].
_SQUARE = 30

#: Smallest square that is chosen: what a printer still prints sharp [mm].
_SMALLEST_SQUARE = 3

#: Largest number of columns or rows that is tried.
_MOST = 200

#: Markers below this are chosen in tenths of a millimetre, larger ones in whole millimetres [mm].
_FINE = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """A specification of a board, some of it open: None is to be chosen."""

    #: Name of the board.
    name: str = "board"
    #: Pattern, of `PATTERNS`.
    pattern: str = CHARUCO
    #: Squares, or tags, along x.
    columns: int | None = None
    #: Squares, or tags, along y.
    rows: int | None = None
    #: Side of a square, or distance of two tags' centres [m].
    square: float | None = None
    #: Side of a marker or tag [m].
    marker: float | None = None
    #: Name of the dictionary.
    dictionary: str | None = None
    #: Id of the first marker.
    first_marker: int = 0
    #: Whether an even number of rows is laid out as by OpenCV before 4.6.
    legacy: bool = False


def designed(wish: Wish, paper: str) -> Board:
    """Choose what is not given of a board so that it is as large as fits on a paper.

    Args:
        wish: What is given.
        paper: Name of the paper, of `PAPERS` or `NO_PAPER`.

    Returns:
        The board.

    Raises:
        CalibError: It does not fit, the dictionary is too small, or what is given makes no board.
    """
    if wish.pattern not in PATTERNS:
        raise CalibError(
            f"The pattern '{wish.pattern}' is not known{did_you_mean(wish.pattern, PATTERNS)}; allowed are "
            f"{choices(PATTERNS)}."
        )
    if wish.pattern == CHESSBOARD and (wish.marker is not None or wish.dictionary is not None):
        raise CalibError("A chessboard has no markers; leave out the marker and the dictionary.")
    if paper != NO_PAPER:
        orientations(paper)  # refuses an unknown paper
    if wish.square is not None and paper != NO_PAPER:
        wish = _with_most_squares(wish, wish.square, paper)
    columns, rows = _COUNTS[wish.pattern]
    wish = replace(wish, columns=wish.columns or columns, rows=wish.rows or rows)
    if wish.square is None:
        return _largest(wish, paper)
    board = _board(wish, wish.square)
    fitting_sheet(board, paper)
    return board


def fitting_sheet(board: Board, paper: str) -> Sheet:
    """Place a board on a paper, see `sheet_for`.

    Args:
        board: The board.
        paper: Name of the paper, of `PAPERS` or `NO_PAPER`.

    Returns:
        The sheet, with the place of the pattern on it.

    Raises:
        CalibError: It does not fit; the message says what does.
    """
    sheet = sheet_for(board, paper)
    if sheet is None:
        _fail_to_fit(board, paper)
    return sheet


def _board(wish: Wish, square: float) -> Board:
    """Make a board with squares of a size; counts are given."""
    columns, rows = wish.columns or 0, wish.rows or 0
    dictionary = wish.dictionary or _dictionary(wish, columns * rows)
    marker = wish.marker
    if marker is None:
        marker = 0.0 if wish.pattern == CHESSBOARD else _marker(square, dictionary)
    return Board(
        name=wish.name,
        pattern=wish.pattern,
        columns=columns,
        rows=rows,
        square=square,
        marker=marker,
        dictionary=dictionary,
        first_marker=wish.first_marker,
        legacy=wish.legacy,
    )


def _dictionary(wish: Wish, squares: int) -> str:
    """Return the first dictionary of the pattern that is large enough; the largest if none is."""
    names = _DICTIONARIES[wish.pattern]
    if wish.pattern == CHESSBOARD:
        return names[0]
    count = squares // 2 if wish.pattern == CHARUCO else squares
    for name in names:
        if wish.first_marker + count <= DICTIONARIES[name].markers:
            return name
    return names[-1]


def _marker(square: float, dictionary: str) -> float:
    """Return the largest marker that leaves one of its bits white around it [m]."""
    if dictionary not in DICTIONARIES:
        return square / 2.0  # the board refuses the dictionary
    bits = DICTIONARIES[dictionary].bits + 2
    largest_mm = 1e3 * square / (1.0 + 2.0 / bits)
    if largest_mm < _FINE:
        return math.floor(10.0 * largest_mm + 1e-6) / 10.0 / 1e3
    return math.floor(largest_mm + 1e-6) / 1e3


def _largest(wish: Wish, paper: str) -> Board:
    """Return the board with the largest squares of whole millimetres that fit."""
    if paper == NO_PAPER:
        return _board(wish, _SQUARE / 1e3)
    longest = max(orientations(paper)[0])
    fewest = max(wish.columns or 1, wish.rows or 1)
    for millimetres in range(int(1e3 * longest / fewest) + 1, _SMALLEST_SQUARE - 1, -1):
        if wish.marker is not None and millimetres / 1e3 <= wish.marker:
            break
        board = _board(wish, millimetres / 1e3)
        if sheet_for(board, paper) is not None:
            return board
    least = f"{_SMALLEST_SQUARE} mm"
    if wish.marker is not None:
        least = f"more than the marker's {1e3 * wish.marker:g} mm"
    raise CalibError(
        f"{wish.columns} columns and {wish.rows} rows of squares of {least} do not fit on {paper}; ask for fewer, or "
        "take a larger paper."
    )


def _with_most_squares(wish: Wish, square: float, paper: str) -> Wish:
    """Choose the counts that are not given: as many squares of a size as fit on a paper."""
    if wish.columns is not None and wish.rows is not None:
        return wish
    best = wish
    for size in orientations(paper):
        filled = _filling(wish, square, size)
        if filled is not None and _count(filled) > _count(best):
            best = filled
    return best


def _count(wish: Wish) -> int:
    """Return the number of squares; 0 if it is not known yet."""
    return (wish.columns or 0) * (wish.rows or 0)


def _filling(wish: Wish, square: float, size: tuple[float, float]) -> Wish | None:
    """Choose the counts that are not given for a sheet of a size; None if the sheet is too small for any board."""
    smallest = replace(wish, columns=wish.columns or 3, rows=wish.rows or 3)
    board = _board(smallest, square)
    across, down = margins(quiet_zone(board))
    # The last of a row of tags has no gap behind it.
    gap = square - board.marker if wish.pattern == APRILTAG else 0.0
    fitting_columns = math.floor((size[0] - across + gap) / square + 1e-6)
    fitting_rows = math.floor((size[1] - down + gap) / square + 1e-6)
    columns = wish.columns or fitting_columns
    rows = wish.rows or fitting_rows
    if wish.rows is None and wish.pattern == CHARUCO and rows > 3:
        rows -= 1 - rows % 2
    if wish.pattern == CHESSBOARD and (columns + rows) % 2 == 0:
        if wish.rows is None:
            rows -= 1
        else:
            columns -= 1
    is_board = min(columns, rows) >= 3 or (wish.pattern == APRILTAG and min(columns, rows) >= 1)
    if (
        not is_board
        or columns > fitting_columns
        or rows > fitting_rows
        or max(columns, rows) > _MOST
    ):
        return None
    return replace(wish, columns=columns, rows=rows)


def _fail_to_fit(board: Board, paper: str) -> NoReturn:
    """Refuse a board that is too large, and say what fits."""
    width, height = board.size
    wish = Wish(
        pattern=board.pattern,
        columns=board.columns,
        rows=board.rows,
        dictionary=board.dictionary,
        first_marker=board.first_marker,
    )
    message = (
        f"{board.columns} columns and {board.rows} rows of squares of {1e3 * board.square:g} mm are "
        f"{1e3 * width:g} x {1e3 * height:g} mm, which does not fit on {paper} with its margins and rulers."
    )
    try:
        largest = _largest(wish, paper)
    except CalibError:
        raise CalibError(f"{message} Ask for fewer, or take a larger paper.") from None
    raise CalibError(
        f"{message} The largest squares that fit are {1e3 * largest.square:g} mm; or ask for fewer, or take a larger "
        f"paper, or '{NO_PAPER}' for a print shop."
    )
