"""The inner corners of chessboards and ChArUco boards.

They are sought where a map expects them, and the map is refitted with each find. OpenCV's detector takes a corner of a
ChArUco board from the markers beside it. Here a marker that was not read costs nothing: the other markers and corners
determine lens and pose, hence where its corners must be. A corner is taken if there is a saddle with the right colours.

The first map to a plain chessboard is from OpenCV, which finds all inner corners or none, and does not know where the
board begins.
Of the orders of the corners, turned by quarters or halves, the right one has a black square at the origin. It is unique
if columns and rows add up to an odd number. Otherwise the board looks the same after half a turn, and may as well have
a white square at the origin; then the order is taken whose x axis points most to the right of the image. In another
image that may be the other end of the board: who knows how the camera moved says which of `Board.orders_alike` it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.basics.values import Value
from calib.boards.board import APRILGRID, CHARUCO, Board, cells_across, corner_signs
from calib.boards.corners.planar_map import PlanarMap, fit_planar_map
from calib.boards.corners.saddles import Saddles, find_saddles, saddle_colours
from calib.boards.opencv import opencv
from calib.boards.project import in_image
from calib.errors import CalibError

#: Width of the window around a corner of a chessboard, in squares; the largest of a ChArUco board.
_WINDOW = 0.14

#: Width of the window around a corner of a ChArUco board, in widths of the white around a marker.
_WINDOW_IN_MARGINS = 0.7

#: Width of the window around a corner of an aprilgrid, in widths of a tag's border or of a small square, whichever is
#: narrower: the window then reaches to where these end.
_WINDOW_IN_BORDERS = 0.3

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


def find_inner_corners(
    image: Array,
    board: Board,
    start: PlanarMap,
    points: Array,
    pixels: Array,
    *,
    is_white_first: bool = False,
) -> tuple[Saddles, PlanarMap]:
    """Find the inner corners of a board, refining a map from the board to the image as more corners are found.

    Args:
        image: Grey values, shape (height, width).
        board: A chessboard or ChArUco board.
        start: A map from the board to the image.
        points: Points of the board to which the map was fitted, shape (m, 2) [m].
        pixels: Their pixels, shape (m, 2).
        is_white_first: True if the colours are the opposite of those described: a white square at the origin.

    Returns:
        All inner corners in the order of their ids, NaN for those that were not found or do not agree with the others;
        and the map fitted to those found.
    """
    corners = board.corners[:, :2]
    signs = -corner_signs(board) if is_white_first else corner_signs(board)
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

            # Drop the corners that disagree with the map of all.
            distance = np.linalg.norm(saddles.pixels - planar_map.project(corners), axis=1)
            usual = float(np.nanmedian(distance))
            spacing = _smallest_squares(board, planar_map, corners)
            tolerance = np.maximum(_TOLERANCE_PX, _TOLERANCE * spacing)
            tolerance = np.maximum(tolerance, _OUTLYING * usual)
            agrees = distance <= tolerance  # False for corners that were not found
            kept = Saddles(saddles.pixels[agrees], saddles.sigma[agrees])
            saddles = kept.among(len(corners), agrees)
        last = count
        count = int(saddles.exist.sum())
        if count <= last or count == visible_corners(board, planar_map, image_size).sum():
            break
    return saddles, planar_map


def visible_corners(board: Board, planar_map: PlanarMap, image_size: tuple[int, int]) -> Mask:
    """Return a mask, shape (n,), of the corners of a board that are inside an image of a width and height [px]."""
    return in_image(planar_map.project(board.corners[:, :2]), image_size, _EDGE)


def windows_at(board: Board, planar_map: PlanarMap, points: Array) -> Array:
    """Return the windows around points (n, 2) [m] of a board: their columns along its x and y, shape (n, 2, 2) [px]."""
    return window_size(board) * planar_map.jacobians(points, _STEP * board.square)


def window_size(board: Board) -> float:
    """Return the width of the window around a corner on the board [m].

    On a ChArUco board it is narrow enough to keep clear of the markers, unless there is hardly any white around them.
    On an aprilgrid it is narrow enough for the small squares, and for the border of the tags.
    """
    if board.pattern == APRILGRID:
        bits = cells_across(board)
        narrowest = min(board.square - board.marker, board.border * board.marker / bits)
        return _WINDOW_IN_BORDERS * narrowest
    largest = _WINDOW * board.square
    if board.pattern != CHARUCO:
        return largest
    margin = (board.square - board.marker) / 2.0
    return float(np.clip(_WINDOW_IN_MARGINS * margin, _SMALLEST_WINDOW * board.square, largest))


def _smallest_squares(board: Board, planar_map: PlanarMap, corners: Array) -> Array:
    """Return how wide a square at each of the corners (n, 2) [m] is where narrowest, (n,) [px]; 0 behind the camera."""
    jacobians = planar_map.jacobians(corners, _STEP * board.square)
    known = np.nan_to_num(jacobians, nan=0.0)
    return np.asarray(board.square * np.linalg.svd(known, compute_uv=False)[:, 1])


# Plain chessboards

#: Fewest columns and rows of squares that OpenCV finds.
_FEWEST = 4

#: Longest side of a picture that OpenCV's slower detector is given [px].
_LARGEST = 1600

#: Largest number of corners with the colours of one order of a chessboard, as a share of those with the opposite ones:
#: if columns are skipped, there are two fifths or more of either.
_MOST_OPPOSITE = 0.2

#: Sizes of which OpenCV seeks a chessboard or a larger one, of whatever size [corners]; the first mostly finds it.
_SEEDS = ((4, 4), (3, 3))

#: Largest share of the points of an outer edge that are corners of squares, if the board ends there.
_MOST_ON_EDGE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Chessboard(Value):
    """A plain chessboard in an image, as OpenCV finds it, with its corners in order."""

    #: From the board to the image.
    map: PlanarMap
    #: The approximate pixels of the corners in the order of their ids, shape (n, 2).
    pixels: Array
    #: True if the square at the origin is white, which only a board that looks the same turned may have.
    is_white_first: bool


def find_chessboard(
    image: Any,  # noqa: ANN401  8-bit
    board: Board,
    *,
    quick: bool = False,
) -> Chessboard | None:
    """Find a plain chessboard in an image, by OpenCV, and the order of its inner corners.

    Args:
        image: Grey values, 8 bits, shape (height, width).
        board: A chessboard.
        quick: True to leave out OpenCV's slower detector, which takes seconds for a chessboard of another size.

    Returns:
        The chessboard; None if not all corners are seen, or what OpenCV takes for them are not: of a board with more
        squares it sometimes takes every other corner.

    Raises:
        CalibError: The board has fewer columns or rows than OpenCV finds.
    """
    if min(board.columns, board.rows) < _FEWEST:
        raise CalibError(
            f"The board '{board.name}' is a chessboard of {board.columns} columns and {board.rows} rows; OpenCV needs "
            f"{_FEWEST} or more of each. A ChArUco board may be smaller."
        )
    cv2 = opencv()
    size = (board.columns - 1, board.rows - 1)
    factor = 1
    is_seen, corners = cv2.findChessboardCornersSB(image, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not is_seen and not quick:
        # The other detector takes minutes for a large picture that is soft.
        factor = max(1, -(-max(image.shape) // _LARGEST))
        shape = (max(1, image.shape[1] // factor), max(1, image.shape[0] // factor))
        small = cv2.resize(image, shape, interpolation=cv2.INTER_AREA)
        flags = (
            cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
        )
        is_seen, corners = cv2.findChessboardCorners(small, size, flags=flags)
    if not is_seen:
        return None

    # The orders in which the corners may be: turned, not mirrored.
    grid = np.asarray(corners, dtype=np.float64).reshape(board.rows - 1, board.columns - 1, 2)
    grid = (grid + 0.5) * factor - 0.5
    along_x = grid[0, -1] - grid[0, 0]
    along_y = grid[-1, 0] - grid[0, 0]
    if along_x[0] * along_y[1] - along_x[1] * along_y[0] < 0.0:
        grid = grid[:, ::-1]
    turns = range(4) if board.columns == board.rows else (0, 2)
    points = board.corners[:, :2]
    image_size = (image.shape[1], image.shape[0])

    # The colours around a corner are the same after half a turn of the board, and the opposite after a quarter.
    first_map = fit_planar_map(points, grid.reshape(-1, 2), image_size)
    windows = windows_at(board, first_map, points)
    grey = np.asarray(image, dtype=float)
    _, found = saddle_colours(grey, grid.reshape(-1, 2), windows)
    colours = found.reshape(grid.shape[:2])
    signs = corner_signs(board)
    best = None
    for turn in turns:
        ordered = np.rot90(grid, turn).reshape(-1, 2)
        turned = (-1) ** turn * np.rot90(colours, turn).reshape(-1)
        agreeing = np.sum(turned == signs)
        opposite = np.sum(turned == -signs)
        if min(agreeing, opposite) > _MOST_OPPOSITE * max(agreeing, opposite):
            continue
        planar_map = fit_planar_map(points, ordered, image_size) if turn else first_map
        is_black_first = bool(agreeing > opposite)
        rightwards = float(windows_at(board, planar_map, board.centre[None, :2])[0, 0, 0])
        score = (is_black_first, rightwards)
        if best is None or score > best[0]:
            is_white_first = board.looks_same_turned and bool(opposite > agreeing)
            best = (score, Chessboard(planar_map, ordered, is_white_first))
    return None if best is None else best[1]


def is_part_of_larger(image: Array, board: Board, planar_map: PlanarMap) -> bool:
    """Return True if a chessboard continues beyond the corners found: OpenCV finds a part of a larger board too.

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
    points = np.concatenate(edges)
    pixels = planar_map.project(points)
    _, colours = saddle_colours(image, pixels, windows_at(board, planar_map, points))
    ends = np.cumsum([len(edge) for edge in edges])[:-1]
    return any(np.mean(of_edge != 0.0) > _MOST_ON_EDGE for of_edge in np.split(colours, ends))


def size_of_chessboard(image: Any) -> tuple[int, int] | None:  # noqa: ANN401  8-bit
    """Return how many squares the chessboard that an image shows has along its sides, the larger first; None: none."""
    cv2 = opencv()
    usual = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE
    for flags in (usual, usual | cv2.CALIB_CB_EXHAUSTIVE):
        for seed in _SEEDS:
            is_seen, _, meta = cv2.findChessboardCornersSBWithMeta(image, seed, flags)
            if is_seen and meta is not None:
                larger, smaller = sorted(np.asarray(meta).shape[:2], reverse=True)
                return larger + 1, smaller + 1
    return None
