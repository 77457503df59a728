"""Drawings of boards: the black parts of a pattern as rectangles, and as a grey picture.

Lengths are in metres, in the frame of the board: x along the columns, y along the rows and down the page. The markers
are those of OpenCV's dictionaries.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array
from calib.boards.board import (
    APRILGRID,
    APRILTAG,
    BODY,
    ROUND,
    Board,
    marker_outlines,
    white_squares,
)
from calib.boards.dictionaries import opencv_dictionary
from calib.boards.opencv import opencv
from calib.errors import CalibError

#: Height of the strips that a circle is drawn in, less than a dot of a printer [m], and their fewest number.
_STRIP = 4e-5
_FEWEST_STRIPS = 64

#: Excess of a length over whole pixels that needs no further pixel [px].
_ROUNDING = 1e-6


def black_rectangles(board: Board) -> Array:
    """Return the black parts of a board, without overlap.

    Args:
        board: The board.

    Returns:
        x and y of the upper left corner in the board's frame, width and height of each rectangle, shape (n, 4) [m].

    Raises:
        CalibError: OpenCV, which has the markers, is not installed; or it is a body.
    """
    if board.pattern == BODY:
        raise CalibError(f"'{board.name}' is a body, which is not drawn on a page.")
    if board.pattern in ROUND:
        return np.concatenate([_strips(centre, board.marker) for centre in board.corners[:, :2]])
    parts = []
    if board.pattern == APRILGRID:
        # The small squares at all corners of tags, each as wide as the gap between tags.
        gap = board.square - board.marker
        column, row = (np.arange(count + 1) for count in (board.columns, board.rows))
        corners = np.stack(np.meshgrid(column, row), axis=-1).reshape(-1, 2) * board.square - gap
        parts.append(np.column_stack([corners, np.full_like(corners, gap)]))
    elif board.pattern != APRILTAG:
        row, column = np.nonzero(~white_squares(board))
        corners = np.column_stack([column, row]) * board.square
        parts.append(np.column_stack([corners, np.full_like(corners, board.square)]))
    for k, outline in enumerate(marker_outlines(board)):
        bits = marker_rectangles(board.dictionary, board.first_marker + k, board.border)
        rectangles = bits * board.marker
        if board.pattern == APRILGRID:
            # Turned by half a turn about the marker's middle.
            rectangles[:, :2] = board.marker - rectangles[:, :2] - rectangles[:, 2:]
        rectangles[:, :2] += outline.min(axis=0)
        parts.append(rectangles)
    return np.concatenate(parts)


def _strips(centre: Array, diameter: float) -> Array:
    """Return a disc about a centre (2,) as strips along x with its area: x, y, width and height, shape (n, 4) [m]."""
    count = max(_FEWEST_STRIPS, int(np.ceil(diameter / _STRIP)))
    edges = np.linspace(-1.0, 1.0, count + 1)
    # The mean width of a strip is the integral of sqrt(1 - y^2) over its height.
    area = edges * np.sqrt(1.0 - edges**2) + np.arcsin(edges)
    half = np.diff(area) / np.diff(edges) / 2.0
    radius = diameter / 2.0
    x = centre[0] - radius * half
    y = centre[1] + radius * edges[:-1]
    return np.column_stack([x, y, 2.0 * radius * half, np.full(count, diameter / count)])


def marker_rectangles(dictionary: str, marker: int, border: int = 1) -> Array:
    """Return the black parts of a marker of side 1: x, y, width and height of each run of bits along x, shape (n, 4).

    Args:
        dictionary: Name of the dictionary, ``"DICT_5X5_100"``.
        marker: Id of the marker.
        border: Width of its black border [bits].
    """
    markers = opencv_dictionary(dictionary)
    side = markers.markerSize + 2 * border
    image = opencv().aruco.generateImageMarker(markers, marker, side, borderBits=border)
    runs = []
    for row, bits in enumerate(image == 0):
        edges = np.flatnonzero(np.diff(bits, prepend=False, append=False))
        runs += [(begin, row, end - begin, 1) for begin, end in edges.reshape(-1, 2)]
    return np.asarray(np.array(runs) / side)


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """A picture of a pattern with a white margin; edges are true to a fraction of a pixel, which shows its share."""

    #: Share of white of each pixel: 1 for white, 0 for black, shape (h, w).
    white: Array
    #: Side of its pixels [m].
    pixel: float
    #: Width of the margin around the pattern [m].
    margin: float

    def place(self, lengths: Array) -> Array:
        """Convert coordinates along x or y of the board [m] to the picture [px], in which 0 is a pixel's centre."""
        return np.asarray((lengths + self.margin) / self.pixel - 0.5)


def texture(board: Board, pixel: float, margin: float) -> Texture:
    """Draw a board's pattern as a grey picture.

    A rectangle covers of a pixel the product of what it covers along x and along y.

    Args:
        board: The board.
        pixel: Side of a pixel [m].
        margin: Width of the white margin around the pattern [m].

    Raises:
        CalibError: OpenCV, which has the markers, is not installed.
    """
    width, height = (np.asarray(board.size) + 2.0 * margin) / pixel
    shape = (int(np.ceil(height - _ROUNDING)), int(np.ceil(width - _ROUNDING)))
    black = np.zeros(shape, dtype=np.float32)
    for left, top, length_x, length_y in black_rectangles(board):
        columns, share_x = _covered(left + margin, length_x, pixel, black.shape[1])
        rows, share_y = _covered(top + margin, length_y, pixel, black.shape[0])
        black[rows, columns] += np.outer(share_y, share_x)
    return Texture(1.0 - np.minimum(black, 1.0), pixel, margin)


def _covered(start: float, length: float, pixel: float, count: int) -> tuple[slice, Array]:
    """Return which of ``count`` pixels an interval [m] covers, and the share of each, 0 to 1, shape (pixels,)."""
    low = start / pixel
    high = (start + length) / pixel
    first = int(np.floor(low))
    last = min(int(np.ceil(high)), count)
    edges = np.arange(first, last)
    shares = np.minimum(edges + 1, high) - np.maximum(edges, low)
    return slice(first, last), np.maximum(shares, 0.0)
