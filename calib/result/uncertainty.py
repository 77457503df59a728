"""Uncertainty on demand, at the price of many fits; noise, prior std and robust weights stay as they were found.

**Bootstrap.** Whole poses, with their repeats, are drawn with replacement within each set-up: B. Efron, R. J.
Tibshirani, An Introduction to the Bootstrap, 1993, sections 9.5 and 13.3. Each sample draws the priors' means too
(J. M. Bardsley and others, SIAM Journal on Scientific Computing 36, 2014), and known distances between set-ups. With
few rows for a parameter it is too wide (N. El Karoui, E. Purdom, JMLR 19, 2018).

**Profile.** The interval of one parameter where the cost, minimised over all others, has risen by no more than the
quantile of F(1, dof): D. M. Bates, D. G. Watts, Nonlinear Regression Analysis, 1988, section 6.1.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri, gammaincinv

from calib.blas import one_blas_thread
from calib.errors import CalibError, ModelError
from calib.estimate.fitting import Fitted
from calib.jobs import Progress, batch_size, run
from calib.model.kinematics import Samples, SamplesOrValues
from calib.model.observability import steps
from calib.numerics.errors import rms
from calib.numerics.rigid_motion import without_rigid_motion
from calib.numerics.solvers import levenberg_marquardt
from calib.result.calibration import CalibrationValues
from calib.result.prediction import ParameterEstimate
from calib.robot.ranges import spread_poses
from calib.robot.robot import read_only
from calib.units import Array, Integers

#: With fewer samples the ends of a 95 % interval lie beyond them; more tell nothing, and do not fit into memory.
FEWEST_SAMPLES, MOST_SAMPLES = 40, 100_000

#: Poses over which a bootstrap's predicted spread is told.
_POSES = 200

#: A prior wider than this is no prior but a hold on what nothing determines; its mean stays [m, rad].
_LEASH = 1.0

#: A fit of a sample ends with steps below this, in steps of 1 mm and 1 mrad.
_STEP = 1e-4

#: Steps are doubled this many times before an end of a profile counts as open; an end is found to this share.
_DOUBLINGS, _TOLERANCE = 10, 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Bootstrap:
    """Parameters of many fits to rows drawn with replacement from those of one."""

    fitted: Fitted  #: That one
    parameters: tuple[ParameterEstimate, ...]  #: Its values and intervals
    x: Array  #: shape (count, p), offsets like ``fitted.estimate.x``
    seed: int
    stopped: int  #: How many samples' fits reached the solver's limit of iterations

    @property
    def measured_rms(self) -> float:
        """Standard deviation over the samples of the predicted position, rms over the measured poses [m]."""
        return rms(self.position_std(_some(self.fitted.estimate.problem.rows.samples)))

    @property
    def everywhere_rms(self) -> float:
        """The same over joint values spread over the limits [m]."""
        return rms(self.position_std(Samples.at(spread_poses(self.fitted.task.robot, _POSES))))

    @property
    def std(self) -> Array:
        """Standard deviation of each parameter over the samples, shape (p,)."""
        return np.asarray(np.std(self.x, axis=0, ddof=1))

    def intervals(self, level: float = 0.95) -> Array:
        """Percentile interval of each parameter's value at a level of probability, shape (p, 2), in its unit."""
        tail = 0.5 * (1.0 - level)
        ends = np.quantile(self.x, (tail, 1.0 - tail), axis=0).T
        values = np.array([p.value for p in self.parameters])
        return np.asarray(ends + (values - self.fitted.estimate.x)[:, None])

    def positions(self, where: SamplesOrValues) -> Array:
        """Where each sample puts the target, in the measurement frame, shape (count, N, 3), [m]; see `position_std`."""
        return np.array([self.fitted.kinematics.points(x, where) for x in self.x])

    def position_std(self, where: SamplesOrValues) -> Array:
        """Standard deviation of the predicted position over the samples, see `Calibration.position_std`, shape (N,).

        At N samples (see `Calibration.samples`), or joint values of shape (N, m) of the first frame and target.
        """
        samples = where if isinstance(where, Samples) else Samples.at(where)
        problem = self.fitted.estimate.problem
        seen = _some(problem.rows.samples)
        as_one_body = not any(kind.position for kind in problem.rows.present)
        if as_one_body:
            samples, seen = (replace(s, frame=np.zeros_like(s.frame)) for s in (samples, seen))
        points, moves = self._scatter(samples)
        if as_one_body:
            moves = without_rigid_motion(points, moves, self._scatter(seen))
        return np.asarray(np.sqrt(np.sum(np.var(moves, axis=2, ddof=1), axis=1)))

    def _scatter(self, samples: Samples) -> tuple[Array, Array]:
        """Mean positions and the samples' differences from them, shapes (N, 3) and (N, 3, count)."""
        points = self.positions(samples)
        mean = points.mean(axis=0)
        return mean, (points - mean).transpose(1, 2, 0)


