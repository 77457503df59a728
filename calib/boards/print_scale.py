"""The scale of a print: what was measured on it against what was drawn."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from calib.basics.units import LENGTH, parse_amount
from calib.boards.board import Board
from calib.boards.board_file import board_of_table, board_toml, parsed_toml, shifted
from calib.errors import CalibError

#: Standard deviation of a length read from a ruler [m].
READING = 0.0003

#: Nobody measures a print better than this, relative to its length: paper moves with the air's humidity.
_BEST = 5e-4

#: A length within this of that of the pattern, relative to it, is one of the whole pattern.
_NEAR = 0.05

#: Example of a measured length, for messages.
_EXAMPLE = "249.3 mm / 10"

#: Keys of a description that a measurement changes.
_CHANGED = ("square_mm", "marker_mm", "sigma_scale_percent")


@dataclass(frozen=True, slots=True)
class PrintScale:
    """The scale of a print."""

    #: Length measured [m].
    measured: float
    #: The same length as drawn [m].
    drawn: float
    #: Number of squares in it, or of distances of tags; None for the whole pattern of a grid of tags.
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
        CalibError: No length, or none that is nearly that of the pattern's width, height or square.
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
    near = [scale for scale in _candidates(board, length) if abs(scale.scale - 1.0) < _NEAR]
    lengths = {scale.drawn for scale in near}
    if len(lengths) != 1:
        width, height = board.size
        raise CalibError(
            f"--measured is {1e3 * length:g} mm. The pattern was drawn {1e3 * width:g} mm wide and {1e3 * height:g} mm "
            f"high, of squares of {1e3 * board.square:g} mm; over how many squares did you measure? Write "
            f'"{1e3 * length:g} mm / {max(1, round(length / board.square))}".'
        )
    return near[0]


def _candidates(board: Board, length: float) -> list[PrintScale]:
    """Return the scales of a print if the length is that of the pattern's width, its height, or a square."""
    scales = []
    for extent, count in zip(board.size, (board.columns, board.rows), strict=True):
        is_whole = abs(extent - count * board.square) < 1e-9
        scales.append(PrintScale(length, extent, count if is_whole else None))
    scales.append(PrintScale(length, board.square, 1))
    return scales


def rescaled(board: Board, scale: PrintScale) -> Board:
    """Return a board with the lengths of its print, rounded to a micrometre.

    Args:
        board: The board as drawn.
        scale: What was measured on the print.

    Returns:
        The board, ``sigma_scale`` that of the measurement.
    """
    return replace(
        board,
        square=_rounded(board.square * scale.scale),
        marker=_rounded(board.marker * scale.scale),
        sigma_scale=shifted(round(1e2 * scale.sigma, 3), -2),
    )


def _rounded(length: float) -> float:
    """Round a length to a micrometre [m]."""
    return shifted(round(1e3 * length, 3), -3)


def corrected_toml(text: str, board: Board) -> str:
    """Change the lengths in the description of a board, and keep all else in it, comments too.

    Args:
        text: The content of the file.
        board: The board with its new lengths.

    Returns:
        The new content.
    """
    wanted = parsed_toml(board_toml(board))
    for key in _CHANGED:
        if key in wanted:
            text = re.sub(
                rf"(?m)^([ \t]*{key}[ \t]*=[ \t]*)[^\s#]+", rf"\g<1>{wanted[key]!r}", text, count=1
            )
    changed = board_of_table(parsed_toml(text), "")
    if board_toml(changed) != board_toml(board):
        # A key is missing or written in another way.
        return board_toml(board)
    return text
