"""Confidence intervals of quantities whose standard deviation is itself estimated."""

from __future__ import annotations

from scipy.special import stdtrit


def interval_factor(freedom: float, level: float = 0.95) -> float:
    """Half width of a two-sided confidence interval, by Student's t distribution.

    Args:
        freedom: Degrees of freedom of the standard deviation; below 1 it counts as 1.
        level: Probability that the interval contains the true value, between 0 and 1.

    Returns:
        The half width, in standard deviations.
    """
    return float(stdtrit(max(freedom, 1.0), 0.5 + level / 2.0))
