"""The scale of a print: what was measured on it against what was drawn."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from calib.basics.units import LENGTH, parse_amount
from calib.basics.value_forms import shift_decimal
from calib.boards.board import Board
from calib.errors import CalibError

#: Standard deviation of a length read from a ruler [m].
READING = 0.0003

#: Smallest relative standard deviation of a measurement: paper changes its size with humidity.
_BEST = 5e-4

#: Largest relative difference of a measured length from that of the whole pattern.
_NEAR = 0.05

#: Example of a measured length, for messages.
_EXAMPLE = "249.3 mm / 10"


@dataclass(frozen=True, slots=True)
class PrintScale:
    """A measurement of the scale of a print."""

    #: Length measured [m].
    measured: float
    #: The same length as drawn [m].
    drawn: float
    #: Number of squares in it, or of distances between tags; None for the whole pattern of a grid of tags.
    squares: int | None

    @property
    def scale(self) -> float:
        """Measured over drawn."""
        return self.measured / self.drawn

    @property
    def sigma(self) -> float:
        """Standard deviation of the scale."""
        return max(READING / self.measured, _BEST)


def print_scale(board: Board, text: str) -> PrintScale:
    """Read what was measured on a print: the whole pattern, one square, or several squares.

    Args:
        board: The board as drawn.
        text: ``"249.3 mm"``, or over a number of squares ``"249.3 mm / 10"``.

    Returns:
        The scale of the print.

    Raises:
        CalibError: It is not a length, or is not close to the pattern's width, its height or a square.
    """
    amount, slash, squares = text.partition("/")
    length = parse_amount(amount, "--measured", LENGTH, _EXAMPLE)
    is_count = re.fullmatch(r"\s*[0-9]{1,4}\s*", squares)
    if length <= 0.0 or (slash and not is_count):
        raise CalibError(
            f'--measured was given as "{text}"; it must be a length above 0, and may be divided by the number of '
            f'squares: "{_EXAMPLE}".'
        )
    if is_count:
        count = int(squares)
        if not 1 <= count <= max(board.columns, board.rows):
            raise CalibError(
                f"--measured says {count} squares; the board has {board.columns} columns and {board.rows} rows."
            )
        return PrintScale(length, count * board.square, count)
    # The length may be that of the pattern's width, of its height, or of a square.
    candidates = []
    for extent, count in zip(board.size, (board.columns, board.rows), strict=True):
        is_whole = abs(extent - count * board.square) < 1e-9
        candidates.append(PrintScale(length, extent, count if is_whole else None))
    candidates.append(PrintScale(length, board.square, 1))
    near = [scale for scale in candidates if abs(scale.scale - 1.0) < _NEAR]
    if len({scale.drawn for scale in near}) != 1:
        width, height = board.size
        raise CalibError(
            f"--measured is {1e3 * length:g} mm. The pattern was drawn {1e3 * width:g} mm wide and {1e3 * height:g} mm "
            f"high, of squares of {1e3 * board.square:g} mm; over how many squares did you measure? Write "
            f'"{1e3 * length:g} mm / {max(1, round(length / board.square))}".'
        )
    return near[0]


def rescaled(board: Board, scale: PrintScale) -> Board:
    """Return a board with the lengths of its print as measured, rounded to a micrometre.

    Args:
        board: The board as drawn.
        scale: What was measured on the print.

    Returns:
        The board, ``sigma_scale`` that of the measurement.
    """
    return replace(
        board,
        square=shift_decimal(round(1e3 * (board.square * scale.scale), 3), -3),
        marker=shift_decimal(round(1e3 * (board.marker * scale.scale), 3), -3),
        sigma_scale=shift_decimal(round(1e2 * scale.sigma, 3), -2),
    )
