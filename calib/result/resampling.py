"""Uncertainty without a formula: the bootstrap's rows and fits, and intervals from the profile of the cost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import fdtri, gammaincinv

from calib.errors import CalibError
from calib.estimate.fitting import Fitted
from calib.estimate.solvers import levenberg_marquardt
from calib.model.observability import steps

Array = NDArray[np.float64]
Integers = NDArray[np.int_]

#: A prior wider than this is no prior but a hold on what nothing determines; its mean stays [m, rad].
_LEASH = 1.0

#: A fit of a sample ends with steps below this, in steps of 1 mm and 1 mrad.
_STEP = 1e-4

#: Steps are doubled this many times before an end of the interval counts as open: about 1000 standard deviations.
_DOUBLINGS = 10

#: A cost that is lower than at the estimate by this share of the rise asked for makes its place the estimate.
_LOWER = 1e-3

#: How often that may happen.
_RESTARTS = 10

#: An end of the interval is found to this share of its distance from the estimate.
_TOLERANCE = 1e-4


def bootstrap_indices(
    blocks: NDArray[np.generic], count: int, seed: int, *, strata: NDArray[np.generic] | None = None
) -> Integers:
    """How often each row is drawn in each sample: as many blocks as there are, with replacement.

    blocks, shape (N,), labels what is drawn together: the pose where it was repeated, or the set-up. Within strata,
    labels of shape (N,), blocks are drawn apart, so that every set-up stays in every sample.

    Returns:
        shape (count, N), how often each row counts.
    """
    rng = np.random.default_rng(seed)
    _, label = np.unique(blocks, return_inverse=True)
    stratum = np.zeros_like(label) if strata is None else np.unique(strata, return_inverse=True)[1]
    result = np.zeros((count, len(label)), dtype=np.int_)
    for s in range(int(stratum.max(initial=-1)) + 1):
        rows = np.flatnonzero(stratum == s)
        _, block = np.unique(label[rows], return_inverse=True)
        number = int(block.max()) + 1
        draws = rng.multinomial(number, np.full(number, 1.0 / number), size=count)
        result[:, rows] = draws[:, block]
    result.setflags(write=False)
    return result


@dataclass(frozen=True, slots=True)
class Profile:
    """An interval from the profile of the cost."""

    low: float  # Lower end; minus infinity where the cost does not rise enough
    high: float  # Upper end; infinity where the cost does not rise enough
    level: float  # Probability that the interval holds the true value


def profile(
    cost_at: Callable[[float], float],
    value: float,
    std: float,
    level: float = 0.95,
    *,
    freedom: float = np.inf,
) -> Profile:
    """The interval of a parameter where the cost, minimised over the others, is not too high.

    cost(x) - cost(estimate) <= quantile of chi^2(1), or of F(1, freedom) where the noise was estimated.

    Args:
        cost_at: The cost, minus twice the logarithm of the likelihood, with the parameter held at a value and the
            others fitted; for an estimated noise, squares over its variance. What is not finite counts as too high.
        value: The estimate, where the cost is least.
        std: Its standard deviation, roughly; the first step.
        level: Probability that the interval holds the true value.
        freedom: Degrees of freedom of the noise's estimate; infinite where the noise is known.

    Raises:
        CalibError: the level is not between 0 and 1, or the estimate or its standard deviation is no such number.

    Example:
        >>> p = profile(lambda x: ((x - 1.0) / 0.5) ** 2, value=1.0, std=0.5)
        >>> round(p.low, 3), round(p.high, 3)
        (0.02, 1.98)
    """
    check_level(level)
    if not (np.isfinite(value) and np.isfinite(std) and std > 0.0):
        raise CalibError(
            f"A profile starts at an estimate with its standard deviation, not at {value:g} with {std:g}: the "
            "parameter may not be identifiable. Profile one that is, or give a step of a likely size"
        )
    rise = float(2.0 * gammaincinv(0.5, level))
    if np.isfinite(freedom):
        rise = float(fdtri(1.0, max(freedom, 1.0), level))
    for _ in range(_RESTARTS):
        least = cost_at(value)
        low, lower_at = _end(cost_at, value, -std, least, rise)
        high, upper_at = (
            (np.nan, None) if lower_at is not None else _end(cost_at, value, std, least, rise)
        )
        better = lower_at if lower_at is not None else upper_at
        if better is None:
            return Profile(low, high, level)
        value = better
    raise CalibError(
        f"The cost is lower elsewhere however far one goes, at last at {value:g}: the estimate is not where the cost "
        "is least. Fit until it converges first."
    )


def _end(
    cost_at: Callable[[float], float], value: float, step: float, least: float, rise: float
) -> tuple[float, float | None]:
    """An end of the interval, or a place where the cost is lower than at the estimate."""

    def above(x: float) -> float:
        """The cost over the limit; finite, for the root finder."""
        over = cost_at(x) - least - rise
        return float(min(over, 1e6 * rise)) if np.isfinite(over) else 1e6 * rise

    inner, reach = value, step * float(np.sqrt(rise))
    for _ in range(_DOUBLINGS + 1):
        outer = value + reach
        over = above(outer)
        if over >= 0.0:
            tolerance = _TOLERANCE * abs(outer - value)
            return float(brentq(above, inner, outer, xtol=tolerance)), None
        if over < -(1.0 + _LOWER) * rise:
            return np.nan, outer
        inner, reach = outer, 2.0 * reach
    return float(np.copysign(np.inf, step)), None


def check_level(level: float) -> None:
    """Refuse a level of an interval that is no probability."""
    if not 0.0 < level < 1.0:
        raise CalibError(
            f"The level of an interval is {level:g}; it must lie between 0 and 1, such as 0.95."
        )


def fit_sample(fitted: Fitted, drawn: tuple[Array, Array]) -> tuple[Array, bool]:
    """The parameters of one sample, and whether its fit converged."""
    problem, start = fitted.estimate.problem, fitted.estimate.x
    count, normal = drawn
    held = problem.precision > 1.0 / _LEASH**2
    wide = np.where(held, 1.0 / np.sqrt(np.where(held, problem.precision, 1.0)), 0.0)
    moved = zip(problem.distances, normal[len(start) :].tolist(), strict=True)
    sample = replace(
        problem,
        weights=problem.weights * count,
        centre=problem.centre + wide * normal[: len(start)],
        distances=tuple(replace(d, length=d.length + d.sigma * by) for d, by in moved),
    )
    size = steps(fitted.kinematics.model.units)
    solution = levenberg_marquardt(sample.system, start, step_size=size, step_tolerance=_STEP)
    return solution.x, solution.status == "converged"
