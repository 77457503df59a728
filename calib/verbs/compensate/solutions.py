"""All joint values that bring an arm's tip to a pose: its inverse kinematics, searched from many starts.

An arm of six joints reaches a pose in up to sixteen ways, each up to whole turns of its joints. Steps from starts that
are spread over the ranges, and from the solutions of other poses, find them all: the search ends when two rounds of new
starts have found nothing new at any pose.
"""

from __future__ import annotations

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.errors import ModelError, choices
from calib.robot.ranges import column_limits, column_ranges, spread_between
from calib.robot.robot import Robot
from calib.verbs.compensate.inverse import POSE, Matching, solve
from calib.verbs.compensate.nominal_actual import Arm

#: A radian counts as this length: the reach of a common arm [m].
_LENGTH = 0.5

#: A pose that is missed by less is reached [m].
_REACHED = 1e-8

#: Arms of fewer than six joints miss poses by the digits that are not shown; up to so much they count as reached [m],
#: and so do solutions that miss up to so many times as much as the best one.
_NEARLY, _AS_NEAR = 1e-4, 10.0

#: Joint values that differ by less are the same solution [rad or m].
_SAME = 1e-5

#: Joint values may exceed their limits by this: digits that were not shown [rad or m].
_ROUNDING = 1e-4

#: Starts of each pose in a round, steps from each, and the most rounds.
_STARTS, _STEPS, _ROUNDS = 24, 25, 10

#: Rounds without anything new after which the search ends.
_IDLE_ROUNDS = 2

#: The most solutions of other poses that are starts too.
_OTHERS = 32

_TURN = 2.0 * np.pi


def joint_solutions(robot: Robot, T_base_tip: Array) -> list[Array]:
    """Return all joint values inside the limits that bring the tip to poses, up to whole turns.

    Args:
        robot: The robot as its controller has it, with m measured joints.
        T_base_tip: Poses of the tip in the base, shape (N, 4, 4) [m].

    Returns:
        For each pose its solutions, shape (k, m), [rad] or [m]: of several values of a joint that turn it alike the one
        nearest to zero; none if it is not reached.

    Raises:
        ModelError: The arm has more than six measured joints, so that it reaches poses in a continuum of ways.
    """
    count = len(robot.joint_names)
    if count > 6:
        raise ModelError(
            f"'{robot.name}' has {count} joints, {choices(robot.joint_names)}: it reaches every pose in a continuum of "
            'ways, and no pose tells which. Record joint values, or hold one that did not move: --hold "joint=10 deg".'
        )
    arm = Arm.of(robot, np.eye(4))
    matching = Matching(POSE, _LENGTH)
    N = len(T_base_tip)
    found: list[Array] = [np.zeros((0, count))] * N
    starts = spread_between(column_ranges(robot), _STARTS * _ROUNDS)
    best = np.full(N, np.inf)  # how far the best solution of each pose misses it
    idle = 0
    for number in range(_ROUNDS):
        of_round = starts[number * _STARTS : (number + 1) * _STARTS]
        others = np.concatenate(found)
        seeds = np.concatenate([of_round, others[:: max(len(others) // _OTHERS, 1)][:_OTHERS]])
        wanted = np.repeat(T_base_tip, len(seeds), axis=0)
        solution = solve(arm, wanted, np.tile(seeds, (N, 1)), matching, steps=_STEPS)
        misses = np.linalg.norm(matching.error(solution.T_base_tool, wanted), axis=1)
        values, is_inside = inside_limits(robot, solution.q)
        misses = np.where(is_inside, misses, np.inf).reshape(N, len(seeds))
        best = np.minimum(best, misses.min(axis=1))
        limit = np.where(best < _NEARLY, np.maximum(_REACHED, _AS_NEAR * best), 0.0)
        is_solution = misses <= limit[:, None]
        values = values.reshape(N, len(seeds), count)
        before = sum(map(len, found))
        found = [
            distinct(np.concatenate([known, values[n][is_solution[n]]]))
            for n, known in enumerate(found)
        ]
        idle = idle + 1 if sum(map(len, found)) == before else 0
        if idle == _IDLE_ROUNDS:
            break
    counts = [len(values) for values in found]
    ends = np.cumsum(counts)[:-1]
    to_the_end = solve(arm, np.repeat(T_base_tip, counts, axis=0), np.concatenate(found), matching)
    values, _ = inside_limits(robot, to_the_end.q)
    return [distinct(of_pose) for of_pose in np.split(values, ends)]


def turning(robot: Robot) -> Mask:
    """Return which of the measured joints turn, shape (m,)."""
    return np.array([robot.joint_types[name] != "prismatic" for name in robot.joint_names])


def inside_limits(robot: Robot, q: Array) -> tuple[Array, Mask]:
    """Bring joint values inside their limits by whole turns.

    Args:
        robot: The robot, with m measured joints.
        q: Readings, shape (n, m), [rad] or [m].

    Returns:
        The readings at the turn inside the limits that is nearest to zero, (n, m); and which rows are inside, (n,).
    """
    low, high = (column_limits(robot) + np.array([-_ROUNDING, _ROUNDING])).T
    turns = turning(robot)
    values = robot.input_values(q)
    nearest = np.where(turns, values - _TURN * np.round(values / _TURN), values)
    up = np.where(turns & (nearest < low), nearest + _TURN, nearest)
    inside = np.where(turns & (up > high), nearest - _TURN, up)
    return robot.readings(inside), ((inside >= low) & (inside <= high)).all(axis=1)


def distinct(values: Array) -> Array:
    """Return the different rows of joint values (n, m), [rad] or [m], the first of each, shape (k, m)."""
    kept: list[Array] = []
    for row in values:
        if all(np.abs(row - other).max() > _SAME for other in kept):
            kept.append(row)
    return np.array(kept).reshape(-1, values.shape[1])
