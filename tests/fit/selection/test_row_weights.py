"""Weights of a reference fit are taken if they predict held-out rows better; lowered weights beside full ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from calib.fit.selection.row_weights import (
    compare_weights,
    explains_more_rows,
    fit_with_all_families,
    with_better_weights,
)
from calib.model.kinematics import Kinematics
from calib.model.parameter_sets import error_model
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot
from tests.fit.selection.models import fitted_to, scene_of, with_outliers, with_outlying_points

TARGET = np.array([0.05, -0.06, 0.04])

WILD = (4, 21)

CELL = Cell(model="zeros")


def test_a_reference_fit_that_explains_more_rows_keeps_its_weights(make_scene):
    scene = scene_of(make_scene, 115, "dh")
    rows, setup = rows_and_setup(scene.robot, scene.points(40), Cell())
    large, small = (fit(Task(scene.robot, Cell(), setup, m), rows) for m in ("dh", "zeros"))
    assert explains_more_rows(with_outliers(large), with_outliers(small, 3, 5))
    assert explains_more_rows(with_outliers(large, 3), with_outliers(small, 3, 5))
    # Each has an outlier of its own, or they agree, or the reference predicts worse.
    assert not explains_more_rows(with_outliers(large, 7), with_outliers(small, 3, 5))
    assert not explains_more_rows(with_outliers(large, 3, 5), with_outliers(small, 3, 5))
    assert not explains_more_rows(with_outliers(small), with_outliers(large, 3, 5))


@pytest.fixture(scope="module")
def robust_and_plain(make_scene):
    """Fits to 30 points, two of them off by millimetres: with these set aside, and with all rows in full."""
    scene = scene_of(make_scene, 91, "dh")
    rows, setup = rows_and_setup(scene.robot, with_outlying_points(scene.points(30)), Cell())
    task = Task(scene.robot, Cell(), setup, "dh")
    robust, plain = fit(task, rows), fit(replace(task, robust=False), rows)
    assert np.flatnonzero(robust.estimate.outliers).tolist() == [4, 17]
    return rows, robust, with_outliers(plain, 4, 17)


def test_weights_of_the_reference_are_taken_where_they_predict_better(robust_and_plain):
    rows, robust, plain = robust_and_plain
    found = with_better_weights(plain, rows, robust)
    weights = found.estimate.problem.weights
    np.testing.assert_array_equal(weights, robust.estimate.problem.weights)
    assert weights[[4, 17]].tolist() == [0.0, 0.0]
    # The reference predicts better, so rows are flagged only where it flags them too.
    np.testing.assert_allclose(found.estimate.scores, robust.estimate.scores, rtol=1e-12)


def test_weights_of_the_reference_are_not_taken_where_they_predict_worse(robust_and_plain):
    rows, robust, plain = robust_and_plain
    found = with_better_weights(robust, rows, plain)
    np.testing.assert_array_equal(found.estimate.x, robust.estimate.x)
    np.testing.assert_array_equal(found.estimate.problem.weights, robust.estimate.problem.weights)
    np.testing.assert_array_equal(found.estimate.scores, robust.estimate.scores)


def test_all_families_are_fitted_beside_the_geometry(make_scene):
    scene = scene_of(make_scene, 115, "dh")
    fitted = fitted_to(scene, scene.points(40), Cell())
    rows = fitted.estimate.problem.rows
    largest = fit_with_all_families(fitted, rows)
    assert largest.task.model == "dh+gain+eccentricity+compliance+gravity"
    np.testing.assert_array_equal(largest.setup.T_tip_target, fitted.setup.T_tip_target)


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
