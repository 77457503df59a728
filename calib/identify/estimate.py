"""Estimation: parameters, noise, prior sizes and robust weights, found together.

Registration has put target and frame in place. From there: least squares with wide priors; robust weights whose scale
is a median, until they settle; then sizes of noise and priors from the data (`calib.identify.variance`) with weights
that name the outliers, each followed by a new solve from where the last one stopped.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.identify.problem import Problem
from calib.identify.robust import Limits, cauchy_weights, median_noise, scores
from calib.identify.solvers import Solution
from calib.identify.variance import Linearised, Sizes, precision_of, sizes_by_reml
from calib.measure.cell import Priors
from calib.model.error_model import ANGLE, FRAME, LENGTH, TARGET, ErrorModel
from calib.model.robot import read_only

Array = NDArray[np.float64]

#: A solver for a problem, from a start x, until steps are shorter than a tolerance in steps of 1 mm and 1 mrad.
Solve = Callable[[Problem, Array, float], Solution]

#: Tolerance between stages, whose weights and sizes change far more, and of the last solve.
_ROUGH, _FINE = 1e-2, 1e-9

#: The noise assumed until the data have told theirs [m].
FIRST_SIGMA = 1e-4

#: Below this the noise is no instrument's but rounding [m].
_SMALLEST_SIGMA = 1e-7

#: The noise may be ten times larger or smaller than the one given or assumed, a standard deviation of its logarithm.
_NOISE_SPREAD = float(np.log(10.0))

#: With fewer degrees of freedom no row can be told from the others, and all keep their weight.
_FEWEST_FREEDOM = 6.0

#: Without priors this holds what no measurement determines: far wider than an arm's errors [m and rad].
_LEASH = 1.0

#: Target and frame stay within this of where registration put them, unless the data say otherwise: far more than
#: registration is off by, and a hold where nothing tells them from each other [m and rad].
_PLACED = 1.0

#: A change below this is none: the hold above leaves traces of that size on what takes part with the target [m, rad].
_NOTHING = 1e-8

#: Covariance of the minimum of summed fourth powers over that of summed squares, for normal noise in 3-D.
_FOURTH_POWERS = 1.4

_ROUNDS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """The result of `estimate`.

    Attributes:
        x: shape (p,), offsets from the registered start [m, rad].
        problem: The problem in its last form: weights, sigma and prior precision as found.
        solution: The solver's, all stages one after the other.
        covariance: shape (p, p), of x.
        scores: shape (N,), how far each row lies from what the others predict.
        limits: The scores between which a row loses its weight.
        freedom: Degrees of freedom left for the noise.
        noise_factor: Found noise over the one given; 1 unit is the sigma of `Problem` at the start.
        prior_length: Size of errors in length [m]; None without priors.
        prior_angle: Size of errors in angle [rad]; None without priors.
    """

    x: Array
    problem: Problem
    solution: Solution
    covariance: Array
    scores: Array
    limits: Limits
    freedom: float
    noise_factor: float
    prior_length: float | None
    prior_angle: float | None

    @property
    def outliers(self) -> NDArray[np.bool_]:
        """Which rows lie beyond the limit, shape (N,)."""
        return self.scores > self.limits.flagged


def estimate(problem: Problem, solve: Solve, *, priors: Priors, robust: bool) -> Estimate:
    """Estimate the parameters of a problem that has been registered.

    Args:
        problem: With weights of 1 and the sigma that is known or assumed.
        solve: The solver.
        priors: Whether and how large; ``"data"`` finds the sizes.
        robust: Whether rows may lose their weight; outliers are named either way.
    """
    stage = _Stage.first(problem, priors)
    solution = solve(stage.problem(problem), np.zeros(problem.size), _ROUGH)
    *_, freedom = _Linear.at(problem, solution.x).fit(stage.weights, 1.0, stage.precision(problem))
    robust = robust and freedom > _FEWEST_FREEDOM
    if robust:
        for _ in range(_ROUNDS):
            before, linear = stage, _Linear.at(problem, solution.x)
            stage = stage.by_median(problem, linear)
            solution = solve(stage.problem(problem), solution.x, _ROUGH).after(solution)
            if np.max(np.abs(stage.weights - before.weights)) < 0.02:
                break
    for _ in range(_ROUNDS):
        before, linear = stage, _Linear.at(problem, solution.x)
        stage = stage.by_likelihood(problem, linear, robust=robust)
        solution = solve(stage.problem(problem), solution.x, _ROUGH).after(solution)
        if stage.is_like(before):
            break
    solution = solve(stage.problem(problem), solution.x, _FINE).after(solution)
    return _finish(problem, stage, solution)


def plain_estimate(problem: Problem, solution: Solution) -> Estimate:
    """The estimate of the paper's solver, which knows no priors and no weights: noise from what is left over.

    It minimises the sum of |r_i|^4. For normal noise in three coordinates that spreads the parameters by 7/5 of least
    squares' covariance: the second derivative is 10 sigma^2 J^T J in the mean and the gradient's covariance
    140 sigma^6 J^T J; so the squares left over are sigma^2 (3 N - 3/5 rank) in the mean.

    Args:
        problem: With weights of 1 and no prior.
        solution: Where that solver stopped, x in [m, rad].
    """
    linear = _Linear.at(problem, solution.x)
    data = Linearised.of(linear.A, linear.y - linear.A @ solution.x, problem.weights)
    rank = np.linalg.matrix_rank(data.H, hermitian=True)
    # Both figures for normal noise: see the docstring.
    noise = float(np.sqrt(data.yy / max(data.count - (2.0 - _FOURTH_POWERS) * rank, 1.0)))
    first = _Stage.first(problem, Priors("off"))
    stage = replace(first, noise=max(noise, linear.smallest))
    return _finish(problem, stage, solution, spread=_FOURTH_POWERS)


@dataclass(frozen=True, slots=True, eq=False)
class _Stage:
    """Weights, noise and prior sizes at one time of the estimation."""

    priors: Priors
    families: tuple[NDArray[np.bool_], ...]
    weights: Array
    noise: float
    sizes: tuple[float, ...]

    @classmethod
    def first(cls, problem: Problem, priors: Priors) -> _Stage:
        """All rows in full, the noise as given, the priors as wide as they were given."""
        families, sizes = _families(problem.kinematics.model, priors)
        return cls(priors, families, np.ones(len(problem.points)), 1.0, sizes)

    @property
    def adapts(self) -> bool:
        """Whether the sizes of the priors are found from the data."""
        return self.priors.sizes == "data"

    def problem(self, problem: Problem) -> Problem:
        """The problem in this form."""
        return problem.reweighted(self.weights, self.noise * problem.sigma, self.precision(problem))

    def precision(self, problem: Problem) -> Array:
        """1 / tau^2 of each parameter, shape (p,)."""
        own = precision_of(self.families, self.sizes, problem.size)
        return own + _placed_precision(problem.kinematics.model)

    def by_median(self, problem: Problem, linear: _Linear) -> _Stage:
        """Robust weights against a scale that outliers cannot move, on the linearised problem."""
        precision = self.precision(problem)
        weights, noise = self.weights, self.noise
        for _ in range(3):
            residual, covariance, _ = linear.fit(weights, noise, precision)
            unscaled = scores(residual, linear.A, covariance / noise**2, weights)
            noise = max(median_noise(unscaled), linear.smallest)
            weights = cauchy_weights(unscaled / noise)
        return _Stage(self.priors, self.families, weights, noise, self.sizes)

    def by_likelihood(self, problem: Problem, linear: _Linear, *, robust: bool) -> _Stage:
        """Noise and prior sizes by restricted likelihood, and the weights that go with them."""
        weights, noise, sizes = self.weights, self.noise, self.sizes
        placed = _placed_precision(problem.kinematics.model)
        for _ in range(2):
            if robust:
                stage = replace(self, sizes=sizes)
                weights = linear.weights(weights, noise, stage.precision(problem))
            data = Linearised.of(linear.A, linear.y, weights)
            found = sizes_by_reml(
                data,
                self.families if self.adapts else (),
                Sizes(noise, sizes if self.adapts else ()),
                smallest_noise=linear.smallest,
                noise_spread=_NOISE_SPREAD,
                known=placed if self.adapts else self.precision(problem),
            )
            noise, sizes = found.noise, found.families if self.adapts else sizes
        return _Stage(self.priors, self.families, weights, noise, sizes)

    def is_like(self, other: _Stage) -> bool:
        """Whether two stages differ by too little to matter."""
        return bool(
            np.max(np.abs(self.weights - other.weights)) < 0.02
            and np.allclose([self.noise, *self.sizes], [other.noise, *other.sizes], rtol=0.01)
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Linear:
    """The problem linearised: y = A x + noise, in units of the rows' sigma."""

    A: Array
    y: Array
    smallest: float

    @classmethod
    def at(cls, problem: Problem, x: Array) -> _Linear:
        """At the parameters x."""
        residual, jacobian = problem.residual_and_jacobian(x)
        A = jacobian / problem.sigma[:, None, None]
        y = residual / problem.sigma[:, None] + A @ x
        return cls(A, y, _SMALLEST_SIGMA / float(np.median(problem.sigma)))

    def fit(self, weights: Array, noise: float, precision: Array) -> tuple[Array, Array, float]:
        """The linear fit with these weights, noise and priors.

        Returns:
            The residual, shape (N, 3), in units of the rows' sigma; the covariance of x, shape (p, p); and the degrees
            of freedom: scalar measurements, by weight, minus the parameters that they have to pay for.
        """
        data = Linearised.of(self.A, self.y, weights)
        x, covariance = data.posterior(noise, precision)
        freedom = data.count - float(np.sum(data.H * covariance)) / noise**2
        return self.y - self.A @ x, covariance, freedom

    def weights(self, weights: Array, noise: float, precision: Array) -> Array:
        """The weights that the scores of the linear fit ask for."""
        residual, covariance, freedom = self.fit(weights, noise, precision)
        if freedom <= _FEWEST_FREEDOM:
            return np.ones(len(weights))
        row_scores = scores(residual / noise, self.A / noise, covariance, weights)
        found = Limits.of(len(weights), freedom).weights(row_scores)
        # Half of the rows cannot be outliers of the other half: then it is the noise that is taken too small.
        return found if np.sum(found) > 0.5 * len(found) else np.ones(len(found))


