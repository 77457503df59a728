"""Boxes, tracker and reflector: what is refused, and that what is kept cannot change."""

import math
import re

import numpy as np
import pytest

from calib.data.surroundings import (
    Box,
    Tracker,
    TrackerNoise,
    check_outside,
    parse_noise,
)
from calib.errors import CalibError

T = np.array([[0.0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"size": (1, 2)}, "The size of the box 'table' is (1, 2); it must be three finite numbers x, y, z [m]"),
        ({"size": (1, 2, 0)}, "The box 'table' has the edges [1.0, 2.0, 0.0] m; each must be longer than 0."),
        ({"size": (1, -2, 3)}, "The box 'table' has the edges [1.0, -2.0, 3.0] m; each must be longer"),
        ({"T_base_box": 2 * np.eye(4)}, "; it must be a 4 x 4 pose with a right-handed"),
    ],
)  # fmt: skip
def test_boxes_that_are_built_wrongly(wrong, said):
    with pytest.raises(CalibError, match=re.escape(said)):
        Box(**{"name": "table", "size": (1, 1, 1), "T_base_box": np.eye(4), **wrong})


def test_a_tracker_inside_a_box_sees_nothing():
    # A beam of 2 m by 0.2 m, turned by 45 deg about z.
    T, c = np.eye(4), math.sqrt(0.5)
    T[:2, :2], T[:3, 3] = [[c, -c], [c, c]], [1.0, 1.0, 0.5]
    beam = Box("beam", np.array([2.0, 0.2, 0.2]), T)
    for place in ([1.6, 1.6, 0.5], [1.0, 1.0, 0.59]):
        with pytest.raises(CalibError, match=r"The tracker, at .* stands inside the box 'beam'"):
            check_outside(Tracker(np.array(place)), [beam])
    for place in ([1.6, 0.4, 0.5], [1.0, 1.0, 0.61], [1.8, 1.8, 0.5]):
        check_outside(Tracker(np.array(place)), [beam])


def test_at_three_metres_a_tracker_has_33_um_beside_the_robot_s_20():
    assert TrackerNoise().std(3.0) == pytest.approx(np.hypot(33e-6, 20e-6))
    assert TrackerNoise(repeatability=0.0).std(np.array([0.0, 3.0])) == pytest.approx(
        [15e-6, 33e-6]
    )


@pytest.mark.parametrize(
    ("text", "constant", "per_length"),
    [
        ("15 um + 6 um/m", 15e-6, 6e-6),
        ("15µm+6 μm/m", 15e-6, 6e-6),
        ("0.05 mm", 5e-5, 0.0),
        ("1e-2 mm + 0.001mm / m", 1e-5, 1e-6),
    ],
)
def test_words(text, constant, per_length):
    noise = parse_noise(text, "noise", repeatability=1e-5)
    assert noise.constant == pytest.approx(constant)
    assert noise.per_length == pytest.approx(per_length)
    assert noise.repeatability == 1e-5
