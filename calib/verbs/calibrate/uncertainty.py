"""Uncertainty on demand, at the price of many fits; noise, prior std and robust weights stay as they were estimated.

**Bootstrap.** Whole poses, with their repeats, are drawn with replacement within each station: B. Efron, R. J.
Tibshirani, An Introduction to the Bootstrap, 1993, sections 9.5 and 13.3. Each sample draws the priors' means too
(J. M. Bardsley and others, SIAM Journal on Scientific Computing 36, 2014), and known distances between stations. With
few rows for a parameter it is too wide (N. El Karoui, E. Purdom, JMLR 19, 2018).

**Profile.** The interval of one parameter in which the cost, minimised over all others, has risen by no more than the
quantile of F(1, dof): D. M. Bates, D. G. Watts, Nonlinear Regression Analysis, 1988, section 6.1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtri, gammaincinv, ndtri

from calib.basics.arguments import check_callable, check_executor, check_type
from calib.basics.arrays import Array, Integers, read_only
from calib.basics.jobs import Progress, batch_size, one_blas_thread, run
from calib.basics.values import Value
from calib.errors import CalibError, ModelError
from calib.fit.estimate.fitting import Fitted
from calib.fit.estimate.problem import Problem
from calib.model.kinematics import Samples, SamplesOrValues
from calib.model.observability import steps
from calib.numerics.errors import rms
from calib.numerics.rigid_motion import without_rigid_motion
from calib.numerics.solvers import levenberg_marquardt
from calib.result.calibration import Calibration
from calib.result.fitted_model import ParameterEstimate
from calib.robot.ranges import spread_poses

#: With fewer samples, the ends of a 95 % interval lie outside of all of them.
FEWEST_SAMPLES = 40

#: More samples do not improve intervals, and do not fit into memory.
MOST_SAMPLES = 100_000

#: Probability that an interval holds the true value.
LEVEL = 0.95

#: Poses over which the predicted scatter of a bootstrap is averaged.
_POSES = 200

#: A prior wider than this only holds a parameter that nothing determines; its mean is not drawn [m, rad].
_WIDEST_DRAWN = 1.0

#: A fit of a sample ends with steps below this, in steps of 1 mm and 1 mrad.
_STEP = 1e-4

#: Steps are doubled this many times before an end of a profile counts as open.
_DOUBLINGS = 10

#: An end of a profile is found to this share of its distance.
_TOLERANCE = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Bootstrap(Value):
    """Parameters of many fits to rows drawn with replacement from those of one fit."""

    #: That fit, of p parameters
    fitted: Fitted
    #: Its values and intervals
    parameters: tuple[ParameterEstimate, ...]
    #: Shape (count, p), offsets like ``fitted.estimate.x``
    x: Array
    #: Seed of the draws
    seed: int
    #: Number of draws whose fits reached the solver's limit of iterations
    stopped: int

    @property
    def measured_rms(self) -> float:
        """Standard deviation of the predicted position over the draws, rms over `_POSES` of the measured poses [m]."""
        measured = self.fitted.estimate.problem.rows.samples
        return rms(self.position_std(_evenly(measured)))

    @property
    def everywhere_rms(self) -> float:
        """Standard deviation of the predicted position over the draws, rms over the joint limits [m].

        It is that of the first measurement frame and target.
        """
        spread = spread_poses(self.fitted.task.robot, _POSES)
        return rms(self.position_std(Samples.at(spread)))

    @property
    def std(self) -> Array:
        """Standard deviation of each parameter over the draws, shape (p,), in the parameters' units."""
        return np.asarray(np.std(self.x, axis=0, ddof=1))

    def intervals(self, level: float = 0.95) -> Array:
        """Return the percentile interval of each parameter's value over the draws.

        Args:
            level: Probability that an interval holds the true value, between 0 and 1.

        Returns:
            Lower and upper ends of the values, not of their changes, shape (p, 2), in the parameters' units.
        """
        tail = 0.5 * (1.0 - level)
        ends = np.quantile(self.x, (tail, 1.0 - tail), axis=0).T
        values = np.array([p.value for p in self.parameters])
        return np.asarray(ends + (values - self.fitted.estimate.x)[:, None])

    def table(self) -> dict[str, Any]:
        """Return the intervals as nested tables of plain values in SI units, for the result file."""
        parameters = []
        ends = self.intervals(LEVEL)
        for p, std, (low, high) in zip(self.parameters, self.std, ends, strict=True):
            parameters.append(
                {"name": p.name, "unit": p.unit, "std": std, "low": low, "high": high}
            )
        return {
            "samples": len(self.x),
            "seed": self.seed,
            "stopped": self.stopped,
            "level": LEVEL,
            "parameters": parameters,
            "expected": {
                "measured_rms_m": self.measured_rms,
                "everywhere_rms_m": self.everywhere_rms,
            },
        }

    def positions(self, where: SamplesOrValues) -> Array:
        """Predict the target's position in the measurement frame by the parameters of each draw.

        Args:
            where: N samples: joint values with the index of the frame and of the target of each; or joint values alone,
                shape (N, m), [rad] or [m], for the first frame and target.

        Returns:
            shape (count, N, 3), [m], each in the frame of its sample.
        """
        return np.array([self.fitted.kinematics.points(x, where) for x in self.x])

    def position_std(self, where: SamplesOrValues) -> Array:
        """Return the standard deviation of the predicted position over the draws.

        If no row determines where the base stands, all positions are seen from the first frame, and the rigid motion
        that explains each draw's change at the measured poses best is subtracted.

        Args:
            where: N samples, see `Calibration.samples`, or joint values of shape (N, m), [rad] or [m], for the first
                frame and target.

        Returns:
            shape (N,), [m]: the root of the sum of the variances along three axes.
        """
        samples = where if isinstance(where, Samples) else Samples.at(where)
        problem = self.fitted.estimate.problem
        if any(kind.position for kind in problem.rows.present):
            _, scatter = self._scatter(samples)
        else:
            measured = _in_first_frame(_evenly(problem.rows.samples))
            # Mean positions, (N, 3), and each draw's differences from them, (N, 3, count) [m].
            points, scatter = self._scatter(_in_first_frame(samples))
            scatter = without_rigid_motion(points, scatter, self._scatter(measured))
        return np.asarray(np.sqrt(np.sum(np.var(scatter, axis=2, ddof=1), axis=1)))

    def _scatter(self, samples: Samples) -> tuple[Array, Array]:
        """Return the mean positions over the draws, (N, 3), and each draw's difference from them, (N, 3, count) [m]."""
        points = self.positions(samples)
        mean = points.mean(axis=0)
        return mean, (points - mean).transpose(1, 2, 0)


