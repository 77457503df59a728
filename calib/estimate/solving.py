"""Solving with given priors: stages on the linearised problem, and solves of the problem itself, in turn.

Each stage asks for the problem linearised at its solution. The solution is sought where the last one was; a stage that
hardly moves it needs no solve.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.estimate.estimate import Estimate, estimate_at_stage, problem_at_stage
from calib.estimate.linear import LinearProblem
from calib.estimate.prior_terms import PriorTerms
from calib.estimate.problem import Problem
from calib.estimate.sole_postures import (
    open_directions,
    open_scores,
    sole_postures,
    update_by_sole_postures,
)
from calib.estimate.stages import Stage, Weighting, run_stages
from calib.estimate.task import Task
from calib.model.observability import steps
from calib.numerics.scores import Limits
from calib.numerics.solvers import SOLVERS, Solution
from calib.robot.robot import read_only
from calib.units import Array

#: Tolerance of a solve between stages, whose weights and priors change far more, in steps of 1 mm and 1 mrad.
_ROUGH = 0.1

#: Tolerance of the last solve, in the same steps.
_FINE = 1e-9

#: A stage's solution that is closer than this is first sought on the linearised problem, in the same steps.
_CLOSE = 5.0


class StageSolver:
    """Follows the solution of a problem from stage to stage; each solve begins where the last one stopped."""

    def __init__(self, problem: Problem, task: Task, start: Array) -> None:
        """Begin at some parameters.

        Args:
            problem: The problem, whose weights, noise and priors each stage sets.
            task: Its solver is used.
            start: shape (p,).
        """
        self._problem = problem
        self._solver = task.solver if callable(task.solver) else SOLVERS[str(task.solver)]
        self._step_size = steps(problem.kinematics.model.units)
        self._x: Array = start.copy()
        self._solution: Solution | None = None  # Of all solves so far
        self._linear: LinearProblem | None = None  # At the solution of the last stage

    def solve(self, stage: Stage, tolerance: float) -> Solution:
        """Solve the problem with the weights, noise and priors of a stage (B = 1).

        Args:
            stage: The stage.
            tolerance: Length of the last step, in steps of 1 mm and 1 mrad.

        Returns:
            The solution, with the history and evaluations of all solves so far.
        """
        system = problem_at_stage(self._problem, stage).system
        solution = self._solver(system, self._x, self._step_size, tolerance)
        if self._solution is not None:
            solution = replace(
                solution,
                evaluations=self._solution.evaluations + solution.evaluations,
                history=self._solution.history + solution.history,
            )
        self._solution = solution
        self._x = solution.x
        return solution

    def linear_at(self, stage: Stage) -> LinearProblem:
        """Return the problem linearised at the solution of a stage (B = 1), or where it hardly differs."""
        near = self._near_last(stage)
        if near is None:
            self.solve(stage, _ROUGH)
            near = self._problem.linear(self._x)
        self._linear = near
        return near

    def _near_last(self, stage: Stage) -> LinearProblem | None:
        """The linearised problem where it gives the stage's solution without a solve; None where it does not."""
        if self._linear is None:
            return None
        x = stage.fit(self._linear)[0][0]
        moved = self._length(x - self._x)
        if moved <= _ROUGH:  # the difference is of the order of 1e-8 m and rad
            return self._linear
        if moved <= _CLOSE:
            # A step as short as this needs no damping, if the next one confirms it.
            linear = self._problem.linear(x)
            if self._length(stage.fit(linear)[0][0] - x) <= _ROUGH:
                self._x = x
                return linear
        return None

    def _length(self, change: Array) -> float:
        """Length of a change of parameters, (p,), in steps of 1 mm and 1 mrad."""
        return float(np.linalg.norm(change / self._step_size))


def mark_sole_postures(problem: Problem, prior: PriorTerms) -> Problem:
    """Return the problem with the rows of sole postures marked, unless they are already.

    Args:
        problem: The problem at the registered start.
        prior: Priors of its parameters.
    """
    rows = problem.rows
    if rows.sole is not None:
        return problem
    linear = problem.linear(prior.centre)
    every = np.ones((1, len(rows)), dtype=bool)
    stage = Stage.initial(prior, every, len(problem.smallest_noise))
    return replace(problem, rows=replace(rows, sole=sole_postures(linear, rows, stage)))


def estimate_with_priors(problem: Problem, task: Task, prior: PriorTerms) -> Estimate:
    """Estimate the parameters, weights, noise and prior standard deviations, without bounds.

    Args:
        problem: The problem, rows of sole postures marked.
        task: Its solver, and the treatment of repeats and outliers.
        prior: Priors; parameters that are held at a bound have a narrow one.
    """
    rows = problem.rows
    weighting = Weighting.of(task.cell.repeats, task.robust, rows)
    solver = StageSolver(problem, task, prior.centre)
    kept = rows.checked[None]
    first = Stage.initial(prior, kept, len(problem.smallest_noise), weighting.start)
    stage, _ = run_stages(first, solver.linear_at, rows.poses, weighting)
    solution = solver.solve(stage, _FINE)
    by_other_rows = estimate_at_stage(problem, stage, solution)
    return _updated_by_sole_postures(by_other_rows, problem, stage)


def _updated_by_sole_postures(estimate: Estimate, problem: Problem, stage: Stage) -> Estimate:
    """The estimate by all other rows, updated by those of sole postures; see `calib.estimate.sole_postures`."""
    sole = ~problem.rows.checked
    if not np.any(sole):
        return estimate
    linear = problem.linear(estimate.x)
    projections = open_directions(linear, stage, sole)
    scores_of_sole = open_scores(linear, estimate.x, stage, projections)
    scores = np.where(sole, scores_of_sole, estimate.scores)
    by_scores = Limits.of(len(sole), estimate.freedom).weights(scores)
    x, covariance = update_by_sole_postures(
        (estimate.x, estimate.covariance),
        stage,
        problem.linear,
        np.where(sole, by_scores, 0.0),
        projections,
    )
    x = read_only(x)
    return replace(
        estimate,
        x=x,
        solution=replace(estimate.solution, x=x),
        covariance=read_only(covariance),
        scores=read_only(scores),
        weights=read_only(np.where(sole, by_scores, estimate.weights)),
    )
