"""The fit with lowered weights beside the one with every row in full."""

from __future__ import annotations

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.fit.selection.robustness import compare_weights
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot

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
def robust(ur3: Robot, table: Measurements) -> Calibration:
    return calibrate(ur3, table, cell=CELL, validate=False)


@pytest.fixture(scope="module")
def plain(ur3: Robot, table: Measurements) -> Calibration:
    return calibrate(ur3, table, cell=CELL, robust=False, validate=False)


def test_it_is_the_difference_of_the_two_calibrations(robust, plain, table):
    found = robust.trust.robustness
    q = table.joints[table.estimation]
    moved = np.linalg.norm(robust.predict(q) - plain.predict(q), axis=1)
    assert found.lowered
    assert found.moved_rms == pytest.approx(np.sqrt(np.mean(moved**2)), rel=1e-6)
    assert found.moved_max == pytest.approx(np.max(moved), rel=1e-6)
    # Two rows of thirty, a hundred times the noise: worse by far on the rows that nobody doubts.
    assert found.moved_rms > 3.0 * robust.geometry.expected_measured
    assert found.errors_lowered["m"].n == found.errors_full["m"].n == 28
    assert found.errors_lowered["m"].rms < 2.5e-4 < 4e-4 < found.errors_full["m"].rms


def test_of_a_fit_with_every_row_in_full_it_is_the_other_way_round(robust, plain):
    found = compare_weights(plain.fit.geometry)
    assert not found.lowered
    assert found.moved_rms == pytest.approx(robust.trust.robustness.moved_rms, rel=1e-6)
    assert found.errors_lowered["m"].rms < 2.5e-4 < 4e-4 < found.errors_full["m"].rms


def test_a_motion_as_one_body_is_no_difference_where_no_row_determines_the_base(calibrated):
    _, c = calibrated("distances")
    found = compare_weights(c.fit.geometry)
    assert found.moved_rms < 3.0 * c.geometry.expected_measured


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
    assert [o.row for o in spoilt.rows.outliers][:8] == list(range(1, 9))
    assert spoilt.model.name == clean.model.name == "dh"
    assert spoilt.non_geometric is None
    assert np.abs(spoilt.predict(q) - clean.predict(q)).max() < 2e-5
