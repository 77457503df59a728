"""The joint zeros alone: of the right sign, named where they are not determined, with errors that rounding changes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.data.priors import Priors
from calib.fit.selection.cross_validation import linear_cross_validation
from calib.result.calibrate import calibrate
from calib.result.calibration_file import read_result, write_result
from calib.result.joint_zeros import (
    ESTIMATION,
    HELD_OUT,
    VALIDATION,
    JointZeros,
    reading_offsets,
)
from calib.robot.robot import Robot
from tests.verbs.convert.zero_arms import (
    SERVO_ZEROS,
    TARGET,
    points,
    servo_arm,
    servo_readings,
    servo_result,
    table,
    ur3_result,
)

KNOWN = Cell(target=TARGET, estimate_target=False, model="zeros", sigma={"m": 1e-4})
TRUE = np.radians(SERVO_ZEROS)


def zeros_of(robot: Robot, measured: Measurements, cell: Cell = KNOWN, **options) -> JointZeros:
    zeros = calibrate(robot, measured, cell=cell, validate=False, **options).zeros
    assert zeros is not None
    return zeros


def test_a_joint_is_at_its_reading_plus_the_zero():
    zeros = servo_result().zeros
    assert zeros.joints == servo_arm().joint_names
    assert zeros.determined.all()
    assert np.abs(zeros.delta - TRUE).max() < 5e-4
    assert np.abs((zeros.delta - TRUE) / zeros.std).max() < 4.0
    assert zeros.std.max() < 5e-4


@pytest.mark.parametrize("model", ["dh", "placement", "zeros+gain"])
def test_they_are_fitted_as_such_beside_any_model(model: str):
    measured = table(servo_arm(), servo_readings(), TRUE, noise=5e-5)
    zeros = zeros_of(servo_arm(), measured, replace(KNOWN, model=model))
    assert zeros.delta == pytest.approx(TRUE, abs=1e-3)


def test_an_unknown_frame_and_target_hide_the_first_and_the_last():
    measured = table(servo_arm(), servo_readings(), TRUE)
    cell = Cell(estimate_frame=True, model="zeros", sigma={"m": 1e-4})
    zeros = zeros_of(servo_arm(), measured, cell)
    assert zeros.determined.tolist() == [False, True, True, True, False]
    assert zeros.delta[[0, -1]].tolist() == [0.0, 0.0]
    assert np.isnan(zeros.std[[0, -1]]).all()
    assert zeros.delta[1:4] == pytest.approx(TRUE[1:4], abs=1e-4)


def test_without_priors_the_same_are_left_as_they_are():
    measured = table(servo_arm(), servo_readings(), TRUE)
    cell = Cell(estimate_frame=True, model="zeros", priors=Priors(source="off"))
    zeros = zeros_of(servo_arm(), measured, cell)
    assert zeros.determined.tolist() == [False, True, True, True, False]
    assert zeros.delta[[0, -1]].tolist() == [0.0, 0.0]
    assert zeros.delta[1:4] == pytest.approx(TRUE[1:4], abs=1e-4)


def test_of_a_sum_of_zeros_one_is_left_as_it_is(serial_urdf):
    """Two joints about one axis: the second one takes the sum."""
    turn = ("revolute", (0.3, 0.0, 0.0), (0.0, 0.0, 0.0), (0, 1, 0))
    joints = [("revolute", (0.0, 0.0, 0.2), (0.0, 0.0, 0.0), (0, 0, 1)), turn, turn]
    joints[2] = ("revolute", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0, 1, 0))
    robot = Robot.from_urdf(serial_urdf(joints), "l0", "tip")
    q = np.random.default_rng(5).uniform(-2, 2, (20, 3))
    zeros = zeros_of(robot, table(robot, q, np.array([0.01, 0.02, -0.005])))
    assert zeros.determined.tolist() == [True, False, True]
    assert zeros.delta == pytest.approx([0.01, 0.0, 0.015], abs=1e-5)


def test_a_frozen_zero_is_not_determined():
    measured = table(servo_arm(), servo_readings(), TRUE * [1, 1, 0, 1, 1])
    zeros = zeros_of(servo_arm(), measured, replace(KNOWN, frozen=("elbow_flex.zero",)))
    assert zeros.determined.tolist() == [True, True, False, True, True]
    assert zeros.delta == pytest.approx(TRUE * [1, 1, 0, 1, 1], abs=1e-4)


def test_a_sliding_joint_and_one_walked_upwards_have_the_sign_of_their_readings(serial_urdf):
    joints = [
        ("prismatic", (0.0, 0.0, 0.1), (0.1, 0.0, 0.0), (0, 0, 1)),
        ("revolute", (0.2, 0.0, 0.0), (0.0, 0.3, 0.0), (0, 1, 0)),
        ("revolute", (0.0, 0.3, 0.0), (0.5, 0.0, 0.0), (1, 0, 0)),
    ]
    true = np.array([0.002, -0.01, 0.02])
    q = np.random.default_rng(6).uniform(-1, 1, (25, 3))
    for base, tip in (("l0", "tip"), ("tip", "l0")):
        robot = Robot.from_urdf(serial_urdf(joints), base, tip)
        by_name = dict(zip(("j1", "j2", "j3"), true, strict=True))
        expected = [by_name[name] for name in robot.joint_names]
        zeros = zeros_of(robot, table(robot, q, np.array(expected)))
        assert zeros.delta == pytest.approx(expected, abs=2e-5), base


def test_offsets_of_joints_become_those_of_the_readings_that_they_follow():
    robot = servo_arm()
    assert reading_offsets(robot) == pytest.approx(np.eye(5), abs=1e-12)
    # The second reading drives joints 2 and 3, as of a palletiser: q_3 - q_2.
    coupling = np.eye(5)
    coupling[2, 1] = -1.0
    coupled = replace(robot, mimic_matrix=coupling)
    moved = coupling @ np.array([0.0, 0.02, 0.01, 0.0, 0.0])
    assert reading_offsets(coupled) @ moved == pytest.approx([0.0, 0.02, 0.01, 0.0, 0.0], abs=1e-12)


def test_errors_after_a_change_are_those_of_readings_changed_by_it():
    robot, q = servo_arm(), servo_readings()
    measured = table(robot, q, TRUE, noise=3e-4)
    zeros = zeros_of(robot, measured)
    assert zeros.rows == ESTIMATION
    errors = zeros.errors["m"]
    for change in (None, np.array([2e-3, -1e-3, 3e-3, 0.0, 5e-3])):
        moved = zeros.delta if change is None else zeros.delta + change
        e = measured.points - points(robot, q + moved)
        assert errors.rms(change) == pytest.approx(np.sqrt(np.mean(np.sum(e**2, axis=1))), rel=2e-3)
    assert errors.n == len(q)
    assert errors.rms(change) > 1.2 * errors.rms()
    assert errors.rms(change) != pytest.approx(errors.rms(-change), rel=1e-3)


def test_held_out_rows_are_predicted_by_fits_without_them():
    result = ur3_result()
    zeros = result.zeros
    assert zeros.rows == HELD_OUT
    assert zeros.errors["m"].n == 28  # of 30, two are outliers
    assert zeros.errors["m"].rms() == pytest.approx(1.692e-3, abs=1e-6)
    alone = calibrate(
        result.nominal,
        result.fit.measurements,
        cell=replace(result.fit.cell, model="zeros"),
        robust=False,
    )
    outliers = result.fit.geometry.estimate.outliers
    held_out = (
        linear_cross_validation(alone.fit.geometry, outliers).errors_without_outliers["m"].rms
    )
    assert zeros.errors["m"].rms() == pytest.approx(held_out, rel=0.05)


def test_without_cross_validation_they_are_those_of_the_validation_rows():
    result = ur3_result()
    zeros = zeros_of(result.nominal, result.fit.measurements, result.fit.cell)
    assert zeros.rows == VALIDATION
    assert zeros.errors["m"].n == 5
    assert zeros.delta == pytest.approx(result.zeros.delta, abs=1e-12)
    only_fitted = result.fit.measurements.select(result.fit.measurements.estimation)
    assert zeros_of(result.nominal, only_fitted, result.fit.cell).rows == ESTIMATION


def test_poses_have_errors_in_both_units():
    robot, q = servo_arm(), servo_readings()
    T, noise = robot.poses(q + TRUE), np.random.default_rng(2).normal(size=(2, len(q), 3))
    turned = T[:, :3, :3] @ Rotation.from_rotvec(1e-3 * noise[0]).as_matrix()
    measured = Measurements(
        robot.joint_names,
        q,
        T[:, :3, 3] + 1e-4 * noise[1],
        kinds=("pose",) * len(q),
        rotations=turned,
    )
    zeros = zeros_of(robot, measured, Cell(model="zeros"))
    assert set(zeros.errors) == {"m", "rad"}
    assert zeros.determined.tolist() == [True] * 4 + [False]  # the target turns with the last
    change = np.full(len(zeros.joints), 1e-2)
    for errors in zeros.errors.values():
        assert errors.rms(change) > 2.0 * errors.rms()


def test_too_few_rows_have_none():
    measured = table(servo_arm(), servo_readings(), TRUE)
    few = measured.select(np.arange(len(measured)) < 2)
    cell = replace(KNOWN, estimate_target=True, model="frames", priors=Priors(source="off"))
    assert calibrate(servo_arm(), few, cell=cell, validate=False).zeros is None


def test_the_paper_s_solver_has_them_too():
    result = ur3_result()
    cell = replace(result.fit.cell, model="paper")
    zeros = zeros_of(result.nominal, result.fit.measurements, cell, solver="paper")
    assert np.degrees(zeros.delta[0]) == pytest.approx(0.345, abs=0.1)


def test_they_read_back(tmp_path: Path):
    write_result(ur3_result(), tmp_path / "result.json")
    zeros, again = ur3_result().zeros, read_result(tmp_path / "result.json").zeros
    assert (again.joints, again.rows) == (zeros.joints, zeros.rows)
    for name in ("delta", "std", "determined"):
        assert np.array_equal(getattr(again, name), getattr(zeros, name), equal_nan=name == "std")
    for name in ("n", "mean_square"):
        assert getattr(again.errors["m"], name) == getattr(zeros.errors["m"], name)
    assert np.array_equal(again.errors["m"].slope, zeros.errors["m"].slope)
    assert np.array_equal(again.errors["m"].curvature, zeros.errors["m"].curvature)
