"""Candidates: joint values at which the robot can be measured, drawn evenly over its joint ranges.

A scrambled Sobol sequence over the ranges is sifted, the cheap tests first, until there are enough. The poses that lie
in the measurement region, whatever else is wrong with them, are kept too: they are where accuracy is wanted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.data.ranges import column_limits, joint_ranges, range_text
from calib.errors import ModelError
from calib.robot.robot import Robot, read_only
from calib.units import UNITS

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]

#: Poses of one batch; a power of two keeps the sequence even.
_BATCH = 4096

#: Candidates are drawn until so many times the number wanted have been tried.
_MOST = 40

#: After so many without one that can be measured it is given up.
_NONE_YET = 10 * _BATCH

#: Joint values have so many steps to a degree or millimetre, so that robot, table and plan say the same.
_STEPS = 1000

#: Margin to the ends of a sliding joint [m], where that of the others is an angle.
_SLIDING_MARGIN = 5e-3


@dataclass(frozen=True, slots=True)
class Condition:
    """What a pose must pass, q of shape (n, m) to shape (n,), and in a few words why a pose is refused that does not.

    One of ``where`` says where accuracy is wanted, not only what can be measured.
    """

    reason: str
    passes: Callable[[Array], NDArray[np.bool_]]
    where: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Pool:
    """Candidates.

    Attributes:
        q: shape (n, m), the poses that passed all tests, all different, [rad] or [m].
        workspace: shape (k, m), those that passed the tests of where, among the first drawn.
        drawn: How many were drawn.
        refused: How many each test refused, of those that had passed the tests before it.
    """

    q: Array
    workspace: Array
    drawn: int
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

    Args:
        robot: The robot.
        ranges: shape (m, 2), see `planning_ranges`.
        tests: In order, but those of ``where`` first.
        count: Candidates wanted.
        seed: The same seed draws the same poses.
        progress: Called with what was kept and what is wanted.

    Raises:
        ModelError: None passed; the text says which tests refused how many.
    """
    # Not above: SciPy's distributions take as long to import as the rest of calib.
    from scipy.stats import qmc

    engine = qmc.Sobol(len(ranges), scramble=True, seed=seed)
    low, high = ranges.T
    kept: list[Array] = []
    workspace: list[Array] = []
    refused = {test.reason: 0 for test in tests}
    drawn = total = 0
    while total < count and drawn < (_MOST * max(count, _BATCH) if total else _NONE_YET):
        q = rounded(robot, low + engine.random(_BATCH) * (high - low), ranges)[: _MOST * count]
        drawn += len(q)
        for sifted, where in ((workspace, True), (kept, False)):
            for test in tests:
                if test.where == where and len(q):
                    passed = test.passes(q)
                    refused[test.reason] += int(np.sum(~passed))
                    q = q[passed]
            sifted.append(q)
        total += len(q)
        if progress is not None:
            progress(min(total, count), count)
    if total == 0:
        parts = [f"{count} {reason}" for reason, count in refused.items() if count]
        raise ModelError(
            f"None of {drawn} poses drawn can be measured: {', '.join(parts)}. Widen the region or the joint ranges, "
            "move the tracker, or drop a condition."
        )
    q = np.concatenate(kept)
    # Each once, in the order drawn: narrow ranges have few values of whole steps.
    q = q[np.sort(np.unique(q, axis=0, return_index=True)[1])]
    return Pool(read_only(q[:count]), read_only(np.concatenate(workspace)[:count]), drawn, refused)


def planning_ranges(
    robot: Robot, narrowed: Mapping[str, tuple[float, float]], margin: float
) -> Array:
    """Lowest and highest joint values to plan with, shape (m, 2), [rad] or [m].

    Those of `calib.data.ranges.joint_ranges`, less a margin to the URDF's limits [rad]; of sliding joints 5 mm, if
    the margin is not 0.

    Raises:
        CalibError: An unknown joint, a range that leaves the limits, or one of which the margin leaves nothing.
    """
    asked = joint_ranges(robot, narrowed)
    result, limits = np.array(asked), column_limits(robot)
    for k, name in enumerate(robot.joint_names):
        slides = robot.joint_types[name] == "prismatic"
        gap = _SLIDING_MARGIN * bool(margin) if slides else margin
        result[k] = max(asked[k, 0], limits[k, 0] + gap), min(asked[k, 1], limits[k, 1] - gap)
        if not result[k, 0] < result[k, 1]:
            gap_text = f"{1e3 * gap:g} mm" if slides else f"{math.degrees(gap):g} deg"
            raise ModelError(
                f"The margin of {gap_text} to the URDF's limits leaves nothing of the range of '{name}', "
                f"{range_text(robot, name, asked[k])}. Widen the range, lessen the margin, or hold the joint (--hold)."
            )
    return read_only(result)


def turn_limits(robot: Robot, narrowed: Mapping[str, tuple[float, float]], margin: float) -> Array:
    """Between which values joints may stand when they are driven, shape (m, 2), [rad] or [m].

    Those of the URDF less a margin, wider than a turn where they are; where ranges are given, as `planning_ranges`.
    """
    result = np.array(planning_ranges(robot, narrowed, margin))
    limits = column_limits(robot)
    for k, name in enumerate(robot.joint_names):
        if name not in narrowed and robot.joint_types[name] != "prismatic":
            result[k] = limits[k] + np.array([margin, -margin])
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
