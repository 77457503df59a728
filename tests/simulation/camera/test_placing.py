"""Places of camera and board: which of them the robot moves, and cells in which nothing is seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.errors import CalibError
from calib.robot.robot import Robot
from calib.simulation.camera.placing import camera_moves, draw_scene
from calib.vision.printed import Print
from tests.simulation.camera.cells import BOARD, CAMERA


def test_the_chain_says_what_the_robot_moves():
    assert camera_moves(Robot.load("ur5", base="tool0", tip="base_link"))
    assert not camera_moves(Robot.load("ur5", base="base_link", tip="tool0"))


def test_a_moved_camera_and_a_moved_board_are_to_be_stated():
    both = Robot.load("baxter", base="left_wrist", tip="right_wrist")
    with pytest.raises(CalibError, match=r"left_wrist.*right_wrist"):
        draw_scene(both, CAMERA, Print(BOARD), seed=0)


def test_a_camera_is_put_on_the_flange_and_the_board_in_the_workspace():
    scene = draw_scene(Robot.load("ur5", base="tool0", tip="base_link"), CAMERA, Print(BOARD), 0)
    assert 0.05 <= np.linalg.norm(scene.T_camera_base[:3, 3]) <= 0.13
    assert 0.2 < np.linalg.norm(scene.T_tip_board[:3, 3]) < 1.5


def test_a_camera_is_put_beside_the_robot_and_the_board_on_the_flange():
    scene = draw_scene(Robot.load("ur5", base="base_link", tip="tool0"), CAMERA, Print(BOARD), 0)
    assert 1.0 <= np.linalg.norm(scene.T_camera_base[:3, 3]) < 2.2
    assert np.linalg.norm(scene.T_tip_board[:3, 3]) < 0.3


def test_a_board_that_is_too_small_is_seen_from_nowhere(monkeypatch):
    monkeypatch.setattr("calib.simulation.camera.placing._PLACES", 2)
    tiny = replace(BOARD, square=4e-4, marker=3e-4)
    robot = Robot.load("ur5", base="base_link", tip="tool0")
    with pytest.raises(CalibError, match="smaller or larger"):
        draw_scene(robot, CAMERA, Print(tiny), seed=0)
