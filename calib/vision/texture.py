"""A board's pattern as a grey picture, its edges to a fraction of a pixel: what a pixel shows is the share of black.

Every black square and every black cell of a marker is a rectangle along the picture's axes, whose share of a pixel is
the product of its shares along x and along y.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.camera.board import APRILTAG, CHARUCO, CHESSBOARD, Board
from calib.errors import CalibError
from calib.units import Array, Mask
from calib.vision.opencv import opencv

#: A length that is longer than whole pixels by this [px] has as many.
_ROUNDING = 1e-6


class Rectangle(NamedTuple):
    """A black rectangle of a pattern, in the board's frame [m]."""

    left: float
    top: float
    width: float
    height: float


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


def rectangles(board: Board) -> list[Rectangle]:
    """Return the black rectangles of a board's pattern, squares and cells of markers.

    Raises:
        CalibError: OpenCV does not have the dictionary, or it has too few markers.
    """
    squares = []
    if board.pattern != APRILTAG:
        squares = [
            Rectangle(board.square * column, board.square * row, board.square, board.square)
            for row, column in _squares(board, _first_black(board))
        ]
    if board.pattern == CHESSBOARD:
        return squares
    cells = []
    for place, black in zip(_marker_places(board), _marker_cells(board), strict=True):
        cells += _black_cells(board, place, black)
    return squares + cells


def texture(board: Board, pixel: float, margin: float) -> Texture:
    """Draw a board's pattern.

    Args:
        board: The board.
        pixel: Side of a pixel [m].
        margin: Width of the white margin around the pattern [m].

    Raises:
        CalibError: OpenCV does not have the dictionary, or it has too few markers.
    """
    width, height = (np.asarray(board.size) + 2.0 * margin) / pixel
    shape = (_whole(height), _whole(width))
    black = np.zeros(shape, dtype=np.float32)
    for rectangle in rectangles(board):
        first_x, share_x = _shares(rectangle.left + margin, rectangle.width, pixel)
        first_y, share_y = _shares(rectangle.top + margin, rectangle.height, pixel)
        rows = slice(first_y, first_y + len(share_y))
        columns = slice(first_x, first_x + len(share_x))
        part = black[rows, columns]
        part += np.outer(share_y, share_x)[: part.shape[0], : part.shape[1]]
    return Texture(1.0 - np.minimum(black, 1.0), pixel, margin)


def _whole(pixels: float) -> int:
    """Return the whole number of pixels that cover a length [px]; what sticks out by rounding is not covered."""
    return int(np.ceil(pixels - _ROUNDING))


def _shares(start: float, length: float, pixel: float) -> tuple[int, Array]:
    """Return the first pixel that a stretch covers, and what share of this one and those behind it.

    Args:
        start: Where the stretch begins, from the picture's edge [m].
        length: Its length [m].
        pixel: Side of a pixel [m].
    """
    low = start / pixel
    high = (start + length) / pixel
    first = int(np.floor(low))
    edges = np.arange(first, int(np.ceil(high)))
    shares = np.minimum(edges + 1, high) - np.maximum(edges, low)
    return first, np.maximum(shares, 0.0)


def _squares(board: Board, parity: int) -> list[tuple[int, int]]:
    """Return row and column of every second square of a chessboard: those whose sum is even (0) or odd (1)."""
    return [
        (row, column)
        for row in range(board.rows)
        for column in range(board.columns)
        if (row + column) % 2 == parity
    ]


def _first_black(board: Board) -> int:
    """Return 0 if the first square is black, 1 if it is white, as in old layouts of an even number of rows."""
    return int(board.legacy and board.pattern == CHARUCO and board.rows % 2 == 0)


def _marker_places(board: Board) -> list[tuple[float, float]]:
    """Return the upper left corners of the markers in the order of their ids, x and y [m]."""
    if board.pattern == CHARUCO:
        inset = (board.square - board.marker) / 2.0
        cells = _squares(board, 1 - _first_black(board))
    else:
        inset = 0.0
        cells = [(row, column) for row in range(board.rows) for column in range(board.columns)]
    return [(column * board.square + inset, row * board.square + inset) for row, column in cells]


def _marker_cells(board: Board) -> list[Mask]:
    """Return which cells of each marker are black, its border included, shape (cells, cells) each."""
    cv2 = opencv()
    number = getattr(cv2.aruco, board.dictionary, None)
    if number is None:
        raise CalibError(
            f"The board '{board.name}' has markers of '{board.dictionary}', which OpenCV does not have; its "
            "dictionaries have names such as 'DICT_5X5_100'."
        )
    dictionary = cv2.aruco.getPredefinedDictionary(number)
    count = len(_marker_places(board))
    known = len(dictionary.bytesList)
    if board.first_marker + count > known:
        raise CalibError(
            f"The board '{board.name}' has {count} markers from id {board.first_marker}; '{board.dictionary}' has "
            f"{known}, 0 to {known - 1}. Choose a larger dictionary."
        )
    side = dictionary.markerSize + 2
    ids = range(board.first_marker, board.first_marker + count)
    return [cv2.aruco.generateImageMarker(dictionary, i, side) == 0 for i in ids]


def _black_cells(board: Board, place: tuple[float, float], black: Mask) -> list[Rectangle]:
    """Return the black cells of a marker.

    Args:
        board: The board.
        place: Upper left corner of the marker, x and y [m].
        black: Which cells are black, shape (cells, cells).
    """
    side = board.marker / len(black)
    left, top = place
    return [
        Rectangle(left + side * column, top + side * row, side, side)
        for row, column in np.argwhere(black)
    ]
