"""Fits without each fold on the linearised problem: against fits from the beginning."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib.identify.crossvalidation import cross_validation, fold_fits, fold_means, folds_of
from calib.identify.estimate import estimate as estimated
from calib.identify.fitting import Fitted, Task, fit, holds_of
from calib.identify.problem import Problem
from calib.identify.rows import Rows
from calib.identify.setup import known_distances, rows_of
from calib.identify.solvers import SOLVERS
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements


def fitted_to(scene: Any, table: Measurements, cell: Cell, model: str = "dh") -> Fitted:
    every, setup = rows_of(scene.robot, table, cell)
    task = Task(scene.robot, cell, setup, model, known_distances(cell, setup), lenient=True)
    return fit(task, every.select(table.estimation))


def of_case(case: tuple[Any, Any]) -> Fitted:
    _, c = case
    return c.fit.larger or c.fit.geometry


def rows_of_fit(fitted: Fitted) -> Rows:
    return fitted.estimate.problem.rows


def with_outliers(make_scene: Any, **given: Any) -> tuple[Any, Measurements]:
    """30 points, two of them off by millimetres."""
    usual = {"frames": [np.eye(4)], "length": 3e-4, "angle": 3e-3, "noise": 2e-5}
    scene = make_scene(91, **(usual | given))
    table = scene.points(30)
    points = table.points.copy()
    points[[4, 17]] += [[2e-3, 0.0, 1e-3], [0.0, -3e-3, 0.0]]
    return scene, replace(table, points=points)


def test_folds_by_the_linearised_problem_go_through_the_stages_of_a_fit(make_scene):
    """At the solution without a fold, the linearised problem has the fold's own estimate."""
    scene, table = with_outliers(make_scene)
    fitted = fitted_to(scene, table, Cell())
    masks = folds_of(fitted.task, rows_of_fit(fitted)).masks[:6]
    problem, estimate = fitted.estimate.problem, fitted.estimate
    holds = holds_of(fitted.task, fitted.kinematics.model, fitted.setup)
    found, _ = fold_fits(fitted, holds, problem.linear(estimate.x), masks)
    std = np.sqrt(np.diag(estimate.covariance))
    for mask, x in zip(masks, found, strict=True):
        first = Problem.first(problem.kinematics, problem.rows.select(~mask))
        np.testing.assert_allclose(
            estimated(first, SOLVERS["lm"], holds).x / std, x / std, atol=0.05
        )


def test_means_at_sizes_that_stay(make_scene):
    scene, table = with_outliers(make_scene)
    fitted = fitted_to(scene, table, Cell())
    problem, estimate = fitted.estimate.problem, fitted.estimate
    linear = problem.linear(estimate.x)
    known, noise = linear.known(problem.precision, problem.centre), np.array([estimate.noise])
    masks = folds_of(fitted.task, problem.rows).masks
    found = fold_means(fitted, linear, masks)
    for mask, x in zip(masks, found, strict=True):
        one = linear.data(np.where(mask, 0.0, problem.weights)[None]).posterior(noise, known)[0]
        np.testing.assert_allclose(x, one[0], rtol=1e-6, atol=1e-12)


def both(fitted: Fitted) -> tuple[Any, Any]:
    """Cross-validation on the linearised problem, and by fits from the beginning."""
    task, rows, outliers = fitted.task, rows_of_fit(fitted), fitted.estimate.outliers
    return (
        cross_validation(task, rows, outliers, fitted=fitted),
        cross_validation(task, rows, outliers),
    )


def assert_refitted(fitted: Fitted) -> None:
    """Each left-out row is predicted as by a fit from the beginning, to a small share of the noise."""
    linear, refitted = both(fitted)
    assert linear.method == refitted.method
    assert linear.errors.rms == pytest.approx(refitted.errors.rms, rel=3e-4, abs=1e-9)
    assert linear.errors.max == pytest.approx(refitted.errors.max, rel=1e-3, abs=1e-9)
    used = rows_of_fit(fitted).used
    apart = (linear.residual - refitted.residual) / fitted.estimate.problem.scales
    assert np.sqrt(np.mean(apart[used] ** 2)) < 1e-2


@pytest.mark.parametrize("name", ["points", "poses", "set-ups", "distances", "pairs", "targets"])
def test_left_out_rows_are_predicted_as_by_refits(calibrated, name):
    assert_refitted(of_case(calibrated(name)))


def test_outliers_are_found_in_each_fold_as_by_refits(make_scene):
    scene, table = with_outliers(make_scene)
    fitted = fitted_to(scene, table, Cell())
    assert np.flatnonzero(fitted.estimate.outliers).tolist() == [4, 17]
    assert_refitted(fitted)


def test_the_papers_rows_are_predicted_as_by_refits(ur3, table, paper_cell):
    every, setup = rows_of(ur3, table, paper_cell)
    task = Task(ur3, paper_cell, setup, "paper")
    assert_refitted(fit(task, every.select(table.estimation)))


@pytest.mark.parametrize(
    ("cell", "count", "solver"),
    [
        (Cell(bounds={"a2": (-1e-5, 1e-5)}), 12, "lm"),
        (Cell(), 9, "lm"),
        (Cell(), 14, "paper"),
    ],
    ids=["at a bound", "few rows", "the paper's solver"],
)
def test_folds_are_fitted_from_the_beginning_where_the_linearised_problem_does_not_do(
    make_scene, cell, count, solver
):
    scene = make_scene(93, frames=[np.eye(4)], length=3e-4, angle=3e-3, noise=2e-5)
    table = scene.points(count)
    every, setup = rows_of(scene.robot, table, cell)
    fitted = fit(Task(scene.robot, cell, setup, "dh", solver=solver), every)
    linear, refitted = both(fitted)
    np.testing.assert_array_equal(linear.residual, refitted.residual)


def test_a_left_out_row_does_not_move_its_own_prediction(make_scene):
    """The fit to all rows gives no more than the place where the problem is linearised."""
    scene = make_scene(94, frames=[np.eye(4)], length=3e-4, angle=3e-3, noise=2e-5)
    table = scene.points(30)
    moved = table.points.copy()
    moved[7] += [3e-3, 4e-3, 0.0]
    before, after = (
        both(fitted_to(scene, one, Cell()))[0].residual
        for one in (table, replace(table, points=moved))
    )
    np.testing.assert_allclose(after[7] - before[7], [3e-3, 4e-3, 0.0], atol=1e-7)


def test_progress_is_told_of_each_fold(make_scene):
    scene, table = with_outliers(make_scene)
    fitted = fitted_to(scene, table, Cell())
    told: list[tuple[int, int]] = []
    task, rows = fitted.task, rows_of_fit(fitted)
    outliers = fitted.estimate.outliers
    cross_validation(task, rows, outliers, lambda *at: told.append(at), fitted=fitted)
    assert told == [(k + 1, 30) for k in range(30)]


def test_set_ups_that_were_not_seen_are_registered_to_their_good_rows(make_scene, join):
    scene = make_scene(5, frames=3, noise=2e-5)
    table = join(*(scene.points(20, f) for f in range(3)))
    points = table.points.copy()
    points[44] += 0.02
    outliers = np.arange(60) == 44
    fitted = fitted_to(scene, replace(table, points=points), Cell(estimate_frame=True))
    left = cross_validation(fitted.task, rows_of_fit(fitted), outliers, fitted=fitted).residual
    assert np.sqrt(np.mean(left[40:][~outliers[40:]] ** 2)) < 1e-4
    np.testing.assert_allclose(left[44], 0.02, atol=5e-4)
