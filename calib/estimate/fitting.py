"""One fit: register, then the stages of `calib.estimate.stages`, each with a solve from where the last one stopped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from calib.blas import one_blas_thread
from calib.data.cell import Cell, Priors
from calib.errors import MeasurementError, ModelError, choices
from calib.estimate.linear import Linear
from calib.estimate.prior_terms import PriorTerms
from calib.estimate.problem import Problem
from calib.estimate.sole_postures import open_directions, open_scores, sole_postures, updated
from calib.estimate.stages import Stage, staged
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics, Samples
from calib.model.observability import steps
from calib.model.parameters import FRAME, TARGET, ErrorModel, Parameter
from calib.numerics.scores import Limits
from calib.numerics.solvers import SOLVERS, Solution, Solver, paper_levenberg_marquardt
from calib.registration.known_distances import KnownDistance
from calib.registration.registration import register, register_held_out
from calib.registration.rows import Rows
from calib.registration.setup import Setup
from calib.robot.robot import Robot, read_only
from calib.units import Array, Mask

#: The paper's algorithm, which is no least-squares solver: it has neither weights nor priors.
PAPER = "paper"

#: Tolerance of a solve between stages, whose weights and sizes change far more.
_ROUGH = 0.1

#: Tolerance of the last solve.
_FINE = 1e-9

#: A stage's solution that is closer than this is first sought by the linearised problem, in steps of 1 mm and 1 mrad.
_CLOSE = 5.0

#: A change below this is set to zero: weak priors leave such traces on parameters that the target can replace [m, rad].
_NOTHING = 1e-8

#: So is one below this share of its standard deviation: the weak prior of an estimated frame leaves such a trace on the
#: first joint, which nothing distinguishes from the frame, and the joint's origin would be rewritten by 1e-8.
_TRACE = 3e-4

#: A parameter at its bound is released where that lowers the sum of squares by more than this.
_WORTH_RELEASING = 1e-6

#: Covariance of the estimator that minimises fourth powers over that of least squares, for normal noise in 3-D.
_FOURTH_POWERS = 1.4


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """What is fitted, but for the rows."""

    robot: Robot  # The nominal robot
    cell: Cell  # What is known, and how to estimate
    setup: Setup  # Frames and targets as given
    model: str | Sequence[Parameter]  # Name of the set and families, or the robot's own parameters
    distances: tuple[KnownDistance, ...] = ()  # Known distances between set-ups
    solver: str | Solver = "lm"  # A name of `SOLVERS`, `PAPER`, or a solver itself
    robust: bool = True  # Whether outliers lose their weight
    lenient: bool = False  # Whether the cell may name parameters that only other models have


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """The parameters that a fit found, and what it found on the way."""

    x: Array  # (p,), offsets from the registered start [m, rad, ...]
    problem: Problem  # The problem in its last form: weights, scales and prior precision as found
    solution: Solution  # The solver's, all stages one after the other
    covariance: Array  # (p, p), of x
    scores: Array  # (N,), how far each row lies from its prediction by the others
    flag_limit: float  # The score above which a row is named as an outlier
    freedom: float  # Degrees of freedom left for the noise
    noise: tuple[float, ...]  # Found noise of each instrument over the one given
    prior_std: Mapping[str, float]  # Size of the errors of each family; empty without priors
    weights: Array  # (N,), robust weights, repeats not shared out
    log_likelihood: float  # The restricted one, at these sizes
    at_bound: tuple[int, ...] = ()  # Parameters that are at a bound

    @property
    def outliers(self) -> Mask:
        """Which rows lie beyond the limit, shape (N,)."""
        return self.scores > self.flag_limit


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """One fit: the registered start and the estimate from there."""

    task: Task  # What was fitted
    setup: Setup  # Frames and targets at the start
    kinematics: Kinematics  # Of the nominal robot with these
    estimate: Estimate  # The parameters from there, with their weights and sizes

    def placed(self) -> Setup:
        """Frames and targets at the solution."""
        return self.setup.displaced(self.kinematics.model.displacements(self.estimate.x)[0])

    def tip_poses(self, samples: Samples) -> Array:
        """T_base_tip of the calibrated robot, the joints' own errors included, shape (N, 4, 4), [m]."""
        found = self.placed()
        T = self.kinematics.poses(self.estimate.x, samples)
        into_base = np.linalg.inv(found.T_frame_base)[samples.frame]
        return np.asarray(into_base @ T @ np.linalg.inv(found.T_tip_target)[samples.target])

    def with_unseen(self, unseen: Setup, rows: Rows) -> Fitted:
        """The fit with frames and targets that it has not seen registered to other rows."""
        if not unseen.count:
            return self
        T_base_tip = self.tip_poses(rows.samples)
        found, own = register_held_out(T_base_tip, self.placed(), unseen, rows), self.setup
        frames, targets = own.T_frame_base.copy(), own.T_tip_target.copy()
        loose, unknown = list(map(bool, unseen.unknown)), unseen.target_unknown
        frames[loose], targets[unknown] = found.T_frame_base[loose], found.T_tip_target[unknown]
        start = replace(
            own.placed(frames, targets),
            unknown=tuple(a or b for a, b in zip(own.unknown, unseen.unknown, strict=True)),
            target_unknown=own.target_unknown | unknown,
        )
        kinematics = Kinematics(self.task.robot, self.kinematics.model, frames, targets)
        return replace(self, setup=start, kinematics=kinematics)

    def residual(self, rows: Rows) -> Array:
        """Measured minus predicted, shape (N, D), [m] and [rad]."""
        return rows.residual(self.kinematics.poses(self.estimate.x, rows.samples))

    def unseen_scores(self, rows: Rows) -> Array:
        """The scores of rows that the fit did not use, shape (N,); see `calib.numerics.scores`."""
        if not len(rows):
            return np.zeros(0)
        estimate, number = self.estimate, dict[int, int]()
        seen = estimate.problem.rows
        for kind in np.unique(rows.kinds):
            here = rows.instruments[rows.kinds == kind][0].tolist()
            for there in seen.instruments[seen.kinds == kind][:1].tolist():
                number |= dict(zip(here, there, strict=False))
        linear, x = Problem.first(self.kinematics, rows).linear(estimate.x), estimate.x[None]
        # Of a kind that was not fitted, the first instrument's noise.
        every = range(len(linear.smallest))
        noise = np.array([[estimate.noise[number.get(c, 0)] for c in every]])
        scores = linear.scores(x, estimate.covariance[None], np.zeros((1, len(rows))), noise)
        return read_only(scores[0])


