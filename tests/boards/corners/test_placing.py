"""The place of a board: a misread id is left out, a wrong layout is no place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.basics.arrays import Array
from calib.boards.board import Board
from calib.boards.corners.markers import Markers
from calib.boards.corners.placing import _agree_with_map, place
from calib.boards.layout import marker_outlines
from tests.boards.board_views import CHARUCO_BOARD, View

SIZE = (640, 480)
STEEP = View(tilt=(10, 55, 20), distortion=(-0.2, 0.05))


def pixels_of(points: Array, view: View, board: Board) -> Array:
    """The pixels of points of the plane, shape (..., 2)."""
    T = view.T_camera_board(board)
    seen = points @ T[:3, :2].T + T[:3, 3]
    xy = seen[..., :2] / seen[..., 2:]
    r2 = np.sum(xy**2, axis=-1, keepdims=True)
    k1, k2 = view.distortion
    return view.focal * xy * (1 + k1 * r2 + k2 * r2**2) + view.principal


def markers(board: Board = CHARUCO_BOARD, view: View = STEEP) -> Markers:
    """All markers of a board, exactly."""
    layout = marker_outlines(board)
    return Markers(np.arange(len(layout)), pixels_of(layout, view, board))


def test_all_agree():
    placement = place(markers(), marker_outlines(CHARUCO_BOARD), SIZE)
    assert placement is not None
    assert placement.is_sound
    assert placement.agrees.all()
    predicted = placement.map.project(CHARUCO_BOARD.corners[:, :2])
    assert np.abs(predicted - STEEP.corners(CHARUCO_BOARD)).max() < 0.3


def test_a_misread_id_is_left_out():
    right = markers()
    ids = right.ids.copy()
    ids[4] = 16
    placement = place(Markers(ids, right.corners), marker_outlines(CHARUCO_BOARD), SIZE)
    assert placement is not None
    assert placement.is_sound
    assert np.flatnonzero(~placement.agrees).tolist() == [4]


def test_another_layout_is_no_sound_place():
    swapped = replace(CHARUCO_BOARD, columns=5, rows=7)
    placement = place(markers(), marker_outlines(swapped), SIZE)
    assert placement is None or not placement.is_sound
    # Of a shift by some ids most markers of every second row agree.
    shifted = markers().of_ids(3, 14)
    placement = place(shifted, marker_outlines(CHARUCO_BOARD), SIZE)
    assert placement is None or not placement.is_sound


def test_one_marker_is_no_place():
    assert place(markers().of_ids(5, 1), marker_outlines(CHARUCO_BOARD), SIZE) is None
    assert place(markers().of_ids(5, 2), marker_outlines(CHARUCO_BOARD), SIZE) is not None


def test_markers_that_a_lens_moves_agree_with_their_neighbours():
    """A lens that bends one side as no map knows; a misread id agrees with nobody."""
    right = markers()
    shift = right.corners - right.corners.mean(axis=(0, 1))
    bent = right.corners + 6e-6 * np.maximum(shift[..., :1], 0.0) ** 3
    layout = marker_outlines(CHARUCO_BOARD)
    placement = place(Markers(right.ids, bent), layout, SIZE)
    assert placement is not None
    by_map = _agree_with_map(placement.map, layout[right.ids], Markers(right.ids, bent))
    assert (~by_map).sum() == 3
    assert placement.misread == 1
    assert placement.is_sound
    ids = right.ids.copy()
    ids[4] = 16
    misread = place(Markers(ids, bent), layout, SIZE)
    assert misread is not None
    assert not misread.agrees[4]
