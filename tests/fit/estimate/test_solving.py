"""Solves between stages begin where the last one stopped, few are made; parameters are held at bounds and released."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell, Priors
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.solving import StageSolver, _pulled_inwards, _without_holds
from calib.fit.estimate.stages import Stage
from calib.numerics.solvers import levenberg_marquardt
from tests.fit.estimate.scene_fits import fitted, task_of

COUNT = 25


@pytest.fixture
def setting(make_scene):
    """A problem, its task and priors, the first stage, and the starts of all solves."""
    scene = make_scene(2, frames=[np.eye(4)], targets=1, noise=1e-4)
    task, rows = task_of(scene, scene.points(COUNT), Cell())
    starts = []

    def solver(system, x0, step_size, step_tolerance):
        starts.append(x0.copy())
        return levenberg_marquardt(system, x0, step_size, step_tolerance)

    task = replace(task, solver=solver)
    problem = Problem.initial(scene.kinematics, rows)
    task = replace(task, model=scene.kinematics.model.parameters)
    prior = PriorTerms.of(task, scene.kinematics.model, task.setup)
    stage = Stage.initial(prior, np.ones((1, COUNT), dtype=bool), 1)
    return problem, task, prior, stage, starts


def test_a_solve_begins_where_the_last_one_stopped(setting):
    problem, task, prior, stage, starts = setting
    solver = StageSolver(problem, task, prior.mean)
    first = solver.solve(stage, 0.1)
    second = solver.solve(stage, 1e-9)
    np.testing.assert_array_equal(starts[0], prior.mean)
    np.testing.assert_array_equal(starts[1], first.x)
    # The history and the number of evaluations are those of both.
    assert second.history[: len(first.history)] == first.history
    assert second.evaluations > first.evaluations


def test_a_stage_that_does_not_move_the_solution_needs_no_solve(setting):
    problem, task, prior, stage, starts = setting
    solver = StageSolver(problem, task, prior.mean)
    linear = solver.linear_at(stage)
    assert len(starts) == 1
    assert solver.linear_at(stage) is linear
    # A row less moves it by less than a step of 1 mm and 1 mrad: the linearised problem gives the solution.
    weights = stage.weights.copy()
    weights[0, 0] = 0.0
    moved = solver.linear_at(replace(stage, weights=weights))
    assert len(starts) == 1
    solution = solver.solve(replace(stage, weights=weights), 1e-9)
    assert np.linalg.norm((solution.x - moved.x) / 1e-3) < 0.1


def test_near_a_solution_no_solve_is_needed_however_far_it_moves(setting):
    """Two linear fits agree, though the first moves by more steps than a stage may without a solve."""
    problem, task, prior, stage, starts = setting
    solution = StageSolver(problem, task, prior.mean).solve(stage, 1e-9)
    del starts[:]
    start = solution.x + 6e-3 / np.sqrt(len(solution.x))
    near = StageSolver(problem, task, start, near_solution=True)
    linear = near.linear_at(stage)
    assert not starts
    np.testing.assert_array_equal(linear.x, near.x)
    assert np.linalg.norm((near.x - solution.x) / 1e-3) < 0.1
    StageSolver(problem, task, start).linear_at(stage)
    assert len(starts) == 1


def test_an_estimate_that_is_only_compared_has_the_likelihood_of_the_optimum(make_scene):
    """And the other one's scores and weights."""
    scene = make_scene(2, frames=[np.eye(4)], targets=1, noise=1e-4)
    task, rows = task_of(scene, scene.points(COUNT), Cell(model="dh"))
    reference = fit(replace(task, model="dh+gain"), rows)
    settled = fit(task, rows, reference=reference)
    compared = fit(task, rows, reference=reference, near=(reference,), only_compared=True)
    expected = settled.estimate.log_likelihood
    assert compared.estimate.log_likelihood == pytest.approx(expected, abs=2e-2)
    np.testing.assert_array_equal(compared.estimate.scores, reference.estimate.scores)
    np.testing.assert_array_equal(compared.estimate.weights, reference.estimate.weights)
    std = np.sqrt(np.diag(settled.estimate.covariance))
    assert np.all(np.abs(compared.estimate.x - settled.estimate.x) < 0.2 * std)


