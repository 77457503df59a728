"""Boxes, tracker and reflector: what is refused, and that what is kept cannot change."""

import copy
import math
import pickle
import re

import numpy as np
import pytest

from calib.errors import CalibError
from calib.measure.cell import Cell
from calib.measure.noise import TrackerNoise
from calib.measure.surroundings import Box, Reflector, Tracker, check_outside

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
        ({"size": (1, 2)}, "The size of the box 'table' must be three finite numbers x, y, z [m]; (1, 2)"),
        ({"size": (1, 2, 0)}, "The box 'table' has the edges [1.0, 2.0, 0.0] m; each must be longer than 0."),
        ({"size": (1, -2, 3)}, "The box 'table' has the edges [1.0, -2.0, 3.0] m; each must be longer"),
        ({"T_base_box": 2 * np.eye(4)}, "The pose of the box 'table' must be a 4 x 4 pose with a right-handed"),
    ],
)  # fmt: skip
def test_boxes_that_are_built_wrongly(wrong, said):
    with pytest.raises(CalibError, match=re.escape(said)):
        Box(**{"name": "table", "size": (1, 1, 1), "T_base_box": np.eye(4), **wrong})


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"position": (1, 2, math.nan)}, "The tracker's position must be three finite numbers x, y, z [m]"),
        ({"nearest": -1.0}, "The tracker measures from -1.0 m to 80.0 m; these must be two numbers"),
        ({"nearest": 90.0}, "The tracker measures from 90.0 m to 80.0 m; these must be two numbers, the first"),
        ({"farthest": math.inf}, "The tracker measures from 0.0 m to inf m; these must be"),
        ({"farthest": "far"}, "The tracker measures from 0.0 m to 'far' m; these must be"),
        ({"noise": 1e-5}, "The tracker's noise must be of type TrackerNoise; 1e-05 was given."),
    ],
)  # fmt: skip
def test_trackers_that_are_built_wrongly(wrong, said):
    with pytest.raises(CalibError, match=re.escape(said)):
        Tracker(**{"position": (1, 2, 3), **wrong})


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"normal": (0, 0, 0)}, "The reflector's normal is [0.0, 0.0, 0.0]; it must be a direction, such as"),
        ({"normal": "up"}, "The reflector's normal must be three finite numbers x, y, z [-]; 'up' was given."),
        ({"acceptance": 0.0}, "The reflector's acceptance is 0.0 rad; it must be a half angle above 0 and at most"),
        ({"acceptance": 30.0}, "The reflector's acceptance is 30.0 rad; it must be a half angle above 0"),
        ({"acceptance": None}, "The reflector's acceptance is None rad; it must be a half angle"),
    ],
)  # fmt: skip
def test_reflectors_that_are_built_wrongly(wrong, said):
    with pytest.raises(CalibError, match=re.escape(said)):
        Reflector(**{"normal": (0, 0, 1), **wrong})


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"boxes": Box("a", (1, 1, 1), T)}, "The boxes are a tuple of Box; Box(name='a'"),
        ({"boxes": ["a"]}, "The boxes are a tuple of Box; ['a'] was given."),
        (
            {"boxes": [Box("a", (1, 1, 1), T), Box("a", (2, 1, 1), T)]},
            "Each box needs a name of its own; given more than once: 'a'.",
        ),
        ({"tracker": (1, 2, 3)}, "A cell's tracker must be of type Tracker; (1, 2, 3) was given."),
        ({"reflector": (0, 0, 1)}, "A cell's reflector must be of type Reflector; (0, 0, 1) was"),
        ({"ranges": [1.0]}, "The joints' ranges must be a mapping from names; [1.0] was given."),
        ({"ranges": {"a": 1.0}}, "The range of the joint 'a' is 1.0; it must be the least and the"),
        ({"ranges": {"a": (1.0, 1.0)}}, "The range of the joint 'a' is (1.0, 1.0); it must be the"),
        ({"ranges": {"a": (2.0, 1.0)}}, "the first less than the second. To keep a joint where"),
        ({"ranges": {"a": (0.0, math.inf)}}, "The range of the joint 'a' is (0.0, inf); it must"),
        ({"ranges": {"a": (0.0, 1.0, 2.0)}}, "The range of the joint 'a' is (0.0, 1.0, 2.0); it"),
    ],
)
def test_a_cell_with_wrong_surroundings(wrong, said):
    with pytest.raises(CalibError, match=re.escape(said)):
        Cell(**wrong)


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
