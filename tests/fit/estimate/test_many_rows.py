"""Fits of many rows: begun by a part of them, in threads, and of a path as many rows as are independent."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.fit.estimate import problem, solving
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameter_sets import error_model
from calib.numerics.geometry import pose_of
from calib.robot import kernel
from calib.robot.robot import Robot

Array = np.ndarray

#: Position of the target in the tip [m].
TARGET = pose_of(np.array([0.05, 0.04, 0.06]))


def path(count: int, seed: int) -> Array:
    """Joint values (N, 6) of an arm that drives from pose to pose, 400 rows on each way [rad]."""
    stops = np.random.default_rng(seed).uniform(-2.6, 2.6, (count // 400 + 2, 6))
    number, share = np.divmod(np.arange(count) / 400.0, 1.0)
    share = (share**2 * (3.0 - 2.0 * share))[:, None]
    number = number.astype(int)
    return stops[number] * (1.0 - share) + stops[number + 1] * share


def fitted_to(robot: Robot, q: Array, errors: Array, seed: int) -> tuple[Fitted, Array, Array]:
    """Return the fit to points with errors (N, 3) [m], and the model's true parameters and 200 of the poses."""
    rng = np.random.default_rng(seed)
    model = error_model(robot, "dh", target=True)
    x = rng.normal(size=len(model)) * np.where(np.array(model.units) == "m", 3e-4, 2e-3)
    points = Kinematics(robot, model, np.eye(4), TARGET).points(x, q) + errors
    table = Measurements(joint_names=robot.joint_names, joints=q, points=points)
    cell = Cell(model="dh")
    rows, setup = rows_and_setup(robot, table, cell)
    return fit(Task(robot, cell, setup, "dh"), rows), x, rng.permutation(q)[:200]


def correlated(phi: float, count: int, seed: int) -> Array:
    """Errors (N, 3) of 0.05 mm with the correlation phi^k between rows k apart."""
    white = np.random.default_rng(seed).normal(0.0, 5e-5, (count + 1000, 3))
    return lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], white, axis=0)[1000:]


def test_some_of_the_rows_lead_to_the_same_fit(ur3, monkeypatch):
    rng = np.random.default_rng(1)
    errors = rng.normal(0.0, 5e-5, (3000, 3))
    errors[::70] += 5e-3
    q = rng.uniform(-2.8, 2.8, (3000, 6))
    whole, _, _ = fitted_to(ur3, q, errors, 2)
    monkeypatch.setattr(solving, "_MANY", 500)
    monkeypatch.setattr(problem, "_MOST_KEPT", 0)
    by_some, _, _ = fitted_to(ur3, q, errors, 2)
    again = pickle.loads(pickle.dumps(by_some))  # columns that are not kept go to other processes
    x = by_some.estimate.x
    np.testing.assert_array_equal(
        again.estimate.problem.linear(x).residual(x), by_some.estimate.problem.linear(x).residual(x)
    )
    std = np.sqrt(np.diag(whole.estimate.covariance))
    np.testing.assert_array_less(np.abs(by_some.estimate.x - whole.estimate.x), 0.05 * std)
    np.testing.assert_allclose(by_some.estimate.weights, whole.estimate.weights, atol=0.05)
    assert by_some.estimate.noise == pytest.approx(whole.estimate.noise, rel=0.01)
    np.testing.assert_array_equal(by_some.estimate.outliers, whole.estimate.outliers)


def test_rows_keep_the_weights_that_they_come_with(ur3, monkeypatch):
    """However many they are."""
    rng = np.random.default_rng(9)
    q = rng.uniform(-2.8, 2.8, (400, 6))
    table = Measurements(
        ur3.joint_names, q, ur3.poses(q)[:, :3, 3] + rng.normal(0.0, 1e-4, (400, 3))
    )
    rows, setup = rows_and_setup(ur3, table, Cell())
    weights = rng.uniform(0.1, 1.0, 400)
    rows, task = replace(rows, weights=weights), Task(ur3, Cell(), setup, "dh")
    monkeypatch.setattr(solving, "_MANY", 100)
    found = fit(task, rows).estimate
    np.testing.assert_array_equal(found.problem.weights, weights)
    monkeypatch.undo()
    np.testing.assert_array_equal(found.x, fit(task, rows).estimate.x)


def test_threads_change_nothing(ur3, monkeypatch):
    rng = np.random.default_rng(3)
    monkeypatch.setattr(kernel, "BLOCK", 64)
    monkeypatch.setattr(problem, "_MOST_KEPT", 0)
    q, errors = rng.uniform(-2.8, 2.8, (700, 6)), rng.normal(0.0, 5e-5, (700, 3))
    in_threads, _, _ = fitted_to(ur3, q, errors, 4)
    monkeypatch.setattr(kernel, "_FEW_BLOCKS", 1000)
    alone, _, _ = fitted_to(ur3, q, errors, 4)
    np.testing.assert_array_equal(in_threads.estimate.x, alone.estimate.x)
    np.testing.assert_array_equal(in_threads.estimate.scores, alone.estimate.scores)


@pytest.mark.slow
def test_a_path_counts_for_as_many_rows_as_are_independent(ur3):
    """Correlated by 0.9 from row to row: as one row of 19; rows drawn from it one by one count in full."""
    count, phi = 24_000, 0.9
    q, errors = path(count, 5), correlated(phi, count, 6)
    fitted, _, _ = fitted_to(ur3, q, errors, 7)
    assert np.max(fitted.estimate.problem.weights) == pytest.approx(1.0 / 19.0, rel=0.25)
    white, _, _ = fitted_to(ur3, q, np.random.default_rng(8).permutation(errors), 7)
    assert np.max(white.estimate.problem.weights) == 1.0
    ratio = np.diag(fitted.estimate.covariance) / np.diag(white.estimate.covariance)
    assert 10.0 < np.max(ratio) < 30.0
    assert fitted.estimate.noise == pytest.approx(white.estimate.noise, rel=0.05)


@pytest.mark.slow
def test_the_stated_deviation_of_a_path_covers_its_error(ur3):
    """Of predictions along the path, in units of their standard deviation: about 1, where 4 rows of 5 tell nothing."""
    count, phi = 16_000, 0.8
    scores = []
    for seed in range(12):
        errors = correlated(phi, count, 100 + seed)
        fitted, x, q = fitted_to(ur3, path(count, 200 + seed), errors, 300 + seed)
        model = error_model(ur3, "dh", target=True)
        truth = Kinematics(ur3, model, np.eye(4), TARGET).points(x, q)
        poses, J = fitted.kinematics.twists(fitted.estimate.x, Samples.at(q), rotation=False)
        variances = np.einsum("ndp,pq,ndq->nd", J, fitted.estimate.covariance, J)
        scores.append((poses[:, :3, 3] - truth) / np.sqrt(variances))
    assert 0.8 < np.sqrt(np.mean(np.square(scores))) < 1.25
    assert np.mean(np.abs(scores) < 1.96) > 0.88
