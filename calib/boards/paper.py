"""Sheets of paper on which boards are printed: the place of the pattern, and the margins that it needs.

10 mm or the quiet zone
+------------------------------------+
|    |+--------------------------+   |
|  r ||                          |   |
|  u ||         pattern          |   |
|  l ||                          |   |
|  e |+--------------------------+   |
|  r   quiet zone                    |
|      ruler ------   text           |
+------------------------------------+
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from calib.boards.board import CHESSBOARD, Board
from calib.boards.dictionaries import DICTIONARIES
from calib.errors import CalibError, choices, did_you_mean

#: No particular paper: the sheet is as large as the pattern with its margins.
NO_PAPER = "none"

#: Width and height of papers in portrait [m].
PAPERS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {"a4": (0.210, 0.297), "a3": (0.297, 0.420), "letter": (0.2159, 0.2794)}
)

#: Papers on which rulers show inches too.
_INCHES = ("letter",)

#: Margin at the edges of the paper that printers leave white [m].
EDGE = 0.010

#: Width of the ruler to the left of the pattern [m].
SIDE_BAND = 0.006

#: Height of the ruler and the text below the pattern [m].
BOTTOM_BAND = 0.008

#: Smallest white margin between the pattern and anything else that is printed [m].
_LEAST_QUIET = 0.003

#: Smallest white margin around a chessboard, whose outer squares have no border of their own [m].
_CHESSBOARD_QUIET = 0.005

#: The smallest sheet without a paper: it has room for the rulers and the text [m].
_SMALLEST = (0.210, 0.140)

#: Difference of lengths that may be due to rounding [m].
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Sheet:
    """A sheet of paper with the place of the pattern on it; x to the right, y down from the upper left corner."""

    #: Width of the sheet [m].
    width: float
    #: Height of the sheet [m].
    height: float
    #: Upper left corner of the pattern on the sheet [m].
    origin: tuple[float, float]
    #: White margin around the pattern [m].
    quiet: float
    #: True if the rulers show inches besides millimetres.
    inches: bool = False


def module_size(board: Board) -> float:
    """Return the side of one bit of a board's markers [m]; 0 for a chessboard."""
    if board.pattern == CHESSBOARD:
        return 0.0
    return board.marker / (DICTIONARIES[board.dictionary].bits + 2)


def quiet_zone(board: Board) -> float:
    """Return the white margin that a pattern needs around it, at least one bit of its markers [m]."""
    least = _CHESSBOARD_QUIET if board.pattern == CHESSBOARD else _LEAST_QUIET
    return max(least, module_size(board))


def orientations(paper: str) -> tuple[tuple[float, float], ...]:
    """Return width and height of a paper, in landscape and in portrait [m].

    Raises:
        CalibError: There is no such paper.
    """
    if paper not in PAPERS:
        names = (*PAPERS, NO_PAPER)
        raise CalibError(
            f"The paper '{paper}' is not known{did_you_mean(paper, names)}; allowed are {choices(names)}."
        )
    width, height = PAPERS[paper]
    return (height, width), (width, height)


def margins(quiet: float) -> tuple[float, float]:
    """Return how much of the width and of the height of a sheet margins and rulers take [m].

    Args:
        quiet: White margin around the pattern [m].
    """
    outer = max(EDGE, quiet)
    return EDGE + SIDE_BAND + quiet + outer, outer + quiet + BOTTOM_BAND + EDGE


def sheet_for(board: Board, paper: str) -> Sheet | None:
    """Place a board on a paper, in landscape if it fits, otherwise in portrait, centred in what the rulers leave.

    Args:
        board: The board.
        paper: Name of the paper, of `PAPERS` or `NO_PAPER`.

    Returns:
        The sheet; None if the board does not fit.

    Raises:
        CalibError: There is no such paper.
    """
    quiet = quiet_zone(board)
    across, down = margins(quiet)
    needed = (board.size[0] + across, board.size[1] + down)
    sizes: tuple[tuple[float, float], ...]
    if paper == NO_PAPER:
        sizes = ((max(needed[0], _SMALLEST[0]), max(needed[1], _SMALLEST[1])),)
    else:
        sizes = orientations(paper)
    for width, height in sizes:
        if needed[0] <= width + _ROUNDING and needed[1] <= height + _ROUNDING:
            x = EDGE + SIDE_BAND + quiet + (width - across - board.size[0]) / 2.0
            y = max(EDGE, quiet) + (height - down - board.size[1]) / 2.0
            return Sheet(width, height, (x, y), quiet, paper in _INCHES)
    return None