@one_blas_thread()
def fit(
    task: Task, rows: Rows, *, started: Setup | None = None, judge: Fitted | None = None
) -> Fitted:
    """Register and estimate; ModelError for an unknown name, MeasurementError for too few rows.

    ``started`` has frames and targets where registration to these rows put them for another fit; None to register. The
    ``judge`` is a fit of another model to these rows, whose start, weights and scores are taken over.
    """
    if judge is not None:
        judged = judge.estimate.problem
        rows, started = replace(rows, weights=judged.weights, sole=judged.rows.sole), judge.setup
    if not callable(task.solver) and task.solver not in (*SOLVERS, PAPER):
        raise ModelError(
            f"There is no solver '{task.solver}'. Choose one of {choices((*SOLVERS, PAPER))}."
        )
    model, setup = model_of(task), task.setup
    if task.cell.priors.source == "off" and rows.count < len(model):
        raise MeasurementError(
            f"{rows.count} numbers for {len(model)} parameters, and priors are off. Measure more poses, or choose a "
            "smaller --model."
        )
    if not len(model):
        raise ModelError(f"The model '{model.name}' leaves nothing to estimate.")
    if started is None:
        # The paper's algorithm starts at the given targets, if all are given.
        at_given = task.solver == PAPER and bool(np.all(setup.target_given))
        sought = setup.with_fixed(
            np.zeros(len(setup.groups), bool), np.full(len(setup.targets), at_given)
        )
        found = register(task.robot.poses(rows.joints), sought, rows)
        started = replace(found, target_unknown=setup.target_unknown)
    model = started.aligned(model)
    kinematics = Kinematics(task.robot, model, started.T_frame_base, started.T_tip_target)
    problem = Problem.first(kinematics, rows, task.distances).with_size_held()
    if task.solver == PAPER:
        estimated = _by_the_paper(problem, task, started)
    else:
        prior = PriorTerms.of(task.cell, model, task.setup, started, lenient=task.lenient)
        estimated = _estimate(_with_sole_postures_marked(problem, prior), task, prior)
    if judge is not None:
        names = ("weights", "scores", "flag_limit")
        estimated = replace(estimated, **{name: getattr(judge.estimate, name) for name in names})
    return Fitted(task, started, kinematics, estimated)


