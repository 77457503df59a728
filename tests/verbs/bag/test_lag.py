"""The lag of points behind joints, planted in motions of a UR5 that Pinocchio moves."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib.robot.robot import Robot
from calib.verbs.bag.lag import Lag, NoLag, find_lag
from calib.verbs.bag.streams import JointStream, PointStream
from tests.verbs.bag.motions import TARGET, stop_and_go, streams, wandering


@pytest.fixture(scope="module")
def ur5() -> Robot:
    return Robot.load("ur5", base="base_link", tip="tool0")


@pytest.mark.parametrize(
    ("lag", "rates"), [(0.05, (125.0, 100.0)), (-4.0, (500.0, 30.0)), (0.7, (30.0, 300.0))]
)
def test_the_lag_of_stops_and_moves_is_found_to_5_ms(ur5: Robot, lag: float, rates):
    rng = np.random.default_rng(3)
    motion = stop_and_go(rng, stops=12, rest=1.0)
    joints, points = streams(
        motion, ur5, rng, lag, joint_rate=rates[0], point_rate=rates[1], jitter=2e-3, drops=0.05
    )
    for robot, within in ((None, 5e-3), (ur5, 1e-3)):
        found = find_lag(joints, points, robot)
        assert isinstance(found, Lag)
        assert found.value == pytest.approx(lag, abs=within)
        assert abs(found.value - lag) < 5.0 * found.sigma
        assert found.sigma < within
        assert found.by_robot == (robot is not None)


def test_a_motion_without_rests_tells_its_lag_by_the_robot(ur5: Robot):
    rng = np.random.default_rng(1)
    motion = wandering(rng, duration=40.0, dt=5e-3)
    joints, points = streams(motion, ur5, rng, -1.3, joint_rate=60.0, point_rate=50.0)
    found = find_lag(joints, points, ur5)
    assert isinstance(found, Lag)
    assert found.value == pytest.approx(-1.3, abs=1e-3)


@pytest.mark.slow
def test_a_long_motion_without_rests_tells_its_lag_alone(ur5: Robot):
    rng = np.random.default_rng(2)
    joints, points = streams(wandering(rng), ur5, rng, 2.2)
    found = find_lag(joints, points)
    assert isinstance(found, Lag)
    assert found.value == pytest.approx(2.2, abs=1e-3)
    # A short one hardly tells it, and says so.
    joints, points = streams(wandering(rng, duration=40.0), ur5, rng, 2.2)
    short = find_lag(joints, points)
    assert isinstance(short, Lag)
    assert short.sigma > 20.0 * found.sigma
    assert abs(short.value - 2.2) < 3.0 * short.sigma


def test_a_robot_that_is_a_centimetre_off_does_not_bias_it(ur5: Robot):
    """The points by Pinocchio on placements that are off; the lag by the nominal robot."""
    rng = np.random.default_rng(4)
    motion = stop_and_go(rng, stops=12, rest=0.8)
    joints, points = streams(motion, ur5, rng, 0.25)
    model = pin.buildModelFromXML(ur5.urdf.data.decode())
    for k in range(1, model.njoints):
        off = 0.01 * rng.standard_normal(6)
        model.jointPlacements[k] = model.jointPlacements[k] * pin.exp6(off)
    data = model.createData()
    frame = model.getFrameId("tool0")
    p = []
    for q in motion.at(points.times - 0.25):
        pin.framesForwardKinematics(model, data, q)
        p.append(data.oMf[frame].act(TARGET))
    moved = PointStream("", "", "", points.times, np.array(p), points.quaternions)
    found = find_lag(joints, moved, ur5)
    assert isinstance(found, Lag)
    assert found.value == pytest.approx(0.25, abs=5e-3)
    assert abs(found.value - 0.25) < 4.0 * found.sigma


def test_no_lag_without_a_motion_that_both_saw(ur5: Robot):
    rng = np.random.default_rng(5)
    joints, points = streams(stop_and_go(rng, stops=8), ur5, rng, 0.2)
    still = np.repeat(points.positions[:1], len(points.times), axis=0)
    standing = PointStream("", "", "", points.times, still, points.quaternions)
    assert find_lag(joints, standing) == NoLag("no_motion")
    assert find_lag(joints, standing, ur5) == NoLag("no_motion")
    # One point a stop, as a tracker gives that is triggered.
    few = PointStream(
        "", "", "", points.times[::400], points.positions[::400], points.quaternions[::400]
    )
    assert find_lag(joints, few) == NoLag("no_motion")
    unmoved = JointStream(
        joints.names, joints.times, np.repeat(joints.q[:1], len(joints.q), axis=0), joints.speeds
    )
    assert find_lag(unmoved, points) == NoLag("no_motion")


def test_a_motion_that_repeats_itself_is_unclear(ur5: Robot):
    t = np.arange(0.0, 60.0, 0.01)
    q = np.array([0.3, -1.2, 1.4, -0.5, 1.0, 0.2]) + 0.4 * np.sin(np.pi * t)[:, None]
    T = ur5.poses(q)
    joints = JointStream(ur5.joint_names, t, q, np.full_like(q, np.nan))
    p = T[:, :3, 3] + 1e-4 * np.random.default_rng(6).standard_normal((len(t), 3))
    points = PointStream("", "", "", t, p, np.full((len(t), 4), np.nan))
    assert find_lag(joints, points, ur5) == NoLag("unclear")


@pytest.mark.slow
def test_the_standard_deviation_is_that_of_the_errors(ur5: Robot):
    for robot, low, high in ((ur5, 0.7, 1.6), (None, 0.5, 1.5)):
        z = []
        for seed in range(24):
            rng = np.random.default_rng(seed)
            motion = stop_and_go(rng, stops=16, rest=0.8)
            joints, points = streams(motion, ur5, rng, 0.4, jitter=2e-3)
            found = find_lag(joints, points, robot)
            assert isinstance(found, Lag)
            z.append((found.value - 0.4) / found.sigma)
        assert low < np.sqrt(np.mean(np.square(z))) < high
