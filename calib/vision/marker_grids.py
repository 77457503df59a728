"""The grid that markers in a picture lie on: how many columns, and in which layout.

The ids of a board's markers run along its rows, so a number of columns and a layout say in which cell of the board each
marker lies. They are right if one homography takes the cells to the picture, and if the markers, taken back by it, are
upright squares of one size. All numbers of columns are tried.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from calib.camera.board import APRILTAG, CHARUCO
from calib.units import Array, Integers, Mask
from calib.values.pickling import Value
from calib.vision.markers import Markers
from calib.vision.opencv import opencv

#: Fewest markers that show a grid.
FEWEST = 4

#: Largest number of columns that is tried.
_MOST_COLUMNS = 60

#: A marker's centre is this near its cell's, in cells: lenses bend the grid, a wrong cell is a whole one off.
_CENTRE_TOLERANCE = 0.3

#: A marker's corners are this near a square's, in cells.
_SHAPE_TOLERANCE = 0.12

#: The same in the picture for the centres, in sides of a marker.
_INLIER = 0.4

#: Corners of an upright marker of side 1 about its centre, clockwise from top left.
_UPRIGHT = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])

#: What a rare kind of board must have more of to be preferred: a first id that is not 0, the legacy layout.
_RARE = 0.6

#: Grids with this share of the best one's markers explain the picture as well.
_ALIKE = 0.95


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the markers of a board lie, by their ids."""

    #: `CHARUCO` or `APRILTAG`.
    pattern: str
    #: Number of columns.
    columns: int
    #: Id of the first marker.
    first: int = 0
    #: Of a ChArUco board, whether the first square holds a marker, as in the legacy layout.
    starts_white: bool = False
    #: Whether the first row is the lowest one, as in Kalibr's grids of AprilTags.
    bottom_up: bool = False

    def cells(self, ids: Integers) -> Integers:
        """Return column and row of the cell of each marker, shape (n, 2); rows of a bottom-up grid are below 0."""
        index = ids - self.first
        if self.pattern == APRILTAG:
            row, column = np.divmod(index, self.columns)
            return np.column_stack([column, -row if self.bottom_up else row])
        pair, place = np.divmod(index, self.columns)
        in_even_row = (self.columns + 1) // 2 if self.starts_white else self.columns // 2
        is_odd = place >= in_even_row
        shift = is_odd == self.starts_white
        column = 2 * np.where(is_odd, place - in_even_row, place) + shift
        return np.column_stack([column, 2 * pair + is_odd])


@dataclass(frozen=True, slots=True, eq=False)
class Grid(Value):
    """Markers of a picture on a grid."""

    #: Where they lie.
    layout: Layout
    #: Which markers of the picture are on the grid, shape (n,).
    is_on: Mask
    #: Ids of those markers.
    ids: Integers
    #: Homography from the cells, of side 1, to the picture, shape (3, 3).
    H_image_cells: Array
    #: Side of a marker, in cells.
    ratio: float

    @property
    def rows(self) -> int:
        """Number of rows, as far as seen."""
        return int(np.abs(self.layout.cells(self.ids)[:, 1]).max()) + 1

    @property
    def completeness(self) -> float:
        """Share of the markers seen of all up to the last one that was seen."""
        return len(self.ids) / float(self.ids.max() - self.layout.first + 1)

    @property
    def plausibility(self) -> float:
        """How well the grid explains which markers are seen: completeness, less for rare kinds of boards."""
        value = self.completeness
        if self.layout.first != 0:
            value *= _RARE
        if self.layout.starts_white:
            value *= _RARE
        return value


def grid_of(markers: Markers) -> Grid | None:
    """Find the grid that most markers lie on.

    Args:
        markers: Markers of one kind in a picture.

    Returns:
        The grid; None if fewer than four markers lie on one, or all in one row.
    """
    if len(markers.ids) < FEWEST:
        return None
    lowest = int(markers.ids.min())
    best = _best(markers, _layouts([0, lowest]))
    if best is None or len(best.ids) < _ALIKE * len(markers.ids):
        # The first id is neither 0 nor one that is seen.
        others = _best(markers, _layouts_below(lowest))
        if best is None or (others is not None and len(others.ids) > len(best.ids)):
            return others
    return best


def _layouts(firsts: Iterable[int]) -> Iterator[Layout]:
    """Yield the layouts of all numbers of columns with these first ids."""
    for first in sorted(set(firsts)):
        for columns in range(2, _MOST_COLUMNS + 1):
            yield Layout(APRILTAG, columns, first)
            yield Layout(APRILTAG, columns, first, bottom_up=True)
            yield Layout(CHARUCO, columns, first)
            yield Layout(CHARUCO, columns, first, starts_white=True)


def _layouts_below(lowest: int) -> Iterator[Layout]:
    """Yield the layouts whose first marker is not seen, but others of the first two rows are."""
    for columns in range(2, _MOST_COLUMNS + 1):
        for first in range(max(1, lowest - columns + 1), lowest):
            yield Layout(APRILTAG, columns, first)
            yield Layout(CHARUCO, columns, first)
            yield Layout(CHARUCO, columns, first, starts_white=True)


def _best(markers: Markers, layouts: Iterable[Layout]) -> Grid | None:
    """Return the most plausible of the grids with the most markers."""
    grids = [grid for layout in layouts if (grid := _fitted(markers, layout)) is not None]
    if not grids:
        return None
    most = max(len(grid.ids) for grid in grids)
    alike = [grid for grid in grids if len(grid.ids) >= _ALIKE * most]
    return max(alike, key=lambda grid: grid.plausibility)


def _fitted(markers: Markers, layout: Layout) -> Grid | None:
    """Fit a homography to a layout; None if it explains fewer than four markers."""
    cells = layout.cells(markers.ids) + 0.5
    columns, rows = cells.max(axis=0) - cells.min(axis=0)
    if columns < 1.0 or rows < 1.0:
        return None
    cv2 = opencv()
    threshold = _INLIER * markers.side
    H, near = cv2.findHomography(cells, markers.centres, cv2.RANSAC, threshold, maxIters=200)
    if H is None or near.sum() < FEWEST or abs(np.linalg.det(H)) < 1e-12:
        return None
    corners = cv2.perspectiveTransform(markers.corners.reshape(1, -1, 2), np.linalg.inv(H))
    about_cell = corners.reshape(-1, 4, 2) - cells[:, None]
    middle = about_cell.mean(axis=1)
    shape = about_cell - middle[:, None]
    ratio = float(np.median(np.sum(shape * _UPRIGHT, axis=(1, 2)))) / 2.0
    if not 0.0 < ratio < 1.0:
        return None
    is_square = np.abs(shape - ratio * _UPRIGHT).max(axis=(1, 2)) < _SHAPE_TOLERANCE
    is_on = is_square & (np.abs(middle).max(axis=1) < _CENTRE_TOLERANCE)
    if is_on.sum() < FEWEST:
        return None
    return Grid(layout, is_on, markers.ids[is_on], H, ratio)
