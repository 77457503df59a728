"""Corrections of joint values: each undoes one mistake, and is named by its code and values."""

from __future__ import annotations

import numpy as np
import pytest

from calib.diagnosis.corrections import correct_joints, shift_zeros
from calib.diagnosis.reasons import Why
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot


def test_zeros_are_shifted_by_quarter_turns_either_way_and_by_half_a_turn():
    q = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    trials = list(shift_zeros("b", 1, q))
    assert {why for _, why, _ in trials} == {Why.JOINT_ZERO}
    assert [values["joint"] for _, _, values in trials] == ["b"] * 3
    added = [values["add_rad"] for _, _, values in trials]
    assert added == pytest.approx([np.pi / 2, -np.pi / 2, np.pi])
    for (shifted, _, _), turn in zip(trials, added, strict=True):
        np.testing.assert_allclose(shifted - q, [[0, turn, 0]] * 2, atol=1e-15)


def test_each_usual_change_of_six_joints_is_tried(ur3: Robot):
    q = random_joint_values(ur3, 4, 1)
    trials = list(correct_joints(ur3, q))
    count = {why: sum(code is why for _, code, _ in trials) for why in {t[1] for t in trials}}
    assert count == {
        Why.JOINT_ZERO: 18,
        Why.COLUMNS_SWAPPED: 15,
        Why.COLUMNS_REVERSED: 1,
        Why.READINGS_COUPLED: 10,
        Why.WRONG_UNIT: 2,
    }
    coupled = [(v, changed) for changed, code, v in trials if code is Why.READINGS_COUPLED]
    values, changed = coupled[0]
    assert (values["joint"], values["reading"]) == ur3.joint_names[1::-1]
    expected = q + values["factor"] * q[:, :1] * np.eye(6)[1]
    np.testing.assert_allclose(changed, expected, atol=1e-15)


def test_a_stated_coupling_is_left_out_in_one_trial(ur3: Robot):
    pan, lift, *_ = ur3.joint_names
    coupled = Robot.from_urdf(ur3.urdf, ur3.base, ur3.tip, coupling={lift: {pan: 1.0}})
    q = random_joint_values(ur3, 4, 1)
    (without,) = [c for c, why, _ in correct_joints(coupled, q) if why is Why.READINGS_NOT_COUPLED]
    np.testing.assert_allclose(coupled.poses(without), ur3.poses(q), atol=1e-12)
