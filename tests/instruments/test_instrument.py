"""Instruments and targets on any link: one sightline for each pair, each with its own chain of one URDF."""

from __future__ import annotations

import numpy as np
import pytest

from calib.basics.arrays import rigid_inverse
from calib.instruments.instrument import Sightline
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from tests.instruments.scenes import BOARD, camera_of, in_hand, pose

T_HAND = pose((0.06, 0.01, 0.05), (0.1, -0.2, 0.3))
T_TABLE = pose((0.5, 0.1, 0.02), (3.0, 0.2, 0.1))


def test_exchanged_links_give_the_inverse_pose():
    """A camera in the hand and a board on the table, and the same two things the other way round."""
    ur5 = Robot.load("ur5", base="tool0", tip="base_link")
    camera_in_hand = Sightline(ur5, rigid_inverse(T_HAND), T_TABLE)
    board_in_hand = Sightline(
        ur5.rebuilt(base="base_link", tip="tool0"), rigid_inverse(T_TABLE), T_HAND
    )
    q = random_joint_values(ur5, 5)
    other = q[:, ::-1]  # the same joints from the foot to the hand
    assert board_in_hand.robot.joint_names == ur5.joint_names[::-1]
    np.testing.assert_allclose(
        camera_in_hand.target_poses(q) @ board_in_hand.target_poses(other),
        np.tile(np.eye(4), (5, 1, 1)),
        atol=1e-12,
    )
    assert camera_in_hand.distances(q) == pytest.approx(board_in_hand.distances(other))
    np.testing.assert_allclose(camera_in_hand.eye, T_HAND[:3, 3])


def test_target_poses_go_from_the_instrument_through_the_robot():
    ur5 = Robot.load("ur5", base="tool0", tip="base_link")
    sightline = Sightline(ur5, rigid_inverse(T_HAND), T_TABLE)
    q = np.array([[0.3, -1.2, 1.5, -0.4, 0.9, 2.0]])
    arm = Robot.load("ur5", base="base_link", tip="tool0")
    T_world_camera = arm.poses(q[:, ::-1])[0] @ T_HAND
    expected = rigid_inverse(T_world_camera) @ T_TABLE
    np.testing.assert_allclose(sightline.target_poses(q)[0], expected, atol=1e-12)


def test_a_second_chain_is_a_second_sightline():
    """Of a robot with two arms one hand sees the other, and each sees the torso."""
    left, right = "left_gripper", "right_gripper"
    hands = Robot.load("baxter", base=left, tip=right)
    by_hand = {
        hand: Sightline(
            hands.rebuilt(base=hand, tip="torso"), rigid_inverse(T_HAND), pose((1.0, 0.0, 0.0))
        )
        for hand in (left, right)
    }
    between = Sightline(hands, rigid_inverse(T_HAND), T_HAND)
    q = random_joint_values(hands, 4)
    values = dict(zip(hands.joint_names, q.T, strict=True))
    T = {}
    for hand, sightline in by_hand.items():
        # Each chain takes the values of its own joints.
        own = np.stack([values[name] for name in sightline.robot.joint_names], axis=1)
        T[hand] = sightline.target_poses(own)
    np.testing.assert_allclose(
        between.target_poses(q), T[left] @ rigid_inverse(T[right]), atol=1e-12
    )
    # One camera, whatever the chain: it is given poses in its own frame.
    away = np.linalg.norm(between.target_poses(q) @ np.append(BOARD.centre, 1.0), axis=1)
    distances = camera_of().board_distances(T[left] @ rigid_inverse(T[right]))
    np.testing.assert_allclose(np.sqrt(distances**2 + 1.0), away)


def test_the_tip_is_where_the_target_is_wanted():
    sightline = in_hand("panda")
    q = random_joint_values(sightline.robot, 3)
    np.testing.assert_allclose(
        sightline.tip_poses(sightline.target_poses(q)), sightline.robot.poses(q), atol=1e-12
    )
