"""Estimation: parameters, noise, prior sizes and robust weights, found together.

Registration has put target and frame in place. From there: least squares with wide priors; robust weights whose scale
is a median, until they settle; then sizes of noise and priors from the data (`calib.estimate.variance`) with weights
that name the outliers, each followed by a new solve from where the last one stopped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from calib.data.cell import Priors
from calib.estimate.problem import Linear, Problem
from calib.estimate.robust import Limits, repeats
from calib.estimate.rows import Rows
from calib.estimate.solvers import Solution, Solver
from calib.estimate.stage import FEWEST_FREEDOM, Holds, Stage
from calib.estimate.variance import Linearised
from calib.model.observability import steps
from calib.model.parameters import FRAME, TARGET
from calib.robot.robot import read_only

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Tolerance between stages, whose weights and sizes change far more, and of the last solve.
_ROUGH, _FINE = 0.1, 1e-9

#: Between stages a problem that was linearised within this of the solution stays, in steps of 1 mm and 1 mrad: what it
#: leaves out is of the order of 1e-8 m and rad.
_NEAR = _ROUGH

#: A stage's solution within this is looked for by the linearised problem first, in the same steps.
_CLOSE = 5.0

#: A change below this is none: the holds leave traces of that size on what takes part with the target [m, rad].
_NOTHING = 1e-8

#: Covariance of the minimum of summed fourth powers over that of summed squares, for normal noise in 3-D.
_FOURTH_POWERS = 1.4

#: A parameter at its bound is let go where that lowers the squares by more than this.
_TELLING = 1e-6

#: Limit of the rounds in which weights, and then sizes, settle.
ROUNDS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """The result of `estimate`."""

    x: Array  # shape (p,), offsets from the registered start [m, rad, ...]
    problem: Problem  # The problem in its last form: weights, scales and prior precision as found
    solution: Solution  # The solver's, all stages one after the other
    covariance: Array  # shape (p, p), of x
    scores: Array  # shape (N,), how far each row lies from what the others predict
    flag_limit: float  # The score above which a row is named as an outlier
    freedom: float  # Degrees of freedom left for the noise
    noise: tuple[float, ...]  # Found noise of each instrument over the one given
    sizes: Mapping[str, float]  # Size of the errors of each family; empty without priors
    weights: Array  # shape (N,), robust weights, repeats not shared out
    log_likelihood: float  # The restricted one, at these sizes
    at_bound: tuple[int, ...] = ()  # Parameters that stand at a bound

    @property
    def outliers(self) -> NDArray[np.bool_]:
        """Which rows lie beyond the limit, shape (N,)."""
        return self.scores > self.flag_limit


def estimate(
    problem: Problem,
    solver: Solver,
    holds: Holds,
    *,
    repeats: str = "weighted",
    robust: bool = True,
    weights: Array | None = None,
) -> Estimate:
    """Estimate the parameters of a problem that has been registered.

    problem is `Problem.first`, solver one of `calib.estimate.solvers`. repeats says what repeats of a pose count for:
    ``"weighted"``, ``"average"`` or ``"independent"``; robust, whether rows may lose their weight, outliers are named
    either way; weights, shape (N,), are those of an estimation before that stay, repeats shared out.
    """
    if weights is not None:
        repeats, robust = "independent", False  # shared out before

    def found(fixed: Mapping[int, float]) -> Estimate:
        held = holds.at_bounds(fixed)
        path = _Path(problem, solver, held.centre.copy())
        every = np.ones((1, len(problem.rows)), dtype=bool)
        first = Stage.first(held, every, len(problem.smallest), weights)
        stage, _ = staged(first, path.linear, problem.rows.poses, repeats, robust=robust)
        path.solve(stage, _FINE)
        assert path.solution is not None
        return _finish(problem, stage, path.solution)

    fixed: dict[int, float] = {}
    released: set[int] = set()
    result = found(fixed)
    if holds.limits is None:
        return result
    # Active set: what would leave its bounds stays there and the others are estimated again; what then is no longer
    # pushed against its bound is let go, once.
    low, high = holds.limits.T
    for _ in range(3 * problem.size):
        beyond = np.flatnonzero((result.x < low) | (result.x > high))
        loose = [] if len(beyond) else _pushed_inside(result, holds, fixed)
        loose = [k for k in loose if k not in released]
        if not len(beyond) and not loose:
            break
        fixed |= {int(k): float(np.clip(result.x[k], low[k], high[k])) for k in beyond}
        released |= set(loose)
        fixed = {k: value for k, value in fixed.items() if k not in loose}
        result = found(fixed)
    return result


def _pushed_inside(result: Estimate, holds: Holds, fixed: Mapping[int, float]) -> list[int]:
    """Parameters at a bound that measurements and priors would have inside of it."""
    assert holds.limits is not None
    known = {} if holds.off else result.sizes
    sizes = np.array([known.get(f, size) for f, size in zip(holds.names, holds.start, strict=True)])
    last = result.problem
    precision = holds.precision + (1.0 / sizes**2) @ holds.families
    free = last.reweighted(last.weights, last.scales, precision, holds.centre)
    residual, jacobian = free.system(result.x)
    slope, bend = jacobian.T @ residual, np.sum(jacobian**2, axis=0)
    loose = []
    for k, value in fixed.items():
        inwards = -slope[k] if value <= holds.limits[k, 0] else slope[k]
        if inwards > 0.0 and inwards**2 > _TELLING * bend[k]:
            loose.append(k)
    return loose


class _Path:
    """Where an estimation has come to: each solve begins where the last one stopped."""

    __slots__ = ("last", "problem", "size", "solution", "solver", "x")

    def __init__(self, problem: Problem, solver: Solver, x: Array) -> None:
        """At the start."""
        self.problem, self.solver, self.x = problem, solver, x
        self.size = steps(problem.kinematics.model.units)
        self.solution: Solution | None = None
        self.last: Linear | None = None

    def solve(self, stage: Stage, tolerance: float) -> None:
        """Go on to the solution with a stage's weights and sizes."""
        found = self.solver(stage.problem(self.problem).system, self.x, self.size, tolerance)
        self.solution = found if self.solution is None else found.after(self.solution)
        self.x = self.solution.x

    def linear(self, stage: Stage) -> Linear:
        """The problem linearised at the solution with a stage's weights and sizes, or where it hardly differs."""
        if self.last is not None:
            x, moves = self._solution_of(self.last, stage)
            if moves <= _NEAR:
                return self.last
            if moves <= _CLOSE:
                # A step as short as this needs no damping, if the next one confirms it.
                start, self.x = self.x, x
                moved = self.problem.linear(x)
                if self._solution_of(moved, stage)[1] <= _NEAR:
                    self.last = moved
                    return moved
                self.x = start
        self.solve(stage, _ROUGH)
        self.last = self.problem.linear(self.x)
        return self.last

    def _solution_of(self, linear: Linear, stage: Stage) -> tuple[Array, float]:
        """A stage's solution of the linearised problem, and how far it lies from x in steps of 1 mm and 1 mrad."""
        x = stage.fit(linear)[0][0]
        return x, float(np.linalg.norm((x - self.x) / self.size))


