"""Markers of a dictionary in a picture."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calib.basics.arrays import Array
from calib.boards.board import Board, marker_outlines
from calib.boards.corners.markers import (
    Markers,
    _agree_with_map,
    _without_doubles,
    find_markers,
    no_markers,
    place_board,
)
from calib.boards.dictionaries import opencv_dictionary
from calib.errors import CalibError
from tests.boards.board_views import CHARUCO_BOARD, View, render


def test_all_markers_with_their_corners():
    view = View(tilt=(20, 10, 30))
    markers = find_markers(render(CHARUCO_BOARD, view), CHARUCO_BOARD.dictionary)
    assert sorted(markers.ids) == list(range(17))
    T = view.T_camera_board(CHARUCO_BOARD)
    layout = marker_outlines(CHARUCO_BOARD)[markers.ids]
    points = layout @ T[:3, :2].T + T[:3, 3]
    pixels = view.focal * points[..., :2] / points[..., 2:] + view.principal
    assert np.abs(markers.corners - pixels).max() < 1.0


def test_a_thorough_search_finds_more_of_what_is_blurred():
    image = render(CHARUCO_BOARD, View(tilt=(40, 60, 0), middle=(0, 0, 0.45), blur=1.2, noise=5))
    quick = find_markers(image, CHARUCO_BOARD.dictionary)
    thorough = find_markers(image, CHARUCO_BOARD.dictionary, thorough=True)
    assert len(thorough.ids) > len(quick.ids)


def test_ids_are_counted_from_the_first():
    corners = np.arange(24.0).reshape(3, 4, 2)
    markers = Markers(np.array([3, 9, 10]), corners).of_ids(np.array([9]))
    assert markers.ids.tolist() == [0]
    np.testing.assert_array_equal(markers.corners, corners[1:2])


def test_a_second_outline_of_a_marker_is_dropped():
    outer = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 20.0], [0.0, 20.0]])
    inner = 2.0 + 0.8 * outer
    beside = outer + np.array([30.0, 0.0])
    corners = np.stack([inner, outer, beside, inner])
    markers = _without_doubles(Markers(np.array([4, 4, 4, 7]), corners))
    assert markers.ids.tolist() == [4, 4, 7]  # on another board the same id, and another id, stay
    np.testing.assert_array_equal(markers.corners, corners[1:])


def test_an_empty_picture_has_none():
    markers = find_markers(np.full((100, 100), 127, np.uint8), "DICT_4X4_50")
    assert markers.ids.shape == no_markers().ids.shape == (0,)
    assert markers.corners.shape == (0, 4, 2)


def test_a_dictionary_that_this_opencv_lacks(monkeypatch: pytest.MonkeyPatch):
    opencv_dictionary.cache_clear()  # another test may have asked for it
    monkeypatch.delattr(cv2.aruco, "DICT_ARUCO_MIP_36h12")
    with pytest.raises(CalibError, match="DICT_ARUCO_MIP_36h12"):
        find_markers(np.zeros((10, 10), np.uint8), "DICT_ARUCO_MIP_36h12")


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
    placement = place_board(markers(), marker_outlines(CHARUCO_BOARD), SIZE)
    assert placement is not None
    assert placement.is_sound
    assert placement.agrees.all()
    predicted = placement.map.project(CHARUCO_BOARD.corners[:, :2])
    assert np.abs(predicted - STEEP.corners(CHARUCO_BOARD)).max() < 0.3


def test_a_misread_id_is_left_out():
    right = markers()
    ids = right.ids.copy()
    ids[4] = 16
    placement = place_board(Markers(ids, right.corners), marker_outlines(CHARUCO_BOARD), SIZE)
    assert placement is not None
    assert placement.is_sound
    assert np.flatnonzero(~placement.agrees).tolist() == [4]


def test_another_layout_is_no_sound_place():
    swapped = replace(CHARUCO_BOARD, columns=5, rows=7)
    placement = place_board(markers(), marker_outlines(swapped), SIZE)
    assert placement is None or not placement.is_sound
    # Of a shift by some ids most markers of every second row agree.
    shifted = markers().of_ids(np.arange(3, 17))
    placement = place_board(shifted, marker_outlines(CHARUCO_BOARD), SIZE)
    assert placement is None or not placement.is_sound


def test_one_marker_is_no_place():
    assert (
        place_board(markers().of_ids(np.arange(5, 6)), marker_outlines(CHARUCO_BOARD), SIZE) is None
    )
    assert (
        place_board(markers().of_ids(np.arange(5, 7)), marker_outlines(CHARUCO_BOARD), SIZE)
        is not None
    )


def test_markers_that_a_lens_moves_agree_with_their_neighbours():
    """A lens that bends one side as no map knows; a misread id agrees with nobody."""
    right = markers()
    shift = right.corners - right.corners.mean(axis=(0, 1))
    bent = right.corners + 6e-6 * np.maximum(shift[..., :1], 0.0) ** 3
    layout = marker_outlines(CHARUCO_BOARD)
    placement = place_board(Markers(right.ids, bent), layout, SIZE)
    assert placement is not None
    by_map = _agree_with_map(placement.map, layout[right.ids], Markers(right.ids, bent))
    assert (~by_map).sum() == 3
    assert placement.misread == 1
    assert placement.is_sound
    ids = right.ids.copy()
    ids[4] = 16
    misread = place_board(Markers(ids, bent), layout, SIZE)
    assert misread is not None
    assert not misread.agrees[4]
