"""Mounts: where flanges point, how far arms reach, where cameras and boards are put, and what is never seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.boards.printed import Print
from calib.errors import CalibError
from calib.robot.dh_rows import DHRow
from calib.robot.ranges import spread_poses
from calib.robot.robot import Robot
from calib.verbs.simulate.mounting import (
    board_in_workspace,
    board_on_flange,
    camera_beside,
    camera_on_flange,
    camera_towards,
    draw_scene,
    frame_along,
    moving_sides,
    outward,
    reach,
)
from calib.verbs.simulate.views import try_views
from tests.verbs.simulate.cells import BOARD, CAMERA

CENTRE = np.array([0.14, 0.1, 0.0])


@pytest.fixture(scope="module")
def panda():
    return Robot.load("panda", base="panda_link0", tip="panda_link8")


@pytest.fixture(scope="module")
def ur5():
    return Robot.load("ur5", base="base_link", tip="tool0")


def is_rotation(R):
    return np.allclose(R @ R.T, np.eye(3)) and np.linalg.det(R) > 0.0


def test_flanges_point_along_z_of_their_frame(panda, ur5):
    np.testing.assert_allclose(outward(panda), [0.0, 0.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(outward(ur5), [0.0, 0.0, 1.0], atol=1e-9)


def test_a_flange_whose_last_axis_is_across_points_away_from_it():
    planar = Robot.from_dh([DHRow("J1", a=0.4), DHRow("J2", a=0.3)])
    np.testing.assert_allclose(outward(planar), [1.0, 0.0, 0.0], atol=1e-12)


def test_reach_is_that_of_a_planar_arm():
    planar = Robot.from_dh([DHRow("J1", a=0.4), DHRow("J2", a=0.3)])
    assert 0.68 < reach(planar) <= 0.7


def test_frames_have_their_z_axis_where_it_is_wished():
    z = np.array([0.6, 0.0, -0.8])
    R = frame_along(z, 0.7)
    assert is_rotation(R)
    np.testing.assert_allclose(R[:, 2], z)
    turned = frame_along(z, 0.0).T @ R
    np.testing.assert_allclose(
        Rotation.from_matrix(turned).as_rotvec(), [0.0, 0.0, 0.7], atol=1e-12
    )


def test_a_camera_on_the_flange_is_beside_it_and_looks_outward(panda):
    for seed in range(20):
        T = camera_on_flange(panda, np.random.default_rng(seed))
        assert is_rotation(T[:3, :3])
        assert 0.05 <= np.hypot(*T[:2, 3]) <= 0.12
        assert 0.0 <= T[2, 3] <= 0.04
        assert T[2, 2] > np.cos(np.sqrt(3.0) * np.deg2rad(15.0))


def test_a_board_on_the_flange_faces_outward(panda):
    for seed in range(20):
        T = board_on_flange(panda, CENTRE, np.random.default_rng(seed))
        assert is_rotation(T[:3, :3])
        # Its z axis points into the page, to the flange.
        assert T[2, 2] < -np.cos(np.sqrt(3.0) * np.deg2rad(15.0))
        middle = T[:3, :3] @ CENTRE + T[:3, 3]
        assert 0.03 <= middle[2] <= 0.08
        assert np.abs(middle[:2]).max() <= 0.04


def test_boards_lie_face_up_or_hang_facing_the_robot(ur5):
    lying = 0
    for seed in range(60):
        T = board_in_workspace(ur5, CENTRE, np.random.default_rng(seed))
        middle = T[:3, :3] @ CENTRE + T[:3, 3]
        is_lying = T[2, 2] < -0.99
        towards_wall = middle[:2] / np.linalg.norm(middle[:2])
        assert is_lying or T[:2, 2] @ towards_wall > 0.99
        assert np.linalg.norm(middle) < 1.5 * reach(ur5)
        lying += is_lying
    assert 30 < lying < 54


def test_a_camera_beside_the_robot_looks_at_it_upright(panda):
    for seed in range(20):
        T = camera_beside(panda, 5.0, np.random.default_rng(seed))
        assert is_rotation(T[:3, :3])
        assert 1.0 <= np.linalg.norm(T[:3, 3]) < 2.5
        # The image's y axis points down.
        assert T[2, 1] < -0.3
        towards_robot = np.array([0.0, 0.0, 0.3]) - T[:3, 3]
        assert T[:3, 2] @ towards_robot / np.linalg.norm(towards_robot) > 0.8


def test_a_camera_comes_nearer_for_a_small_board_but_not_into_the_workspace(panda):
    T = camera_beside(panda, 5.0, np.random.default_rng(1))
    nearer = camera_beside(panda, 0.95, np.random.default_rng(1))
    nearest = camera_beside(panda, 0.01, np.random.default_rng(1))
    np.testing.assert_array_equal(T[:3, :3], nearer[:3, :3])
    sight = T[:3, 2]
    assert 1.0 <= np.linalg.norm(T[:3, 3] - nearest[:3, 3]) + 0.9 * reach(panda) <= 1.5
    moved = (nearer[:3, 3] - T[:3, 3]) / np.linalg.norm(nearer[:3, 3] - T[:3, 3])
    assert moved @ sight > 0.9


def test_the_chain_says_what_the_robot_moves():
    assert moving_sides(Robot.load("ur5", base="tool0", tip="base_link")) == (True, False)
    assert moving_sides(Robot.load("ur5", base="base_link", tip="tool0")) == (False, True)


def test_a_camera_on_a_head_looks_to_where_the_hand_mostly_is():
    robot = Robot.load("tiago", base="head_2_link", tip="wrist_ft_tool_link")
    T_head_camera = camera_towards(robot, np.random.default_rng(0))
    hands = robot.poses(spread_poses(robot))[:, :3, 3]
    directions = hands / np.linalg.norm(hands, axis=1, keepdims=True)
    mean = directions.mean(axis=0) / np.linalg.norm(directions.mean(axis=0))
    assert T_head_camera[:3, 2] @ mean > np.cos(np.radians(25.0))  # 15 deg about each axis at most
    assert np.linalg.norm(T_head_camera[:3, 3]) < 0.13


def test_a_camera_on_one_of_two_flanges_looks_outward():
    both = Robot.load("baxter", base="left_wrist", tip="right_wrist")
    T = camera_towards(both, np.random.default_rng(0))
    arm = Robot.load("baxter", base="right_wrist", tip="left_wrist")
    np.testing.assert_array_equal(T, camera_on_flange(arm, np.random.default_rng(0)))


@pytest.mark.slow
def test_mounts_that_are_given_are_kept():
    robot = Robot.load("ur5", base="tool0", tip="base_link")
    drawn = draw_scene(robot, CAMERA, Print(BOARD), seed=0).sightline
    T_camera_base, T_tip_board = drawn.T_instrument_base, drawn.T_tip_target
    other = draw_scene(robot, CAMERA, Print(BOARD), 1, T_camera_base=T_camera_base).sightline
    np.testing.assert_array_equal(other.T_instrument_base, T_camera_base)
    assert np.abs(other.T_tip_target - T_tip_board).max() > 0.05
    other = draw_scene(robot, CAMERA, Print(BOARD), 1, T_tip_board=T_tip_board).sightline
    np.testing.assert_array_equal(other.T_tip_target, T_tip_board)
    assert np.abs(other.T_instrument_base - T_camera_base).max() > 0.05


def test_a_camera_on_a_head_sees_the_board_on_the_hand():
    """Both links move: the camera looks forward along x of the head, and the board is drawn on the hand."""
    robot = Robot.load("tiago", base="head_2_link", tip="wrist_ft_tool_link")
    assert moving_sides(robot) == (True, True)
    T_camera_base = np.eye(4)
    T_camera_base[:3, :3] = [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]
    sightline = draw_scene(robot, CAMERA, Print(BOARD), 0, T_camera_base).sightline
    assert np.linalg.norm(sightline.T_tip_target[:3, 3]) < 0.3


def test_a_camera_is_put_on_the_flange_and_the_board_in_the_workspace():
    sightline = draw_scene(
        Robot.load("ur5", base="tool0", tip="base_link"), CAMERA, Print(BOARD), 0
    ).sightline
    assert 0.05 <= np.linalg.norm(sightline.T_instrument_base[:3, 3]) <= 0.13
    assert 0.2 < np.linalg.norm(sightline.T_tip_target[:3, 3]) < 1.5


def test_a_camera_is_put_beside_the_robot_and_the_board_on_the_flange():
    sightline = draw_scene(
        Robot.load("ur5", base="base_link", tip="tool0"), CAMERA, Print(BOARD), 0
    ).sightline
    assert 1.0 <= np.linalg.norm(sightline.T_instrument_base[:3, 3]) < 2.2
    assert np.linalg.norm(sightline.T_tip_target[:3, 3]) < 0.3


def test_a_place_with_one_view_is_a_place(monkeypatch):
    module = "calib.verbs.simulate.mounting"
    monkeypatch.setattr(f"{module}.try_views", lambda *words: try_views(*words)[:1])
    monkeypatch.setattr(f"{module}._PLACES", 3)
    robot = Robot.load("ur5", base="base_link", tip="tool0")
    sightline = draw_scene(robot, CAMERA, Print(BOARD), 0).sightline
    assert np.linalg.norm(sightline.T_tip_target[:3, 3]) < 0.3


def test_a_board_that_is_too_small_is_seen_from_nowhere(monkeypatch):
    monkeypatch.setattr("calib.verbs.simulate.mounting._PLACES", 2)
    tiny = replace(BOARD, square=4e-4, marker=3e-4)
    robot = Robot.load("ur5", base="base_link", tip="tool0")
    with pytest.raises(CalibError, match="smaller or larger"):
        draw_scene(robot, CAMERA, Print(tiny), seed=0)
