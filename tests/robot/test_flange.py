"""The robot that stands for poses of the flange."""

import numpy as np
from scipy.spatial.transform import Rotation

from calib.data.forms.flange_poses import flange_joints
from calib.robot.flange import JOINTS, NAME, is_flange_robot
from calib.robot.robot import Robot


def test_any_pose_is_reached_exactly():
    robot = Robot.load(NAME)
    rng = np.random.default_rng(0)
    R = Rotation.random(200, rng).as_matrix()
    # Next to a pitch of 90 deg, and there, too.
    R[0] = Rotation.from_euler("ZYX", [0.3, np.pi / 2, 0.2]).as_matrix()
    R[1] = Rotation.from_euler("ZYX", [0.3, np.pi / 2 - 1e-9, 0.2]).as_matrix()
    p = rng.uniform(-3.0, 3.0, (200, 3))
    T = robot.poses(flange_joints(p, R))
    np.testing.assert_allclose(T[:, :3, 3], p, atol=1e-15)
    np.testing.assert_allclose(T[:, :3, :3], R, atol=1e-15)


def test_it_is_known_by_its_joints_in_any_order():
    assert is_flange_robot(Robot.load(NAME).joint_names)
    assert is_flange_robot(Robot.load(NAME, base="flange", tip="base").joint_names)
    assert not is_flange_robot(JOINTS[:5])
    assert not is_flange_robot(Robot.load("ur3").joint_names)
