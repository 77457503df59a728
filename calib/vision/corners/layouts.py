"""Where a board's markers and the colours of its squares are, by its description.

A ChArUco board's squares are black and white in turns, with the markers in the white ones, counted in rows along x. The
square at the origin is black; in the layout of OpenCV before 4.6 it is white where the number of rows is even. The
corners of a marker are clockwise from its top left, as OpenCV gives them.
"""

from __future__ import annotations

import numpy as np

from calib.camera.board import APRILTAG, CHESSBOARD, Board
from calib.units import Array


def marker_corners(board: Board) -> Array:
    """Return the corners of all markers in the order of their ids, shape (markers, 4, 2) [m]; none of a chessboard."""
    if board.pattern == CHESSBOARD:
        return np.zeros((0, 4, 2))
    if board.pattern == APRILTAG:
        return board.corners[:, :2].reshape(-1, 4, 2)
    margin = (board.square - board.marker) / 2.0
    corners = board.marker * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    origins = board.square * white_squares(board) + margin
    return np.asarray(origins[:, None, :] + corners)


def white_squares(board: Board) -> Array:
    """Return column and row, from 0, of the white squares of a chessboard or ChArUco board, shape (n, 2)."""
    column, row = np.meshgrid(np.arange(board.columns), np.arange(board.rows))
    is_white = (column + row + _first_is_white(board)) % 2 == 1
    return np.stack([column[is_white], row[is_white]], axis=1).astype(float)


def corner_signs(board: Board) -> Array:
    """Return 1 for each corner whose square towards +x and +y is white, -1 if it is black, shape (n,)."""
    column, row = np.meshgrid(np.arange(1, board.columns), np.arange(1, board.rows))
    is_white = (column + row + _first_is_white(board)) % 2 == 1
    return np.where(is_white, 1.0, -1.0).reshape(-1)


def _first_is_white(board: Board) -> int:
    """Return 1 if the square at the origin is white, else 0."""
    return int(board.legacy and board.rows % 2 == 0)