def test_a_parameter_at_a_bound_is_released_where_the_rows_pull_it_inside(make_scene):
    """Held 1 mm to either side of the optimum, as at a lower and as at an upper bound."""
    scene = make_scene(0, frames=[np.eye(4)], noise=1e-4)
    given = Priors(source="given")
    found, _ = fitted(scene, scene.points(25), Cell(priors=given), robust=False)
    k = found.kinematics.model.index("d1")
    best = float(found.estimate.x[k])

    def released(value, low, high):
        x = found.estimate.x.copy()
        x[k] = value
        prior = PriorTerms.of(found.task, found.kinematics.model, found.setup)
        limits = prior.limits.copy()
        limits[k] = low, high
        moved, prior = replace(found.estimate, x=x), replace(prior, limits=limits)
        return _pulled_inwards(moved, prior, {k: value})

    below, above = best - 1e-3, best + 1e-3
    assert released(below, below, best + 1.0) == {k}
    assert released(above, best - 1.0, above) == {k}
    assert released(above, above, best + 2.0) == set()
    assert released(below, best - 2.0, below) == set()
    # At the optimum it stays where it is, and so near it that little is to be gained.
    assert released(best, best, best + 1.0) == set()

    def squares(value):
        x = found.estimate.x.copy()
        x[k] = value
        residual, _ = found.estimate.problem.system(x)
        return residual @ residual

    # Where the sum of squares would fall by 1e-6: it falls by the square of the distance.
    step = 1e-3 * np.sqrt(1e-6 / (squares(below) - squares(best)))
    assert released(best - 0.8 * step, best - 0.8 * step, best + 1.0) == set()
    assert released(best - 1.2 * step, best - 1.2 * step, best + 1.0) == {k}


@pytest.mark.slow
def test_bounds_hold_and_let_go_of_what_they_no_longer_hold(make_scene):
    """At the end no bounded parameter could lower the cost by moving inwards (Karush, Kuhn, Tucker)."""
    prior_std = {"length": 3e-3, "angle": 15e-3, "zero": 15e-3}
    stopped = 0
    for seed in range(12):
        scene = make_scene(seed, frames=[np.eye(4)], noise=1e-4)
        names = scene.kinematics.model.names
        chosen = np.random.default_rng(seed).choice(len(names), 8, replace=False)
        cell = Cell(bounds={names[k]: (-1e-3, 1e-3) for k in chosen}, priors=Priors(source="given"))
        found, _ = fitted(scene, scene.points(25), cell, robust=False)
        e, model = found.estimate, found.kinematics.model
        stopped += len(e.at_bound)
        for k in chosen:
            assert abs(e.x[model.index(names[k])]) <= 1e-3 * (1 + 1e-9)
        precision, centre = e.problem.prior_precision.copy(), e.problem.prior_mean.copy()
        for k in e.at_bound:
            precision[k], centre[k] = prior_std[model.parameters[k].family] ** -2, 0.0
        free = replace(e.problem, prior_precision=precision, prior_mean=centre)
        r, J = free.system(e.x)
        slope, bend = J.T @ r, np.sum(J**2, axis=0)
        for k in e.at_bound:
            assert slope[k] * np.sign(e.x[k]) < 1e-3 * np.sqrt(bend[k])
    assert stopped > 20


def test_without_holds_each_parameter_has_its_usual_prior(make_scene):
    """That of its family as estimated, or as given where all of its family were held."""
    scene = make_scene(0, frames=[np.eye(4)], noise=1e-4)
    found, _ = fitted(scene, scene.points(25), Cell(), robust=False)
    estimate, model = found.estimate, found.kinematics.model
    prior = PriorTerms.of(found.task, model, found.setup)
    k = model.index("d1")
    held = prior.at_bounds({k: 1e-3})
    problem = replace(estimate.problem, prior_precision=held.precision, prior_mean=held.mean)
    released = _without_holds(replace(estimate, problem=problem), prior)
    np.testing.assert_allclose(released.prior_precision, estimate.problem.prior_precision)
    assert released.prior_mean[k] == 0.0
    without_length = {name: std for name, std in estimate.prior_std.items() if name != "length"}
    released = _without_holds(replace(estimate, prior_std=without_length), prior)
    assert released.prior_precision[k] == pytest.approx(
        prior.start[prior.names.index("length")] ** -2
    )
