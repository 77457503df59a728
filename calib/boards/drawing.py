"""Drawings of boards: the black parts of a pattern as rectangles, the markers from OpenCV's dictionaries.

Lengths are in metres, in the frame of the board: x along the columns, y along the rows and down the page.
"""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.boards.board import APRILTAG, CHARUCO, CHESSBOARD, Board
from calib.boards.dictionaries import DICTIONARIES
from calib.boards.opencv import opencv


def black_rectangles(board: Board) -> Array:
    """Return the black parts of a board, without overlap.

    Args:
        board: The board.

    Returns:
        x and y of the upper left corner, width and height of each rectangle, shape (n, 4) [m].

    Raises:
        CalibError: OpenCV, which has the markers, is not installed.
    """
    if board.pattern == CHESSBOARD:
        return _black_squares(board)
    markers = [
        _placed(marker_rectangles(board.dictionary, board.first_marker + k), corner, board.marker)
        for k, corner in enumerate(marker_corners(board))
    ]
    squares = _black_squares(board) if board.pattern == CHARUCO else np.empty((0, 4))
    return np.concatenate([squares, *markers])


def is_white(board: Board) -> Mask:
    """Return which squares of a chessboard or ChArUco board are white, shape (rows, columns).

    The first square is black; in the legacy layout with an even number of rows it is white.
    """
    row, column = np.indices((board.rows, board.columns))
    first = 1 if board.pattern == CHARUCO and board.legacy and board.rows % 2 == 0 else 0
    return np.asarray((row + column + first) % 2 == 1)


def marker_corners(board: Board) -> Array:
    """Return the upper left corners of a board's markers, in the order of their ids, shape (markers, 2) [m]."""
    if board.pattern == APRILTAG:
        row, column = np.indices((board.rows, board.columns))
        return np.column_stack([column.ravel(), row.ravel()]).astype(float) * board.square
    row, column = np.nonzero(is_white(board))
    margin = (board.square - board.marker) / 2.0
    return np.column_stack([column, row]).astype(float) * board.square + margin


def marker_rectangles(dictionary: str, marker: int) -> Array:
    """Return the black parts of a marker of side 1, as runs of bits along x, shape (n, 4).

    Args:
        dictionary: Name of the dictionary, ``"DICT_5X5_100"``.
        marker: Id of the marker.
    """
    aruco = opencv().aruco
    side = DICTIONARIES[dictionary].bits + 2
    markers = aruco.getPredefinedDictionary(getattr(aruco, dictionary))
    image = aruco.generateImageMarker(markers, marker, side)
    runs = []
    for row, bits in enumerate(image == 0):
        edges = np.flatnonzero(np.diff(bits, prepend=False, append=False))
        runs += [(begin, row, end - begin, 1) for begin, end in edges.reshape(-1, 2)]
    return np.array(runs) / side


def _black_squares(board: Board) -> Array:
    """Return the black squares of a chessboard or ChArUco board, shape (n, 4) [m]."""
    row, column = np.nonzero(~is_white(board))
    corners = np.column_stack([column, row]) * board.square
    return np.column_stack([corners, np.full_like(corners, board.square)])


def _placed(rectangles: Array, corner: Array, scale: float) -> Array:
    """Scale rectangles and move their origin to a corner."""
    placed = rectangles * scale
    placed[:, :2] += corner
    return placed
