"""Joints at their stops: the angle that is measured, and the chain that it is seen through."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib.data.kinds as registry
from calib.data.stops import (
    is_stop,
    stop_angle,
    stop_derivative,
    stop_links,
    stop_poses,
    stop_residual,
)
from calib.errors import UrdfError
from calib.robot.robot import Robot


@pytest.mark.parametrize("name", ["ur3", "so101", "panda"])
def test_what_is_predicted_is_the_joint_s_angle(name: str):
    robot = Robot.load(name)
    for joint in robot.joints:
        base, tip = stop_links(robot.urdf, joint.name)
        chain = Robot.from_urdf(robot.urdf, base, tip)
        T_frame_base, T_tip_target = stop_poses(robot.urdf, joint.name)
        q = np.linspace(-3.0, 3.0, 7)[:, None]
        T = T_frame_base @ chain.poses(q) @ T_tip_target
        np.testing.assert_allclose(stop_angle(T), q, atol=1e-14)
        np.testing.assert_allclose(T[:, :3, 2], np.tile([0.0, 0.0, 1.0], (7, 1)), atol=1e-14)


def test_whole_turns_do_not_count():
    T = np.eye(4)[None]
    np.testing.assert_allclose(stop_residual(np.array([[6.0]]), T), [[6.0 - 2.0 * np.pi]])


def test_the_derivative_is_that_of_differences():
    rng = np.random.default_rng(0)
    T = np.tile(np.eye(4), (5, 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(rng.normal(0.0, 0.5, (5, 3))).as_matrix()
    twists = rng.normal(size=(5, 6, 4))
    J = stop_derivative(np.zeros((5, 1)), T, twists)
    step = 1e-6
    for k in range(4):
        moved = []
        for sign in (1.0, -1.0):
            ahead = T.copy()
            turn = Rotation.from_rotvec(sign * step * twists[:, 3:, k]).as_matrix()
            ahead[:, :3, :3] = turn @ T[:, :3, :3]
            moved.append(stop_angle(ahead))
        np.testing.assert_allclose(J[:, :, k], (moved[0] - moved[1]) / (2.0 * step), atol=1e-8)


def test_a_stop_is_a_station_and_a_target_of_the_joint_s_name():
    urdf = Robot.load("so101").urdf
    assert is_stop(urdf, "elbow_flex", "elbow_flex")
    assert not is_stop(urdf, "", "elbow_flex")
    assert not is_stop(urdf, "target", "target")


def test_joints_that_do_not_turn_have_no_such_stop():
    urdf = Robot.load("panda").urdf
    with pytest.raises(UrdfError, match="'panda_finger_joint1', which is prismatic"):
        stop_links(urdf, "panda_finger_joint1")
    with pytest.raises(UrdfError, match="no joint 'elbow'"):
        stop_links(urdf, "elbow")


def test_the_kind_measures_no_length_and_no_place():
    kind = registry.get("stop")
    assert (kind.of_joint, kind.measures_length, kind.tells_place, kind.free) == (
        True,
        False,
        False,
        False,
    )
