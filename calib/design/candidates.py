"""Candidates: joint values at which the robot can be measured, drawn evenly over its joint ranges.

A scrambled Sobol sequence over the ranges is sifted, the cheap tests first, until there are enough. The poses that lie
in the measurement region, whatever else is wrong with them, are kept too: they are where accuracy is wanted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.errors import ModelError
from calib.jobs import Progress
from calib.robot.ranges import column_limits, joint_ranges
from calib.robot.robot import Robot, read_only
from calib.units import UNITS, Array

Reason = Literal["region", "tracker_range", "reflector_cone", "beam", "collision"]

#: Poses of one batch; a power of two keeps the sequence even.
_BATCH = 4096

#: So many times the number wanted are drawn at most, and so many at most until the first that can be measured.
_MOST, _NONE_YET = 40, 10 * _BATCH

#: Joint values have so many steps to a degree or millimetre, so that robot, table and plan say the same.
_STEPS = 1000

#: Margin to the ends of a sliding joint [m], where that of the others is an angle.
_SLIDING_MARGIN = 5e-3


Code = Literal[
    "generic_target",  # no target was given: planned for one at a general place, x y z [m]
    "orientation_noise",  # the noise of an orientation was assumed [rad]
    "reflector_not_checked",  # a reflector, and no tracker that it must face
    "collisions_not_checked",
    "collisions_checked",  # the holder's radius [m], and what stands around
    "no_geometry",  # links that were not checked, or not all of them
    "always_close",  # pairs that are always closer than the clearance, and refused only where they touch
    "always_touching",  # pairs that were not checked
]


class Note(NamedTuple):
    """What a person must know of a plan: a code and its values, of which `calib.text.plan` makes a sentence."""

    code: Code
    values: tuple[str | float, ...] = ()


class Condition(NamedTuple):
    """What a pose must pass, q of shape (n, m) to shape (n,), and what it is refused for otherwise.

    That of the region says where accuracy is wanted, the others what can be measured.
    """

    reason: Reason
    passes: Callable[[Array], NDArray[np.bool_]]


class Pool(NamedTuple):
    """Candidates."""

    q: Array  #: shape (n, m), the poses that passed all tests, all different, [rad] or [m].
    workspace: Array  #: shape (k, m), those in the region, among the first drawn.
    drawn: int  #: How many were drawn.
    #: How many each test refused, of those that had passed the ones before it.
    refused: dict[str, int]


def draw(
    robot: Robot,
    ranges: Array,
    tests: Sequence[Condition],
    count: int,
    seed: int,
    progress: Progress | None = None,
) -> Pool:
    """Draw candidates until ``count`` have passed all tests, or far more than that have been tried.

    The tests are asked in order, that of the region first; ``ranges`` are as in `planning_ranges`, shape (m, 2).
    """
    # Not above: SciPy's distributions take as long to import as the rest of calib.
    from scipy.stats import qmc

    engine, (low, high) = qmc.Sobol(len(ranges), scramble=True, seed=seed), ranges.T
    kept, workspace, drawn, total = [], [], 0, 0
    refused: dict[str, int] = dict.fromkeys((test.reason for test in tests), 0)
    while total < count and drawn < (_MOST * max(count, _BATCH) if total else _NONE_YET):
        q = rounded(robot, low + engine.random(_BATCH) * (high - low), ranges)[: _MOST * count]
        drawn += len(q)
        inside = q
        for test in tests:
            passed = test.passes(q) if len(q) else np.zeros(0, dtype=np.bool_)
            refused[test.reason] += int(np.sum(~passed))
            q = q[passed]
            inside = q if test.reason == "region" else inside
        workspace.append(inside)
        kept.append(q)
        total += len(q)
        if progress is not None:
            progress(min(total, count), count)
    if total == 0:
        parts = ", ".join(f"{number} by {reason}" for reason, number in refused.items() if number)
        raise ModelError(
            f"None of {drawn} poses drawn can be measured; refused: {parts}. Widen the region or the joint "
            "ranges, move the tracker, or drop a condition."
        )
    # Each once, in the order drawn: narrow ranges have few values of whole steps.
    q = np.concatenate(kept)
    q = q[np.sort(np.unique(q, axis=0, return_index=True)[1])]
    return Pool(read_only(q[:count]), read_only(np.concatenate(workspace)[:count]), drawn, refused)


def by_joint(robot: Robot, margin: float) -> Array:
    """A margin of the robot's columns, shape (m,): an angle [rad], and 5 mm for sliding joints unless it is 0."""
    slides = [joint.type == "prismatic" for joint in robot.inputs]
    return np.where(slides, _SLIDING_MARGIN * bool(margin), margin)


def planning_ranges(
    robot: Robot,
    narrowed: Mapping[str, tuple[float, float]],
    margin: float,
    *,
    turns: bool = False,
) -> Array:
    """Lowest and highest joint values to plan with, shape (m, 2), [rad] or [m].

    Those of `joint_ranges`, less a margin to the URDF's limits as in `by_joint`; with ``turns``, joints that turn
    and are not narrowed go to their limits, more than a turn where these allow it.
    """
    limits, gap = column_limits(robot), by_joint(robot, margin)
    result = np.array(joint_ranges(robot, narrowed))
    for k, joint in enumerate(robot.inputs):
        if turns and joint.type != "prismatic" and joint.name not in narrowed:
            result[k] = limits[k]
    result[:, 0] = np.maximum(result[:, 0], limits[:, 0] + gap)
    result[:, 1] = np.minimum(result[:, 1], limits[:, 1] - gap)
    empty = [name for name, (a, b) in zip(robot.joint_names, result, strict=True) if not a < b]
    if empty:
        raise ModelError(
            f"The margin to the URDF's limits leaves nothing of the range of '{empty[0]}'. Widen the range, lessen the "
            "margin, or hold the joint (--hold)."
        )
    return read_only(result)


def rounded(robot: Robot, q: Array, ranges: Array | None = None) -> Array:
    """Joint values, shape (n, m), as a table writes them, to 0.001 deg and mm, inside of ranges, shape (m, 2)."""
    slides = [joint.type == "prismatic" for joint in robot.inputs]
    unit = np.where(slides, UNITS["mm"].to_si, UNITS["deg"].to_si)
    counts = np.round(q / unit * _STEPS)
    if ranges is not None:
        low, high = ranges.T / unit * _STEPS
        counts = np.clip(counts, np.ceil(low), np.floor(high))
    # The number that stands in a table, times the factor that its reader uses: the same to the last bit.
    return np.asarray(counts / _STEPS * unit)