def _with_sole_postures_marked(problem: Problem, prior: PriorTerms) -> Problem:
    """The problem with the rows of sole postures marked, unless they are already."""
    rows = problem.rows
    if rows.sole is not None:
        return problem
    linear = problem.linear(prior.centre)
    first = Stage.first(prior, np.ones((1, len(rows)), dtype=bool), len(problem.smallest))
    return replace(problem, rows=replace(rows, sole=sole_postures(linear, rows, first)))


def model_of(task: Task) -> ErrorModel:
    """The error model of a task, frozen and tied parameters out; `ModelError` where they cannot be."""
    setup = task.setup
    model = error_model(
        task.robot,
        task.model,
        frame=setup.frame_unknowns,
        target=setup.unknown_targets,
        targets=setup.target_names,
        rotation=setup.rotation,
        gravity=task.cell.gravity,
    )
    frozen, ties = task.cell.frozen, task.cell.ties
    held = {*frozen, *ties, *(other for other, _ in ties.values())}
    placed = [p.name for p in model.parameters if p.family in (FRAME, TARGET) and p.name in held]
    if placed:
        raise ModelError(f"{choices(placed)} cannot be frozen or tied: a frame or target is whole.")
    if task.lenient:
        frozen = tuple(name for name in frozen if name in model.names and name not in ties)
        ties = {n: t for n, t in ties.items() if n in model.names and t[0] in model.names}
    return model.tied(ties).without(frozen)


def _estimate(problem: Problem, task: Task, prior: PriorTerms) -> Estimate:
    """The estimate within bounds, by an active set: a parameter that is pulled inwards is released, once."""
    low, high = prior.limits.T
    fixed: dict[int, float] = {}
    released: set[int] = set()
    result = _within(problem, task, prior)
    for _ in range(3 * problem.size):
        beyond = np.flatnonzero((result.x < low) | (result.x > high)).tolist()
        held = bool(fixed) and not beyond
        loose = _pulled_inwards(result, prior, fixed) - released if held else set()
        if not beyond and not loose:
            break
        fixed |= {k: float(np.clip(result.x[k], low[k], high[k])) for k in beyond}
        released |= loose
        fixed = {k: value for k, value in fixed.items() if k not in loose}
        result = _within(problem, task, prior.at_bounds(fixed))
    return result


