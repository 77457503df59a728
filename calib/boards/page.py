"""Pages with a board: the pattern, two rulers to check the scale of the print, and lines of text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array
from calib.basics.values import Value
from calib.boards.board import Board
from calib.boards.drawing import black_rectangles
from calib.boards.paper import EDGE, SIDE_BAND, Sheet

#: Lengths of the rulers [m]; the longest that has room is taken.
_RULERS = (0.1, 0.05, 0.02)

#: Width of the rulers' lines [m].
_LINE = 0.0002

#: Distance of two ticks [m].
_STEP = 0.005

#: Length of the ticks at every 50 mm, 10 mm and 5 mm, and of those of inches [m].
_TICKS = (0.003, 0.002, 0.0012)

#: Size of the font: from the top of its tallest letters to the bottom of its deepest [m].
TEXT_SIZE = 0.0023

#: Distance of two lines of text [m].
_LEADING = 0.0027

#: Distance of the text from the beginning of the label at the end of the ruler [m].
_GAP = 0.011

#: Width of the ruler below the pattern with its text: beside a small pattern they begin further left [m].
_RULER_AND_TEXT = 0.18

#: An inch [m].
_INCH = 0.0254


@dataclass(frozen=True, slots=True)
class Text:
    """A line of text."""

    #: Left end of its baseline on the page, x to the right, y down [m].
    at: tuple[float, float]
    #: The text.
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Page(Value):
    """A page to print: black rectangles and text on white."""

    #: Width of the page [m].
    width: float
    #: Height of the page [m].
    height: float
    #: x and y of the upper left corner, width and height of the pattern's rectangles, shape (n, 4) [m].
    pattern: Array
    #: The same of the rulers' lines, shape (n, 4) [m].
    lines: Array
    #: Texts, in a font of `TEXT_SIZE`.
    texts: tuple[Text, ...]
    #: Title of the document.
    title: str


def page_of(board: Board, sheet: Sheet, lines: Sequence[str]) -> Page:
    """Draw the page of a board.

    Args:
        board: The board.
        sheet: The paper and the place of the pattern on it.
        lines: Lines of text, at most three, which are printed below the pattern.

    Returns:
        The page.
    """
    pattern = black_rectangles(board)
    pattern[:, :2] += sheet.origin
    x, y = sheet.origin
    below = y + board.size[1] + sheet.quiet
    leftmost = max(EDGE + SIDE_BAND, min(x, sheet.width - EDGE - _RULER_AND_TEXT))
    across, labels_across = _ruler_across(sheet, leftmost, below)
    down, labels_down = _ruler_down(sheet, below - y)
    texts = _paragraph(lines, labels_across[0].at[0] + _GAP, below + TEXT_SIZE)
    return Page(
        sheet.width,
        sheet.height,
        pattern,
        np.concatenate([across, down]),
        (*labels_across, *labels_down, *texts),
        board.name,
    )


def _paragraph(lines: Sequence[str], x: float, y: float) -> list[Text]:
    """Return lines of text below each other, the first with its baseline at y [m]."""
    return [Text((x, y + k * _LEADING), line) for k, line in enumerate(lines)]


def _ruler_across(sheet: Sheet, x: float, y: float) -> tuple[Array, list[Text]]:
    """Draw the ruler below the pattern: its lines, shape (n, 4) [m], and the texts at its end.

    Args:
        sheet: The sheet.
        x: Left end of the ruler [m].
        y: Its upper edge [m].
    """
    length = _ruler_length(sheet.width - x - EDGE)
    lines = _ruler(length, inches=sheet.inches)
    lines[:, :2] += (x, y)
    labels = [Text((x + length + 0.001, y + TEXT_SIZE), f"{1e3 * length:.0f} mm")]
    if sheet.inches:
        inches = _inches_of(length)
        labels.append(Text((x + inches * _INCH + 0.001, y + 0.006), f"{inches} in"))
    return lines, labels


def _ruler_down(sheet: Sheet, room: float) -> tuple[Array, list[Text]]:
    """Draw the ruler beside the pattern, its ticks away from it; the texts stay as narrow as it is.

    Args:
        sheet: The sheet.
        room: Length that has room above the ruler below the pattern [m].
    """
    x = sheet.origin[0] - sheet.quiet - SIDE_BAND
    y = sheet.origin[1]
    length = _ruler_length(room)
    lines = _ruler(length, inches=sheet.inches)[:, [1, 0, 3, 2]]
    lines[:, 0] = SIDE_BAND - lines[:, 0] - lines[:, 2]
    lines[:, :2] += (x, y)
    end = float(np.max(lines[:, 1] + lines[:, 3]))
    words = (f"{1e3 * length:.0f}", "mm")
    labels = [Text((x + 0.0015, end + (k + 1) * _LEADING), word) for k, word in enumerate(words)]
    return lines, labels


def _ruler_length(room: float) -> float:
    """Return the longest ruler that has room [m]."""
    fitting = [length for length in _RULERS if length <= room]
    return fitting[0] if fitting else _RULERS[-1]


def _ruler(length: float, *, inches: bool) -> Array:
    """Return the lines of a ruler along x, its ticks downwards from y = 0, shape (n, 4) [m].

    The middle of the first and of the last tick are the ends of the length. Ticks of inches hang from a second line.
    """
    half = _LINE / 2.0
    lines = [(-half, 0.0, length + _LINE, _LINE)]
    count = round(length / _STEP) + 1
    lines += [(k * _STEP - half, _LINE, _LINE, _tick(k) - _LINE) for k in range(count)]
    if inches:
        lines += _inches(_inches_of(length))
    return np.array(lines)


def _tick(k: int) -> float:
    """Return the length of the tick at k times 5 mm [m]."""
    if k % 10 == 0:
        return _TICKS[0]
    return _TICKS[1] if k % 2 == 0 else _TICKS[2]


def _inches_of(length: float) -> int:
    """Return the number of inches beside a ruler in millimetres: 4 beside 100 mm, 2 beside 50 mm."""
    return round(length / _INCH)


def _inches(count: int) -> list[tuple[float, float, float, float]]:
    """Return a line of inches below that of millimetres."""
    half = _LINE / 2.0
    level = _TICKS[0] + 0.001
    lines = [(-half, level, count * _INCH + _LINE, _LINE)]
    lines += [(k * _INCH - half, level + _LINE, _LINE, _TICKS[1]) for k in range(count + 1)]
    return lines