def _families(
    model: ErrorModel, priors: Priors
) -> tuple[tuple[NDArray[np.bool_], ...], tuple[float, ...]]:
    """The families that the model has, and the sizes to begin with: the leash without priors."""
    length, angle = (_LEASH, _LEASH) if priors.sizes == "off" else (priors.length, priors.angle)
    pairs = [(model.family(LENGTH), length), (model.family(ANGLE), angle)]
    present = [(members, size) for members, size in pairs if np.any(members)]
    return tuple(m for m, _ in present), tuple(s for _, s in present)


def _placed_precision(model: ErrorModel) -> Array:
    """The hold on target and frame, 1 / tau^2 for theirs and 0 for the robot's parameters, shape (p,)."""
    placed = model.family(FRAME) | model.family(TARGET)
    return np.where(placed, 1.0 / _PLACED**2, 0.0)


def _finish(problem: Problem, stage: _Stage, solution: Solution, spread: float = 1.0) -> Estimate:
    """The estimate at the last stage, with covariance and scores at the solution itself.

    ``spread`` is the covariance that the solver's estimator has, over that of least squares.
    """
    final = stage.problem(problem)
    linear = _Linear.at(problem, solution.x)
    _, of_least_squares, freedom = linear.fit(stage.weights, stage.noise, final.precision)
    deviation = float(np.sqrt(spread)) * stage.noise
    _, covariance, _ = linear.fit(stage.weights, deviation, final.precision)
    residual = linear.y - linear.A @ solution.x
    A = linear.A / stage.noise
    row_scores = scores(residual / stage.noise, A, of_least_squares, stage.weights)
    model = problem.kinematics.model
    names = [f for f in (LENGTH, ANGLE) if np.any(model.family(f))]
    size = {} if stage.priors.sizes == "off" else dict(zip(names, stage.sizes, strict=True))
    # Without priors there is nothing to keep a6 small beside the target, and so no trace to remove.
    held = stage.priors.sizes != "off"
    own = held & (model.family(LENGTH) | model.family(ANGLE))
    x = read_only(np.where(own & (np.abs(solution.x) < _NOTHING), 0.0, solution.x))
    return Estimate(
        x=x,
        problem=final,
        solution=replace(solution, x=x),
        covariance=read_only(covariance),
        scores=read_only(row_scores),
        limits=Limits.of(len(problem.points), freedom),
        freedom=freedom,
        noise_factor=stage.noise,
        prior_length=size.get(LENGTH),
        prior_angle=size.get(ANGLE),
    )
