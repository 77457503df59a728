"""Reaching poses roughly: what can be reached is, and what cannot comes near."""

from __future__ import annotations

import numpy as np

from calib.robot.ranges import random_joint_values
from calib.verbs.plan.candidates import planning_ranges
from calib.verbs.plan.reaching import reach


def test_near_poses_are_reached_within_the_ranges(ur3, panda):
    for robot in (ur3, panda):
        ranges = planning_ranges(robot, {}, 0.1)
        low, high = ranges.T
        q = np.clip(random_joint_values(robot, 60), low + 0.3, high - 0.3)
        wanted = robot.poses(q)
        start = q + np.random.default_rng(2).uniform(-0.15, 0.15, q.shape)
        reached = reach(robot, ranges, wanted, start)
        away = np.linalg.norm(robot.poses(reached)[:, :3, 3] - wanted[:, :3, 3], axis=1)
        assert np.median(away) < 1e-6
        assert np.mean(away < 1e-3) > 0.8


def test_a_redundant_arm_keeps_to_the_ranges(panda):
    ranges = planning_ranges(panda, {}, 0.1)
    q = random_joint_values(panda, 40)
    reached = reach(panda, ranges, panda.poses(q[::-1].copy()), np.clip(q, *ranges.T))
    assert (reached >= ranges[:, 0] - 1e-9).all()
    assert (reached <= ranges[:, 1] + 1e-9).all()


def test_a_pose_out_of_reach_is_approached(ur3):
    T = np.tile(np.eye(4), (1, 1, 1))
    T[0, :3, 3] = 3.0, 0.0, 0.2
    start = np.full((1, 6), 0.3)
    ranges = planning_ranges(ur3, {}, 0.1)
    before = np.linalg.norm(ur3.poses(start)[0, :3, 3] - T[0, :3, 3])
    after = np.linalg.norm(ur3.poses(reach(ur3, ranges, T, start))[0, :3, 3] - T[0, :3, 3])
    assert after < before
