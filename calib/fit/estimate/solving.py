"""Solving with given priors and bounds: stages on the linearised problem, and solves of the problem itself, in turn.

Each stage asks for the problem linearised at its solution. The solution is sought where the last one was; a stage that
hardly moves it needs no solve. Bounds are kept by an active set around these estimates: parameters beyond a bound are
held there, and released at most once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calib.basics.arrays import Array
from calib.errors import ArgumentError
from calib.fit.estimate.estimate import Estimate, estimate_at_stage, problem_at_stage
from calib.fit.estimate.linear import LinearProblem
from calib.fit.estimate.prior_terms import PriorTerms
from calib.fit.estimate.problem import Problem
from calib.fit.estimate.stages import Stage, Weighting, run_stages
from calib.fit.estimate.task import Task
from calib.model.observability import steps
from calib.numerics.solvers import SOLVERS, Solution

#: Tolerance of a solve between stages, whose weights and priors change far more, in steps of 1 mm and 1 mrad; of images
#: in standard deviations, if these are larger: a lens's last coefficient may be open to a thousand steps.
_ROUGH = 0.1

#: Tolerance of the last solve, in the same steps.
_FINE = 1e-9

#: A stage's solution that is closer than this is first sought on the linearised problem, in the same steps: 5 mrad
#: squared are a quarter of the rough tolerance, so that the next linearisation confirms nearly all.
_CLOSE = 5.0

#: Message of the solution of a fit that is only compared with others.
_COMPARED = "Solved as far as the comparison of models needs it."

#: Of more rows a part of so many, thirty times those that a model of hundreds of parameters needs, leads to a start
#: from where all of them hardly move.
_MANY = 10_000

#: The first stage of a candidate, with priors as given, may be as far from the solution of a similar fit where it is
#: linearised: the stages that follow are nearer, or linearised anew.
_NEAR = 1.0

#: A parameter at its bound is released if that lowers the sum of squares by more than this.
_WORTH_RELEASING = 1e-6

#: The most estimates, as a multiple of the number of parameters.
_ROUNDS = 3


class StageSolver:
    """Follows the solution of a problem from stage to stage; each solve begins where the last one stopped."""

    def __init__(
        self, problem: Problem, task: Task, start: Array, *, near_solution: bool = False
    ) -> None:
        """Begin at some parameters.

        Args:
            problem: The least-squares problem, whose weights, noise and priors each stage sets.
            task: The fit, of which the solver alone counts; if it is a name, it must be one of `SOLVERS`.
            start: shape (p,), parameters where the first solve begins [m, rad, ...].
            near_solution: Whether they are those of a similar fit: the problem linearised there then comes before any
                solve.
        """
        self._problem = problem
        self._solver = task.solver if callable(task.solver) else SOLVERS[str(task.solver)]
        self._step = steps(problem.kinematics.model.units)
        self._of_images = bool(np.any(problem.rows.has_views))
        self._x: Array = start.copy()
        self._solution: Solution | None = None  # Of all solves so far
        # At the solution of the last stage
        self._linear: LinearProblem | None = problem.linear(start) if near_solution else None
        self._close = np.inf if near_solution else _CLOSE
        self._enough = _NEAR if near_solution else _ROUGH

    def solve(self, stage: Stage, tolerance: float) -> Solution:
        """Solve the problem with the weights, noise and priors of a stage, from where the last solve stopped.

        Args:
            stage: State of one fit (B = 1).
            tolerance: A step shorter than this has converged: the norm over all parameters, each in units of its step.

        Returns:
            The solution, with the history and number of evaluations of all solves so far.

        Raises:
            ArgumentError: A solver that a user wrote returned something else than a `Solution`.
            SolverError: The residual is not finite at the start.
        """
        step_size = self._step
        if self._of_images:
            linear = self._problem.linear(self._x) if self._linear is None else self._linear
            _, covariance, _ = stage.fit(linear)
            step_size = self._step_size(covariance)
        system = problem_at_stage(self._problem, stage).system
        solution = self._solver(system, self._x, step_size, tolerance)
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

    @property
    def x(self) -> Array:
        """Parameters at which the problem was linearised or solved last, shape (p,)."""
        return self._x

    def linear_at_start(self) -> LinearProblem:
        """Return the problem linearised where the first solve would begin, as near its solution."""
        self._linear = self._problem.linear(self._x)
        return self._linear

    def linear_at(self, stage: Stage) -> LinearProblem:
        """Return the problem linearised at the solution of a stage of one fit (B = 1), or where it hardly differs.

        A solve, with the tolerance `_ROUGH`, is saved if the solution has moved by no more than that since the last
        stage, whose linearisation then serves; or by no more than `_CLOSE`, if a second linear fit confirms the new
        solution. Norms are over all parameters, in steps.
        """

        def step_to_solution(linear: LinearProblem, start: Array) -> tuple[Array, float]:
            """The parameters that fit a linearised problem best, (p,), and how far they are from others, in steps."""
            x, covariance, _ = stage.fit(linear)
            step = (x[0] - start) / self._step_size(covariance)
            return x[0], float(np.linalg.norm(step))

        if self._linear is not None:
            x, moved = step_to_solution(self._linear, self._x)
            enough, self._enough = self._enough, _ROUGH
            # The linearisation is off by the square of the step: by 1e-8 m and rad, by 1e-6 from a similar fit.
            if moved <= enough:
                return self._linear
            if moved <= self._close:
                # A step as short as this, or from a similar fit, needs no damping, if the next one confirms it.
                linear = self._problem.linear(x)
                _, further = step_to_solution(linear, x)
                if further <= _ROUGH:
                    self._x = x
                    self._linear = linear
                    return linear
        self.solve(stage, _ROUGH)
        self._linear = self._problem.linear(self._x)
        return self._linear

    def _step_size(self, covariance: Array) -> Array:
        """The steps in which changes of parameters count, (p,), where they have a covariance (1, p, p)."""
        if not self._of_images:
            return self._step
        return np.asarray(np.maximum(self._step, np.sqrt(np.diagonal(covariance[0]))))


def estimate_with_priors(
    problem: Problem,
    task: Task,
    prior: PriorTerms,
    start: Array | None = None,
    near: Estimate | None = None,
    stop_shares: Array | None = None,
) -> Estimate:
    """Estimate the parameters, weights, noise and prior standard deviations, without regard to bounds.

    Args:
        problem: The least-squares problem.
        task: The fit.
        prior: Priors, at whose means the first solve begins; parameters that are held at a bound have a narrow one. Its
            source says whether their standard deviations are estimated or kept.
        start: shape (p,), parameters where the first solve begins instead; None: there.
        near: Estimate of another model of the same rows, with the same weights, with which this one is only compared:
            the solution begins nearby and is as exact as stages need it. The restricted likelihood then differs from
            that of the optimum by the square of this inexactness.
        stop_shares: shape (C, 3), what the targets of a stop have in common, to begin with; None: nothing.

    Returns:
        The estimate, by all rows.

    Raises:
        SolverError: The residual is not finite at the start.
    """
    rows = problem.rows
    weighting = Weighting.of(task.cell.repeats, task.robust, rows)
    begin = prior.mean if start is None else start
    some = rows.evenly(_MANY)
    if np.all(some) or rows.weights is not None or problem.stops is not None:
        solver = StageSolver(problem, task, begin, near_solution=near is not None)
        every_row = np.ones((1, len(rows)), dtype=bool)
        first = Stage.initial(prior, every_row, len(problem.smallest_noise), weighting.start)
        if stop_shares is not None:
            first = replace(first, stop_shares=stop_shares[None])
        stage, _ = run_stages(
            first, solver.linear_at, rows.poses, weighting, only_compared=near is not None
        )
    else:
        # Some of the rows lead to where all of them are near their solution: two or three passes find it.
        part = problem.select(some)
        solver_of_part = StageSolver(part, task, begin)
        first = Stage.initial(prior, np.ones((1, len(part.rows)), dtype=bool), len(part.noise))
        stage, _ = run_stages(first, solver_of_part.linear_at, part.rows.poses, weighting)
        linear = solver_of_part.linear_at(stage)
        x, covariance, _ = stage.fit(linear)
        solver = StageSolver(problem, task, x[0])
        first = stage.of_all_rows(solver.linear_at_start(), covariance, robust=weighting.robust)
        stage, _ = run_stages(first, solver.linear_at, rows.poses, weighting, near=True)
    if near is None:
        return estimate_at_stage(problem, stage, solver.solve(stage, _FINE))
    solution = Solution(solver.x, np.nan, "converged", _COMPARED, 0, ())
    return estimate_at_stage(problem, stage, solution, like=near)


def estimate_within_bounds(
    problem: Problem,
    task: Task,
    prior: PriorTerms,
    start: Array | None = None,
    near: Estimate | None = None,
    stop_shares: Array | None = None,
) -> Estimate:
    """Estimate the parameters within their bounds, by an active set.

    A parameter that comes out beyond a bound is held at this bound, and all others are estimated again. When none is
    beyond, those held parameters are released that the measurements pull inwards, each at most once. It ends when none
    is beyond or released, or after `_ROUNDS` p further estimates.

    Args:
        problem: The least-squares problem.
        task: The fit.
        prior: Priors and bounds of the p parameters, none of them held.
        start: shape (p,), parameters where the first solve begins; None: at the means of the priors.
        near: See `estimate_with_priors`.
        stop_shares: shape (C, 3), what the targets of a stop have in common, to begin with; None: nothing.

    Returns:
        The last estimate, with the indices of the parameters that are held at a bound.

    Raises:
        SolverError: The residual is not finite at the start.
    """
    low, high = prior.limits.T
    again = None if near is None else start
    fixed: dict[int, float] = {}
    released: set[int] = set()
    estimate = estimate_with_priors(problem, task, prior, start, near, stop_shares)
    for _ in range(_ROUNDS * problem.size):
        is_beyond = (estimate.x < low) | (estimate.x > high)
        beyond = np.flatnonzero(is_beyond).tolist()
        to_release: set[int] = set()
        if fixed and not beyond:
            to_release = _pulled_inwards(estimate, prior, fixed) - released
        if not beyond and not to_release:
            break
        for k in beyond:
            fixed[k] = float(np.clip(estimate.x[k], low[k], high[k]))
        for k in to_release:
            del fixed[k]
        released |= to_release
        held = prior.at_bounds(fixed)
        estimate = estimate_with_priors(problem, task, held, again, near, stop_shares)
    return estimate


def _pulled_inwards(estimate: Estimate, prior: PriorTerms, fixed: Mapping[int, float]) -> set[int]:
    """Indices of parameters at a bound, given with their value, whose release would lower the sum of squares.

    Those count that it would move inwards, off the bound. A Gauss-Newton step of one parameter alone lowers the sum of
    squares by slope^2 / curvature.
    """
    residual, jacobian = _without_holds(estimate, prior).system(estimate.x)
    slope = jacobian.T @ residual  # gradient of half the sum of squares
    curvature = np.sum(jacobian**2, axis=0)
    result = set()
    for k, value in fixed.items():
        at_low = value <= prior.limits[k, 0]
        inwards = -slope[k] if at_low else slope[k]
        if inwards > 0.0 and inwards**2 > _WORTH_RELEASING * curvature[k]:
            result.add(k)
    return result


def _without_holds(estimate: Estimate, prior: PriorTerms) -> Problem:
    """The estimate's problem in which parameters that are held at a bound have their usual priors again.

    Families of parameters have the prior standard deviation that was estimated; the one as given if all parameters of a
    family were held, or priors are off.
    """
    estimated_std = {} if prior.source == "off" else estimate.prior_std
    prior_std = []
    for family, given_std in zip(prior.names, prior.start, strict=True):
        prior_std.append(estimated_std.get(family, given_std))
    family_precision = 1.0 / np.array(prior_std) ** 2
    precision = prior.precision + family_precision @ prior.families
    return replace(estimate.problem, prior_precision=precision, prior_mean=prior.mean)
