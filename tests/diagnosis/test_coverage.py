"""What a result rests on: rows outside of the measured poses, corners of workspaces, and weights that were lowered."""

from __future__ import annotations

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.coverage import outside, spread_of
from calib.example import paper_measurements
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics
from calib.result.calibrate import calibrate
from calib.result.calibration import CalibrationValues
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot

TYPES = ("revolute",) * 6


def drawn(robot: Robot, count: int, seed: int) -> np.ndarray:
    """Joint values all over the limits."""
    return np.random.default_rng(seed).uniform(*limits(robot).T, (count, len(robot.joint_names)))


def limits(robot: Robot) -> np.ndarray:
    return np.array([(max(j.lower, -np.pi), min(j.upper, np.pi)) for j in robot.joints])


def tips(robot: Robot, q: np.ndarray) -> np.ndarray:
    return robot.poses(q)[:, :3, 3]


def spread(robot: Robot, q: np.ndarray) -> float:
    return spread_of(tips(robot, q), tips(robot, drawn(robot, 2000, 0)))


@pytest.fixture(scope="module")
def paper_joints(ur3):
    table = Measurements.read(paper_measurements(), ur3.joint_names, ur3.joint_types)
    return table.joints_for(ur3.joint_names)


def test_the_paper_s_last_rows_lie_outside(ur3, paper_joints):
    """Rows 34 and 35 ask for joint values far from those of rows 1 to 30."""
    found = outside(paper_joints[:30], paper_joints[30:], ur3.joint_names, TYPES)
    numbers = np.arange(31, 36)
    rows = [int(numbers[row.index]) for row in found]
    assert {34, 35} <= set(rows)
    for row in found:
        asked = paper_joints[30 + row.index]
        for b in row.beyond:
            j = ur3.joint_names.index(b.joint)
            low, high = paper_joints[:30, j].min(), paper_joints[:30, j].max()
            assert b.by == pytest.approx(max(low - asked[j], asked[j] - high))
            assert b.by > 0.05 * (high - low)


def test_a_margin_of_a_twentieth_is_allowed():
    measured = np.array([[0.0, 0.0], [1.0, 2.0]])
    asked = np.array([[1.049, 2.09], [1.051, -0.09], [0.5, 2.11], [-0.2, -0.3]])
    found = outside(measured, asked, ("a", "b"), ("revolute", "prismatic"))
    assert [row.index for row in found] == [1, 2, 3]
    assert found[0].beyond[0].by == pytest.approx(0.051)
    # The worst in shares of its range comes first.
    assert [b.joint for b in found[2].beyond] == ["a", "b"]


def test_continuous_joints_are_measured_on_a_circle():
    measured = np.radians([[170.0], [-175.0], [150.0], [-160.0]])
    asked = np.radians([[185.0], [-180.0], [540.0], [140.0], [-100.0], [260.0]])
    found = outside(measured, asked, ("a",), ("continuous",))
    assert [row.index for row in found] == [3, 4, 5]
    np.testing.assert_allclose([np.degrees(r.beyond[0].by) for r in found], [10, 60, 60])
    # The same values of a joint with limits are far apart.
    assert [row.index for row in outside(measured, asked[:3], ("a",), ("revolute",))] == [2]


def test_the_paper_s_poses_are_no_corner(ur3, paper_joints):
    assert 0.38 < spread(ur3, paper_joints[:30]) < 0.5


TARGET = np.array([0.05, -0.06, 0.04])
WILD = (4, 21)
CELL = Cell(model="zeros")


@pytest.fixture(scope="module")
def table(ur3: Robot) -> Measurements:
    """Forty good rows, and two of them spoilt by 10 mm; the last ten for validation."""
    q = random_joint_values(ur3, 40, 1)
    poses, rng = ur3.poses(q), np.random.default_rng(1)
    points = poses[:, :3, :3] @ TARGET + poses[:, :3, 3] + 1e-4 * rng.normal(size=(40, 3))
    points[list(WILD)] += [0.0, 0.0, 0.01]
    return Measurements(ur3.joint_names, q, points, sets=("estimate",) * 30 + ("validate",) * 10)


@pytest.fixture(scope="module")
def robust(ur3: Robot, table: Measurements) -> CalibrationValues:
    return calibrate(ur3, table, cell=CELL, validate=False)


@pytest.fixture(scope="module")
def plain(ur3: Robot, table: Measurements) -> CalibrationValues:
    return calibrate(ur3, table, cell=CELL, robust=False, validate=False)


def test_it_is_the_difference_of_the_two_calibrations(robust, plain, table):
    found = robust.robustness
    q = table.joints[table.estimation]
    moved = np.linalg.norm(robust.predict(q) - plain.predict(q), axis=1)
    assert found.lowered
    assert found.moved_rms == pytest.approx(np.sqrt(np.mean(moved**2)), rel=1e-6)
    assert found.moved_max == pytest.approx(np.max(moved), rel=1e-6)
    # Two rows of thirty, a hundred times the noise: worse by far on the rows that nobody doubts.
    assert found.moved_rms > 3.0 * robust.expected_measured
    assert found.errors_lowered.n == found.errors_full.n == 28
    assert found.errors_lowered.rms < 2.5e-4 < 4e-4 < found.errors_full.rms


@pytest.mark.parametrize(
    ("seed", "size"), [(0, 0.03), pytest.param(1, 0.5, marks=pytest.mark.slow)]
)
def test_auto_chooses_as_if_gross_rows_were_not_there(ur3, seed: int, size: float):
    """A fifth of the rows is gross: they have no weight in the fits, and no say in which model is chosen."""
    model = error_model(ur3, "dh")
    rng = np.random.default_rng(seed)
    x = rng.normal(size=len(model)) * np.where(np.array(model.units) == "m", 3e-4, 3e-3)
    T_tip_target = np.eye(4)
    T_tip_target[:3, 3] = TARGET
    q = random_joint_values(ur3, 40, seed)
    points = Kinematics(ur3, model, np.eye(4), T_tip_target).points(x, q)
    points += 1e-4 * rng.normal(size=(40, 3))
    thrown = rng.normal(size=(8, 3))
    points[:8] += size * thrown / np.linalg.norm(thrown, axis=1, keepdims=True)
    spoilt, clean = (
        calibrate(ur3, Measurements(ur3.joint_names, q[k:], points[k:]), validate=False)
        for k in (0, 8)
    )
    assert [o.row for o in spoilt.outliers][:8] == list(range(1, 9))
    assert spoilt.model.name == clean.model.name == "dh"
    assert spoilt.non_geometric is None
    assert np.abs(spoilt.predict(q) - clean.predict(q)).max() < 2e-5
