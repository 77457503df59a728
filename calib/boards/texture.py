"""A board's pattern as a grey picture, its edges to a fraction of a pixel: what a pixel shows is the share of black.

The black parts are rectangles along the picture's axes, see `calib.boards.drawing`, whose share of a pixel is the
product of their shares along x and along y.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array
from calib.boards.board import Board
from calib.boards.drawing import black_rectangles

#: A length that is longer than whole pixels by this [px] has as many.
_ROUNDING = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """A picture of a pattern with a white margin."""

    #: 1 for white, 0 for black, shape (h, w).
    white: Array
    #: Side of its pixels [m].
    pixel: float
    #: Width of the margin around the pattern [m].
    margin: float

    def place(self, lengths: Array) -> Array:
        """Return where lengths along x or y of the board [m] lie in the picture [px]; 0 is a pixel's centre."""
        return np.asarray((lengths + self.margin) / self.pixel - 0.5)


def texture(board: Board, pixel: float, margin: float) -> Texture:
    """Draw a board's pattern.

    Args:
        board: The board.
        pixel: Side of a pixel [m].
        margin: Width of the white margin around the pattern [m].

    Raises:
        CalibError: OpenCV, which has the markers, is not installed.
    """
    width, height = (np.asarray(board.size) + 2.0 * margin) / pixel
    black = np.zeros((_whole(height), _whole(width)), dtype=np.float32)
    for left, top, length_x, length_y in black_rectangles(board):
        columns, share_x = _shares(left + margin, length_x, pixel, black.shape[1])
        rows, share_y = _shares(top + margin, length_y, pixel, black.shape[0])
        black[rows, columns] += np.outer(share_y, share_x)
    return Texture(1.0 - np.minimum(black, 1.0), pixel, margin)


def _whole(pixels: float) -> int:
    """Return the whole number of pixels that cover a length [px]; what sticks out by rounding is not covered."""
    return int(np.ceil(pixels - _ROUNDING))


def _shares(start: float, length: float, pixel: float, count: int) -> tuple[slice, Array]:
    """Return the pixels that a stretch covers, and what share of each.

    Args:
        start: Where the stretch begins, from the picture's edge [m].
        length: Its length [m].
        pixel: Side of a pixel [m].
        count: Number of pixels.
    """
    low = start / pixel
    high = (start + length) / pixel
    first = int(np.floor(low))
    last = min(int(np.ceil(high)), count)
    edges = np.arange(first, last)
    shares = np.minimum(edges + 1, high) - np.maximum(edges, low)
    return slice(first, last), np.maximum(shares, 0.0)
