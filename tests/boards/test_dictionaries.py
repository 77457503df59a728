"""Dictionaries of markers: those of OpenCV, and what is too large for them."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import pytest

from calib.boards.dictionaries import (
    DICTIONARIES,
    KINDS,
    Dictionary,
    check_markers,
    dictionary_of,
    kind_of,
    opencv_dictionary,
    smallest_dictionary,
)
from calib.errors import CalibError


def test_the_dictionaries_are_those_of_opencv():
    names = {name for name in dir(cv2.aruco) if name.startswith("DICT_")}
    # Two spellings of each AprilTag family.
    assert {name.casefold() for name in names} == {name.casefold() for name in DICTIONARIES}
    for name, row in DICTIONARIES.items():
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
        assert (row.bits, row.markers) == (dictionary.markerSize, len(dictionary.bytesList)), name


def test_a_dictionary_that_is_too_small_names_larger_ones():
    check_markers("DICT_4X4_50", 0, 50, "A board")
    with pytest.raises(CalibError, match=r"Large enough are 'DICT_4X4_100', 'DICT_4X4_250'"):
        check_markers("DICT_4X4_50", 1, 50, "A board")
    with pytest.raises(CalibError, match="Large enough are 'DICT_APRILTAG_36h10'"):
        check_markers("DICT_APRILTAG_36h11", 0, 2000, "A board")
    with pytest.raises(CalibError, match=r"did you mean 'DICT_5X5_100'"):
        check_markers("DICT_5X5_10O", 0, 5, "A board")
    with pytest.raises(CalibError):
        check_markers("DICT_4X4_50", -1, 5, "A board")


def test_small_dictionaries_are_the_beginning_of_large_ones():
    assert sorted(name for kind in KINDS for name in kind) == sorted(DICTIONARIES)
    for kind in KINDS:
        codes = [
            cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)).bytesList for name in kind
        ]
        for small, large in itertools.pairwise(codes):
            np.testing.assert_array_equal(small, large[: len(small)])


def test_dictionaries_with_the_same_first_markers():
    assert kind_of("DICT_5X5_100") == kind_of("DICT_5X5_1000")
    assert kind_of("DICT_APRILTAG_36h11") != kind_of("DICT_APRILTAG_36h10")


def test_the_smallest_dictionary_that_has_an_id():
    assert smallest_dictionary(KINDS[1], 49) == "DICT_5X5_50"
    assert smallest_dictionary(KINDS[1], 50) == "DICT_5X5_100"
    assert smallest_dictionary(KINDS[1], 999) == "DICT_5X5_1000"
    assert smallest_dictionary(KINDS[1], 5000) == "DICT_5X5_1000"


def test_dictionaries_that_opencv_makes():
    assert dictionary_of("DICT_5X5_30_SEED_7") == Dictionary(5, 30)
    assert dictionary_of("DICT_4X4_80_SEED_7_FROM_DICT_4X4_50") == Dictionary(4, 80)
    made = opencv_dictionary("DICT_5X5_30_SEED_7")
    theirs = cv2.aruco.extendDictionary(30, 5, cv2.aruco.Dictionary(), 7)
    np.testing.assert_array_equal(made.bytesList, theirs.bytesList)
    longer = opencv_dictionary("DICT_4X4_80_SEED_7_FROM_DICT_4X4_50")
    base = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    np.testing.assert_array_equal(longer.bytesList[:50], base.bytesList)
    assert kind_of("DICT_5X5_30_SEED_7") == ("DICT_5X5_30_SEED_7",)


@pytest.mark.parametrize(
    "name",
    [
        "DICT_5X4_30_SEED_7",
        "DICT_5X5_30_SEED_",
        "DICT_9X9_30_SEED_7",
        "DICT_4X4_40_SEED_7_FROM_DICT_4X4_50",
        "DICT_4X4_80_SEED_7_FROM_DICT_5X5_50",
        "DICT_4X4_80_SEED_7_FROM_DICT_NONE",
    ],
)
def test_dictionaries_that_it_does_not(name: str):
    assert dictionary_of(name) is None
    with pytest.raises(CalibError, match="SEED"):
        check_markers(name, 0, 4, "The board")