def staged(
    stage: Stage,
    linear_at: Callable[[Stage], Linear],
    poses: NDArray[np.int_],
    repeats: str,
    *,
    robust: bool,
) -> tuple[Stage, Array]:
    """Weights, noise and sizes from the first stage on, until they settle, for each fit of the stage.

    Returns:
        The last stage, and the degrees of freedom of the first fit, shape (B,): where they are few no row loses its
        weight.
    """
    linear = linear_at(stage)
    stage = stage.sharing(linear, poses, repeats)
    freedom = stage.fit(linear)[2]
    robust = robust and bool(np.any(freedom > FEWEST_FREEDOM))

    def settled(
        stage: Stage, step: Callable[[Stage], Stage], alike: Callable[[Stage, Stage], Mask]
    ) -> Stage:
        """After this step has been taken until each fit changes no more."""
        nonlocal linear
        going = np.arange(len(stage.kept))
        for _ in range(ROUNDS):
            before = stage.at(going)
            after = step(before).sharing(linear, poses, repeats)
            linear = linear_at(after)
            stage = stage.put(going, after)
            going = going[~alike(after, before)]
            if not len(going):
                break
        return stage

    if robust:
        stage = settled(stage, lambda s: s.by_median(linear), Stage.weighs_like)
    likely = partial(Stage.by_likelihood, robust=robust)
    return settled(stage, lambda s: likely(s, linear), Stage.is_like), freedom


def plain_estimate(problem: Problem, solution: Solution) -> Estimate:
    """The estimate of the paper's solver, which knows no priors and no weights: noise from what is left over.

    It minimises the sum of |r_i|^4. For normal noise in three coordinates that spreads the parameters by 7/5 of least
    squares' covariance: the second derivative is 10 sigma^2 J^T J in the mean and the gradient's covariance
    140 sigma^6 J^T J; so the squares left over are sigma^2 (3 N - 3/5 rank) in the mean.
    """
    linear = problem.linear(solution.x)
    holds = Holds.of(problem.kinematics.model, Priors("off"))
    first = Stage.first(holds, np.ones((1, len(problem.rows)), dtype=bool), len(problem.smallest))
    data = linear.data(first.effective)
    rank = np.linalg.matrix_rank(data.H[0, 0], hermitian=True)
    # Both figures for normal noise: see the docstring.
    left = max(float(data.count[0, 0]) - (2.0 - _FOURTH_POWERS) * rank, 1.0)
    noise = np.sqrt(np.sum(np.square(linear.residual(solution.x))) / left)
    stage = replace(first, noise=np.array([[max(noise, linear.smallest[0])]]))
    return _finish(problem, stage, solution, spread=_FOURTH_POWERS)


