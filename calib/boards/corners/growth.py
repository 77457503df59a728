"""The inner corners of a chessboard or ChArUco board, sought where a map expects them, the map refitted with each find.

OpenCV's detector takes a corner of a ChArUco board from the markers beside it. Here a marker that was not read costs
nothing: the other markers and corners determine lens and pose, hence where its corners must be. A corner is taken if
there is a saddle with the right colours.
"""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.boards.board import CHARUCO, Board
from calib.boards.corners.planar_map import PlanarMap, fit_planar_map
from calib.boards.corners.saddles import Saddles, find_saddles
from calib.boards.layout import corner_signs
from calib.boards.project import in_image

#: Width of the window around a corner of a chessboard, in squares; the largest of a ChArUco board.
_WINDOW = 0.14

#: Width of the window around a corner of a ChArUco board, in widths of the white around a marker.
_WINDOW_IN_MARGINS = 0.7

#: Smallest width of a window, if there is hardly any white, in squares.
_SMALLEST_WINDOW = 0.04

#: Step of the differences by which a map is differentiated, in squares.
_STEP = 0.25

#: Maximum number of searches, each with the map of the last.
_ROUNDS = 4

#: Weight of a marker's corner relative to a saddle's.
_MARKER_WEIGHT = 0.01

#: Smallest side of a square whose corners can be told apart [px].
_SMALLEST_SQUARE = 5.0

#: Distance from the image's edges within which corners are not found [px].
_EDGE = 2.5

#: A corner is an outlier if its distance from the map of all exceeds this many times the median, ...
_OUTLYING = 6.0

#: ... and this many squares, which the map may be off for what it does not know of the lens, ...
_TOLERANCE = 0.05

#: ... and this [px].
_TOLERANCE_PX = 1.0


def grow(
    image: Array, board: Board, start: PlanarMap, points: Array, pixels: Array
) -> tuple[Saddles, PlanarMap]:
    """Find the inner corners of a board.

    Args:
        image: Grey values, shape (height, width).
        board: A chessboard or ChArUco board.
        start: A map from the board to the image.
        points: Points of the board to which the map was fitted, shape (m, 2) [m].
        pixels: Their pixels, shape (m, 2).

    Returns:
        The corners in the order of their ids, those that agree with the others; and the map fitted to them.
    """
    corners = board.corners[:, :2]
    signs = corner_signs(board)
    image_size = (image.shape[1], image.shape[0])
    planar_map = start
    count = -1
    for _ in range(_ROUNDS):
        # Search the corners that are in the image, and large enough there.
        expected = planar_map.project(corners)
        windows = windows_at(board, planar_map, corners)
        is_large = _smallest_squares(board, planar_map, corners) >= _SMALLEST_SQUARE
        tried = is_large & in_image(expected, image_size, _EDGE)
        found = find_saddles(image, expected[tried], windows[tried], signs[tried])
        saddles = found.among(len(corners), tried)

        exist = saddles.exist
        if exist.any():
            weights = np.concatenate([np.ones(exist.sum()), np.full(len(points), _MARKER_WEIGHT)])
            planar_map = fit_planar_map(
                np.concatenate([corners[exist], points]),
                np.concatenate([saddles.pixels[exist], pixels]),
                image_size,
                weights,
            )
            saddles = _without_outliers(saddles, board, planar_map)
        last = count
        count = int(saddles.exist.sum())
        if count <= last or count == visible_corners(board, planar_map, image_size).sum():
            break
    return saddles, planar_map


def visible_corners(board: Board, planar_map: PlanarMap, image_size: tuple[int, int]) -> Mask:
    """Return which corners of a board are inside an image of a width and height [px], shape (n,)."""
    return in_image(planar_map.project(board.corners[:, :2]), image_size, _EDGE)


def windows_at(board: Board, planar_map: PlanarMap, points: Array) -> Array:
    """Return the windows around points (n, 2) [m] of a board: their columns along its x and y, shape (n, 2, 2) [px]."""
    return window_size(board) * planar_map.jacobians(points, _STEP * board.square)


def window_size(board: Board) -> float:
    """Return the width of the window around a corner on the board [m]: it holds no marker, or both alike."""
    largest = _WINDOW * board.square
    if board.pattern != CHARUCO:
        return largest
    margin = (board.square - board.marker) / 2.0
    return float(np.clip(_WINDOW_IN_MARGINS * margin, _SMALLEST_WINDOW * board.square, largest))


def _smallest_squares(board: Board, planar_map: PlanarMap, corners: Array) -> Array:
    """Return the width of a square at each corner where it is narrowest, shape (n,) [px]; 0 behind the camera."""
    jacobians = planar_map.jacobians(corners, _STEP * board.square)
    known = np.nan_to_num(jacobians, nan=0.0)
    return np.asarray(board.square * np.linalg.svd(known, compute_uv=False)[:, 1])


def _without_outliers(saddles: Saddles, board: Board, planar_map: PlanarMap) -> Saddles:
    """Return the corners without those that disagree with the map of all."""
    corners = board.corners[:, :2]
    distance = np.linalg.norm(saddles.pixels - planar_map.project(corners), axis=1)
    usual = float(np.nanmedian(distance))
    spacing = _smallest_squares(board, planar_map, corners)
    tolerance = np.maximum(_TOLERANCE_PX, _TOLERANCE * spacing)
    tolerance = np.maximum(tolerance, _OUTLYING * usual)
    agrees = distance <= tolerance  # False for corners that were not found
    return Saddles(saddles.pixels[agrees], saddles.sigma[agrees]).among(len(corners), agrees)
