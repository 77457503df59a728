"""Cells with a camera: what is drawn, and that what is seen follows from robot, camera, print and mounts."""

from __future__ import annotations

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.errors import CalibError
from calib.robot.robot import Robot
from calib.verbs.simulate.camera.cell import draw_camera_cell, given_mounts
from calib.verbs.simulate.camera.equipment import usual_camera
from calib.verbs.simulate.camera.scene import is_framed
from calib.verbs.simulate.scenario import Scenario
from tests.verbs.simulate.camera.cells import BOARD


@pytest.fixture(scope="module")
def cell():
    robot = Robot.load("ur5", base="tool0", tip="base_link")
    return draw_camera_cell(Scenario(robot), usual_camera(), BOARD, seed=7)


def test_camera_print_and_robot_have_errors(cell):
    assert np.abs(cell.camera.values - cell.stated.values).max() > 1.0
    assert 1e-4 < abs(cell.printed.scale[1] - 1.0) < 0.02
    assert cell.printed.offsets is not None
    assert np.abs(cell.truth.x).max() > 1e-4
    assert cell.truth.targets == ("board",)


def test_the_scene_is_that_of_the_nominal_robot(cell):
    q = cell.views(3, seed=1)
    nominal = cell.scene.board_poses(q)
    true = cell.truth.poses(q)
    distances = np.linalg.norm(true[:, :3, 3] - nominal[:, :3, 3], axis=1)
    assert distances.min() > 1e-4
    assert distances.max() < 0.05


def test_views_to_validate_with_are_others(cell):
    q = cell.views(4, seed=1)
    np.testing.assert_array_equal(q, cell.views(4, seed=1))
    other = cell.views(4, seed=1, validation=True)
    assert np.abs(q - other).min() > 1e-6
    assert is_framed(cell.scene, cell.scene.board_poses(other)).all()
    assert cell.views(0, seed=1).shape == (0, 6)


def test_mounts_of_a_cell_file_are_taken(cell):
    T_camera_base, T_tip_board = cell.truth.T_frame_base[0], cell.truth.T_tip_target[0]
    assert given_mounts(Cell()).T_camera_base is None
    assert given_mounts(Cell()).T_tip_board is None
    position = T_tip_board[:3, 3]
    stated = Cell(T_frame_base=T_camera_base, target=position, target_rotation=T_tip_board[:3, :3])
    np.testing.assert_allclose(given_mounts(stated).T_camera_base, T_camera_base)
    np.testing.assert_allclose(given_mounts(stated).T_tip_board, T_tip_board)
    scenario = Scenario(cell.scenario.robot, stated)
    other = draw_camera_cell(scenario, usual_camera(), BOARD, seed=11)
    np.testing.assert_allclose(other.truth.T_frame_base[0], T_camera_base)
    np.testing.assert_allclose(other.truth.T_tip_target[0], T_tip_board)
    with pytest.raises(CalibError, match="target_rpy_deg"):
        given_mounts(Cell(target=position))


def test_the_cell_of_another_seed_is_another(cell):
    robot = cell.scenario.robot
    other = draw_camera_cell(Scenario(robot), usual_camera(), BOARD, seed=8)
    again = draw_camera_cell(Scenario(robot), usual_camera(), BOARD, seed=7)
    np.testing.assert_array_equal(again.truth.T_tip_target, cell.truth.T_tip_target)
    np.testing.assert_array_equal(again.camera.values, cell.camera.values)
    assert np.abs(other.truth.T_tip_target - cell.truth.T_tip_target).max() > 1e-3
    assert np.abs(other.camera.values - cell.camera.values).max() > 0.1
