"""Markers of any dictionary in pictures."""

from __future__ import annotations

import itertools

import cv2
import numpy as np

from calib.boards.board_design import Wish, designed
from calib.boards.dictionaries import DICTIONARIES
from calib.boards.drawing import marker_corners
from calib.boards.markers import KINDS, Markers, find_markers, smallest_dictionary
from tests.boards.rendered import photo


def test_small_dictionaries_are_the_beginning_of_large_ones():
    assert sorted(name for kind in KINDS for name in kind) == sorted(DICTIONARIES)
    for kind in KINDS:
        codes = [
            cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)).bytesList for name in kind
        ]
        for small, large in itertools.pairwise(codes):
            np.testing.assert_array_equal(small, large[: len(small)])


def test_the_smallest_dictionary_that_has_an_id():
    assert smallest_dictionary(KINDS[1], 49) == "DICT_5X5_50"
    assert smallest_dictionary(KINDS[1], 50) == "DICT_5X5_100"
    assert smallest_dictionary(KINDS[1], 999) == "DICT_5X5_1000"


def test_markers_are_found_with_their_centres():
    board = designed(Wish(columns=6, rows=5), "a4")
    image, H_image_board = photo(board, size=(800, 600))
    markers = next(iter(find_markers(image)))
    assert markers.kind == KINDS[1]
    assert sorted(markers.ids) == list(range(15))
    centres = marker_corners(board) + board.marker / 2
    expected = cv2.perspectiveTransform(centres[None], H_image_board)[0]
    assert np.abs(markers.centres - expected[markers.ids]).max() < 0.3


def test_the_centre_is_where_the_diagonals_meet():
    H = np.array([[1.0, 0.2, 3.0], [0.1, 0.9, 2.0], [0.02, 0.05, 1.0]])
    square = np.array([[[0, 0], [2, 0], [2, 2], [0, 2], [1, 1]]], dtype=float)
    places = cv2.perspectiveTransform(square, H)
    markers = Markers(KINDS[0], np.array([3]), places[:, :4])
    np.testing.assert_allclose(markers.centres, places[:, 4])
    flat = Markers(KINDS[0], np.array([3]), square[:, :4])
    assert flat.side == 2.0
