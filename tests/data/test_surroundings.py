"""Instrument, reflector, boxes and known distances: the noise model, unit vectors, and values that are refused."""

from __future__ import annotations

import numpy as np
import pytest

from calib.data.surroundings import (
    Box,
    GroupDistance,
    Reflector,
    Tracker,
    TrackerNoise,
    check_box_names,
)
from calib.errors import CalibError


def test_at_three_metres_a_tracker_has_33_um_beside_the_robot_s_20():
    assert TrackerNoise().std(3.0) == pytest.approx(np.hypot(33e-6, 20e-6))
    assert TrackerNoise(repeatability=0.0).std(np.array([0.0, 3.0])) == pytest.approx(
        [15e-6, 33e-6]
    )


@pytest.mark.parametrize("parts", [(0.0, 0.0, 0.0), (-1e-6, 1e-6, 0.0), (np.nan, 0.0, 0.0)])
def test_a_noise_is_positive(parts):
    with pytest.raises(CalibError, match="none may be below 0, and not all 0"):
        TrackerNoise(*parts)


def test_the_normal_is_kept_as_a_unit_vector():
    np.testing.assert_allclose(Reflector([0, 3, 4]).normal, [0, 0.6, 0.8])
    for normal, acceptance in (([0, 0, 0], 1.0), ([0, 0, 1], 0.0), ([0, 0, 1], 3.2)):
        with pytest.raises(CalibError, match="The reflector's normal is"):
            Reflector(normal, acceptance)


def test_a_tracker_has_a_range():
    assert (Tracker([1, 2, 3]).nearest, Tracker([1, 2, 3]).farthest) == (0.0, 80.0)
    for nearest, farthest in ((-1.0, 2.0), (2.0, 2.0)):
        with pytest.raises(CalibError, match="The tracker measures from"):
            Tracker([1, 2, 3], nearest, farthest)


def test_boxes_have_edges_poses_and_names_of_their_own():
    box = Box("table", [1, 2, 3], np.eye(4))
    assert not box.size.flags.writeable
    check_box_names([box, Box("wall", [1, 2, 3], np.eye(4))])
    with pytest.raises(CalibError, match="more than one is 'table'"):
        check_box_names([box, box])
    with pytest.raises(CalibError, match="each must be longer than 0"):
        Box("table", [1, 0, 3], np.eye(4))
    with pytest.raises(CalibError, match="The pose of the box 'table' is"):
        Box("table", [1, 2, 3], -np.eye(4))


@pytest.mark.parametrize(
    ("first", "second", "groups", "pairs"),
    [
        ("a", "b", ["b", "a", "c", "a"], (("a", "b"),)),
        ("a", "b", ["a", "c"], ()),
        ("*l", "*r", ["1l", "2l", "2r", "1r", "3l"], (("1l", "1r"), ("2l", "2r"))),
        ("p*/l", "p*/r", ["p1/l", "q1/l", "q1/r", "p1/r", "p/l", "p/r"], (("p1/l", "p1/r"), ("p/l", "p/r"))),
        # The text of the star is what is left of the whole name: "aba" is "ab" and "ba" only where they overlap.
        ("ab*ba", "x*", ["aba", "xa", "x"], ()),
        ("ab*ba", "x*", ["abba", "x", "xa"], (("abba", "x"),)),
        ("*", "*2", ["1", "12", "122"], (("1", "12"), ("12", "122"))),
    ],
)  # fmt: skip
def test_the_star_stands_for_the_same_text(
    first: str, second: str, groups: list[str], pairs: tuple[tuple[str, str], ...]
):
    assert GroupDistance(first, second, 1.0, 1e-3).pairs(groups) == pairs
