"""Plain chessboards: OpenCV finds all inner corners or none, and does not know where the board begins.

Of the orders of the corners, turned by quarters or halves, the right one has a black square at the origin. It is unique
if columns and rows add up to an odd number. Otherwise the board looks the same after half a turn; then the order is
taken whose x axis points most to the right of the image, which is the same board pose in two images only while the
camera does not roll by more than a quarter of a turn.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from calib.basics.arrays import Array
from calib.boards.board import Board
from calib.boards.corners.growth import windows_at
from calib.boards.corners.planar_map import PlanarMap, fit_planar_map
from calib.boards.corners.saddles import find_saddles
from calib.boards.layout import corner_signs
from calib.boards.opencv import opencv
from calib.errors import CalibError

#: Fewest columns and rows of squares that OpenCV finds.
_FEWEST = 4

#: Largest share of the points of an outer edge that are corners of squares, if the board ends there.
_MOST_ON_EDGE = 0.5


def is_ambiguous(board: Board) -> bool:
    """Return whether a chessboard looks the same after half a turn."""
    return (board.columns + board.rows) % 2 == 0


def find_chessboard(image: Any, board: Board) -> tuple[PlanarMap, Array] | None:  # noqa: ANN401  8-bit
    """Find a chessboard.

    Args:
        image: Grey values, 8 bits, shape (height, width).
        board: A chessboard.

    Returns:
        The map from the board to the image, and the approximate pixels of the corners in the order of their ids, shape
        (n, 2); None if not all corners are seen.

    Raises:
        CalibError: The board has fewer columns or rows than OpenCV finds.
    """
    if min(board.columns, board.rows) < _FEWEST:
        raise CalibError(
            f"The board '{board.name}' is a chessboard of {board.columns} columns and {board.rows} rows; OpenCV needs "
            f"{_FEWEST} or more of each. A ChArUco board may be smaller."
        )
    pixels = _all_corners(image, board)
    if pixels is None:
        return None

    # The orders in which the corners may be: turned, not mirrored.
    grid = pixels.reshape(board.rows - 1, board.columns - 1, 2)
    along_x = grid[0, -1] - grid[0, 0]
    along_y = grid[-1, 0] - grid[0, 0]
    if along_x[0] * along_y[1] - along_x[1] * along_y[0] < 0.0:
        grid = grid[:, ::-1]
    turns = range(4) if board.columns == board.rows else (0, 2)
    orders = [np.rot90(grid, turn).reshape(-1, 2) for turn in turns]

    grey = np.asarray(image, dtype=float)
    signs = corner_signs(board)
    best = None
    for ordered in orders:
        planar_map = fit_planar_map(board.corners[:, :2], ordered, (image.shape[1], image.shape[0]))
        windows = windows_at(board, planar_map, board.corners[:, :2])
        agreeing = find_saddles(grey, ordered, windows, signs).exist.sum()
        opposite = find_saddles(grey, ordered, windows, -signs).exist.sum()
        rightwards = windows_at(board, planar_map, board.centre[None, :2])[0, 0, 0]
        score = (bool(agreeing > opposite), float(rightwards))
        if best is None or score > best[0]:
            best = (score, planar_map, ordered)
    return None if best is None else best[1:]


def is_part_of_larger(image: Array, board: Board, planar_map: PlanarMap) -> bool:
    """Return whether a chessboard continues beyond the corners found: OpenCV finds a part of a larger board too.

    Args:
        image: Grey values, shape (height, width).
        board: The board as described.
        planar_map: From the board to the image.
    """
    width, height = board.size
    x = board.square * np.arange(1, board.columns)
    y = board.square * np.arange(1, board.rows)
    edges = [np.stack(np.broadcast_arrays(x, edge), axis=1) for edge in (0.0, height)]
    edges += [np.stack(np.broadcast_arrays(edge, y), axis=1) for edge in (0.0, width)]
    for points in edges:
        pixels = planar_map.project(points)
        windows = windows_at(board, planar_map, points)
        known = np.isfinite(pixels).all(axis=1)
        signs = np.ones(int(known.sum()))
        exist = find_saddles(image, pixels[known], windows[known], signs).exist
        exist |= find_saddles(image, pixels[known], windows[known], -signs).exist
        if exist.sum() > _MOST_ON_EDGE * len(points):
            return True
    return False


def size_of_chessboard(image: Any) -> tuple[int, int] | None:  # noqa: ANN401  8-bit
    """Return columns and rows of whatever chessboard an image shows, the larger number first; None if there is none."""
    cv2 = opencv()
    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
    is_seen, _, meta = cv2.findChessboardCornersSBWithMeta(image, (3, 3), flags)
    if not is_seen or meta is None:
        return None
    larger, smaller = sorted(np.asarray(meta).shape[:2], reverse=True)
    return larger + 1, smaller + 1


def _all_corners(image: Any, board: Board) -> Array | None:  # noqa: ANN401  8-bit
    """Return all inner corners in rows, in any of OpenCV's orders, shape (n, 2) [px]; None if they are not all seen."""
    cv2 = opencv()
    size = (board.columns - 1, board.rows - 1)
    is_seen, corners = cv2.findChessboardCornersSB(image, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not is_seen:
        flags = (
            cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
        )
        is_seen, corners = cv2.findChessboardCorners(image, size, flags=flags)
    if not is_seen:
        return None
    return np.asarray(corners, dtype=np.float64).reshape(-1, 2)
