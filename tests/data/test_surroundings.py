"""Boxes, tracker and reflector: what is refused, and that what is kept cannot change."""

import copy
import math
import pickle
import re

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.surroundings import (
    Box,
    Reflector,
    Tracker,
    TrackerNoise,
    check_outside,
    parse_noise,
)
from calib.errors import CalibError

T = np.array([[0.0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])


def test_a_cell_with_surroundings_can_be_sent_to_another_process():
    cell = Cell(
        boxes=(Box("table", (1, 1, 1), T),),
        tracker=Tracker((2.5, 0, 0.5), 1.0, 20.0, TrackerNoise(1e-5, 0.0, 0.0)),
        reflector=Reflector((0, 3, 4), 0.5),
        ranges={"elbow": (-1.0, 2.0)},
    )
    for there in (pickle.loads(pickle.dumps(cell)), copy.deepcopy(cell)):
        assert repr(there) == repr(cell)
        assert there.tracker.noise == cell.tracker.noise
        for array in (there.boxes[0].size, there.tracker.position, there.reflector.normal):
            assert not array.flags.writeable
        with pytest.raises(TypeError, match="does not support item assignment"):
            there.ranges["new"] = (0.0, 1.0)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"name": " "}, "A box needs a name; ' ' was given."),
        ({"name": 3}, "A box needs a name; 3 was given."),
        ({"size": (1, 2)}, "The size of the box 'table' is (1, 2); it must be three finite numbers x, y, z [m]"),
        ({"size": (1, 2, 0)}, "The box 'table' has the edges [1.0, 2.0, 0.0] m; each must be longer than 0."),
        ({"size": (1, -2, 3)}, "The box 'table' has the edges [1.0, -2.0, 3.0] m; each must be longer"),
        ({"T_base_box": 2 * np.eye(4)}, "; it must be a 4 x 4 pose with a right-handed"),
    ],
)  # fmt: skip
def test_boxes_that_are_built_wrongly(wrong, said):
    with pytest.raises(CalibError, match=re.escape(said)):
        Box(**{"name": "table", "size": (1, 1, 1), "T_base_box": np.eye(4), **wrong})


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"position": (1, 2, math.nan)}, "The tracker's position is (1, 2, nan); it must be three finite"),
        ({"nearest": -1.0}, "The tracker measures from -1.0 m to 80.0 m; these must be two numbers"),
        ({"nearest": 90.0}, "The tracker measures from 90.0 m to 80.0 m; these must be two numbers, the first"),
        ({"farthest": math.inf}, "The tracker measures from 0.0 m to inf m; these must be"),
        ({"farthest": "far"}, "The tracker measures from 0.0 m to 'far' m; these must be"),
    ],
)  # fmt: skip
def test_trackers_that_are_built_wrongly(wrong, said):
    with pytest.raises(CalibError, match=re.escape(said)):
        Tracker(**{"position": (1, 2, 3), **wrong})


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"normal": (0, 0, 0)}, "The reflector's normal is [0.0, 0.0, 0.0]; it must be a direction, such as"),
        ({"normal": "up"}, "The reflector's normal is 'up'; it must be three finite numbers x, y, z [-]"),
        ({"acceptance": 0.0}, "The reflector's acceptance is 0.0 rad; it must be a half angle above 0 and at most"),
        ({"acceptance": 30.0}, "The reflector's acceptance is 30.0 rad; it must be a half angle above 0"),
        ({"acceptance": None}, "The reflector's acceptance is None rad; it must be a half angle"),
    ],
)  # fmt: skip
def test_reflectors_that_are_built_wrongly(wrong, said):
    with pytest.raises(CalibError, match=re.escape(said)):
        Reflector(**{"normal": (0, 0, 1), **wrong})


def test_boxes_of_one_name_or_what_is_none():
    boxes = (Box("a", (1, 1, 1), T), Box("a", (2, 1, 1), T))
    with pytest.raises(CalibError, match=r"given more than once: 'a'\."):
        Cell(boxes=boxes)
    with pytest.raises(CalibError, match="The boxes are a tuple of Box"):
        Cell(boxes=("a",))


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


@pytest.mark.parametrize(
    "text",
    ["", "15", "15 kg", "um 15", "1 um + 2 um", "1 um + 2 um/mm", "-1 um", "1..2 um", "1.2.3 mm"],
)
def test_other_words_are_refused_with_what_is_allowed(text):
    with pytest.raises(CalibError, match=r"--noise was given as"):
        parse_noise(text, "--noise")


@pytest.mark.parametrize(
    "values", [(-1e-6, 0.0, 0.0), (0.0, 0.0, 0.0), (np.nan, 0.0, 1e-6), (0.0, True, 0.0)]
)
def test_what_is_no_standard_deviation_is_refused(values):
    with pytest.raises(CalibError, match="must be numbers, none below 0 and not all 0"):
        TrackerNoise(*values)
