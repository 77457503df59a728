"""Markers of a dictionary in a picture."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from calib.boards.corners.markers import Markers, _without_doubles, find_markers, no_markers
from calib.boards.layout import marker_outlines
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
    markers = Markers(np.array([3, 9, 10]), corners).of_ids(9, 1)
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
    monkeypatch.delattr(cv2.aruco, "DICT_ARUCO_MIP_36h12")
    with pytest.raises(CalibError, match="DICT_ARUCO_MIP_36h12"):
        find_markers(np.zeros((10, 10), np.uint8), "DICT_ARUCO_MIP_36h12")
