"""Errors with what is unknown registered: positions in metres, orientations in radians."""

from __future__ import annotations

import numpy as np
import pytest

from calib.basics.arrays import read_only
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.misfit import misfit, with_joints
from calib.fit.registration.table_rows import rows_and_setup
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot


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
