"""Whole turns: a stretch of poses that nothing but a turn more of a joint can reach."""

import numpy as np
import pytest

from calib.design.candidates import turn_limits
from calib.design.turns import turning, with_whole_turns
from calib.model.robot import Robot
from calib.model.urdf import Urdf

WIDE = np.array([[-2.0 * np.pi, 2.0 * np.pi], [-np.pi, np.pi]])


def floor(a, b):
    """A bar on its first joint must not pass through straight down, 90 deg (and that less or more turns)."""
    path = a[0] + np.linspace(0.0, 1.0, 181) * (b[0] - a[0])
    return bool(np.all(np.abs(np.mod(path, 2.0 * np.pi) - 0.5 * np.pi) > 0.05))


def poses(*degrees):
    return np.array([[np.radians(d), 0.1 * k] for k, d in enumerate(degrees)])


def test_a_bar_goes_over_the_top():
    q = poses(-120.0, -80.0, -10.0, 150.0, 170.0)
    near, far = np.arange(3), np.arange(3, 5)
    assert not floor(q[2], q[3])
    turned = with_whole_turns(q, [near, far], WIDE, np.array([True, False]), floor)
    assert turned[:3] == pytest.approx(q[:3])
    assert np.degrees(turned[3:, 0]) == pytest.approx([-210.0, -190.0])
    assert turned[3:, 1] == pytest.approx(q[3:, 1])
    assert floor(turned[0], turned[3])


def test_the_longest_stretch_stays_whatever_the_order():
    q = poses(150.0, 170.0, -120.0, -80.0, -10.0)
    turned = with_whole_turns(
        q, [np.arange(2), np.arange(2, 5)], WIDE, np.array([True, False]), floor
    )
    assert np.degrees(turned[:, 0]) == pytest.approx([-210.0, -190.0, -120.0, -80.0, -10.0])


@pytest.mark.parametrize(
    ("ranges", "turns"),
    [(WIDE, [False, False]), (np.array([[-np.pi, np.pi], [-np.pi, np.pi]]), [True, False])],
)
def test_where_no_turn_leads_poses_stay(ranges, turns):
    q = poses(-120.0, -80.0, -10.0, 150.0, 170.0)
    turned = with_whole_turns(q, [np.arange(3), np.arange(3, 5)], ranges, np.array(turns), floor)
    assert np.array_equal(turned, q)


def test_joints_of_more_than_a_turn():
    ur3 = Robot.load("urdf/ur3.urdf", base="base", tip="tool0")
    limits = turn_limits(ur3, {"wrist_1_joint": (-1.0, 1.0)}, np.radians(5.0))
    assert np.degrees(limits[0]) == pytest.approx([-355.0, 355.0])
    assert limits[3] == pytest.approx([-1.0, 1.0])
    # The elbow has one turn, and a joint with a range is kept in it.
    assert turning(ur3, limits).tolist() == [True, True, False, False, True, True]


def test_joints_that_slide_or_are_followed_are_not_turned():
    text = Robot.load("urdf/ur3.urdf", base="base", tip="tool0").urdf.data.decode()
    start = text.index("</joint>", text.index('name="wrist_3_joint"'))
    mimic = '<mimic joint="wrist_2_joint" multiplier="0.5"/>'
    robot = Robot.from_urdf(
        Urdf.from_bytes((text[:start] + mimic + text[start:]).encode(), "m"), "base", "tool0"
    )
    wide = np.tile([-10.0, 10.0], (len(robot.inputs), 1))
    assert turning(robot, wide).tolist() == [True, True, True, True, False]
    panda = Robot.load("panda", tip="panda_leftfinger")
    assert not turning(panda, np.tile([-10.0, 10.0], (8, 1)))[-1]
