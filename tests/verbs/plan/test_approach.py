"""Approaches: moves by which joints arrive, the room that they need, and visits from each side."""

from __future__ import annotations

import numpy as np
import pytest

from calib.robot.ranges import column_limits
from calib.robot.robot import Robot
from calib.verbs.plan.approach import approaches, side_name, visits, with_room

FIVE = np.radians(5.0)

_SLIDING = """<robot name="gantry">
<link name="base"/><link name="cart"/><link name="hand"/>
<joint name="slide" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
<limit lower="-0.5" upper="0.5" effort="1" velocity="1"/></joint>
<joint name="wrist" type="revolute"><parent link="cart"/><child link="hand"/><axis xyz="0 0 1"/>
<limit lower="-0.1" upper="0.2" effort="1" velocity="1"/></joint></robot>"""


@pytest.fixture
def gantry(tmp_path) -> Robot:
    path = tmp_path / "gantry.urdf"
    path.write_text(_SLIDING)
    return Robot.load(path, base="base", tip="hand")


def test_joints_arrive_by_five_degrees_or_twenty_millimetres(ur3, gantry):
    six = column_limits(ur3)
    np.testing.assert_allclose(approaches(ur3, six, "one"), [[FIVE] * 6])
    np.testing.assert_allclose(approaches(ur3, six, "both"), [[FIVE] * 6, [-FIVE] * 6])
    assert approaches(ur3, six, "straight").shape == (0, 6)
    # A tenth of a range of 0.3 rad is less than 5 deg.
    np.testing.assert_allclose(approaches(gantry, column_limits(gantry), "one"), [[0.02, 0.03]])


def test_ranges_leave_room_to_come_from():
    ranges = np.array([[-1.0, 1.0], [0.0, 2.0]])
    one = np.array([[0.1, 0.2]])
    np.testing.assert_allclose(with_room(ranges, one), [[-0.9, 1.0], [0.2, 2.0]])
    np.testing.assert_allclose(with_room(ranges, np.vstack([one, -one])), [[-0.9, 0.9], [0.2, 1.8]])
    np.testing.assert_array_equal(with_room(ranges, one[:0]), ranges)


def test_every_pose_is_visited_from_each_side_in_turn():
    q = np.array([[0.0, 1.0], [2.0, 3.0]])
    sides = np.array([[0.1, 0.2], [-0.1, -0.2]])
    joints, moves = visits(q, sides)
    np.testing.assert_array_equal(joints, q[[0, 0, 1, 1]])
    np.testing.assert_array_equal(moves, sides[[0, 1, 0, 1]])
    assert [side_name(move) for move in moves] == ["rising", "falling"] * 2
    joints, moves = visits(q, sides[:0])
    np.testing.assert_array_equal(joints, q)
    np.testing.assert_array_equal(moves, [[0.0, 0.0], [2.0, 2.0]])
