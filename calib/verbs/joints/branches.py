"""The branch of each pose among its solutions: the shortest way through all poses, and how much longer others are.

With the solutions s of pose n and the distance |s - s'| between those of neighbouring poses, summed over the joints and
across whole turns where a joint may make them, forward and backward sums give the length of the shortest way through
each solution (dynamic programming):

    L_n(s) = F_n(s) + B_n(s),    F_n(s) = min_s' F_n-1(s') + |s - s'|,    B_n(s) = min_s' B_n+1(s') + |s - s'|
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from calib.basics.arrays import Array, Integers
from calib.robot.ranges import column_limits
from calib.robot.robot import Robot
from calib.verbs.compensate.solutions import turning

_TURN = 2.0 * np.pi

#: A joint with a wider range may show one angle as two values [rad].
_MORE_THAN_A_TURN = _TURN + 1e-3


def ways(robot: Robot, solutions: Sequence[Array]) -> list[Integers]:
    """Return ways through all poses, one for each solution of the pose with the fewest: the shortest through it.

    Args:
        robot: The robot, with m measured joints.
        solutions: For each of N poses its solutions, (k, m), [rad] or [m], one or more.

    Returns:
        Each way as the index of its solution at every pose, shape (N,), from 0; the shortest first.
    """
    steps = _steps(robot, solutions)
    forward, backward = _sums(steps), _sums([step.T for step in reversed(steps)])[::-1]
    fewest = int(np.argmin([len(values) for values in solutions]))
    lengths = forward[fewest] + backward[fewest]
    found: list[Integers] = []
    for start in np.argsort(lengths, kind="stable").tolist():
        way = np.zeros(len(solutions), dtype=np.intp)
        way[fewest] = start
        for n in range(fewest, 0, -1):
            way[n - 1] = np.argmin(forward[n - 1] + steps[n - 1][:, way[n]])
        for n in range(fewest, len(solutions) - 1):
            way[n + 1] = np.argmin(backward[n + 1] + steps[n][way[n]])
        found.append(way)
    return found


def detours(robot: Robot, solutions: Sequence[Array], way: Integers) -> Array:
    """Return how much longer the way becomes if one pose is reached by its next best solution.

    Args:
        robot: The robot, with m measured joints.
        solutions: For each of N poses its solutions, (k, m), [rad] or [m].
        way: Index of the solution of each pose, shape (N,).

    Returns:
        shape (N,), [rad], a metre counting as one; infinite where there is one solution. Below zero if another one
        makes the way shorter.
    """
    steps = _steps(robot, solutions)
    result = np.full(len(solutions), np.inf)
    for n, values in enumerate(solutions):
        lengths = np.zeros(len(values))
        if n > 0:
            lengths += steps[n - 1][way[n - 1]]
        if n + 1 < len(solutions):
            lengths += steps[n][:, way[n + 1]]
        others = np.arange(len(values)) != way[n]
        if np.any(others):
            result[n] = np.min(lengths[others]) - lengths[way[n]]
    return result


def unwound(robot: Robot, q: Array) -> tuple[Array, tuple[str, ...]]:
    """Bring each joint's values to the turns that make it move least from pose to pose.

    Args:
        robot: The robot, with m measured joints.
        q: Joint values of N poses in their order, shape (N, m), [rad] or [m].

    Returns:
        The values, inside the limits; and the names of the joints that may as well be a whole turn away at all poses.
    """
    limits = column_limits(robot)
    result = q.copy()
    may_differ = []
    for j, (name, turns) in enumerate(zip(robot.joint_names, turning(robot), strict=True)):
        low, high = limits[j]
        if not turns or high - low < _MORE_THAN_A_TURN:
            continue
        for n in range(1, len(q)):
            value = result[n, j] - _TURN * np.round((result[n, j] - result[n - 1, j]) / _TURN)
            value = value - _TURN if value > high else value
            result[n, j] = value + _TURN if value < low else value
        column = result[:, j]
        shifts = _TURN * np.arange(-4, 5)
        fits = (column.min() + shifts >= low) & (column.max() + shifts <= high)
        middles = np.abs(column.mean() + shifts)
        best = int(np.argmin(np.where(fits, middles, np.inf)))
        result[:, j] = column + (shifts[best] if np.any(fits) else 0.0)
        if np.sum(fits) > 1:
            may_differ.append(name)
    return result, tuple(may_differ)


def _steps(robot: Robot, solutions: Sequence[Array]) -> list[Array]:
    """Return the distances between the solutions of each pose and the next, (k, k') [rad], a metre counting as one."""
    low, high = column_limits(robot).T
    wraps = turning(robot) & (high - low >= _MORE_THAN_A_TURN)
    steps = []
    for before, after in pairwise(solutions):
        difference = np.abs(before[:, None] - after[None])
        across = np.abs((difference + np.pi) % _TURN - np.pi)
        steps.append(np.where(wraps, across, difference).sum(axis=2))
    return steps


def _sums(steps: Sequence[Array]) -> list[Array]:
    """Return, for each solution of each pose, the length of the shortest way from the first pose to it, (k,)."""
    sums = [np.zeros(len(steps[0]))] if steps else [np.zeros(1)]
    for step in steps:
        sums.append(np.min(sums[-1][:, None] + step, axis=0))
    return sums
