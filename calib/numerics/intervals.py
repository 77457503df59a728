"""Intervals of a probability."""

from __future__ import annotations

from scipy.special import stdtrit


def interval_factor(freedom: float, level: float = 0.95) -> float:
    """How many standard deviations the two-sided interval of a probability reaches: Student's t."""
    return float(stdtrit(max(freedom, 1.0), 0.5 + level / 2.0))