def _within(problem: Problem, task: Task, prior: PriorTerms) -> Estimate:
    """The estimate with some parameters held at a bound; each solve begins where the last one stopped."""
    solver = task.solver if callable(task.solver) else SOLVERS[str(task.solver)]
    size = steps(problem.kinematics.model.units)
    x, solution, last = prior.centre.copy(), None, None

    def solve(stage: Stage, tolerance: float) -> Solution:
        nonlocal x, solution
        found = solver(_problem_of(problem, stage).system, x, size, tolerance)
        if solution is not None:
            evaluations = solution.evaluations + found.evaluations
            history = solution.history + found.history
            found = replace(found, evaluations=evaluations, history=history)
        solution = found
        x = solution.x
        return solution

    def linear_at(stage: Stage) -> Linear:
        """The problem linearised at the solution with a stage's weights and sizes, or where it hardly differs."""
        nonlocal x, last
        if last is not None:
            found = stage.fit(last)[0][0]
            moves = np.linalg.norm((found - x) / size)
            if moves <= _ROUGH:  # what it leaves out is of the order of 1e-8 m and rad
                return last
            if moves <= _CLOSE:
                # A step as short as this needs no damping, if the next one confirms it.
                moved = problem.linear(found)
                if np.linalg.norm((stage.fit(moved)[0][0] - found) / size) <= _ROUGH:
                    x, last = found, moved
                    return moved
        solve(stage, _ROUGH)
        last = problem.linear(x)
        return last

    kept = problem.rows.checked[None]
    first = Stage.first(prior, kept, len(problem.smallest), given_weights(problem.rows))
    stage, _ = staged(first, linear_at, problem.rows.poses, **weighting(task, problem.rows))
    return _updated_by_sole_postures(_finish(problem, stage, solve(stage, _FINE)), problem, stage)


def _updated_by_sole_postures(estimate: Estimate, problem: Problem, stage: Stage) -> Estimate:
    """The estimate by all other rows, updated by those of sole postures."""
    sole = ~problem.rows.checked
    if not np.any(sole):
        return estimate
    linear = problem.linear(estimate.x)
    projections = open_directions(linear, stage, sole)
    of_sole = open_scores(linear, estimate.x, stage, projections)
    scores = np.where(sole, of_sole, estimate.scores)
    allowed = Limits.of(len(sole), estimate.freedom).weights(scores)
    weights = np.where(sole, allowed, estimate.weights)
    x, covariance = updated(
        (estimate.x, estimate.covariance),
        stage,
        problem.linear,
        np.where(sole, allowed, 0.0),
        projections,
    )
    x = read_only(x)
    return replace(
        estimate,
        x=x,
        solution=replace(estimate.solution, x=x),
        covariance=read_only(covariance),
        scores=read_only(scores),
        weights=read_only(weights),
    )


def given_weights(rows: Rows) -> Array | float:
    """The weights to begin with, shape (N,), or 1 for all."""
    return 1.0 if rows.weights is None else rows.weights


def weighting(task: Task, rows: Rows) -> dict[str, Any]:
    """How `staged` finds weights. Given ones are kept, and repeats are already shared out in them."""
    found = rows.weights is None
    return {
        "repeats": task.cell.repeats if found else "independent",
        "robust": task.robust and found,
    }


def _problem_of(problem: Problem, stage: Stage) -> Problem:
    """The problem with a stage's weights, noise and priors."""
    scales = np.append(stage.noise[0], 1.0)[problem.rows.instruments] * problem.rows.scales
    priors = stage.priors
    return replace(
        problem,
        weights=stage.effective[0],
        scales=scales,
        precision=priors.precision[0],
        centre=priors.centre,
        rho=stage.rho[0],
    )


def _pulled_inwards(result: Estimate, prior: PriorTerms, fixed: Mapping[int, float]) -> set[int]:
    """Parameters at a bound that measurements and priors pull to its inside."""
    known = {} if prior.source == "off" else result.prior_std
    prior_std = np.array(
        [known.get(f, size) for f, size in zip(prior.names, prior.start, strict=True)]
    )
    precision = prior.precision + (1.0 / prior_std**2) @ prior.families
    free = replace(result.problem, precision=precision, centre=prior.centre)
    residual, jacobian = free.system(result.x)
    slope, bend = jacobian.T @ residual, np.sum(jacobian**2, axis=0)
    inwards = {k: -slope[k] if v <= prior.limits[k, 0] else slope[k] for k, v in fixed.items()}
    return {k for k, pull in inwards.items() if pull > 0.0 and pull**2 > _WORTH_RELEASING * bend[k]}


