"""Errors with what is unknown registered: positions in metres, orientations in radians."""

from __future__ import annotations

import numpy as np
import pytest

from calib.basics.arrays import read_only
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.misfit import misfit, poses_of_images, with_joints
from calib.fit.registration.table_rows import rows_and_setup
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from tests.images import arm, cell, mounts, poses, table


@pytest.fixture
def q(ur3: Robot) -> np.ndarray:
    return random_joint_values(ur3, 12, 1)


def test_a_known_target_keeps_its_error_and_an_unknown_one_is_registered(ur3: Robot, q):
    T = ur3.poses(q)
    points = T[:, :3, 3] + T[:, :3, :3] @ [0.003, 0.0, 0.004]
    table = Measurements(ur3.joint_names, q, points)
    for estimate, error in ((False, 0.005), (True, 0.0)):
        cell = Cell(target=read_only(np.zeros(3)), estimate_target=estimate)
        rows, setup = rows_and_setup(ur3, table, cell)
        position, angle = misfit(ur3, setup, rows)
        assert position == pytest.approx(error, abs=1e-8)
        assert np.isnan(angle)


def test_orientations_have_their_own_error(ur3: Robot, q):
    T = ur3.poses(q)
    table = Measurements(
        ur3.joint_names, q, T[:, :3, 3], kinds=("pose",) * 12, rotations=T[:, :3, :3]
    )
    cell = Cell(target=read_only(np.zeros(3)), estimate_target=False)
    rows, setup = rows_and_setup(ur3, table, cell)
    assert misfit(ur3, setup, rows) == pytest.approx((0.0, 0.0), abs=1e-9)
    turned = with_joints(rows, q + 0.02 * np.eye(6)[5])  # about the axis that the tip lies on
    assert misfit(ur3, setup, turned) == pytest.approx((0.0, 0.02), abs=1e-9)


def test_views_as_poses_have_the_boards_poses():
    q = poses(5)
    m = table(q)
    result, c = poses_of_images(arm(), cell(), m)
    T_camera_base, T_tip_board = mounts()
    T = T_camera_base @ arm().poses(q) @ T_tip_board
    np.testing.assert_allclose(result.points, T[:, :3, 3], atol=1e-6)
    np.testing.assert_allclose(result.rotations, T[:, :3, :3], atol=1e-6)
    assert set(result.kinds) == {"pose"}
    assert c.estimate_frame
    assert poses_of_images(arm(), c, result) is None  # these are poses
