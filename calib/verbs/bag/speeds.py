"""Velocities of values over time, with noise averaged, and the runs of times at which something holds.

A velocity is the difference between the means over a time h after and before, by the integral I of the values:

    v(t) = (I(t + h) - 2 I(t) + I(t - h)) / h^2
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_trapezoid

from calib.basics.arrays import Array, Mask


def velocities(times: Array, values: Array, grid: Array, half: float) -> Array:
    """Return the velocities of values; see the module's text.

    Args:
        times: shape (N,), increasing [s].
        values: shape (N, D), in any unit.
        grid: shape (M,), times at which they are wanted [s].
        half: The time h [s].

    Returns:
        shape (M, D) [unit/s].
    """
    integral = cumulative_trapezoid(values, times, axis=0, initial=0.0)
    columns = []
    for column in integral.T:
        before, at, after = (np.interp(grid + k * half, times, column) for k in (-1, 0, 1))
        columns.append((after - 2.0 * at + before) / half**2)
    return np.column_stack(columns)


def means(times: Array, values: Array, grid: Array, half: float) -> Array:
    """Return the means of values over a time before and after each time of a grid.

    Args:
        times: shape (N,), increasing [s].
        values: shape (N,), in any unit.
        grid: shape (M,) [s].
        half: The time on either side [s].

    Returns:
        shape (M,), in the unit of the values.
    """
    integral = cumulative_trapezoid(values, times, initial=0.0)
    after, before = (np.interp(grid + k * half, times, integral) for k in (1, -1))
    return np.asarray((after - before) / (2.0 * half))


def runs(holds: Mask) -> list[tuple[int, int]]:
    """Return the first and the last index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], holds, [False]]).astype(int)))
    return [(int(first), int(end) - 1) for first, end in edges.reshape(-1, 2)]
