"""A board for a paper: what is not given is chosen so that the board is as large as fits and easy to find.

A ChArUco board gets an odd number of rows if the number is free, because then it is the same in all versions of OpenCV;
a chessboard gets an even and an odd number, because otherwise it looks the same after half a turn. A marker is as large
as leaves one of its bits white around it, which its detection needs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from calib.boards.board import (
    APRILGRID,
    APRILTAG,
    ASYMMETRIC_CIRCLES,
    BODY,
    CHARUCO,
    CHESSBOARD,
    CIRCLES,
    PATTERNS,
    ROUND,
    TAGS,
    Board,
)
from calib.boards.board_page import NO_PAPER, Sheet, margins, quiet_zone, sheet_for, sizes_of_paper
from calib.boards.dictionaries import DICTIONARIES, dictionary_of
from calib.errors import CalibError, choices, did_you_mean

#: Default columns and rows of each pattern: 54 corners, 54 corners, 96 corners of 24 tags.
_COUNTS: Mapping[str, tuple[int, int]] = {
    CHARUCO: (10, 7),
    CHESSBOARD: (10, 7),
    APRILTAG: (6, 4),
    APRILGRID: (6, 4),
    CIRCLES: (9, 6),
    ASYMMETRIC_CIRCLES: (5, 7),
}

#: Default dictionaries of each pattern; the first that is large enough is taken.
_DICTIONARIES: Mapping[str, tuple[str, ...]] = {
    CHARUCO: ("DICT_5X5_100", "DICT_5X5_250", "DICT_5X5_1000"),
    CHESSBOARD: ("",),
    APRILTAG: ("DICT_APRILTAG_36h11", "DICT_APRILTAG_36h10"),
    APRILGRID: ("DICT_APRILTAG_36h11",),
    CIRCLES: ("",),
    ASYMMETRIC_CIRCLES: ("",),
}

#: Usual sides of tags, or diameters of circles, in distances of their centres: Kalibr leaves 0.3 of a tag between tags,
#: and OpenCV's circles are half a distance wide, asymmetric ones nearly a distance of rows.
_USUAL_SHARES: Mapping[str, float] = {APRILGRID: 1.0 / 1.3, CIRCLES: 0.5, ASYMMETRIC_CIRCLES: 0.8}

#: Side of a square if nothing limits it [mm].
_SQUARE = 30

#: Smallest square that is chosen: a printer still prints it sharply [mm].
_SMALLEST_SQUARE = 3

#: Largest number of columns or rows that is chosen.
_MOST = 200

#: Markers smaller than this are chosen in tenths of a millimetre, larger ones in whole millimetres [mm].
_FINE = 10.0

#: Makes the board with these columns, rows and side of a square [m].
_Make = Callable[[int, int, float], Board]


def design(
    paper: str,
    *,
    pattern: str = CHARUCO,
    columns: int | None = None,
    rows: int | None = None,
    square: float | None = None,
    marker: float | None = None,
    dictionary: str | None = None,
    first_marker: int = 0,
    **others: Any,  # noqa: ANN401
) -> Board:
    """Design a board: choose what is not given so that it is as large as fits on a paper.

    Args:
        paper: Name of the paper, of `PAPERS`; or `NO_PAPER`: nothing limits the size.
        pattern: One of `PATTERNS`.
        columns: Number of squares, or tags, along x; None: chosen.
        rows: Number of squares, or tags, along y; None: chosen.
        square: Side of a square, or distance between the centres of tags [m]; None: chosen.
        marker: Side of a marker or tag [m]; None: chosen. A chessboard has none.
        dictionary: Name of OpenCV's dictionary of markers; None: the smallest usual one that is large enough. A
            chessboard has none.
        first_marker: Id of the first marker.
        others: Further attributes of `Board`, which do not matter for what is chosen.

    Returns:
        The board.

    Raises:
        CalibError: It does not fit, the dictionary is too small, or what is given is not a board.
    """
    if pattern not in PATTERNS:
        raise CalibError(
            f"The pattern '{pattern}' is not known{did_you_mean(pattern, PATTERNS)}; allowed are {choices(PATTERNS)}."
        )
    if pattern == BODY:
        raise CalibError(
            "A body of tags is described in a file, with the id and the corners of each tag; it is not drawn on a page."
        )
    for given, attribute in ((marker, "marker"), (dictionary, "dictionary")):
        if given is not None and attribute not in PATTERNS[pattern]:
            raise CalibError(f"The pattern {pattern} has no {attribute}; leave it out.")
    for count in (columns, rows):
        if count is not None and count < 1:
            raise CalibError(f"A board has 1 or more columns and rows, not {count}.")
    if paper != NO_PAPER:
        sizes_of_paper(paper)  # refuses an unknown paper

    def make(columns: int, rows: int, square: float) -> Board:
        """Return the board with these counts and this side of a square [m], what else is not given chosen."""
        # The first dictionary of the pattern that is large enough, or the largest.
        names = _DICTIONARIES[pattern]
        count = columns * rows // 2 if pattern == CHARUCO else columns * rows
        chosen = dictionary or names[-1]
        if not dictionary and names[0]:
            last = first_marker + count
            chosen = next((n for n in names if last <= DICTIONARIES[n].markers), names[-1])
        side = marker
        if side is None:
            side = _largest_marker(pattern, square, chosen)
        return Board(
            pattern=pattern,
            columns=columns,
            rows=rows,
            square=square,
            marker=side,
            dictionary=chosen,
            first_marker=first_marker,
            **others,
        )

    default_columns, default_rows = _COUNTS[pattern]
    if square is None:
        # The largest squares of whole millimetres that fit.
        columns, rows = columns or default_columns, rows or default_rows
        if paper == NO_PAPER:
            return make(columns, rows, _SQUARE / 1e3)
        longest = max(sizes_of_paper(paper)[0])
        for millimetres in range(
            int(1e3 * longest / max(columns, rows)) + 1, _SMALLEST_SQUARE - 1, -1
        ):
            if marker is not None and millimetres / 1e3 <= marker:
                break
            board = make(columns, rows, millimetres / 1e3)
            if sheet_for(board, paper) is not None:
                return board
        least = f"{_SMALLEST_SQUARE} mm"
        if marker is not None:
            least = f"more than the marker's {1e3 * marker:g} mm"
        raise CalibError(
            f"{columns} columns and {rows} rows of squares of {least} do not fit on {paper}; ask for fewer, or take a "
            "larger paper."
        )

    if paper != NO_PAPER and (columns is None or rows is None):
        columns, rows = _most_squares(make, (columns, rows), square, paper)
    board = make(columns or default_columns, rows or default_rows, square)
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
    if sheet is not None:
        return sheet
    width, height = board.size
    message = (
        f"{board.columns} columns and {board.rows} rows of squares of {1e3 * board.square:g} mm are "
        f"{1e3 * width:g} x {1e3 * height:g} mm, which does not fit on {paper} with its margins and rulers."
    )
    try:
        largest = design(
            paper,
            pattern=board.pattern,
            columns=board.columns,
            rows=board.rows,
            dictionary=board.dictionary or None,
            first_marker=board.first_marker,
        )
    except CalibError:
        raise CalibError(f"{message} Ask for fewer, or take a larger paper.") from None
    raise CalibError(
        f"{message} The largest squares that fit are {1e3 * largest.square:g} mm; or ask for fewer, or take a larger "
        f"paper, or '{NO_PAPER}' for a print shop."
    )


def _largest_marker(pattern: str, square: float, dictionary: str) -> float:
    """Return the largest side m of a marker with one of its bits white around it [m]: m (1 + 2 / bits) <= square.

    The bits are those along a side, border included. m is rounded down to millimetres, a small one to tenths of them.
    The tags of an aprilgrid, and circles, have a usual size; a chessboard has no markers.
    """
    if pattern == CHESSBOARD:
        return 0.0
    if pattern in _USUAL_SHARES:
        largest_mm = 1e3 * square * _USUAL_SHARES[pattern]
    else:
        known = dictionary_of(dictionary)
        if known is None:
            return square / 2.0  # the board refuses the dictionary
        largest_mm = 1e3 * square / (1.0 + 2.0 / (known.bits + 2))
    if largest_mm < _FINE:
        return math.floor(10.0 * largest_mm + 1e-6) / 10.0 / 1e3
    return math.floor(largest_mm + 1e-6) / 1e3


def _most_squares(
    make: _Make, given: tuple[int | None, int | None], square: float, paper: str
) -> tuple[int | None, int | None]:
    """Choose those of the ``given`` columns and rows that are None: as many squares of a side [m] as fit on a paper.

    A ChArUco board gets an odd number of rows, a chessboard an odd sum of columns and rows. What is None stays None if
    too few squares fit.
    """
    columns, rows = given
    smallest = make(columns or 3, rows or 3, square)
    across, down = margins(quiet_zone(smallest))
    # There is no gap after the last tag or circle of a row.
    gap = square - smallest.marker if smallest.pattern in (*TAGS, *ROUND) else 0.0
    best = given
    most = 0
    for width, height in sizes_of_paper(paper):
        step = 2.0 * square if smallest.pattern == ASYMMETRIC_CIRCLES else square
        fitting_columns = math.floor((width - across + gap) / step + 1e-6)
        fitting_rows = math.floor((height - down + gap) / square + 1e-6)
        chosen_columns = columns or fitting_columns
        chosen_rows = rows or fitting_rows
        if rows is None and smallest.pattern == CHARUCO and chosen_rows > 3:
            chosen_rows -= 1 - chosen_rows % 2
        if smallest.pattern == CHESSBOARD and (chosen_columns + chosen_rows) % 2 == 0:
            if rows is None:
                chosen_rows -= 1
            else:
                chosen_columns -= 1
        if smallest.pattern == ASYMMETRIC_CIRCLES and rows is None:
            # With an odd number of rows it is known which end is the first.
            chosen_rows -= 1 - chosen_rows % 2
        fewest = 1 if smallest.pattern in TAGS else 3
        counts = (chosen_columns, chosen_rows)
        is_board = min(counts) >= fewest and max(counts) <= _MOST
        fits = chosen_columns <= fitting_columns and chosen_rows <= fitting_rows
        if is_board and fits and chosen_columns * chosen_rows > most:
            best = counts
            most = chosen_columns * chosen_rows
    return best
