from __future__ import annotations

import re

import numpy as np
import pytest

from calib.cli.surroundings_words import add_surroundings, parse_start
from calib.cli.verbs.plan import parse_ladder
from calib.data.cell import Cell
from calib.data.surroundings import Tracker, TrackerNoise
from calib.errors import CalibError
from calib.robot.robot import Robot
from calib.text.lines import row_ranges


def test_ladders():
    assert parse_ladder(None) is None
    assert parse_ladder("none") == []
    assert parse_ladder(" 10,15, 20 30") == [10, 15, 20, 30]


@pytest.mark.parametrize("text", ["", "10;15", "ten", "0", "10,0", "-5", "1.5", "none,5"])
def test_ladders_that_mean_nothing(text):
    with pytest.raises(CalibError, match=re.escape(f'--ladder was given as "{text}"; it must be')):
        parse_ladder(text)


def test_starts(ur3):
    assert parse_start([], ur3) is None
    np.testing.assert_array_equal(parse_start(["home"], ur3), np.zeros(6))
    start = parse_start(["elbow_joint=90 deg", " shoulder_lift_joint = -1 rad"], ur3)
    np.testing.assert_allclose(start, [0.0, -1.0, np.pi / 2, 0.0, 0.0, 0.0], rtol=1e-15)
    assert not start.flags.writeable


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        (["elbow"], "--start was given 'elbow'; it must be 'joint=value' with a unit"),
        (["elbow_joint=1"], "--start 'elbow_joint=1' is '1'; a joint's value needs a unit"),
        (["elbow_joint=1 deg"] * 2, "--start was given 'elbow_joint=1 deg'; it must be"),
        (["elbow=1 deg"], "The chain has no joint 'elbow' to start at"),
        (["elbow_joint=1 mm"], "is a length, and the joint turns"),
    ],
)  # fmt: skip
def test_starts_that_mean_nothing(ur3, texts, said):
    with pytest.raises(CalibError, match=re.escape(said)):
        parse_start(texts, ur3)


def test_no_robot_starts_beyond_its_limits(ur3, panda):
    with pytest.raises(CalibError, match=r"'elbow_joint' .* -180 to 180 deg"):
        parse_start(["elbow_joint=400 deg"], ur3)
    # The zero of a Panda's fourth joint is one that it cannot reach.
    for texts in (["home"], ["panda_joint1=10 deg"]):
        with pytest.raises(
            CalibError, match=r"--start: 'panda_joint4' would stand beyond its limits"
        ):
            parse_start(texts, panda)
    assert parse_start(["home", "panda_joint4=-90 deg"], panda)[3] == pytest.approx(-np.pi / 2)


def test_a_start_of_a_joint_that_slides(serial_urdf):
    joints = [("prismatic", (0, 0, 0.1), (0, 0, 0), (0, 0, 1))]
    robot = Robot.from_urdf(serial_urdf(joints))
    assert parse_start(["j1=20 mm"], robot).tolist() == [0.02]
    with pytest.raises(CalibError, match=r"is an angle, and the joint slides"):
        parse_start(["j1=20 deg"], robot)


def test_noise():
    assert add_surroundings(Cell(sigma=1e-4), noise=None).sigma == 1e-4
    assert add_surroundings(Cell(), noise="0.05 mm").sigma == pytest.approx(5e-5, rel=1e-15)
    tracker = Tracker(np.array([2.0, 0.0, 0.0]), noise=TrackerNoise(1e-5, 1e-6, 3e-5))
    cell = add_surroundings(Cell(tracker=tracker, sigma=1e-4), noise="20 um + 5 um/m")
    assert cell.sigma is None
    assert cell.tracker is not None
    noise = cell.tracker.noise
    assert (noise.constant, noise.per_length) == pytest.approx((20e-6, 5e-6), rel=1e-12)
    assert noise.repeatability == 3e-5
    np.testing.assert_array_equal(cell.tracker.position, tracker.position)
    with pytest.raises(CalibError, match=r"nothing says where the tracker stands; add --tracker"):
        add_surroundings(Cell(), noise="20 um + 5 um/m")
    with pytest.raises(CalibError, match=r"--noise was given as \"3\"; it must be a length"):
        add_surroundings(Cell(), noise="3")


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ([4], "4"),
        ([1, 2], "1, 2"),
        ([9, 7, 8, 3], "3, 7 to 9"),
        (range(1, 31), "1 to 30"),
        (range(0, 60, 3), "0, 3, 6, 9, 12, 15, 18, 21, 24, 27, 30, 33 and 8 more"),
    ],
)
def test_rows_in_words(rows, text):
    assert row_ranges(rows) == text
