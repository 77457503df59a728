"""Trials of other inputs: errors with what is unknown registered, and corrections named by code and values."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from calib.basics.arrays import read_only
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.trials import (
    correct_columns,
    correct_joints,
    misfit,
    poses_of_images,
    scale_column,
    shift_zeros,
    with_joints,
    wrong_unit,
)
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


def test_zeros_are_shifted_by_multiples_of_45_deg():
    q = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    trials = list(shift_zeros("b", 1, q))
    assert {mistake.why for _, mistake in trials} == {Why.JOINT_ZERO}
    assert [mistake.values["joint"] for _, mistake in trials] == ["b"] * 7
    added = [mistake.values["add_rad"] for _, mistake in trials]
    assert sorted(np.degrees(added)) == pytest.approx([-135, -90, -45, 45, 90, 135, 180])
    for (shifted, _), turn in zip(trials, added, strict=True):
        np.testing.assert_allclose(shifted - q, [[0, turn, 0]] * 2, atol=1e-15)


def test_each_usual_change_of_six_joints_is_tried(ur3: Robot):
    q = random_joint_values(ur3, 4, 1)
    trials = list(correct_joints(ur3, q, {}))
    assert Counter(mistake.why for _, mistake in trials) == {
        Why.COLUMNS_SWAPPED: 15,
        Why.COLUMNS_REVERSED: 1,
        Why.READINGS_COUPLED: 10,
        Why.WRONG_UNIT: 2,
    }
    coupled = [(m.values, changed) for changed, m in trials if m.why is Why.READINGS_COUPLED]
    values, changed = coupled[0]
    assert (values["joint"], values["reading"]) == ur3.joint_names[1::-1]
    expected = q + values["factor"] * q[:, :1] * np.eye(6)[1]
    np.testing.assert_allclose(changed, expected, atol=1e-15)


def test_each_column_is_changed_alone(ur3: Robot):
    q = random_joint_values(ur3, 4, 1)
    trials = list(correct_columns(ur3, q, {ur3.joint_names[2]: "deg"}))
    assert len(trials) == 6 * (1 + 7 + 2)
    for i, (changed, _) in trials:
        others = np.arange(6) != i
        np.testing.assert_array_equal(changed[:, others], q[:, others])
        assert not np.allclose(changed[:, i], q[:, i])
    signs = [c for i, c in trials if i == 2 and c[1].why is Why.JOINTS_TURNED]
    np.testing.assert_array_equal(signs[0][0][:, 2], -q[:, 2])
    units = [c for i, c in trials if i == 2 and c[1].why is Why.WRONG_UNIT]
    assert [mistake.values.get("unit") for _, mistake in units] == ["rad", None]
    np.testing.assert_allclose(units[0][0][:, 2], np.degrees(q[:, 2]))


@pytest.mark.parametrize(
    ("factor", "stated", "true"),
    [(10.0, "mm", "cm"), (1e-3, "m", "mm"), (25.4, "mm", "in"), (1.0 / 25.4, "in", "mm"),
     (np.degrees(1.0), "deg", "rad"), (np.degrees(1.0), "rad", None), (10.0, "m", None)],
)  # fmt: skip
def test_a_wrong_unit_has_a_name_only_if_it_is_a_unit(factor, stated, true):
    values = wrong_unit("points", factor, stated).values
    assert (values["factor"], values.get("unit")) == (factor, true)
    assert values.get("header") == (stated if true else None)
    unknown = wrong_unit("points", factor, None)
    assert unknown == Reason.of(Why.WRONG_UNIT, what="points", factor=factor)


def test_a_joint_is_scaled_alone():
    q = np.array([[0.1, 0.2, 0.3]])
    (changed, mistake), _ = scale_column("b", 1, q, np.array([-2.0, 3.0]))
    np.testing.assert_allclose(changed, [[0.1, -0.4, 0.3]])
    assert mistake == Reason.of(Why.JOINT_FACTOR, joint="b", factor=-2.0)


def test_a_stated_coupling_is_left_out_in_one_trial(ur3: Robot):
    pan, lift, *_ = ur3.joint_names
    coupled = Robot.from_urdf(ur3.urdf, ur3.base, ur3.tip, coupling={lift: {pan: 1.0}})
    q = random_joint_values(ur3, 4, 1)
    (without,) = [c for c, m in correct_joints(coupled, q, {}) if m.why is Why.READINGS_NOT_COUPLED]
    np.testing.assert_allclose(coupled.poses(without), ur3.poses(q), atol=1e-12)
