"""Cross-validation on the linearised problem is that of refits to first order."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from unittest import mock

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from calib.fit.selection import cross_validation as module
from calib.fit.selection.cross_validation import cross_validation
from calib.fit.selection.linear_folds import (
    fold_posterior_means,
    held_out_residuals_linear,
    linear_cross_validation,
)
from tests.fit.selection.models import fitted_to, task_of, with_outlying_points


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


@pytest.mark.parametrize("name", ["points", "poses", "set-ups", "distances", "pairs", "targets"])
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
    [(Cell(bounds={"a2": (-1e-5, 1e-5)}), 12, "lm"), (Cell(), 9, "lm"), (Cell(), 14, "paper")],
    ids=["at a bound", "few rows", "the paper's solver"],
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


def test_without_a_fold_the_mean_is_that_of_the_normal_equations_of_the_others(make_scene):
    """(A^T W A + P) x = A^T W y, with the weights of the fold at zero."""
    scene = make_scene(93, frames=[np.eye(4)], length=3e-4, angle=3e-3, noise=2e-5)
    fitted = fitted_to(scene, scene.points(30), Cell())
    problem = fitted.estimate.problem
    linear = problem.linear(fitted.estimate.x)
    mask = np.arange(30) < 6
    (x,) = fold_posterior_means(fitted, linear, mask[None])
    (noise,) = fitted.estimate.noise
    A = linear.A[~mask] * np.sqrt(problem.weights[~mask])[:, None, None] / noise
    r = linear.residual(np.zeros(len(x)))[~mask] * np.sqrt(problem.weights[~mask])[:, None] / noise
    A, r = A.reshape(-1, len(x)), r.ravel()
    information = A.T @ A + linear.C.T @ linear.C + np.diag(problem.prior_precision)
    right = A.T @ r + linear.C.T @ linear.z + problem.prior_precision * problem.prior_mean
    np.testing.assert_allclose(x, np.linalg.solve(information, right), rtol=1e-5, atol=1e-9)