@one_blas_thread()
def bootstrap(
    calibration: Calibration,
    count: int,
    seed: int,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Bootstrap:
    """Fit the geometry again to rows drawn with replacement, whole poses within each station; see the module's text.

    The same seed gives the same draws, whatever executor fits them; 200 are enough for standard deviations, 1000 for
    intervals.

    Args:
        calibration: A result in memory, with the fit of its geometry to N rows.
        count: Number of draws of the N rows, each of which is fitted, `FEWEST_SAMPLES` to `MOST_SAMPLES`.
        seed: Seed of the draws, 0 or more.
        progress: Called after each fit with the number of fits done and of all; None: nothing is called.
        executor: Runs the fits; None: in this process.

    Returns:
        The parameters fitted to each draw, shape (count, p), and the number of fits that did not converge.

    Raises:
        CalibError: Too few or too many draws, or a seed below 0.
        ModelError: The paper's solver made the calibration, or the result was read from a file.
    """
    check_type(
        "calibration",
        calibration,
        Calibration,
        "a Calibration that was made here, not read from a file",
    )
    check_type("count", count, (int, np.integer), "a whole number")
    check_type("seed", seed, (int, np.integer), "a whole number")
    check_callable("progress", progress)
    check_executor(executor)
    if not FEWEST_SAMPLES <= count <= MOST_SAMPLES or seed < 0:
        raise CalibError(
            f"A bootstrap of {count} samples with seed {seed} was asked for; it takes {FEWEST_SAMPLES} to "
            f"{MOST_SAMPLES} samples, 1000 for intervals to be trusted, and a seed of 0 or more."
        )
    fitted = calibration.fit.geometry
    _check_solver(fitted)
    draws = _draws(fitted.estimate.problem, count, seed)
    x, stopped = np.empty((count, len(fitted.estimate.x))), 0
    fits = run(_fit_sample, fitted, draws, executor, batch=batch_size(count))
    for done, (k, (x_of_sample, converged)) in enumerate(fits, start=1):
        x[k] = x_of_sample
        stopped += not converged
        if progress is not None:
            progress(done, count)
    # The scale error of the instrument is drawn too: all rows share it.
    scale = np.random.default_rng([seed, 2]).normal(size=(count, 1))
    x = x + scale * calibration.geometry.change_by_scale
    return Bootstrap(fitted, calibration.parameters, read_only(x), seed, stopped)


def _draws(problem: Problem, count: int, seed: int) -> Iterator[tuple[Array, Array]]:
    """Draw ``count`` times how often each of N rows is taken, (N,), and a normal number for each prior and distance.

    Those are of shape (p + K,) for p parameters and K known distances between frames.
    """
    rows = problem.rows
    times_drawn = bootstrap_counts(rows.blocks, count, seed, rows.samples.frame)
    # Not the generator that draws the rows: priors would follow them.
    rng = np.random.default_rng([seed, 1])
    normal = rng.normal(size=(count, problem.size + len(problem.distances)))
    return zip(times_drawn, normal, strict=True)


def bootstrap_counts(
    blocks: NDArray[np.generic],
    count: int,
    seed: int,
    strata: NDArray[np.generic],
) -> Integers:
    """Draw blocks of rows with replacement, as many as there are, ``count`` times.

    Args:
        blocks: Label of each row's block, shape (N,): rows of one block, such as repeats of a pose, are drawn together.
        count: Number of draws.
        seed: Seed of the draws, 0 or more.
        strata: Label of each row's stratum, shape (N,). Within each, such as a station, as many blocks are drawn as it
            has, so that it stays in every draw.

    Returns:
        Number of times that each row is drawn in each draw, shape (count, N).
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
    """Fit one draw of a bootstrap, which gives its parameters, shape (p,), and whether the fit converged.

    ``drawn`` is how often each row is taken, (N,), by which its weight is multiplied, and the normal numbers by which
    the means of the priors and the known distances are moved, in their standard deviations, (p + K,).
    """
    problem, start = fitted.estimate.problem, fitted.estimate.x
    counts, normal = drawn
    is_drawn = problem.prior_precision > 1.0 / _WIDEST_DRAWN**2
    precision = np.where(is_drawn, problem.prior_precision, 1.0)
    prior_std = np.where(is_drawn, 1.0 / np.sqrt(precision), 0.0)
    distances = []
    for known, by in zip(problem.distances, normal[len(start) :].tolist(), strict=True):
        distances.append(known._replace(length=known.length + known.sigma * by))
    sample = replace(
        problem,
        weights=problem.weights * counts,
        stops=None if problem.stops is None else problem.stops.drawn(counts),
        prior_mean=problem.prior_mean + prior_std * normal[: len(start)],
        distances=tuple(distances),
        _last=[],  # of the stops that were measured, and the distances as given
    )
    size = steps(fitted.kinematics.model.units)
    solution = levenberg_marquardt(sample.system, start, step_size=size, step_tolerance=_STEP)
    return solution.x, solution.status == "converged"


@dataclass(frozen=True, slots=True)
class Profile:
    """An interval from the profile of the cost; an end is infinite if the cost does not rise enough on its side."""

    #: Lower end of the parameter's value, in its unit
    low: float
    #: Upper end
    high: float
    #: Probability that the interval holds the true value
    level: float


def profile_table(parameter: ParameterEstimate, interval: Profile) -> dict[str, Any]:
    """Return the profile-likelihood interval of a parameter as an entry of ``profiles`` of a result file."""
    return {"name": parameter.name, "unit": parameter.unit, **asdict(interval)}


@one_blas_thread()
def profile_interval(calibration: Calibration, name: str, level: float = 0.95) -> Profile:
    """Return the interval of one parameter from the profile of the cost; see the module's text.

    Args:
        calibration: A result in memory.
        name: Name of a parameter of the geometry, or else of the non-geometric model.
        level: Probability that the interval holds the true value, between 0 and 1.

    Returns:
        Both ends of the parameter's value, not of its change from the nominal one.

    Raises:
        ModelError: No such parameter, it stands at a bound, the paper's solver made the calibration, or the result was
            read from a file.
        CalibError: The level is not between 0 and 1.
    """
    parameter = calibration.parameter(name)
    fitted, part = calibration.fit.geometry, calibration.geometry
    non_geometric = calibration.fit.non_geometric
    if non_geometric is not None and name not in calibration.model.names:
        fitted, part = non_geometric, calibration.part(non_geometric=True)
    _check_solver(fitted)
    estimate = fitted.estimate
    k = fitted.kinematics.model.index(name)
    if k in estimate.at_bound:
        raise ModelError(
            f"'{name}' stands at its bound, {parameter.value:g} {parameter.unit}: it has no profile. Widen the bound "
            "in the cell file's table [bounds]."
        )
    x = float(estimate.x[k])
    low, high = profile(partial(_least_cost, fitted, k), x, parameter.std, level, estimate.freedom)
    # The scale error of the instrument, of which the cost knows nothing, is independent of the noise.
    by_scale = float(ndtri(0.5 + 0.5 * level) * part.change_by_scale[k])
    low, high = x - float(np.hypot(x - low, by_scale)), x + float(np.hypot(high - x, by_scale))
    # Offsets from the registered start become values.
    return Profile(low + parameter.value - x, high + parameter.value - x, level)


def profile(
    cost_at: Callable[[float], float],
    value: float,
    std: float,
    level: float = 0.95,
    freedom: float = np.inf,
) -> tuple[float, float]:
    """Return the interval of one parameter in which the cost, minimised over the others, is not too high.

    cost(x) - cost(value) <= quantile of F(1, freedom); that of chi^2(1) if the noise is known.

    Args:
        cost_at: Function that returns the least sum of squares over their variance [1] with the parameter held at a
            value, in the parameter's unit.
        value: The estimate, where the cost is least, in the parameter's unit.
        std: Its standard deviation, from which the search for an end starts, in the same unit.
        level: Probability of the interval, between 0 and 1.
        freedom: Degrees of freedom of the noise, at least 1 is taken; infinite if the noise is known.

    Returns:
        Lower and upper end, in the parameter's unit; infinite if the cost does not rise enough.

    Raises:
        CalibError: The level is not between 0 and 1.
    """
    if not 0.0 < level < 1.0:
        raise CalibError(f"The level of an interval is {level:g}; it must lie between 0 and 1.")
    rise = float(2.0 * gammaincinv(0.5, level))  # the quantile of chi^2(1)
    if np.isfinite(freedom):
        rise = float(fdtri(1.0, max(freedom, 1.0), level))
    least = cost_at(value)

    def above(x: float) -> float:
        """Return the cost less the highest one allowed in the interval, capped: the root finder needs finite ones."""
        over = cost_at(x) - least - rise
        if not np.isfinite(over):
            return 1e6 * rise
        return float(min(over, 1e6 * rise))

    # Not above: SciPy's optimisers take longer to import than most calibrations take.
    from scipy.optimize import brentq

    def end(step: float) -> float:
        """Find where the cost crosses the highest one allowed, on the side of the step; infinite if it does not."""
        inner = value
        reach = step * float(np.sqrt(rise))
        for _ in range(_DOUBLINGS + 1):
            outer = value + reach
            if above(outer) >= 0.0:
                return float(brentq(above, inner, outer, xtol=_TOLERANCE * abs(reach)))
            inner = outer
            reach *= 2.0
        return float(np.copysign(np.inf, step))

    return end(-std), end(std)


def _least_cost(fitted: Fitted, k: int, value: float) -> float:
    """Return the least sum of squares over their variance, the priors' included, with parameter k held at an offset.

    The offset counts from the registered start, in the parameter's unit; all others are fitted.
    """
    estimate = fitted.estimate
    problem, C = estimate.problem, estimate.covariance
    others = np.arange(len(estimate.x)) != k
    # The others start where the covariance says that they follow the one that is held.
    start = estimate.x + C[:, k] / C[k, k] * (value - estimate.x[k])
    start[k] = value
    if not np.any(others):
        residual, _ = problem.system(start)
        return float(residual @ residual)

    def system(free: Array) -> tuple[Array, Array]:
        """Return weighted residuals, (n,), and their derivative by the parameters that are not held, (n, p - 1)."""
        x = start.copy()
        x[others] = free
        residual, jacobian = problem.system(x)
        return residual, jacobian[:, others]

    size = steps(fitted.kinematics.model.units)[others]
    return 2.0 * levenberg_marquardt(system, start[others], step_size=size).cost


def _check_solver(fitted: Fitted) -> None:
    """Refuse a fit by the paper's solver by a `ModelError`: its solution is not the least cost of the problem."""
    if not fitted.task.has_weights_and_priors:
        raise ModelError("The solver 'paper' has neither bootstrap nor profile. Choose 'lm'.")


def _evenly(samples: Samples) -> Samples:
    """Return at most `_POSES` of the samples, evenly spread over their order."""
    count = min(len(samples), _POSES)
    return samples.select(np.linspace(0, len(samples) - 1, count).astype(int))


def _in_first_frame(samples: Samples) -> Samples:
    """Return samples all in the first measurement frame, so that one rigid motion can be fitted to all positions."""
    return replace(samples, frame=np.zeros_like(samples.frame))