def _finish(problem: Problem, stage: Stage, solution: Solution, spread: float = 1.0) -> Estimate:
    """The estimate at the last stage, with covariance and scores at the solution itself.

    ``spread`` is the covariance that the solver's estimator has, over that of least squares.
    """
    linear = problem.linear(solution.x)
    effective, holds, known = stage.effective, stage.holds, stage.known(linear)
    _, of_least_squares, freedom = stage.fit(linear)
    # The estimate itself stays: weights that targets share would be less sharp where they lie to each other.
    told = _shared_by_stops(problem.rows, linear, stage, float(freedom[0]))
    _, covariance = told.posterior(np.sqrt(spread) * stage.noise, known)
    own = np.where(holds.flat, 0.0, stage.precision)
    model = problem.kinematics.model
    # Without priors there is nothing to keep a6 small beside the target, and so no trace to remove.
    cleaned = (
        ~model.family(FRAME, TARGET)
        & (not holds.off)
        & np.array([u in ("m", "rad") for u in model.units])
    )
    x = np.where(cleaned & (np.abs(solution.x) < _NOTHING), 0.0, solution.x)
    x[list(holds.fixed)] = holds.centre[list(holds.fixed)]
    scores = linear.scores(solution.x[None], of_least_squares, effective, stage.noise)
    likelihood = linear.data(effective).log_likelihood(stage.noise, known, own)
    return Estimate(
        x=read_only(x),
        problem=stage.problem(problem),
        solution=replace(solution, x=read_only(x)),
        covariance=read_only(covariance[0]),
        scores=read_only(scores[0]),
        flag_limit=float(Limits.of(len(problem.rows), freedom[0]).flagged),
        freedom=float(freedom[0]),
        noise=tuple(stage.noise[0].tolist()),
        sizes={} if holds.off else dict(zip(holds.names, stage.sizes[0].tolist(), strict=True)),
        weights=read_only(stage.weights[0]),
        log_likelihood=float(likelihood[0]),
        at_bound=holds.fixed,
    )


def _shared_by_stops(rows: Rows, linear: Linear, stage: Stage, freedom: float) -> Linearised:
    """The normal equations with the derivative as several targets of one stop let it be known.

    They share where the robot stopped beside where it should: with the correlation rho the mean of n rows has the
    variance s^2 (1 + (n - 1) rho) / n, and so much less is known of what moves all of them alike. What they say of
    each other counts as ever, though it is known better.
    """
    effective = stage.effective[0]
    if rows.samples.target.min() == rows.samples.target.max():
        return linear.data(stage.effective)
    weights = stage.weights[0] * rows.where(lambda kind: kind.position)
    alive = weights > 0.0
    if len(np.unique(rows.samples.target[alive])) < 2:
        return linear.data(stage.effective)
    labels = np.column_stack([rows.blocks, rows.samples.frame])
    stops = np.unique(labels, axis=0, return_inverse=True)[1].reshape(-1)
    counts = np.bincount(stops, alive)
    if np.max(counts) < 2:
        return linear.data(stage.effective)
    paid = float(np.sum(effective @ linear.used)) - freedom
    found = repeats(
        linear.residual(linear.x)[:, :3] / linear.noise_of(stage.noise)[0, :, :3],
        linear.used[:, :3],
        stops,
        weights,
        fitted=max(paid, 0.0),
    )
    # Repeats have been shared out already.
    w = np.where(alive, effective, 0.0)
    sums = np.maximum(np.bincount(stops, w), np.finfo(np.float64).tiny)
    already = sums / np.maximum(np.bincount(stops, weights), np.finfo(np.float64).tiny)
    wider = np.maximum((1.0 + np.maximum(counts - 1.0, 0.0) * found.rho) * already, 1.0)
    less = np.where(alive, 1.0 - 1.0 / np.sqrt(wider[stops]), 0.0)
    share, columns = w / sums[stops], linear.columns.copy()
    for column in columns[:-1, :3].reshape(-1, len(rows)):
        column -= less * np.bincount(stops, share * column)[stops]
    return replace(linear, columns=columns).data(stage.effective)
