"""The grid of markers: cells by ids, and grids that are recognised from places alone."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from calib.boards.board import APRILTAG, CHARUCO, Board
from calib.boards.drawing import is_white, marker_corners
from calib.boards.marker_grids import Layout, grid_of
from calib.boards.markers import KINDS, Markers

#: A steep view.
H = np.array([[900.0, 200.0, 300.0], [-100.0, 800.0, 250.0], [0.3, 1.1, 1.0]])


def described(pattern=CHARUCO, columns=7, rows=6, *, first=0, legacy=False):
    return Board(
        pattern=pattern,
        columns=columns,
        rows=rows,
        square=0.1,
        marker=0.07,
        dictionary="DICT_5X5_1000",
        first_marker=first,
        legacy=legacy,
    )


def seen(board, keep=slice(None)):
    """The markers of a board in the picture of a camera without noise."""
    square = board.marker * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    corners = marker_corners(board)[:, None] + square
    places = cv2.perspectiveTransform(corners.reshape(1, -1, 2), H).reshape(-1, 4, 2)
    ids = board.first_marker + np.arange(board.markers)
    return Markers(KINDS[1], ids[keep], places[keep])


@pytest.mark.parametrize("columns", [2, 3, 6, 7])
@pytest.mark.parametrize("legacy", [False, True])
def test_cells_of_a_charuco_board_are_its_white_squares(columns, legacy):
    board = described(columns=columns, first=3, legacy=legacy)
    layout = Layout(CHARUCO, columns, 3, starts_white=legacy)
    rows, columns_of_cells = np.nonzero(is_white(board))
    cells = layout.cells(3 + np.arange(board.markers))
    np.testing.assert_array_equal(cells, np.column_stack([columns_of_cells, rows]))


def test_cells_of_a_grid_of_tags():
    ids = np.array([5, 6, 8, 12])
    cells = Layout(APRILTAG, 3, 5).cells(ids)
    np.testing.assert_array_equal(cells, [[0, 0], [1, 0], [0, 1], [1, 2]])
    cells = Layout(APRILTAG, 3, 5, bottom_up=True).cells(ids)
    np.testing.assert_array_equal(cells, [[0, 0], [1, 0], [0, -1], [1, -2]])


@pytest.mark.parametrize("pattern", [CHARUCO, APRILTAG])
@pytest.mark.parametrize("columns", [2, 5, 8])
@pytest.mark.parametrize("first", [0, 20])
def test_columns_and_rows_of_what_is_seen(pattern, columns, first):
    grid = grid_of(seen(described(pattern, columns, 5, first=first)))
    assert (grid.layout.pattern, grid.layout.columns, grid.rows) == (pattern, columns, 5)
    assert grid.layout.first == first
    assert not grid.layout.starts_white
    assert grid.ratio == pytest.approx(0.7)
    assert grid.completeness == 1.0


def test_the_legacy_layout():
    grid = grid_of(seen(described(legacy=True)))
    assert grid.layout == Layout(CHARUCO, 7, 0, starts_white=True)


def test_rows_from_the_bottom():
    board = described(APRILTAG, 4, 3)
    markers = seen(board)
    ids = np.arange(12).reshape(3, 4)[::-1].ravel()
    grid = grid_of(Markers(markers.kind, ids, markers.corners))
    assert grid.layout == Layout(APRILTAG, 4, 0, bottom_up=True)
    assert grid.rows == 3


@pytest.mark.parametrize("first", [0, 40])
def test_half_of_the_markers_are_enough(first):
    rng = np.random.default_rng(1)
    board = described(first=first)
    keep = np.sort(rng.choice(board.markers, 12, replace=False))
    grid = grid_of(seen(board, keep))
    assert (grid.layout.columns, grid.layout.first) == (7, first)
    assert grid.completeness < 0.7


def test_a_stray_marker_is_left_out():
    markers = seen(described())
    corners = markers.corners.copy()
    corners[4] += 80.0
    grid = grid_of(Markers(markers.kind, markers.ids, corners))
    assert grid.layout.columns == 7
    np.testing.assert_array_equal(np.flatnonzero(~grid.is_on), [4])
    assert 4 not in grid.ids


def test_one_id_in_all_places_is_no_grid():
    markers = seen(described())
    ids = np.full_like(markers.ids, 7)
    assert grid_of(Markers(markers.kind, ids, markers.corners)) is None


def test_an_id_that_is_seen_twice():
    markers = seen(described())
    ids = markers.ids.copy()
    ids[5] = 6
    assert grid_of(Markers(markers.kind, ids, markers.corners)).layout.columns == 7


def test_too_few_markers_or_one_row_are_no_grid():
    board = described()
    assert grid_of(seen(board, slice(0, 3))) is None
    assert grid_of(seen(described(APRILTAG), slice(0, 6))) is None


def test_places_without_order_are_no_grid():
    rng = np.random.default_rng(0)
    markers = seen(described())
    order = rng.permutation(len(markers.ids))
    assert grid_of(Markers(markers.kind, markers.ids[order], markers.corners)) is None
