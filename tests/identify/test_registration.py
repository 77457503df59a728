"""Target and measurement frame found without a guess."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.errors import MeasurementError
from calib.identify.registration import _both_system, register
from calib.measure.cell import Cell
from calib.model.readback import random_joint_values
from calib.model.robot import Robot


def seen(robot, q, T_frame_base, target):
    poses = T_frame_base @ robot.poses(q)
    return poses[:, :3, :3] @ target + poses[:, :3, 3]


def tracker_frame(rng):
    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    T[:3, 3] = rng.uniform(-4, 4, 3)
    return T


def test_target_alone_is_exact_in_closed_form(ur3):
    target = np.array([-0.07, 0.03, 0.2])
    q = random_joint_values(ur3, 8)
    cell = register(ur3, Cell(), q, seen(ur3, q, np.eye(4), target))
    np.testing.assert_allclose(cell.target, target, atol=1e-13)
    np.testing.assert_array_equal(cell.T_frame_base, np.eye(4))


def test_frame_alone_is_exact_in_closed_form(ur3):
    rng = np.random.default_rng(0)
    T, target = tracker_frame(rng), np.array([0.05, 0.0, 0.1])
    q = random_joint_values(ur3, 6)
    asked = Cell(target=target, estimate_target=False, estimate_frame=True)
    cell = register(ur3, asked, q, seen(ur3, q, T, target))
    np.testing.assert_allclose(cell.T_frame_base, T, atol=1e-12)
    np.testing.assert_array_equal(cell.target, target)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("guess", [None, np.array([0.3, -0.3, 0.3])])
def test_frame_and_target_together_from_anywhere(ur3, seed, guess):
    rng = np.random.default_rng(seed)
    T, target = tracker_frame(rng), rng.uniform(-0.3, 0.3, 3)
    q = random_joint_values(ur3, 20, seed)
    cell = register(ur3, Cell(target=guess, estimate_frame=True), q, seen(ur3, q, T, target))
    np.testing.assert_allclose(cell.T_frame_base, T, atol=1e-7)
    np.testing.assert_allclose(cell.target, target, atol=1e-7)


@pytest.mark.parametrize(("name", "tip"), [("panda", "panda_link8"), ("kinova", None)])
def test_other_arms_too(name, tip):
    robot = Robot.load(name, tip=tip)
    rng = np.random.default_rng(3)
    T, target = tracker_frame(rng), np.array([0.1, -0.05, 0.2])
    q = random_joint_values(robot, 25)
    cell = register(robot, Cell(estimate_frame=True), q, seen(robot, q, T, target))
    np.testing.assert_allclose(cell.target, target, atol=1e-7)


def test_what_is_known_stays_as_it_is(ur3):
    rng = np.random.default_rng(0)
    T = tracker_frame(rng)
    known = Cell(target=np.array([0.1, 0.0, 0.0]), estimate_target=False, T_frame_base=T)
    assert register(ur3, known, random_joint_values(ur3, 3), np.zeros((3, 3))) is known


def test_a_reflected_cloud_does_not_give_a_reflected_frame(ur3):
    q = random_joint_values(ur3, 20)
    target = np.array([0.05, 0.02, 0.1])
    mirrored = seen(ur3, q, np.eye(4), target) * np.array([1.0, 1.0, -1.0])
    asked = Cell(target=target, estimate_target=False, estimate_frame=True)
    cell = register(ur3, asked, q, mirrored)
    assert np.linalg.det(cell.T_frame_base[:3, :3]) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("cell", "rows", "what"),
    [
        (Cell(estimate_frame=True), 2, "the measurement frame and the target"),
        (
            Cell(target=np.zeros(3), estimate_target=False, estimate_frame=True),
            2,
            "the measurement frame",
        ),
    ],
)
def test_too_few_rows_are_refused_with_the_numbers(ur3, cell, rows, what):
    q = random_joint_values(ur3, rows)
    with pytest.raises(
        MeasurementError, match=f"{rows} rows give {3 * rows} numbers.*{what} alone"
    ):
        register(ur3, cell, q, np.zeros((rows, 3)))


def test_noise_and_one_gross_row_leave_a_start_that_is_good_enough(ur3):
    rng = np.random.default_rng(9)
    T, target = tracker_frame(rng), np.array([0.05, -0.02, 0.1])
    q = random_joint_values(ur3, 40)
    points = seen(ur3, q, T, target) + 1e-3 * rng.normal(size=(40, 3))
    points[7] += 0.05
    cell = register(ur3, Cell(estimate_frame=True), q, points)
    assert np.linalg.norm(cell.target - target) < 5e-3


def test_the_derivative_in_frame_and_target_against_differences(ur3):
    rng = np.random.default_rng(4)
    T, target = tracker_frame(rng), rng.uniform(-0.2, 0.2, 3)
    poses = ur3.poses(random_joint_values(ur3, 5))
    points = rng.uniform(-1, 1, (5, 3))
    x = 0.4 * rng.normal(size=9)
    _, J = _both_system(T, target, poses, points, x)
    for k in range(9):
        step = np.zeros(9)
        step[k] = 1e-5
        ahead, _ = _both_system(T, target, poses, points, x + step)
        behind, _ = _both_system(T, target, poses, points, x - step)
        np.testing.assert_allclose(J[:, k], (ahead - behind) / 2e-5, atol=1e-8)
