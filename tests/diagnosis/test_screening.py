"""Errors of other inputs by closed forms: those of exact robots are zero, and known noise is what remains."""

from __future__ import annotations

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.screening import screened_errors
from calib.fit.registration.table_rows import rows_and_setup
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from tests.fits import place

#: Where the base stands in a frame, far from it.
T_FRAME_BASE = place((2.0, -1.0, 0.5), (0.3, -0.9, 1.2))


def screened(robot: Robot, cell: Cell, q: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Errors of joint values (T, N, m) with points (N, 3), or (T, N, 3) [m]."""
    table = Measurements(robot.joint_names, q[0], points.reshape(-1, len(q[0]), 3)[0])
    rows, setup = rows_and_setup(robot, table, cell)
    return screened_errors(robot, setup, rows, q, points)


@pytest.mark.parametrize("frame", [False, True])
def test_an_exact_robot_has_no_error_wherever_its_frame_is(ur3: Robot, frame: bool):
    """Of joint values in which one joint counts the other way something remains."""
    q = random_joint_values(ur3, 12, 1)
    points = ur3.poses(q)[:, :3, 3]
    if frame:
        points = points @ T_FRAME_BASE[:3, :3].T + T_FRAME_BASE[:3, 3]
    turned = q * np.where(np.arange(6) == 2, -1.0, 1.0)
    right, wrong = screened(ur3, Cell(estimate_frame=frame), np.stack([q, turned]), points)
    assert right < 1e-12
    assert wrong > 0.02


def test_what_the_best_target_leaves_is_the_error(ur3: Robot):
    """In a known frame the target is the mean of what is seen in the tip."""
    q = random_joint_values(ur3, 12, 1)
    T = ur3.poses(q)
    in_tip = np.array([0.03, -0.02, 0.1]) + 1e-3 * np.random.default_rng(2).normal(size=(12, 3))
    points = T[:, :3, 3] + np.einsum("nij,nj->ni", T[:, :3, :3], in_tip)
    (error,) = screened(ur3, Cell(), q[None], points)
    off = in_tip - in_tip.mean(axis=0)
    assert error == pytest.approx(np.sqrt(np.mean(np.sum(off**2, axis=1))))
