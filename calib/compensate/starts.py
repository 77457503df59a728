"""Where to look for joint values: those that the nominal robot has for a pose, near the ones that are given.

With joint values for each row the solution next to them is meant. With poses alone each row follows the one before, and
the first is the solution nearest to a start, found from joint values spread over the limits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from calib.compensate.inverse import WEIGHTED, Matching, Solved, solve
from calib.compensate.nominal_actual import Arm
from calib.errors import ModelError, choices
from calib.measure.ranges import column_limits, full_ranges
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]

#: A row follows the one before if no joint moves further than this [rad or m]; else all solutions are looked at.
_NEAR = 0.5

#: The same inside of a block of rows, and the longest block.
_VERY_NEAR, _LONGEST_BLOCK = 0.1, 256

#: What is near takes no more steps than this.
_FEW_STEPS = 15

#: Sets of joint values that a solution is looked for from, and in how many steps.
_SPREAD, _STEPS = 48, 30

#: What may be left of an error [m]; and of one that can only be made small, twice the least that was found.
_REACHED = 1e-8

#: Joint values may pass their limits by this, for rounding [rad or m].
_ROUNDING = 1e-9


def following(
    arm: Arm,
    T_wanted: Array,
    start: Array,
    matching: Matching,
    progress: Callable[[int, int], None] | None = None,
) -> Solved:
    """Each row's solution follows the row before, and that of the first is the nearest to a start, shape (m,).

    A path is followed in blocks, which grow as long as all goes well: rows of a block start at the row before it.

    Args:
        arm: The nominal arm.
        T_wanted: shape (N, 4, 4), T_base_tool [m].
        start: shape (m,), where the first row starts [rad] or [m].
        matching: What of the poses is to be reached.
        progress: Called with the number of rows done and of all.
    """
    limits = column_limits(arm.robot)
    spread = _spread(arm.robot)
    count = len(T_wanted)
    q, poses = np.empty((count, len(start))), np.empty_like(T_wanted)
    q[0], poses[0] = _nearest(arm, T_wanted[0], start, np.vstack([start, spread]), matching)
    done, block = 1, 1
    while done < count:
        wanted, before = T_wanted[done : done + block], q[done - 1]
        starts = np.tile(before, (len(wanted), 1))
        solved = solve(arm, wanted, starts, matching, limits, steps=_FEW_STEPS)
        good = _good(arm, solved.q, solved.T_base_tool, wanted, matching, limits)
        jumps = np.abs(np.diff(np.vstack([before, solved.q]), axis=0)).max(axis=1)
        good &= jumps <= (_NEAR if len(wanted) == 1 else _VERY_NEAR)
        taken = len(good) if good.all() else int(np.argmin(good))
        q[done : done + taken] = solved.q[:taken]
        poses[done : done + taken] = solved.T_base_tool[:taken]
        if not taken and block == 1:
            seeds = np.vstack([before, spread])
            q[done], poses[done] = _nearest(arm, wanted[0], before, seeds, matching)
            taken = 1
        done += taken
        if progress is not None:
            progress(done, count)
        block = min(2 * block, _LONGEST_BLOCK) if taken == len(good) else 1
    return Solved(read_only(q), read_only(poses), arm.motion(q)[1])


def start_values(robot: Robot, named: Mapping[str, float] | None) -> Array:
    """Joint values to start near, shape (m,): those that are named, the others in the middle of their range.

    Raises:
        ModelError: A joint that the chain does not have.
    """
    given = dict(named or {})
    strange = [name for name in given if name not in robot.joint_names]
    if strange:
        raise ModelError(
            f"The chain has no joints {choices(strange)} to start at; it has {choices(robot.joint_names)}."
        )
    middle: Array = full_ranges(robot).mean(axis=1)
    return read_only(
        [given.get(name, value) for name, value in zip(robot.joint_names, middle, strict=True)]
    )


def _nearest(
    arm: Arm, T: Array, reference: Array, seeds: Array, matching: Matching
) -> tuple[Array, Array]:
    """Of the solutions that are found from some joint values the one nearest to a reference; or the best there is."""
    limits = column_limits(arm.robot)
    wanted = np.tile(T, (len(seeds), 1, 1))
    solved = solve(arm, wanted, seeds, matching, limits, steps=_STEPS)
    q = _turned_to(arm.robot, solved.q, reference, limits)
    good = _good(arm, q, solved.T_base_tool, wanted, matching, limits)
    distance = np.linalg.norm(q - reference, axis=1)
    if good.any():
        best = int(np.argmin(np.where(good, distance, np.inf)))
    else:
        error = np.linalg.norm(matching.error(solved.T_base_tool, wanted), axis=1)
        best = int(np.argmin(error))
    return q[best], solved.T_base_tool[best]


def _good(
    arm: Arm, q: Array, poses: Array, wanted: Array, matching: Matching, limits: Array
) -> NDArray[np.bool_]:
    """Which rows have reached what they can, inside the limits, shape (N,)."""
    error = np.linalg.norm(matching.error(poses, wanted), axis=1)
    may_be_left = matching.name == WEIGHTED and len(arm.robot.joint_names) < matching.rows
    enough = max(_REACHED, 2.0 * float(error.min())) if may_be_left else _REACHED
    inside = ((q >= limits[:, 0] - _ROUNDING) & (q <= limits[:, 1] + _ROUNDING)).all(axis=1)
    return np.asarray((error <= enough) & inside, dtype=np.bool_)


def _turned_to(robot: Robot, q: Array, reference: Array, limits: Array) -> Array:
    """The same poses with each turning joint by whole turns as near to the reference as its limits allow."""
    turn = 2.0 * np.pi
    result: Array = q.copy()
    for column, name in enumerate(robot.joint_names):
        alone = set(np.abs(robot.coupling[:, column])) <= {0.0, 1.0}
        if robot.joint_types[name] == "prismatic" or not alone:
            continue
        values = q[:, column] - turn * np.round((q[:, column] - reference[column]) / turn)
        low, high = limits[column]
        values = np.where(values > high + _ROUNDING, values - turn, values)
        values = np.where(values < low - _ROUNDING, values + turn, values)
        result[:, column] = values
    return result


def _spread(robot: Robot) -> Array:
    """Joint values spread over the limits, shape (count, m): the same for every call."""
    low, high = full_ranges(robot).T
    unit = qmc.Sobol(len(low), scramble=False).random_base2(6)[:_SPREAD]
    # Half a step inside: the first of the sequence is the corner where every joint is at its limit.
    return read_only(low + (high - low) * (unit + 0.5 / _SPREAD))
