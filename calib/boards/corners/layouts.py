"""Where the markers of a board and the colours of its squares are, as `calib.boards.drawing` draws them."""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array
from calib.boards.board import CHESSBOARD, Board
from calib.boards.drawing import is_white, marker_corners


def marker_outlines(board: Board) -> Array:
    """Return the corners of all markers or tags of a board.

    Args:
        board: The board.

    Returns:
        Corners in the order of the ids, clockwise from a marker's top left as OpenCV gives them, shape (markers, 4, 2)
        [m]; none of a chessboard.
    """
    if board.pattern == CHESSBOARD:
        return np.zeros((0, 4, 2))
    corners = board.marker * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    return np.asarray(marker_corners(board)[:, None, :] + corners)


def corner_signs(board: Board) -> Array:
    """Return 1 for each corner whose square towards +x and +y is white, -1 if it is black, shape (n,)."""
    return np.where(is_white(board)[1:, 1:], 1.0, -1.0).reshape(-1)
