"""What the command line says of the surroundings, and every way to say it wrongly."""

import math
import re

import numpy as np
import pytest

from calib.cli import surroundings_words as words
from calib.data.cell import Cell
from calib.data.surroundings import Box, Reflector, Tracker, TrackerNoise
from calib.errors import CalibError


def test_a_tracker():
    np.testing.assert_allclose(words.parse_tracker("2500 0 500 mm").position, [2.5, 0, 0.5])
    given = Tracker((0, 0, 0), 1.0, 5.0, TrackerNoise(1e-3))
    moved = words.parse_tracker("1, 2, 3m", given)
    np.testing.assert_array_equal(moved.position, [1, 2, 3])
    assert (moved.nearest, moved.farthest, moved.noise) == (1.0, 5.0, TrackerNoise(1e-3))


def test_a_reflector():
    np.testing.assert_allclose(words.parse_reflector("0, 3 4").normal, [0, 0.6, 0.8])
    assert words.parse_reflector("-1 0 0").acceptance == pytest.approx(math.radians(30))
    assert words.parse_reflector("1 0 0", Reflector((0, 0, 1), 0.2)).acceptance == 0.2


def test_boxes():
    table, wall = words.parse_boxes(["table: 0 0 -20 1200 800 40 mm", "cell: wall: 1,2,3,4,5,6m"])
    assert (table.name, wall.name) == ("table", "cell: wall")
    np.testing.assert_allclose(table.size, [1.2, 0.8, 0.04])
    np.testing.assert_allclose(table.T_base_box[:3, 3], [0, 0, -0.02])
    np.testing.assert_array_equal(table.T_base_box[:3, :3], np.eye(3))
    np.testing.assert_array_equal(wall.size, [4, 5, 6])


@pytest.mark.parametrize(
    ("text", "name", "low", "high"),
    [
        ("elbow=-90..90 deg", "elbow", -math.pi / 2, math.pi / 2),
        ("lift=10mm..0.5m", "lift", 0.01, 0.5),
        ("a=b=-1.5..-1e-1rad", "a=b", -1.5, -0.1),
    ],
)
def test_ranges(text, name, low, high):
    assert words.parse_ranges([text]) == {name: pytest.approx((low, high))}


@pytest.mark.parametrize(
    ("parse", "text", "said"),
    [
        (words.parse_tracker, "2500 0 mm", "--tracker was given as \"2500 0 mm\"; it must be three numbers and a unit"),
        (words.parse_reflector, "0 0", "--reflector was given as \"0 0\"; it must be a direction in the tip, three"),
    ],
)  # fmt: skip
def test_words_that_cannot_be_read(parse, text, said):
    with pytest.raises(CalibError, match=re.escape(said)):
        parse(text)


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        (["0 0 0 1 1 1 m"], '--box was given as "0 0 0 1 1 1 m"; it must be a name, the centre'),
        (["a: 0 0 0 1 -1 1 m"], "three edges above 0, and a unit of length"),
        (
            ["a: 0 0 0 1 1 1 kg"],
            "a unit of length: \"table: 0 0 -20 1200 800 40 mm\". The units are 'm', 'mm'",
        ),
        (2 * ["a: 0 0 0 1 1 1 m"], "Each box needs a name of its own; given more than once: 'a'."),
    ],
)
def test_boxes_that_cannot_be_read(texts, said):
    with pytest.raises(CalibError, match=re.escape(said)):
        words.parse_boxes(texts)


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        (["-90..90 deg"], '--range was given as "-90..90 deg"; it must be a joint, its least and'),
        (["a=90 deg"], '--range was given as "a=90 deg"'),
        (2 * ["a=-90..90 deg"], 'such as "elbow_joint=-90..90 deg", and each joint once.'),
        (["a=0..90 kg"], "--range \"a=0..90 kg\": 'kg' is not a unit that calib knows"),
        (["a=0 m..90 deg"], "is from '0 m' to '90 deg'; one is an angle and one a length."),
    ],
)
def test_ranges_that_cannot_be_read(texts, said):
    with pytest.raises(CalibError, match=re.escape(said)):
        words.parse_ranges(texts)


def test_the_command_line_stands_on_top_of_the_file():
    cell = Cell(
        tip="tool0",
        tracker=Tracker((0, 0, 0), 1.0, 5.0),
        reflector=Reflector((0, 0, 1), 0.2),
        boxes=(Box("a", (1, 1, 1), np.eye(4)), Box("b", (1, 1, 1), np.eye(4))),
        ranges={"j": (0.0, 1.0), "k": (0.0, 1.0)},
    )
    assert repr(words.add_surroundings(cell)) == repr(cell)
    said = words.add_surroundings(
        cell,
        tracker="1 2 3 m",
        reflector="1 0 0",
        boxes=["b: 0 0 0 2 2 2 m", "c: 0 0 0 3 3 3 m"],
        ranges=["k=-1..1 rad"],
    )
    assert said.tip == "tool0"
    assert said.tracker.position.tolist() == [1, 2, 3]
    assert said.tracker.nearest == 1.0
    assert said.reflector.normal.tolist() == [1, 0, 0]
    assert said.reflector.acceptance == 0.2
    assert [(box.name, box.size[0]) for box in said.boxes] == [("a", 1), ("b", 2), ("c", 3)]
    assert said.ranges == {"j": (0.0, 1.0), "k": (-1.0, 1.0)}
