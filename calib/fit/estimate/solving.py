"""Solving with given priors: stages on the linearised problem, and solves of the problem itself, in turn.

Each stage asks for the problem linearised at its solution. The solution is sought where the last one was; a stage that
hardly moves it needs no solve.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.errors import ArgumentError
from calib.fit.estimate.estimate import Estimate, estimate_at_stage, problem_at_stage
from calib.fit.estimate.linear import LinearProblem
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.sole_postures import (
    open_directions,
    open_scores,
    sole_postures,
    update_by_sole_postures,
)
from calib.fit.estimate.stages import Stage, Weighting, run_stages
from calib.fit.estimate.task import Task
from calib.model.observability import steps
from calib.numerics.scores import Limits
from calib.numerics.solvers import SOLVERS, Solution

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
            problem: The least-squares problem of N rows and p parameters, whose weights, noise and priors each stage
                sets.
            task: Options of the fit; of them ``task.solver`` is used: a solver itself, or its name in `SOLVERS`.
            start: shape (p,), parameters where the first solve begins: offsets from the nominal robot and the
                registered frames and targets [m, rad, ...].
        """
        self._problem = problem
        self._solver = task.solver if callable(task.solver) else SOLVERS[str(task.solver)]
        self._step_size = steps(problem.kinematics.model.units)
        self._x: Array = start.copy()
        self._solution: Solution | None = None  # Of all solves so far
        self._linear: LinearProblem | None = None  # At the solution of the last stage

    def solve(self, stage: Stage, tolerance: float) -> Solution:
        """Solve the problem with the weights, noise and priors of a stage, from where the last solve stopped.

        Begins at `_x`, shape (p,), the offsets where the last solve stopped, and moves it to the solution; `_solution`
        is what all solves so far came to, None before the first.

        Args:
            stage: Row weights, noise and prior standard deviations of one fit (B = 1).
            tolerance: A step shorter than this has converged: the norm over all parameters, each in units of its step.

        Returns:
            The solution x, shape (p,), [m, rad, ...], with the history and number of evaluations of all solves so far.

        Raises:
            ArgumentError: A solver returned something else.
            SolverError: The residual is not finite at the start.
        """
        system = problem_at_stage(self._problem, stage).system
        solution = self._solver(system, self._x, self._step_size, tolerance)
        if not isinstance(solution, Solution):  # of a solver that a user wrote
            raise ArgumentError(
                f"The solver returned a value of the type {type(solution).__name__}; it must be a Solution "
                "(calib.numerics.solvers)."
            )
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
        """Return the problem linearised at the solution of a stage, or where it hardly differs.

        A solve, with the tolerance 0.1 (`_ROUGH`) in steps of 1 mm and 1 mrad, is saved where the last linearisation,
        or one at a solution close to it, serves.

        Args:
            stage: Row weights, noise and prior standard deviations of one fit (B = 1).

        Returns:
            The linearised problem: residual and Jacobian of N rows of D scalars by p parameters, in units of each
            scalar's given sigma, at its ``x``, shape (p,).
        """
        near = self._near_last(stage)
        if near is None:
            self.solve(stage, _ROUGH)
            near = self._problem.linear(self._x)
        self._linear = near
        return near

    def _near_last(self, stage: Stage) -> LinearProblem | None:
        """The linearised problem that gives a stage's solution without a solve; None where a solve is needed.

        It is that of the last stage where the solution has moved by no more than 0.1 (`_ROUGH`), or one at the new
        solution where that moved by no more than 5 (`_CLOSE`) and a second linear fit moves it by no more than 0.1:
        norms over all parameters, in steps of 1 mm and 1 mrad.

        Uses the problem linearised for the last stage (``_linear``, None before the first one), and the parameters
        where the last solve stopped (``_x``, shape (p,)), which it moves to a solution that is confirmed.

        Args:
            stage: Row weights, noise and prior standard deviations of one fit (B = 1).

        Returns:
            N rows of D scalars by p parameters, in units of each scalar's given sigma; or None.
        """
        if self._linear is None:
            return None
        x = _solution_of(stage, self._linear)
        moved = self._length(x - self._x)
        if moved <= _ROUGH:  # the difference is of the order of 1e-8 m and rad
            return self._linear
        if moved <= _CLOSE:
            # A step as short as this needs no damping, if the next one confirms it.
            linear = self._problem.linear(x)
            confirmed = _solution_of(stage, linear)
            if self._length(confirmed - x) <= _ROUGH:
                self._x = x
                return linear
        return None

    def _length(self, change: Array) -> float:
        """Length of a change of parameters, in steps of 1 mm and 1 mrad (``_step_size``, shape (p,)).

        Args:
            change: shape (p,), in the parameters' units [m, rad, ...].

        Returns:
            The Euclidean norm over all parameters, without unit.
        """
        return float(np.linalg.norm(change / self._step_size))


