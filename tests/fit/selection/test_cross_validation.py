"""Cross-validation against leave-one-out by hand, and on the linearised problem that of refits to first order."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from unittest import mock

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.task import Task
from calib.fit.registration.registration import register
from calib.fit.registration.table_rows import rows_and_setup
from calib.fit.selection import cross_validation as module
from calib.fit.selection.cross_validation import (
    cross_validation,
    fold_posterior_means,
    held_out_residuals_linear,
    linear_cross_validation,
    nominal_cross_validation,
)
from calib.fit.selection.folds import seen_only_by
from tests.fit.selection.models import fitted_to, task_of, task_of_case, with_outlying_points


def test_each_row_is_predicted_by_a_fit_to_the_others(make_scene):
    """So few rows that no fold is taken from the linear problem."""
    scene = make_scene(93, frames=[np.eye(4)], length=3e-4, angle=3e-3, noise=2e-5)
    table = scene.points(9)
    task, rows = task_of(scene, table, Cell())
    outliers = np.zeros(9, dtype=bool)
    done = []
    found = cross_validation(fit(task, rows), outliers, lambda k, count: done.append((k, count)))
    for row in (0, 5):
        others = fit(task, rows.select(np.arange(9) != row))
        np.testing.assert_allclose(found.residual[row], others.residual(rows)[row], atol=1e-12)
    assert done == [(k, 9) for k in range(1, 10)]


def test_the_nominal_robot_is_given_what_the_calibrated_one_is(calibrated):
    """Its frames and targets are registered without the fold, and its errors are those of the robot as it is."""
    scene, c = calibrated("set-ups")
    task, rows = task_of_case((scene, c))
    found = nominal_cross_validation(task, rows, c.fit.geometry.estimate.outliers)
    assert found.method == c.cross_validation.method
    assert found.errors["m"].rms > 20 * c.cross_validation.errors["m"].rms
    frames = fit(Task(scene.robot, c.fit.cell, task.setup, "frames"), rows)
    assert found.errors["m"].rms >= frames.residual(rows).std() * 0.9


@pytest.mark.parametrize("cell", [Cell(), Cell(estimate_frame=True)], ids=["target", "frame too"])
def test_nominal_errors_are_those_of_a_registration_without_the_pose(make_scene, cell):
    """Leave-one-out by hand: neither the pose itself nor an outlier has a part in the registration."""
    scene = make_scene(94, frames=[np.eye(4)], length=3e-4, angle=3e-3, noise=2e-5)
    task, rows = task_of(scene, scene.points(10), cell)
    outliers = np.arange(10) == 6
    T_base_tip = task.robot.poses(rows.joints)
    expected = np.empty((10, 3))
    for pose in range(10):
        kept = ~outliers & (np.arange(10) != pose)
        registered = register(T_base_tip[kept], task.setup, rows.select(kept))
        predicted = registered.target_poses(T_base_tip, rows.samples)
        expected[pose] = rows.residual(predicted)[pose]
    found = nominal_cross_validation(task, rows, outliers)
    np.testing.assert_allclose(found.residual, expected, atol=1e-9)
    # Far from what a registration to all rows leaves.
    setup = register(T_base_tip, task.setup, rows)
    fitted = rows.residual(setup.target_poses(T_base_tip, rows.samples))
    assert np.sum(expected**2) > 1.2 * np.sum(fitted**2)


def test_a_station_that_was_held_out_is_registered_with_the_target_of_the_others(make_scene, join):
    scene = make_scene(95, frames=3, length=3e-4, angle=3e-3, noise=2e-5)
    table = join(*(scene.points(8, f) for f in range(3)))
    task, rows = task_of(scene, table, Cell(estimate_frame=True))
    T_base_tip = task.robot.poses(rows.joints)
    expected = np.empty((24, 3))
    for station in range(3):
        held_out = rows.samples.frame == station
        others = register(T_base_tip[~held_out], task.setup, rows.select(~held_out))
        target = others.with_fixed(np.zeros(3, dtype=bool), np.ones(1, dtype=bool))
        own = register(T_base_tip[held_out], target, rows.select(held_out))
        predicted = own.target_poses(T_base_tip, rows.samples)
        expected[held_out] = rows.residual(predicted)[held_out]
    found = nominal_cross_validation(task, rows, np.zeros(24, dtype=bool))
    np.testing.assert_allclose(found.residual, expected, atol=1e-9)


def test_held_out_stations_are_registered_to_their_good_rows(make_scene, join):
    scene = make_scene(5, frames=3, noise=2e-5)
    table = join(*(scene.points(20, f) for f in range(3)))
    points = table.points.copy()
    points[44] += 0.02
    outliers = np.arange(60) == 44
    fitted = fitted_to(scene, replace(table, points=points), Cell(estimate_frame=True))
    residual = cross_validation(fitted, outliers).residual
    assert np.sqrt(np.mean(residual[40:][~outliers[40:]] ** 2)) < 1e-4
    np.testing.assert_allclose(residual[44], 0.02, atol=5e-4)


def both(fitted: Fitted) -> tuple[Any, Any]:
    """Cross-validation on the linearised problem, and by fits from the beginning."""
    linear = cross_validation(fitted, fitted.estimate.outliers)
    with mock.patch.object(module, "held_out_residuals_linear", return_value={}):
        return linear, cross_validation(fitted, fitted.estimate.outliers)


def assert_refitted(fitted: Fitted) -> None:
    """Each held-out row is predicted as by a fit from the beginning, to a small share of the noise."""
    linear, refitted = both(fitted)
    assert linear.method == refitted.method
    assert linear.errors["m"].rms == pytest.approx(refitted.errors["m"].rms, rel=3e-4, abs=1e-9)
    assert linear.errors["m"].max == pytest.approx(refitted.errors["m"].max, rel=1e-3, abs=1e-9)
    used = fitted.estimate.problem.rows.used
    apart = (linear.residual - refitted.residual) / fitted.estimate.problem.scales
    assert np.sqrt(np.mean(apart[used] ** 2)) < 1e-2


@pytest.mark.parametrize(
    "name",
    [
        "points",
        "poses",
        "distances",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("set-ups", "pairs", "targets")),
    ],
)
def test_held_out_rows_are_predicted_as_by_refits(calibrated, name):
    _, c = calibrated(name)
    assert_refitted(c.fit.non_geometric or c.fit.geometry)


def test_outliers_are_found_in_each_fold_as_by_refits(make_scene):
    scene = make_scene(91, frames=[np.eye(4)], length=3e-4, angle=3e-3, noise=2e-5)
    fitted = fitted_to(scene, with_outlying_points(scene.points(30)), Cell())
    assert np.flatnonzero(fitted.estimate.outliers).tolist() == [4, 17]
    assert_refitted(fitted)


@pytest.mark.parametrize(
    ("cell", "count", "solver"),
    [
        pytest.param(Cell(bounds={"a2": (-1e-5, 1e-5)}), 12, "lm", id="at a bound"),
        pytest.param(Cell(), 9, "lm", id="few rows"),
        pytest.param(Cell(), 14, "paper", id="the paper's solver", marks=pytest.mark.slow),
    ],
)
def test_folds_are_fitted_from_the_beginning_where_the_linear_problem_is_not_accurate(
    make_scene, cell, count, solver
):
    scene = make_scene(93, frames=[np.eye(4)], length=3e-4, angle=3e-3, noise=2e-5)
    every, setup = rows_and_setup(scene.robot, scene.points(count), cell)
    fitted = fit(Task(scene.robot, cell, setup, "dh", solver=solver), every)
    masks = tuple(np.eye(count, dtype=bool))
    assert held_out_residuals_linear(fitted, masks, fitted.estimate.outliers) == {}
    linear, refitted = both(fitted)
    np.testing.assert_array_equal(linear.residual, refitted.residual)


def test_no_fold_of_a_fit_at_a_bound_or_by_the_paper_s_solver_is_linear(make_scene):
    """Not even where the folds lie within the bounds, and where the robot is linear within so much noise."""
    scene = make_scene(93, frames=[np.eye(4)], length=3e-4, angle=3e-3, noise=1e-3)
    table, masks, none = scene.points(40), tuple(np.eye(40, dtype=bool)), np.zeros(40, dtype=bool)
    free = fitted_to(scene, table, Cell())
    assert len(held_out_residuals_linear(free, masks, none)) == 40
    a2 = free.estimate.x[free.kinematics.model.index("a2")]
    bounded = fitted_to(scene, table, Cell(bounds={"a2": (a2 - 1e-3, a2 - 1e-7)}))
    assert bounded.estimate.at_bound
    assert held_out_residuals_linear(bounded, masks, none) == {}
    task, rows = task_of(scene, table, Cell())
    papers = fit(replace(task, solver="paper"), rows)
    assert held_out_residuals_linear(papers, masks, none) == {}


def test_the_linear_one_agrees_with_the_refitted_one(case):
    """For every kind; prior std and noise are not estimated anew, and folds move them a little."""
    _, c = case
    # Where there is a non-geometric model the geometry alone leaves outliers, which each fold flags anew.
    fitted = c.fit.non_geometric or c.fit.geometry
    refitted = c.cross_validation if c.non_geometric is None else c.non_geometric.cross_validation
    linear = linear_cross_validation(fitted)
    assert linear.method == refitted.method
    assert linear.errors["m"].rms == pytest.approx(refitted.errors["m"].rms, rel=0.1)
    if refitted.errors["rad"].n:
        assert linear.errors["rad"].rms == pytest.approx(refitted.errors["rad"].rms, rel=0.1)
    good = ~fitted.estimate.outliers
    used = fitted.estimate.problem.rows.used & good[:, None]
    apart = (linear.residual - refitted.residual) / fitted.estimate.problem.scales
    assert np.sqrt(np.mean(apart[used] ** 2)) < 0.5


@pytest.mark.parametrize("size", [1, 6, 20])
def test_without_a_fold_the_mean_is_that_of_the_normal_equations_of_the_others(make_scene, size):
    """(A^T W A + P) x = A^T W y, with the weights of the fold at zero, be it smaller than the model or larger."""
    scene = make_scene(93, frames=[np.eye(4)], length=3e-4, angle=3e-3, noise=2e-5)
    fitted = fitted_to(scene, scene.points(30), Cell())
    problem = fitted.estimate.problem
    weights = np.where(np.arange(30) % 5 == 0, 0.5, 1.0)
    problem = replace(problem, weights=weights)
    fitted = replace(fitted, estimate=replace(fitted.estimate, problem=problem))
    linear = problem.linear(fitted.estimate.x)
    mask = np.arange(30) < size
    last = np.arange(30) == 29
    x, _ = fold_posterior_means(fitted, linear, [mask, last])
    (noise,) = fitted.estimate.noise
    A = linear.A[~mask] * np.sqrt(problem.weights[~mask])[:, None, None] / noise
    r = linear.residual(np.zeros(len(x)))[~mask] * np.sqrt(problem.weights[~mask])[:, None] / noise
    A, r = A.reshape(-1, len(x)), r.ravel()
    information = A.T @ A + linear.C.T @ linear.C + np.diag(problem.prior_precision)
    right = A.T @ r + linear.C.T @ linear.z + problem.prior_precision * problem.prior_mean
    np.testing.assert_allclose(x, np.linalg.solve(information, right), rtol=1e-5, atol=1e-9)


def test_what_only_a_fold_sees_stays_at_its_prior_without_it(calibrated):
    """A frame of one station has no more than the weak prior about 0 left, however many rows saw it."""
    _, c = calibrated("set-ups")
    fitted = c.fit.geometry
    linear = fitted.estimate.problem.linear(fitted.estimate.x)
    frame = fitted.estimate.problem.rows.samples.frame
    for number in np.unique(frame):
        mask = frame == number
        unseen = seen_only_by(fitted, mask)
        assert np.any(unseen)
        (x,) = fold_posterior_means(fitted, linear, mask[None])
        np.testing.assert_allclose(x[unseen], 0.0, atol=1e-9)
