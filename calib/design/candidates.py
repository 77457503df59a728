"""Candidates: joint values at which the robot can be measured, drawn evenly over its joint ranges.

A scrambled Sobol sequence over the ranges is sifted by conditions, the cheap ones first, until there are enough. The
poses that lie in the measurement region, whatever else is wrong with them, are kept too: they are where accuracy is
wanted.
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

#: At most this many times the wanted number are drawn.
_MOST = 40

#: At most this many are drawn until the first that can be measured.
_NONE_YET = 10 * _BATCH

#: Steps to a degree or millimetre of planned joint values, so that robot, table and plan have the same numbers.
_STEPS = 1000

#: Margin to the ends of a sliding joint [m], where that of the others is an angle.
_SLIDING_MARGIN = 5e-3


class Condition(NamedTuple):
    """Condition that a pose must pass.

    That of the region says where accuracy is wanted, the others what can be measured.
    """

    #: Why a pose is refused that does not pass.
    reason: Reason
    #: Of poses (n, m) [rad] or [m], whether each passes, (n,).
    passes: Callable[[Array], NDArray[np.bool_]]


class Pool(NamedTuple):
    """Candidates of a plan."""

    #: Shape (n, m), the poses that passed all conditions, all different, [rad] or [m].
    q: Array
    #: Shape (k, m), those in the region, among the first drawn.
    workspace: Array
    #: Number of poses that were drawn.
    drawn: int
    #: Number that each condition refused, of those that had passed the ones before it.
    refused: dict[str, int]


def draw(
    robot: Robot,
    ranges: Array,
    conditions: Sequence[Condition],
    count: int,
    seed: int,
    progress: Progress | None = None,
) -> Pool:
    """Draw candidates until enough have passed all conditions, or far more than that have been tried.

    Args:
        robot: The robot.
        ranges: Lowest and highest value of each joint, shape (m, 2), [rad] or [m], see `planning_ranges`.
        conditions: Tested in this order, that of the region first.
        count: Number of candidates that is enough.
        seed: Of the Sobol sequence.
        progress: Called with the candidates there are and the number wanted.

    Returns:
        The candidates, in the order drawn.

    Raises:
        ModelError: No pose passed.
    """
    # Not above: SciPy's distributions take as long to import as the rest of calib.
    from scipy.stats import qmc

    sequence = qmc.Sobol(len(ranges), scramble=True, seed=seed)
    low, high = ranges.T
    measurable, in_region = np.empty((0, len(ranges))), np.empty((0, len(ranges)))
    refused: dict[str, int] = dict.fromkeys((condition.reason for condition in conditions), 0)
    drawn = 0
    while len(measurable) < count and drawn < _most(len(measurable), count):
        unit = sequence.random(_BATCH)
        batch = rounded(robot, low + unit * (high - low), ranges)[: _MOST * count]
        drawn += len(batch)
        batch_in_region, batch_measurable = _sift(batch, conditions, refused)
        in_region = np.concatenate([in_region, batch_in_region])
        measurable = np.concatenate([measurable, batch_measurable])
        if progress is not None:
            progress(min(len(measurable), count), count)
    if not len(measurable):
        _refuse_all(drawn, refused)
    q = _without_repeats(measurable)
    return Pool(read_only(q[:count]), read_only(in_region[:count]), drawn, refused)


def _most(measurable: int, count: int) -> int:
    """Return how many poses are drawn at most, by the number that can be measured so far."""
    return _MOST * max(count, _BATCH) if measurable else _NONE_YET


def _sift(
    q: Array, conditions: Sequence[Condition], refused: dict[str, int]
) -> tuple[Array, Array]:
    """Test poses by each condition in turn.

    Args:
        q: shape (n, m), [rad] or [m].
        conditions: In order.
        refused: Number refused by reason; those of these poses are added to it.

    Returns:
        The poses in the region, and those that pass all conditions.
    """
    in_region = q
    for condition in conditions:
        passes = condition.passes(q) if len(q) else np.zeros(0, dtype=np.bool_)
        refused[condition.reason] += int(np.sum(~passes))
        q = q[passes]
        if condition.reason == "region":
            in_region = q
    return in_region, q


def _refuse_all(drawn: int, refused: Mapping[str, int]) -> None:
    """Raise the error that no pose can be measured, with the reasons."""
    parts = ", ".join(f"{number} by {reason}" for reason, number in refused.items() if number)
    raise ModelError(
        f"None of {drawn} poses drawn can be measured; refused: {parts}. Widen the region or the "
        "joint ranges, move the tracker, or drop a condition."
    )


def _without_repeats(q: Array) -> Array:
    """Return each pose once, in the order drawn: narrow ranges have few values of whole steps."""
    _, first = np.unique(q, axis=0, return_index=True)
    return q[np.sort(first)]


def margins_by_joint(robot: Robot, margin: float) -> Array:
    """Return the margin to the limits of each of the robot's joints, shape (m,), [rad] or [m].

    Args:
        robot: The robot.
        margin: Margin of joints that turn [rad]; that of sliding joints is 5 mm, unless this is 0.
    """
    slides = [joint.type == "prismatic" for joint in robot.inputs]
    return np.where(slides, _SLIDING_MARGIN * bool(margin), margin)


def planning_ranges(
    robot: Robot,
    narrowed: Mapping[str, tuple[float, float]],
    margin: float,
    *,
    turns: bool = False,
) -> Array:
    """Return the lowest and highest joint values to plan with.

    Args:
        robot: The robot.
        narrowed: Ranges of single joints by name [rad] or [m].
        margin: Distance to the URDF's limits of joints that turn [rad]; see `margins_by_joint` for those that slide.
        turns: Whether joints that turn, and are not narrowed, go to their limits where these allow more than a turn.

    Returns:
        shape (m, 2), [rad] or [m], read-only.

    Raises:
        ModelError: The margin leaves nothing of a range.
    """
    limits = column_limits(robot)
    gap = margins_by_joint(robot, margin)
    ranges = np.array(joint_ranges(robot, narrowed))
    for k, joint in enumerate(robot.inputs):
        if turns and joint.type != "prismatic" and joint.name not in narrowed:
            ranges[k] = limits[k]
    ranges[:, 0] = np.maximum(ranges[:, 0], limits[:, 0] + gap)
    ranges[:, 1] = np.minimum(ranges[:, 1], limits[:, 1] - gap)
    for name, (low, high) in zip(robot.joint_names, ranges, strict=True):
        if not low < high:
            raise ModelError(
                f"The margin to the URDF's limits leaves nothing of the range of '{name}'. Widen "
                "the range, lessen the margin, or hold the joint (--hold)."
            )
    return read_only(ranges)


def rounded(robot: Robot, q: Array, ranges: Array | None = None) -> Array:
    """Round joint values to what a table writes: 0.001 deg and 0.001 mm.

    Args:
        robot: The robot.
        q: shape (n, m), [rad] or [m].
        ranges: shape (m, 2), between which the rounded values stay; None: anywhere.

    Returns:
        shape (n, m), [rad] or [m].
    """
    slides = [joint.type == "prismatic" for joint in robot.inputs]
    unit = np.where(slides, UNITS["mm"].to_si, UNITS["deg"].to_si)
    counts = np.round(q / unit * _STEPS)
    if ranges is not None:
        low, high = ranges.T / unit * _STEPS
        counts = np.clip(counts, np.ceil(low), np.floor(high))
    # The number in a table, times the factor that its reader uses: the same to the last bit.
    return np.asarray(counts / _STEPS * unit)