def _by_the_paper(problem: Problem, task: Task, started: Setup) -> Estimate:
    """The estimate of the paper's solver, in mm and rad at absolute parameters, without priors and weights.

    It minimises the sum of |r_i|^4; then the expected sum of squared residuals is sigma^2 (3 N - 3/5 rank).
    """
    model = problem.kinematics.model
    if any(kind.name != "point" for kind in problem.rows.present) or len(started.targets) > 1:
        raise ModelError("The solver 'paper' takes positions of one target. Choose --solver lm.")
    unit = np.array([1e3 if p.unit == "m" else 1.0 for p in model.parameters])
    target = started.T_tip_target[0, :3, 3]
    at_target = dict(zip(("target_x", "target_y", "target_z"), target, strict=True))
    nominal = np.array([at_target.get(p.name, p.nominal) for p in model.parameters])
    found = paper_levenberg_marquardt(partial(problem.paper_system, nominal, unit), nominal * unit)
    solution = replace(found, x=found.x / unit - nominal)
    linear = problem.linear(solution.x)
    cell = replace(task.cell, priors=Priors("off"), bounds={}, parameter_priors={})
    prior = PriorTerms.of(cell, model, task.setup, started, lenient=True)
    every = np.ones((1, len(problem.rows)), dtype=bool)
    stage = Stage.first(prior, every, len(problem.smallest))
    data = linear.data(stage.effective, stage.rho)
    rank = np.linalg.matrix_rank(data.H[0, 0], hermitian=True)
    left = max(float(data.count[0, 0]) - (2.0 - _FOURTH_POWERS) * rank, 1.0)
    noise = np.sqrt(np.sum(np.square(linear.residual(solution.x))) / left)
    stage = replace(stage, noise=np.array([[max(noise, linear.smallest[0])]]))
    return _finish(problem, stage, solution, spread=_FOURTH_POWERS)


def _finish(problem: Problem, stage: Stage, solution: Solution, spread: float = 1.0) -> Estimate:
    """The estimate at the last stage; ``spread`` is the covariance of the estimator over that of least squares."""
    linear, model = problem.linear(solution.x), problem.kinematics.model
    effective, prior, priors = stage.effective, stage.prior, stage.priors
    _, of_least_squares, freedom = stage.judged(linear)
    data = linear.data(effective, stage.rho)
    _, covariance = data.posterior(np.sqrt(spread) * stage.noise, priors)
    if problem.gauge is not None:  # the arm's size is as uncertain as by its prior
        growth = problem.gauge.growth
        covariance = covariance + problem.gauge.variance(priors.precision[0]) * np.outer(
            growth, growth
        )
    # Without priors there is nothing to keep a6 small beside the target, and so no trace to remove.
    held = prior.source != "off"
    cleaned = ~model.family(FRAME, TARGET) & np.isin(model.units, ("m", "rad")) & held
    least = np.maximum(_NOTHING, _TRACE * np.sqrt(np.diagonal(covariance[0])))
    traces = cleaned & (np.abs(solution.x) < least)
    x = np.where(traces, 0.0, solution.x)
    if np.any(traces):  # frames and targets make up for them
        A, placed = linear.A[linear.used], model.family(FRAME, TARGET)
        x[placed] += np.linalg.lstsq(A[:, placed], A[:, traces] @ solution.x[traces], rcond=1e-9)[0]
    x[list(prior.fixed)] = prior.centre[list(prior.fixed)]
    scores = linear.scores(solution.x[None], of_least_squares, effective, stage.noise)
    own = np.where(prior.flat, 0.0, priors.precision)
    likelihood = data.log_likelihood(stage.noise, priors, own)
    return Estimate(
        x=read_only(x),
        problem=_problem_of(problem, stage),
        solution=replace(solution, x=read_only(x)),
        covariance=read_only(covariance[0]),
        scores=read_only(scores[0]),
        flag_limit=float(Limits.of(len(problem.rows), freedom[0]).flagged),
        freedom=float(freedom[0]),
        noise=tuple(stage.noise[0].tolist()),
        prior_std=dict(zip(prior.names, stage.prior_std[0].tolist(), strict=True)) if held else {},
        weights=read_only(stage.weights[0]),
        log_likelihood=float(likelihood[0]),
        at_bound=prior.fixed,
    )