@one_blas_thread()
def bootstrap(
    calibration: CalibrationValues,
    count: int,
    seed: int,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Bootstrap:
    """Fit the geometry again to rows drawn with replacement, whole poses within each set-up; see the module's text.

    The samples are the same for the same seed, wherever they are fitted; 200 are enough for standard deviations, 1000
    for intervals.

    Raises:
        CalibError: Too few or too many samples, a seed below 0, or the paper's solver made the calibration.
    """
    if not FEWEST_SAMPLES <= count <= MOST_SAMPLES or seed < 0:
        raise CalibError(
            f"A bootstrap of {count} samples with seed {seed} was asked for; it takes {FEWEST_SAMPLES} to "
            f"{MOST_SAMPLES} samples, 1000 for intervals to be trusted, and a seed of 0 or more."
        )
    fitted = calibration.fitted
    _check_solver(fitted)
    problem, start = fitted.estimate.problem, fitted.estimate.x
    rows = problem.rows
    drawn = bootstrap_indices(rows.blocks, count, seed, rows.samples.frame)
    # Not the generator that draws the rows: priors would follow them.
    rng = np.random.default_rng([seed, 1])
    noise = rng.normal(size=(count, len(start) + len(problem.distances)))
    x, stopped = np.empty((count, len(start))), 0
    items, size = zip(drawn, noise, strict=True), batch_size(count)
    for done, (k, found) in enumerate(run(_fit_sample, fitted, items, executor, batch=size), 1):
        x[k], stopped = found[0], stopped + (not found[1])
        if progress is not None:
            progress(done, count)
    return Bootstrap(fitted, calibration.parameters, read_only(x), seed, stopped)


def bootstrap_indices(
    blocks: NDArray[np.generic], count: int, seed: int, strata: NDArray[np.generic]
) -> Integers:
    """How often each row is drawn in each sample, shape (count, N): as many blocks as there are, with replacement.

    blocks, shape (N,), labels what is drawn together: the pose where it was repeated, or the set-up. Within strata,
    labels of shape (N,), blocks are drawn apart, so that every set-up stays in every sample.
    """
    rng = np.random.default_rng(seed)
    result = np.zeros((count, len(blocks)), dtype=np.int_)
    for stratum in np.unique(strata):
        rows = np.flatnonzero(strata == stratum)
        labels, block = np.unique(blocks[rows], return_inverse=True)
        draws = rng.multinomial(len(labels), np.full(len(labels), 1.0 / len(labels)), size=count)
        result[:, rows] = draws[:, block]
    return result


def _fit_sample(fitted: Fitted, drawn: tuple[Array, Array]) -> tuple[Array, bool]:
    """The parameters of one sample, and whether its fit converged."""
    problem, start = fitted.estimate.problem, fitted.estimate.x
    count, normal = drawn
    held = problem.precision > 1.0 / _LEASH**2
    wide = np.where(held, 1.0 / np.sqrt(np.where(held, problem.precision, 1.0)), 0.0)
    moved = zip(problem.distances, normal[len(start) :].tolist(), strict=True)
    sample = replace(
        problem,
        weights=problem.weights * count,
        stops=None if problem.stops is None else problem.stops.drawn(count),
        centre=problem.centre + wide * normal[: len(start)],
        distances=tuple(d._replace(length=d.length + d.sigma * by) for d, by in moved),
    )
    size = steps(fitted.kinematics.model.units)
    solution = levenberg_marquardt(sample.system, start, step_size=size, step_tolerance=_STEP)
    return solution.x, solution.status == "converged"


@dataclass(frozen=True, slots=True)
class Profile:
    """An interval from the profile of the cost; an end is infinite where the cost does not rise enough."""

    low: float
    high: float
    level: float  # Probability that the interval holds the true value


@one_blas_thread()
def profile_interval(calibration: CalibrationValues, name: str, level: float = 0.95) -> Profile:
    """The interval of one parameter, in its unit, from the profile of the cost; see the module's text.

    An end is infinite where the measurements set no limit. A parameter that the geometry lacks is that of
    the non-geometric model.

    Raises:
        ModelError: No such parameter, it stands at a bound, or the paper's solver made the calibration.
        CalibError: The level is not between 0 and 1.
    """
    found = calibration.parameter(name)
    fitted = calibration.fitted
    if calibration.fit is not None and calibration.fit.non_geometric is not None:
        fitted = fitted if name in calibration.model.names else calibration.fit.non_geometric
    _check_solver(fitted)
    estimate = fitted.estimate
    k = fitted.kinematics.model.index(name)
    if k in estimate.at_bound:
        raise ModelError(
            f"'{name}' stands at its bound, {found.value:g} {found.unit}: it has no profile. Widen the bound in the "
            "cell file's table [bounds]."
        )
    at = float(estimate.x[k])
    low, high = profile(
        lambda value: _least_cost(fitted, k, value), at, found.std, level, estimate.freedom
    )
    return Profile(low + found.value - at, high + found.value - at, level)


def profile(
    cost_at: Callable[[float], float],
    value: float,
    std: float,
    level: float = 0.95,
    freedom: float = np.inf,
) -> tuple[float, float]:
    """The interval where the cost, minimised over the others, is not too high.

    cost(x) - cost(estimate) <= quantile of chi^2(1), or of F(1, freedom) where the noise was estimated. The cost is
    that of squares over their variance, the standard deviation the first step.
    """
    if not 0.0 < level < 1.0:
        raise CalibError(f"The level of an interval is {level:g}; it must lie between 0 and 1.")
    known = not np.isfinite(freedom)
    rise = float(2.0 * gammaincinv(0.5, level) if known else fdtri(1.0, max(freedom, 1.0), level))
    least = cost_at(value)

    def above(x: float) -> float:
        """The cost over the limit; finite, for the root finder."""
        over = cost_at(x) - least - rise
        return float(min(over, 1e6 * rise)) if np.isfinite(over) else 1e6 * rise

    # Not above: SciPy's optimisers take longer to import than most calibrations take.
    from scipy.optimize import brentq

    def end(step: float) -> float:
        """Where the cost crosses the limit, on one side."""
        inner, reach = value, step * float(np.sqrt(rise))
        for _ in range(_DOUBLINGS + 1):
            outer = value + reach
            if above(outer) >= 0.0:
                return float(brentq(above, inner, outer, xtol=_TOLERANCE * abs(reach)))
            inner, reach = outer, 2.0 * reach
        return float(np.copysign(np.inf, step))

    return end(-std), end(std)


def _least_cost(fitted: Fitted, k: int, value: float) -> float:
    """Squares over their variance, the priors' included, with parameter k held at a value and the others fitted."""
    estimate = fitted.estimate
    problem, C = estimate.problem, estimate.covariance
    others = np.arange(len(estimate.x)) != k
    start = estimate.x + C[:, k] / C[k, k] * (value - estimate.x[k])
    start[k] = value
    if not np.any(others):
        residual, _ = problem.system(start)
        return float(residual @ residual)

    def system(rest: Array) -> tuple[Array, Array]:
        """Residual and derivative over the other parameters."""
        x = start.copy()
        x[others] = rest
        residual, jacobian = problem.system(x)
        return residual, jacobian[:, others]

    size = steps(fitted.kinematics.model.units)[others]
    return 2.0 * levenberg_marquardt(system, start[others], step_size=size).cost


def _check_solver(fitted: Fitted) -> None:
    """Refuse the paper's solver: its fit is not the least cost of its own problem."""
    if fitted.task.solver == "paper":
        raise ModelError("The solver 'paper' has neither bootstrap nor profile. Choose 'lm'.")


def _some(samples: Samples) -> Samples:
    """At most `_POSES` of the samples, evenly spread over their order."""
    count = min(len(samples), _POSES)
    return samples.select(np.linspace(0, len(samples) - 1, count).astype(int))
