"""Trend of one figure over time: constant, drifting at a rate, or with one step.

Values z_i at times t_i with standard deviations s_i are fitted by weighted least squares with a constant, with a line,
and with a step at each time after the first,

    z = a,      z = a + r t,      z = a + h [t >= t_k]

Uncertainties of r and h grow by the scatter about line or step, the root of chi-square over its degrees of freedom, if
that is more than 1. The trend is the one of the two whose p-value, of r or h over its uncertainty, is smaller; that the
step may be at any of K - 1 times is counted against it: its p-value is K - 1 times as large. A figure that has neither,
but scatters about a constant by more than chance, is unsteady.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import chdtrc, ndtr

from calib.basics.arrays import Array

#: What a figure does over time; of two dates a drift and a step are the same, and it is called a change.
Shape = Literal["steady", "drift", "step", "change", "unsteady"]

#: Probability that a robot is not called steady though it is; its joints, and the three tests of each, share it.
LEVEL = 0.01

#: A line, a step, and scatter about a constant.
_TESTS = 3

#: Fewest dates at which a drift differs from a step.
_FEWEST = 3


@dataclass(frozen=True, slots=True)
class Trend:
    """The course of one figure over time: steady, a drift, or a step."""

    #: What it does
    shape: Shape
    #: Probability of such a trend, or a stronger one, if nothing changes; not yet shared among joints
    p: float
    #: Slope of the line [unit of the values per unit of the times]
    rate: float
    #: Its standard deviation
    rate_std: float
    #: Height of the best step [unit of the values]; NaN of a single date
    step: float
    #: Its standard deviation
    step_std: float
    #: Index of the date from which on the best step counts; 0 of a single date
    step_at: int


def joint_trend(times: Array, values: Array, stds: Array, level: float = LEVEL) -> Trend:
    """Find what a figure does over time.

    Args:
        times: K dates, ascending, shape (K,), in any unit.
        values: The figure at each, shape (K,).
        stds: Standard deviations, shape (K,), positive.
        level: Probability that the figure is not called steady though it is.

    Returns:
        The trend; steady with infinite standard deviations if all dates are the same.
    """
    weights = stds**-2.0
    count = len(times)
    one = np.ones(count)
    if count == 1 or times[0] == times[-1]:
        return Trend("steady", 1.0, 0.0, np.inf, np.nan, np.inf, 0)

    middle = float(np.average(times, weights=weights))
    line = np.stack([one, times - middle], axis=1)
    rate, rate_std, _ = _last_of(line, values, weights)
    # Between two results of one date there is no step in time.
    places = [k for k in range(1, count) if times[k] > times[k - 1]]
    steps = []
    for k in places:
        after = (np.arange(count) >= k).astype(np.float64)
        steps.append((*_last_of(np.stack([one, after], axis=1), values, weights), k))
    step, step_std, _, at = min(steps, key=lambda found: found[2])

    p_line = _p_of(rate / rate_std)
    p_step = min(len(places) * _p_of(step / step_std), 1.0)
    p = min(p_line, p_step)
    _, residual, _ = _solved(one[:, None], values, weights)
    p_constant = float(chdtrc(count - 1, np.sum(weights * residual**2)))
    shape: Shape = "steady"
    if p < level / _TESTS:
        shape = "drift" if p_line <= p_step else "step"
        if len(places) + 1 < _FEWEST:
            shape = "change"
    elif p_constant < level / _TESTS:
        shape, p = "unsteady", p_constant
    return Trend(shape, p, rate, rate_std, step, step_std, at)


def _p_of(deviation: float) -> float:
    """Return the probability that a normal deviation [standard deviations] is at least as large, of either sign."""
    return 2.0 * float(ndtr(-abs(deviation)))


def _last_of(design: Array, values: Array, weights: Array) -> tuple[float, float, float]:
    """Return the last coefficient, its standard deviation with the scatter that is left, and the chi-square left."""
    x, residual, covariance = _solved(design, values, weights)
    chi_square = float(np.sum(weights * residual**2))
    freedom = len(values) - design.shape[1]
    scatter = max(chi_square / freedom, 1.0) if freedom else 1.0
    return float(x[-1]), float(np.sqrt(scatter * covariance[-1, -1])), chi_square


def _solved(design: Array, values: Array, weights: Array) -> tuple[Array, Array, Array]:
    """Return coefficients (n,), residuals (K,) and covariance (n, n) of weighted least squares."""
    information = design.T @ (weights[:, None] * design)
    covariance = np.linalg.inv(information)
    x = covariance @ (design.T @ (weights * values))
    return x, values - design @ x, covariance
