"""Solves between stages: each begins where the last one stopped, and none is made where a stage hardly moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.solving import StageSolver
from calib.fit.estimate.special_cases.sole_postures import mark_sole_postures
from calib.fit.estimate.stages import Stage
from calib.numerics.solvers import levenberg_marquardt
from tests.fit.estimate.scene_fits import task_of

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


def test_sole_postures_are_marked_once(setting):
    problem, _, prior, _, _ = setting
    marked = mark_sole_postures(problem, prior)
    assert marked.rows.sole is not None
    assert marked.rows.sole.shape == (COUNT,)
    assert mark_sole_postures(marked, prior) is marked
