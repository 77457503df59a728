"""All joint values that reach a pose."""

from __future__ import annotations

import numpy as np
import pytest

from calib.errors import ModelError
from calib.robot.ranges import column_limits, random_joint_values
from calib.robot.robot import Robot
from calib.verbs.compensate.solutions import joint_solutions


def off(solutions: np.ndarray, q: np.ndarray) -> float:
    """How far the nearest solution is, whole turns aside."""
    return float(np.abs((solutions - q + np.pi) % (2.0 * np.pi) - np.pi).max(axis=1).min())


def test_an_arm_with_a_shoulder_an_elbow_and_a_wrist_has_eight():
    robot = Robot.load("ur5", base="base", tip="tool0")
    q = np.array([[0.3, -1.2, 1.5, -1.0, -1.4, 0.4], [-0.5, -1.0, 1.3, -1.2, -1.2, 1.0]])
    found = joint_solutions(robot, robot.poses(q))
    assert [len(values) for values in found] == [8, 8]
    for values, row in zip(found, q, strict=True):
        assert off(values, row) < 1e-12
        T = robot.poses(values)
        np.testing.assert_allclose(T, np.broadcast_to(robot.poses(row[None]), T.shape), atol=1e-11)


def test_limits_leave_fewer():
    robot = Robot.load("z1")
    q = random_joint_values(robot, 6, 3)
    found = joint_solutions(robot, robot.poses(q))
    low, high = column_limits(robot).T
    for values, row in zip(found, q, strict=True):
        assert off(values, row) < 1e-11
        assert (values >= low - 1e-3).all()
        assert (values <= high + 1e-3).all()
        assert len(values) < 8


def test_an_arm_of_five_joints_reaches_its_own_poses_even_with_few_digits():
    robot = Robot.load("so101")
    q = random_joint_values(robot, 4, 1)
    T = robot.poses(q)
    T[:, :3, 3] = np.round(T[:, :3, 3], 5)
    found = joint_solutions(robot, T)
    for values, row in zip(found, q, strict=True):
        assert off(values, row) < 1e-3


def test_what_is_not_reached_has_none():
    robot = Robot.load("ur5", base="base", tip="tool0")
    T = robot.poses(np.zeros((1, 6)))
    T[:, 0, 3] += 5.0
    assert [len(values) for values in joint_solutions(robot, T)] == [0]


def test_seven_joints_have_a_continuum():
    robot = Robot.load("panda", tip="panda_link8")
    with pytest.raises(ModelError, match="7 joints"):
        joint_solutions(robot, robot.poses(np.zeros((1, 7))))
    held = Robot.load("panda", tip="panda_link8", held={"panda_joint3": 0.1})
    q = random_joint_values(held, 2, 1)
    assert all(
        off(s, row) < 1e-10 for s, row in zip(joint_solutions(held, held.poses(q)), q, strict=True)
    )
