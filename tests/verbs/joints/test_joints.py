"""Joint values from poses of the flange: what decides between the branches."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from calib.errors import UrdfError
from calib.robot.robot import Robot
from calib.verbs.joints.joints import joint_values
from tests.places import ROOT

sys.path.insert(0, str(ROOT / "scripts"))


def test_limits_may_leave_one_solution_of_each_pose():
    robot = Robot.load("panda", tip="panda_link8", held={"panda_joint3": 0.1})
    q = np.array([0.2, -0.4, -2.0, 0.1, 1.9, 0.6]) + np.linspace(0.0, 0.5, 5)[:, None]
    found = joint_values(robot, robot.poses(q))
    assert (found.decided_by, found.unique.all(), found.open_turns) == ("limits", True, ())
    np.testing.assert_allclose(found.q, q, atol=1e-11)


def test_branches_of_a_sound_arm_are_alike_and_not_unique():
    robot = Robot.load("ur5", base="base", tip="tool0")
    q = np.array([0.3, -1.2, 1.5, -1.0, -1.4, 0.4]) + np.linspace(0.0, 0.5, 5)[:, None]
    found = joint_values(robot, robot.poses(q))
    assert (found.decided_by, found.unique.any()) == ("", False)
    assert set(found.counts) == {8}
    np.testing.assert_allclose(robot.poses(found.q), robot.poses(q), atol=1e-10)


def test_poses_that_are_not_reached_are_counted():
    robot = Robot.load("ur5", base="base", tip="tool0")
    T = robot.poses(np.zeros((3, 6)) + 0.5)
    T[1, 0, 3] += 3.0
    with pytest.raises(UrdfError, match=r"1 of 3 poses of 'tool0' in 'base'.*pose 2"):
        joint_values(robot, T)


@pytest.mark.slow
@pytest.mark.parametrize("number", [6, 11])
def test_what_was_measured_tells_the_branch_of_an_arm_with_errors(number: int):
    """A UR5; and one whose controller has its own lengths and angles."""
    import flange_poses_study as study

    scene = study.make_scene(study.SETS[number - 1], number)
    found, errors = study.recovered(scene, number)
    assert found.decided_by == "measurements"
    assert found.unique.sum() >= 18
    assert errors[found.unique].max() < 1e-9


@pytest.mark.slow
def test_without_a_robot_mount_and_board_are_within_the_bound():
    import flange_poses_study as study

    scene = study.make_scene(study.SETS[1], 2)
    ratios = study.ratio(scene, range(6))
    # Six draws of twelve coordinates, which are correlated.
    assert min(ratios) > 0.5
    assert max(ratios) < 1.5
