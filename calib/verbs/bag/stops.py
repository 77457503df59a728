"""When the arm stands: times at which no joint moves, by its position, and by its reported speed where it has one.

The speed of a joint is the difference between its means over a tenth of a second before and after, so that noise of
encoders is averaged. It rests where it is slower than

    max(2 mrad/s, min(40 noise, 2 % of its fast speeds))

with the 5 % quantile of its speeds as the noise, which is a small share of it.
"""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array
from calib.verbs.bag.speeds import means, runs, velocities
from calib.verbs.bag.streams import JointStream

#: Speeds are looked at on a grid of so much [s].
_GRID = 0.02

#: Half of the time over which a speed is taken [s].
_HALF = 0.1

#: A joint that is slower rests [rad/s] or [m/s].
_SLOW = 2e-3

#: The same as a multiple of the 5 % quantile of its speeds, which is a tenth of their noise where it often rests.
_OF_NOISE = 40.0

#: A speed above this share of the fast ones is motion.
_OF_FAST = 0.02

#: The mean of a joint moves by less within a stop [rad] or [m].
_DRIFT = 1e-3

#: Stops shorter than this are where the arm turns back, not stops [s].
SHORTEST = 0.2

#: Reported speeds are believed if they and the differences of positions are correlated like this.
_BELIEVED = 0.9


def find_stops(joints: JointStream) -> Array:
    """Find the times at which the arm stands.

    Args:
        joints: The joint values.

    Returns:
        shape (S, 2), beginning and end of each stop [s], of at least `SHORTEST`.
    """
    first, last = joints.times[0] + _HALF, joints.times[-1] - _HALF
    grid = np.arange(first, last, _GRID)
    if not len(grid):
        return np.zeros((0, 2))
    is_still = np.ones(len(grid), dtype=bool)
    by_position = velocities(joints.times, joints.q, grid, _HALF)
    for signed, reported in zip(by_position.T, joints.speeds.T, strict=True):
        speed = np.abs(signed)
        if np.isfinite(reported).all():
            by_driver = means(joints.times, reported, grid, _HALF)
            norm = np.sqrt(np.sum(signed**2) * np.sum(by_driver**2))
            if norm > 0.0 and np.sum(signed * by_driver) > _BELIEVED * norm:
                speed = np.maximum(speed, np.abs(by_driver))
        low, high = np.quantile(speed, [0.05, 0.95])
        limit = max(_SLOW, _OF_NOISE * float(low))
        if high > 0.0:
            limit = max(min(limit, _OF_FAST * float(high)), _SLOW)
        is_still &= speed < limit
    # A gap in the messages is no rest.
    near = np.clip(np.searchsorted(joints.times, grid), 1, len(joints.times) - 1)
    gap = joints.times[near] - joints.times[near - 1]
    is_still &= gap < max(_HALF, 10.0 * joints.interval)

    stops = []
    for start, stop in runs(is_still):
        begin, end = grid[start], grid[stop]
        if end - begin >= SHORTEST and _drift(joints, begin, end) < _DRIFT:
            stops.append((begin, end))
    return np.array(stops).reshape(-1, 2)


def _drift(joints: JointStream, begin: float, end: float) -> float:
    """Return the largest difference of a joint's means over the first and the last quarter of a stop."""
    inside = joints.q[(joints.times >= begin) & (joints.times <= end)]
    if not len(inside):
        return np.inf
    quarter = max(len(inside) // 4, 1)
    return float(np.abs(inside[-quarter:].mean(axis=0) - inside[:quarter].mean(axis=0)).max())
