"""Layouts of boards: which squares are white, and where the markers are."""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.boards.board import APRILTAG, CHARUCO, CHESSBOARD, Board


def white_squares(board: Board) -> Mask:
    """Return which squares of a chessboard or ChArUco board are white, shape (rows, columns).

    The first square is black; in the legacy layout with an even number of rows it is white.
    """
    row, column = np.indices((board.rows, board.columns))
    first = 1 if board.pattern == CHARUCO and board.legacy and board.rows % 2 == 0 else 0
    return np.asarray((row + column + first) % 2 == 1)


def corner_signs(board: Board) -> Array:
    """Return 1 for each inner corner whose square towards +x, +y is white, -1 if it is black, shape (n,)."""
    return np.where(white_squares(board)[1:, 1:], 1.0, -1.0).reshape(-1)


def marker_outlines(board: Board) -> Array:
    """Return the corners of all markers or tags of a board.

    Args:
        board: The board.

    Returns:
        shape (markers, 4, 2) [m], in the order of the ids, each clockwise from its top left as in OpenCV; a chessboard
        has none.
    """
    if board.pattern == CHESSBOARD:
        return np.zeros((0, 4, 2))
    if board.pattern == APRILTAG:
        return board.corners[:, :2].reshape(-1, 4, 2)
    row, column = np.nonzero(white_squares(board))
    margin = (board.square - board.marker) / 2.0
    first = np.column_stack([column, row]) * board.square + margin
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    return np.asarray(first[:, None] + board.marker * square)
