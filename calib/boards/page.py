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

#: Lengths of the rulers [m]; the longest one that fits is taken.
_RULERS = (0.1, 0.05, 0.02)

#: Width of the rulers' lines [m].
_LINE = 0.0002

#: Distance between ticks [m].
_STEP = 0.005

#: Length of the ticks at every 50 mm, 10 mm and 5 mm [m]; ticks of inches are like those at 10 mm.
_TICKS = (0.003, 0.002, 0.0012)

#: Size of the font: from the top of its tallest letters to the bottom of its deepest [m].
TEXT_SIZE = 0.0023

#: Distance between lines of text [m].
_LEADING = 0.0027

#: Distance of the text from the start of the label at the end of the ruler [m].
_GAP = 0.011

#: Width of the ruler below the pattern with its text; below a small pattern they begin further left [m].
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
    #: The same for the lines of the rulers, shape (n, 4) [m].
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
        lines: Lines of text, at most three, to print below the pattern.

    Returns:
        The page.
    """
    pattern = black_rectangles(board)
    pattern[:, :2] += sheet.origin
    x, y = sheet.origin
    below = y + board.size[1] + sheet.quiet

    # The ruler below the pattern, and the texts after its end.
    leftmost = max(EDGE + SIDE_BAND, min(x, sheet.width - EDGE - _RULER_AND_TEXT))
    length = _ruler_length(sheet.width - leftmost - EDGE)
    across = _ruler(length, inches=sheet.inches)
    across[:, :2] += (leftmost, below)
    end = leftmost + length + 0.001
    texts = [Text((end, below + TEXT_SIZE), f"{1e3 * length:.0f} mm")]
    if sheet.inches:
        inches = round(length / _INCH)
        texts.append(Text((leftmost + inches * _INCH + 0.001, below + 0.006), f"{inches} in"))

    # The ruler beside the pattern, its ticks pointing away; its texts stay as narrow as it is.
    left = x - sheet.quiet - SIDE_BAND
    length = _ruler_length(below - y)
    down = _ruler(length, inches=sheet.inches)[:, [1, 0, 3, 2]]
    down[:, 0] = SIDE_BAND - down[:, 0] - down[:, 2]
    down[:, :2] += (left, y)
    bottom = float(np.max(down[:, 1] + down[:, 3]))
    for k, word in enumerate((f"{1e3 * length:.0f}", "mm"), 1):
        texts.append(Text((left + 0.0015, bottom + k * _LEADING), word))

    for k, line in enumerate(lines):
        texts.append(Text((end + _GAP, below + TEXT_SIZE + k * _LEADING), line))
    return Page(
        sheet.width,
        sheet.height,
        pattern,
        np.concatenate([across, down]),
        tuple(texts),
        board.name,
    )


def _ruler_length(room: float) -> float:
    """Return the longest ruler that fits, or else the shortest [m]."""
    fitting = [length for length in _RULERS if length <= room]
    return fitting[0] if fitting else _RULERS[-1]


def _ruler(length: float, *, inches: bool) -> Array:
    """Return the lines of a ruler along x, its ticks downwards from y = 0, shape (n, 4) [m].

    The length is that between the middles of the first and the last tick. Ticks of inches hang from a second line.
    """
    half = _LINE / 2.0
    fifty, ten, five = _TICKS
    lines = [(-half, 0.0, length + _LINE, _LINE)]
    for k in range(round(length / _STEP) + 1):
        tick = five
        if k % 10 == 0:
            tick = fifty
        elif k % 2 == 0:
            tick = ten
        lines.append((k * _STEP - half, _LINE, _LINE, tick - _LINE))
    if inches:  # 4 below 100 mm, 2 below 50 mm
        count = round(length / _INCH)
        level = fifty + 0.001
        lines.append((-half, level, count * _INCH + _LINE, _LINE))
        lines += [(k * _INCH - half, level + _LINE, _LINE, ten) for k in range(count + 1)]
    return np.array(lines)
