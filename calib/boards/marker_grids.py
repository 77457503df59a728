"""The grid that markers in a picture lie on: how many columns, and in which layout.

The ids of a board's markers run along its rows, so a number of columns and a layout say in which cell of the board each
marker lies. They are right if one homography takes the cells to the picture, and if the markers, taken back by it, are
upright squares of one size. All numbers of columns are tried, but first without a fit: each marker alone says where its
neighbours lie, in sides of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.basics.values import Value
from calib.boards.board import APRILTAG, CHARUCO
from calib.boards.markers import Markers
from calib.boards.opencv import opencv

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

#: Neighbours of a marker that are looked at before the fit.
_NEIGHBOURS = 4

#: Median distance of neighbours from where a layout has them, in cells; a wrong layout has them a whole one off.
_NEIGHBOUR_TOLERANCE = 0.35

#: Corners of an upright marker of side 1 about its centre, clockwise from top left.
_UPRIGHT = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])

#: What a rare kind of board must have more of to be preferred: a first id that is not 0, the legacy layout.
_RARE = 0.6

#: Grids with this share of the best one's markers explain the picture as well.
_ALIKE = 0.95


@dataclass(frozen=True, slots=True)
class Layout:
    """The arrangement of a board's markers: which cell each id lies in."""

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
        """Completeness, reduced for rare kinds of boards: how well the grid explains which markers are seen."""
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
    neighbours = _Neighbours.of(markers)
    grids = []
    for layout in layouts:
        grid = _fitted(markers, layout) if neighbours.agree_with(layout) else None
        if grid is not None:
            grids.append(grid)
    if not grids:
        return None
    most = max(len(grid.ids) for grid in grids)
    alike = [grid for grid in grids if len(grid.ids) >= _ALIKE * most]
    return max(alike, key=lambda grid: grid.plausibility)


@dataclass(frozen=True, slots=True, eq=False)
class _Neighbours(Value):
    """Positions of neighbouring markers, in the frame of each marker."""

    #: Ids of the markers, shape (pairs,).
    ids: Integers
    #: Ids of their neighbours, shape (pairs,).
    others: Integers
    #: From the centre of a marker to that of its neighbour, in sides of the marker, shape (pairs, 2).
    offsets: Array

    @classmethod
    def of(cls, markers: Markers) -> _Neighbours:
        """Look at the nearest neighbours of each marker."""
        cv2 = opencv()
        centres = markers.centres
        ids, others, offsets = [], [], []
        for k, corners in enumerate(markers.corners):
            distances = np.linalg.norm(centres - centres[k], axis=1)
            # An id that is seen twice says nothing of where the board has it.
            distances[markers.ids == markers.ids[k]] = np.inf
            nearest = np.argsort(distances)[:_NEIGHBOURS]
            nearest = nearest[np.isfinite(distances[nearest])]
            if len(nearest) == 0:
                continue
            H = cv2.getPerspectiveTransform(np.float32(corners), np.float32(_UPRIGHT))
            offsets.append(cv2.perspectiveTransform(centres[None, nearest], H)[0])
            ids += [markers.ids[k]] * len(nearest)
            others += list(markers.ids[nearest])
        pairs = np.concatenate(offsets) if offsets else np.empty((0, 2))
        return cls(np.array(ids, dtype=int), np.array(others, dtype=int), pairs)

    def agree_with(self, layout: Layout) -> bool:
        """Return whether most neighbours lie where a layout has them."""
        if len(self.ids) == 0:
            return False
        cells = (layout.cells(self.others) - layout.cells(self.ids)).astype(float)
        # Sides of a marker in a cell: more than 1, as a marker is smaller than its cell.
        along = np.sum(self.offsets * cells, axis=1)
        scale = float(np.median(along / np.sum(cells**2, axis=1)))
        if scale < 1.0 - _NEIGHBOUR_TOLERANCE:
            return False
        distances = np.abs(self.offsets / scale - cells).max(axis=1)
        return bool(np.median(distances) < _NEIGHBOUR_TOLERANCE)


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
    about_cell = _in_cells(markers.corners, H) - cells[:, None]
    middle = about_cell.mean(axis=1)
    shape = about_cell - middle[:, None]
    ratio = float(np.median(np.sum(shape * _UPRIGHT, axis=(1, 2)))) / 2.0
    is_square = np.abs(shape - ratio * _UPRIGHT).max(axis=(1, 2)) < _SHAPE_TOLERANCE
    is_on = is_square & (np.abs(middle).max(axis=1) < _CENTRE_TOLERANCE)
    if not 0.0 < ratio < 1.0 or is_on.sum() < FEWEST:
        return None
    return Grid(layout, is_on, markers.ids[is_on], H, ratio)


def _in_cells(corners: Array, H_image_cells: Array) -> Array:
    """Take corners of markers from the picture to the cells, shape (n, 4, 2)."""
    H = np.linalg.inv(H_image_cells)
    places = opencv().perspectiveTransform(corners.reshape(1, -1, 2), H)
    return np.asarray(places).reshape(corners.shape)
