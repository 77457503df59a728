"""Places of camera and board: which of them the robot moves, and cells in which nothing is seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.boards.printed import Print
from calib.errors import CalibError
from calib.robot.robot import Robot
from calib.verbs.simulate.camera.placing import Mounts, camera_moves, draw_scene, moving_sides
from tests.verbs.simulate.camera.cells import BOARD, CAMERA


def test_the_chain_says_what_the_robot_moves():
    assert camera_moves(Robot.load("ur5", base="tool0", tip="base_link"))
    assert not camera_moves(Robot.load("ur5", base="base_link", tip="tool0"))


def test_a_moved_camera_and_a_moved_board_are_to_be_stated():
    both = Robot.load("baxter", base="left_wrist", tip="right_wrist")
    with pytest.raises(CalibError, match=r"left_wrist.*right_wrist"):
        draw_scene(both, CAMERA, Print(BOARD), seed=0)


@pytest.mark.slow
def test_mounts_that_are_given_are_kept():
    robot = Robot.load("ur5", base="tool0", tip="base_link")
    drawn = draw_scene(robot, CAMERA, Print(BOARD), seed=0)
    camera = Mounts(T_camera_base=drawn.T_camera_base)
    other = draw_scene(robot, CAMERA, Print(BOARD), 1, camera)
    np.testing.assert_array_equal(other.T_camera_base, drawn.T_camera_base)
    assert np.abs(other.T_tip_board - drawn.T_tip_board).max() > 0.05
    board = Mounts(T_tip_board=drawn.T_tip_board)
    other = draw_scene(robot, CAMERA, Print(BOARD), 1, board)
    np.testing.assert_array_equal(other.T_tip_board, drawn.T_tip_board)
    assert np.abs(other.T_camera_base - drawn.T_camera_base).max() > 0.05


def test_a_camera_on_a_head_sees_the_board_on_the_hand():
    """Both links move: the camera looks forward along x of the head, and the board is drawn on the hand."""
    robot = Robot.load("tiago", base="head_2_link", tip="wrist_ft_tool_link")
    assert moving_sides(robot) == (True, True)
    T_camera_base = np.eye(4)
    T_camera_base[:3, :3] = [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]
    scene = draw_scene(robot, CAMERA, Print(BOARD), 0, Mounts(T_camera_base=T_camera_base))
    assert np.linalg.norm(scene.T_tip_board[:3, 3]) < 0.3


def test_a_camera_is_put_on_the_flange_and_the_board_in_the_workspace():
    scene = draw_scene(Robot.load("ur5", base="tool0", tip="base_link"), CAMERA, Print(BOARD), 0)
    assert 0.05 <= np.linalg.norm(scene.T_camera_base[:3, 3]) <= 0.13
    assert 0.2 < np.linalg.norm(scene.T_tip_board[:3, 3]) < 1.5


def test_a_camera_is_put_beside_the_robot_and_the_board_on_the_flange():
    scene = draw_scene(Robot.load("ur5", base="base_link", tip="tool0"), CAMERA, Print(BOARD), 0)
    assert 1.0 <= np.linalg.norm(scene.T_camera_base[:3, 3]) < 2.2
    assert np.linalg.norm(scene.T_tip_board[:3, 3]) < 0.3


def test_a_board_that_is_too_small_is_seen_from_nowhere(monkeypatch):
    monkeypatch.setattr("calib.verbs.simulate.camera.placing._PLACES", 2)
    tiny = replace(BOARD, square=4e-4, marker=3e-4)
    robot = Robot.load("ur5", base="base_link", tip="tool0")
    with pytest.raises(CalibError, match="smaller or larger"):
        draw_scene(robot, CAMERA, Print(tiny), seed=0)
