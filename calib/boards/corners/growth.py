"""The inner corners of a chessboard or ChArUco board, sought where a map expects them, the map refitted with each find.

OpenCV's detector takes a corner of a ChArUco board from the markers beside it. Here a marker that was not read costs
nothing: whatever the other markers and corners say of the lens and the pose tells where its corners must be, and a
saddle of the right colours is there, or the corner is not taken.
"""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.boards.board import CHARUCO, Board, corner_signs
from calib.boards.corners.planar_map import PlanarMap, fit_planar_map, in_image
from calib.boards.corners.saddles import Saddles, find_saddles

#: Width of the window around a corner of a chessboard, in squares; the largest of a ChArUco board.
_WINDOW = 0.14

#: Width of the window around a corner of a ChArUco board, in widths of the white around a marker.
_WINDOW_IN_MARGINS = 0.7

#: The smallest, where there is hardly any white, in squares.
_SMALLEST_WINDOW = 0.04

#: Searches, each with the map of the last.
_ROUNDS = 4

#: Weight of a marker's corner beside a saddle's.
_MARKER_WEIGHT = 0.01

#: Side of a square below which its corners are not to be told apart [px].
_SMALLEST_SQUARE = 5.0

#: A corner disagrees with the others if it is further from where they have it than this many times the usual.
_OUTLYING = 6.0

#: And than this, in squares: what the map does not know of the lens.
_TOLERANCE = 0.05

#: And than this [px].
_TOLERANCE_PX = 1.0


def grow(
    image: Array, board: Board, start: PlanarMap, points: Array, pixels: Array
) -> tuple[Saddles, PlanarMap]:
    """Find the inner corners of a board.

    Args:
        image: Grey values, shape (height, width).
        board: A chessboard or ChArUco board.
        start: A map from the board to the image.
        points: Points of the board that the map was made of, shape (m, 2) [m].
        pixels: Their pixels, shape (m, 2).

    Returns:
        The corners in the order of their ids, those that agree with the others; and the map that they make.
    """
    corners = board.corners[:, :2]
    signs = corner_signs(board)
    image_size = (image.shape[1], image.shape[0])
    planar_map = start
    count = -1
    for _ in range(_ROUNDS):
        saddles = _search(image, board, planar_map, signs)
        exist = saddles.exist
        if exist.any():
            weights = np.concatenate([np.ones(exist.sum()), np.full(len(points), _MARKER_WEIGHT)])
            planar_map = fit_planar_map(
                np.concatenate([corners[exist], points]),
                np.concatenate([saddles.pixels[exist], pixels]),
                image_size,
                weights,
            )
            saddles = _without_outliers(saddles, corners, planar_map, board.square)
        last = count
        count = int(saddles.exist.sum())
        if count <= last or count == visible_corners(board, planar_map, image_size).sum():
            break
    return saddles, planar_map


def visible_corners(board: Board, planar_map: PlanarMap, image_size: tuple[int, int]) -> Mask:
    """Test which corners of a board are inside an image.

    Args:
        board: The board.
        planar_map: From the board to the image.
        image_size: Width and height [px].

    Returns:
        A truth value for each corner, shape (n,).
    """
    pixels = planar_map.project(board.corners[:, :2])
    return in_image(np.nan_to_num(pixels, nan=-1.0), image_size, 2.0)


def window_size(board: Board) -> float:
    """Return the width of the window around a corner on the board [m]: in it is no marker, or both evenly."""
    largest = _WINDOW * board.square
    if board.pattern != CHARUCO:
        return largest
    margin = (board.square - board.marker) / 2.0
    return float(np.clip(_WINDOW_IN_MARGINS * margin, _SMALLEST_WINDOW * board.square, largest))


def _search(image: Array, board: Board, planar_map: PlanarMap, signs: Array) -> Saddles:
    """Search all corners of a board where a map has them."""
    corners = board.corners[:, :2]
    expected = planar_map.project(corners)
    jacobians = planar_map.jacobians(corners, 0.25 * board.square)
    is_large = board.square * _smallest_stretch(jacobians) >= _SMALLEST_SQUARE
    image_size = (image.shape[1], image.shape[0])
    tried = is_large & in_image(np.nan_to_num(expected, nan=-1.0), image_size, 2.0)
    saddles = find_saddles(
        image, expected[tried], window_size(board) * jacobians[tried], signs[tried]
    )
    pixels = np.full((len(corners), 2), np.nan)
    sigma = np.full(len(corners), np.nan)
    pixels[tried] = saddles.pixels
    sigma[tried] = saddles.sigma
    return Saddles(pixels, sigma)


def _smallest_stretch(jacobians: Array) -> Array:
    """Return the smaller singular value of each Jacobian, shape (n,) [px/m]; 0 where it is not known."""
    known = np.nan_to_num(jacobians, nan=0.0)
    return np.asarray(np.linalg.svd(known, compute_uv=False)[:, 1])


def _without_outliers(
    saddles: Saddles, corners: Array, planar_map: PlanarMap, square: float
) -> Saddles:
    """Return the corners without those that disagree with the map of all."""
    distance = np.linalg.norm(saddles.pixels - planar_map.project(corners), axis=1)
    usual = float(np.nanmedian(distance))
    spacing = square * _smallest_stretch(planar_map.jacobians(corners, 0.25 * square))
    tolerance = np.maximum(_TOLERANCE_PX, _TOLERANCE * spacing)
    tolerance = np.maximum(tolerance, _OUTLYING * usual)
    agrees = distance <= tolerance  # False where there is none
    pixels = np.where(agrees[:, None], saddles.pixels, np.nan)
    return Saddles(pixels, np.where(agrees, saddles.sigma, np.nan))
