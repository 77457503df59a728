"""Stops of an arm, planted."""

from __future__ import annotations

import numpy as np
import pytest

from calib.robot.robot import Robot
from calib.verbs.bag.stops import SHORTEST, find_stops
from calib.verbs.bag.streams import JointStream
from tests.verbs.bag.motions import stop_and_go, streams, wandering


@pytest.mark.parametrize("rate", [30.0, 125.0, 500.0])
@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_stops_are_found_where_they_are(rate: float, noise: float):
    rng = np.random.default_rng(0)
    motion = stop_and_go(rng, stops=8, rest=1.0)
    robot = Robot.load("ur5", base="base_link", tip="tool0")
    joints, _ = streams(motion, robot, rng, 0.0, joint_rate=rate, joint_noise=noise)
    found = find_stops(joints)
    assert len(found) == 8
    for (begin, end), (first, last) in zip(found, motion.rests, strict=True):
        assert first - 0.1 < begin < first + 0.35
        assert last - 0.35 < end < last + 0.1


def test_coarse_encoders_and_reported_speeds():
    """Steps of 1.5 mrad, as of a servo, do not hide a stop; a reported creep does."""
    rng = np.random.default_rng(1)
    motion = stop_and_go(rng, stops=6, rest=1.0, n=2)
    t = np.arange(0.0, motion.duration, 0.01)
    q = motion.at(t)
    none = np.full_like(q, np.nan)
    steps = JointStream(("a", "b"), t, np.round(q / 1.5e-3) * 1.5e-3, none)
    assert len(find_stops(steps)) == 6
    speeds = np.gradient(q, t, axis=0)
    assert len(find_stops(JointStream(("a", "b"), t, q, speeds))) == 6
    creeping = np.where(np.abs(speeds) < 1e-3, 0.02, speeds)
    assert len(find_stops(JointStream(("a", "b"), t, q, creeping))) == 0
    # Speeds that have nothing to do with the positions are not believed.
    nonsense = np.ones_like(q)
    assert len(find_stops(JointStream(("a", "b"), t, q, nonsense))) == 6


def test_no_stop_in_a_motion_a_gap_or_a_creep():
    rng = np.random.default_rng(2)
    robot = Robot.load("ur5", base="base_link", tip="tool0")
    joints, _ = streams(wandering(rng, duration=20.0), robot, rng, 0.0)
    assert len(find_stops(joints)) == 0
    t = np.concatenate([np.arange(0.0, 5.0, 0.01), np.arange(15.0, 20.0, 0.01)])
    turning = JointStream(("a",), t, t[:, None] % 5.0, np.full((len(t), 1), np.nan))
    assert len(find_stops(turning)) == 0
    creeping = JointStream(("a",), t, 1e-3 * t[:, None], np.full((len(t), 1), np.nan))
    assert len(find_stops(creeping)) == 0


def test_a_bag_that_is_too_short_has_none():
    t = np.arange(10) * 0.01
    stream = JointStream(("a",), t, np.zeros((10, 1)), np.full((10, 1), np.nan))
    assert find_stops(stream).shape == (0, 2)
    assert SHORTEST > 0.1
