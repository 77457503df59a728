"""Readings modulo a turn come back into the limits, and no others do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.basics.arrays import read_only
from calib.data.measurements import Measurements
from calib.data.whole_turns import brought_back
from calib.diagnosis.reasons import Why
from calib.result.calibrate import calibrate
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot

TURN = 2.0 * np.pi


def table_of(robot: Robot, q: np.ndarray) -> Measurements:
    return Measurements(robot.joint_names, q, robot.poses(q)[:, :3, 3])


def test_angles_from_0_to_360_deg_come_back_into_the_limits(panda: Robot):
    q = random_joint_values(panda, 12, 1)
    table = brought_back(panda, table_of(panda, q % TURN))
    np.testing.assert_allclose(table.joints, q, atol=1e-12)
    # Joint 6 turns from -1 to 215 deg; some of its readings are at the other end either way.
    changed = np.flatnonzero(np.any(q < 0.0, axis=0))
    assert table.turned == tuple(panda.joint_names[i] for i in changed)
    assert brought_back(panda, table).turned == table.turned
    assert brought_back(panda, table_of(panda, q)).turned == ()


def test_readings_of_a_counter_one_turn_on_come_back(panda: Robot):
    q = random_joint_values(panda, 12, 1)
    shifted = q + TURN * np.array([0, -1, 0, 2, 0, 0, 0])
    table = brought_back(panda, table_of(panda, shifted))
    np.testing.assert_allclose(table.joints, q, atol=1e-12)
    assert table.turned == (panda.joint_names[1], panda.joint_names[3])


def test_what_is_no_angle_modulo_a_turn_stays(ur3: Robot, panda: Robot):
    # Limits of two turns leave two places for each reading.
    q = random_joint_values(ur3, 12, 1) + TURN
    assert brought_back(ur3, table_of(ur3, q)).turned == ()
    # A column that spans more than a turn counts turns; one value that no turn brings back speaks against it.
    q = random_joint_values(panda, 12, 1)
    for first, second in ((-3.2, 3.2), (-0.1 + TURN, 3.1)):
        changed = q.copy()
        changed[:2, 0] = first, second
        assert brought_back(panda, table_of(panda, changed)).turned == ()


def test_a_result_says_so(panda: Robot):
    q = random_joint_values(panda, 30, 1)
    table = table_of(panda, np.where(np.arange(7) == 0, q % TURN, q))
    rng = np.random.default_rng(1)
    noisy = replace(table, points=read_only(table.points + rng.normal(0, 2e-3, (30, 3))))
    result = calibrate(panda, noisy, model="zeros")
    (reason,) = [r for r in result.verdict.reasons if r.why is Why.READINGS_TURNED]
    assert reason.values["joints"] == panda.joint_names[0]