def _solution_of(stage: Stage, linear: LinearProblem) -> Array:
    """The parameters that fit a linearised problem best, with given weights, noise and priors.

    Args:
        stage: Row weights, noise and prior standard deviations of one fit (B = 1).
        linear: The problem linearised: N rows of D scalars by p parameters, in units of each scalar's given sigma.

    Returns:
        shape (p,), the parameters themselves, not their change from where the problem is linearised [m, rad, ...].
    """
    x, _, _ = stage.fit(linear)
    of_fit: Array = x[0]
    return of_fit


def mark_sole_postures(problem: Problem, prior: PriorTerms) -> Problem:
    """Return the problem with the rows of sole postures marked, unless they are already.

    Such poses alone determine a direction of the parameters, so that no other row can check them.

    Args:
        problem: The least-squares problem at the registered start: N rows of measurements, p parameters.
            ``problem.rows.sole`` is None where they are not marked yet.
        prior: Priors of its parameters: standard deviations as given, and their means (``prior.centre``, shape (p,)
            [m, rad, ...]), where the problem is linearised.

    Returns:
        The problem whose ``rows.sole`` is the mask of these rows, shape (N,).
    """
    rows = problem.rows
    if rows.sole is not None:
        return problem
    linear = problem.linear(prior.centre)
    every_row = np.ones((1, len(rows)), dtype=bool)
    first = Stage.initial(prior, every_row, len(problem.smallest_noise))
    marked = replace(rows, sole=sole_postures(linear, rows, first))
    return replace(problem, rows=marked)


def estimate_with_priors(problem: Problem, task: Task, prior: PriorTerms) -> Estimate:
    """Estimate the parameters, weights, noise and prior standard deviations, without bounds.

    Args:
        problem: The least-squares problem of N rows and p parameters. Its rows of sole postures (poses that alone
            determine a direction of the parameters, which no other row can check) are marked; they have no part in
            noise and prior standard deviations.
        task: Robot, cell and options of the fit; used are the solver, and the treatment of repeats (``cell.repeats``)
            and outliers (``robust``).
        prior: Priors of the p parameters, with the means (``prior.centre``, shape (p,) [m, rad, ...]) where the first
            solve begins; those that are held at a bound have a narrow one.

    Returns:
        The parameters, offsets from the nominal robot and the registered frames and targets, by all rows; with
        covariance, scores, weights, noise and prior standard deviations.

    Raises:
        SolverError: The residual is not finite at the start.
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
    """Update an estimate by the rows of sole postures, which had no part in it; see `calib.fit.estimate.sole_postures`.

    Such a row is weighted by its score: how far it lies from what wide priors predict, along the directions in which
    the other rows do not predict it.

    Args:
        estimate: The estimate by all other rows: used are ``x``, shape (p,), ``covariance``, shape (p, p), ``scores``
            and ``weights``, shape (N,), and the degrees of freedom of the noise, ``freedom``.
        problem: The least-squares problem of N rows and p parameters; ``problem.rows.checked``, shape (N,), is False
            for rows of sole postures.
        stage: Row weights, noise and prior standard deviations of the estimate's fit (B = 1).

    Returns:
        The estimate with parameters and covariance by all rows, and the scores and weights of the rows of sole postures
        set (weights from 0 to 1); itself where there are none. Noise and prior standard deviations stay.
    """
    sole = ~problem.rows.checked
    if not np.any(sole):
        return estimate
    linear = problem.linear(estimate.x)
    projections = open_directions(linear, stage, sole)
    scores_of_sole = open_scores(linear, estimate.x, stage, projections)
    scores = np.where(sole, scores_of_sole, estimate.scores)
    by_scores = Limits.of(len(sole), estimate.freedom).weights(scores)
    weights_of_sole = np.where(sole, by_scores, 0.0)
    by_others = (estimate.x, estimate.covariance)
    x, covariance = update_by_sole_postures(
        by_others, stage, problem.linear, weights_of_sole, projections
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
