"""Candidates: joint values at which the robot can be measured, drawn evenly over its joint ranges.

A scrambled Sobol sequence over the ranges is sifted by conditions, the cheap ones first, until there are enough. The
poses that lie in the measurement region, whatever else is wrong with them, are kept too: they are where accuracy is
wanted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.basics.arrays import Array, read_only
from calib.basics.jobs import Progress
from calib.basics.units import UNITS
from calib.errors import ModelError
from calib.robot.ranges import column_limits, joint_ranges, margins_by_joint
from calib.robot.robot import Robot

Reason = Literal[
    "region",
    "tracker_range",
    "reflector_cone",
    "beam",
    "limits",
    "focus",
    "tilt",
    "image",
    "collision",
]

#: What is easily mistaken where no image can be taken.
_HOW_THEY_FACE = (
    " Check how both are turned (--camera-at, --board-at): z of a camera is its line of sight, and z of a board points "
    "into the page, so that one that lies face up is turned by 180 deg about x."
)

#: Poses of one batch; a power of two keeps the sequence even.
_BATCH = 4096

#: At most this many times the wanted number are drawn.
_MOST = 40

#: At most this many are drawn until the first that can be measured.
_NONE_YET = 10 * _BATCH

#: Steps to a degree or millimetre of planned joint values, so that robot, table and plan have the same numbers.
_STEPS = 1000


class Condition(NamedTuple):
    """Condition that a pose must pass.

    That of the region says where accuracy is wanted, the others what can be measured.
    """

    #: Word for why a pose is refused that does not pass.
    reason: Reason
    #: Function of joint values, shape (n, m), [rad] or [m], that returns whether each pose passes, shape (n,).
    passes: Callable[[Array], NDArray[np.bool_]]


class Pool(NamedTuple):
    """Candidates of a plan."""

    #: Shape (n, m), the poses that passed all conditions, all different, [rad] or [m]; fewer than were wanted where
    #: drawing ended before.
    q: Array
    #: Shape (k, m), the first poses in the region, at most as many as candidates were wanted, whatever else refused
    #: them, [rad] or [m].
    workspace: Array
    #: Number of poses that were drawn.
    drawn: int
    #: Number that each condition refused, of those that had passed the ones before it.
    refused: dict[str, int]


class Draws(NamedTuple):
    """Numbers of poses at which drawing ends."""

    #: Candidates that are enough, 1 or more.
    enough: int
    #: Poses drawn of which none can be measured.
    none_yet: int
    #: Poses drawn, however few can be measured.
    most: int

    def most_after(self, measurable: Array) -> int:
        """Return the number of poses at which drawing ends, where those (n, m) can be measured so far."""
        return self.most if len(measurable) else self.none_yet


class _Sifted(NamedTuple):
    """Poses that were drawn, sifted by the conditions."""

    #: Number of poses that were drawn.
    drawn: int
    #: Shape (k, m), those in the region, [rad] or [m].
    in_region: Array
    #: Shape (n, m), those that passed all conditions, [rad] or [m].
    measurable: Array
    #: Number that each condition refused, by its reason.
    refused: dict[str, int]

    def joined(self, other: _Sifted) -> _Sifted:
        """Return these poses with others behind them, and the sums of the numbers drawn and refused.

        Concatenates ``in_region``, joint values of the poses in the region, shape (k, m), and ``measurable``, of those
        that passed all conditions, shape (n, m), [rad] or [m]; adds up ``drawn``, the number drawn, and ``refused``,
        the number that each condition refused, by its reason.

        Args:
            other: Poses of the same robot, sifted by the same conditions.
        """
        return _Sifted(
            drawn=self.drawn + other.drawn,
            in_region=np.concatenate([self.in_region, other.in_region]),
            measurable=np.concatenate([self.measurable, other.measurable]),
            refused={
                reason: number + other.refused[reason] for reason, number in self.refused.items()
            },
        )


def draw(
    robot: Robot,
    ranges: Array,
    conditions: Sequence[Condition],
    count: int,
    seed: int,
    progress: Progress | None = None,
) -> Pool:
    """Draw readings, evenly over the joints' ranges, until enough have passed all conditions, or too many are drawn.

    Too many are 40 times as many as are wanted (but no fewer than 163,840), or 40,960 of which none has passed. Values
    are rounded to whole steps of 0.001 deg or 0.001 mm, as tables are written.

    Args:
        robot: The robot, with m measured joints.
        ranges: Lowest and highest value of each joint, shape (m, 2), [rad] or for sliding joints [m], in the order of
            ``robot.joint_names``, see `planning_ranges`.
        conditions: Tests that a pose must pass: each has a ``reason``, a word, and a function ``passes`` of joint
            values, shape (n, m), that returns True for those that pass, shape (n,). Applied in this order, that with
            the reason ``"region"``, if any, first.
        count: Number of candidates that is enough, 1 or more.
        seed: Seed of the Sobol sequence: the same one draws the same poses.
        progress: Called after each batch with the number of candidates so far and ``count``; None: nothing is called.

    Returns:
        ``q``, joint values of the candidates, shape (n, m), [rad] or [m]: poses that passed, each once, in the order
        drawn; n is ``count``, or less where too many were drawn or poses were repeated. ``workspace``, shape (at most
        ``count``, m): the first poses that passed the region's condition (without one, all that were drawn), whether or
        not they passed the others. ``drawn``, the number of poses drawn, and ``refused``, the number that each reason
        refused, of those that had passed the conditions before it.

    Raises:
        ModelError: No pose passed.
    """
    draws = Draws(count, _NONE_YET, _MOST * max(count, _BATCH))
    batches = (batch[: _MOST * count] for batch in _batches(robot, ranges, seed))
    return collect(batches, conditions, draws, progress)


def collect(
    batches: Iterator[Array],
    conditions: Sequence[Condition],
    draws: Draws,
    progress: Progress | None = None,
) -> Pool:
    """Sift batches of poses until enough have passed all conditions, or too many are drawn.

    Args:
        batches: Joint values of poses without end, shape (any number, m) each, [rad] or for sliding joints [m].
        conditions: Tests that a pose must pass, see `draw`.
        draws: How many are enough, and how many too many.
        progress: Called after each batch with the number of candidates so far and the number wanted; None: nothing is
            called.

    Returns:
        The pool, see `draw`.

    Raises:
        ModelError: No pose passed.
    """
    count = draws.enough
    sifted = _sift(next(batches), conditions)
    while len(sifted.measurable) < count and sifted.drawn < draws.most_after(sifted.measurable):
        if progress is not None:
            progress(len(sifted.measurable), count)
        sifted = sifted.joined(_sift(next(batches), conditions))
    if progress is not None:
        progress(min(len(sifted.measurable), count), count)
    if not len(sifted.measurable):
        _refuse_all(sifted.drawn, sifted.refused)
    q = _without_repeats(sifted.measurable)
    workspace = sifted.in_region[:count]
    return Pool(read_only(q[:count]), read_only(workspace), sifted.drawn, sifted.refused)


def _batches(robot: Robot, ranges: Array, seed: int) -> Iterator[Array]:
    """Yield batches of readings at joint values from a scrambled Sobol sequence over their ranges, without end.

    Args:
        robot: The robot, with m measured joints.
        ranges: Lowest and highest value of each joint, shape (m, 2), [rad] or for sliding joints [m].
        seed: Seed of the scrambling.

    Yields:
        Readings, shape (4096, m), [rad] or [m], rounded to whole steps of 0.001 deg or 0.001 mm, at which the joints
        are within their ranges.
    """
    # Not above: SciPy's distributions take as long to import as the rest of calib.
    from scipy.stats import qmc

    sequence = qmc.Sobol(len(ranges), scramble=True, seed=seed)
    is_coupled = bool(robot.reading_coupling)
    low, high = _ranges_less_rounding(robot, ranges).T if is_coupled else ranges.T
    while True:
        unit = sequence.random(_BATCH)
        values = low + unit * (high - low)
        if is_coupled:
            yield rounded(robot, robot.readings(values))
        else:
            yield rounded(robot, values, ranges)


def _ranges_less_rounding(robot: Robot, ranges: Array) -> Array:
    """Return ranges of joints less what they move by if all readings are rounded, at most to their middle.

    Args:
        robot: The robot, with m measured joints whose readings are coupled.
        ranges: Lowest and highest value of each joint, shape (m, 2), [rad] or for sliding joints [m].
    """
    half_steps = 0.5 / _STEPS * _table_units(robot)
    moved = np.abs(robot.reading_matrix) @ half_steps
    moved = np.minimum(moved, 0.5 * np.ptp(ranges, axis=1))
    return np.column_stack([ranges[:, 0] + moved, ranges[:, 1] - moved])


def _sift(q: Array, conditions: Sequence[Condition]) -> _Sifted:
    """Test poses by each condition in turn; what one refuses, the later ones do not see.

    Args:
        q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m].
        conditions: Tests, each with a ``reason``, a word, and a function ``passes`` of joint values, shape (n, m), that
            returns True for those that pass, shape (n,); in the order to apply.

    Returns:
        ``drawn``, the number n; ``measurable``, joint values of the poses that pass all conditions; ``in_region``, of
        those that pass the conditions up to the one with the reason ``"region"`` (without it all n poses); and
        ``refused``, how many poses each reason refused.
    """
    in_region = measurable = q
    refused: dict[str, int] = dict.fromkeys((condition.reason for condition in conditions), 0)
    for condition in conditions:
        passes = np.zeros(0, dtype=np.bool_)
        if len(measurable):
            passes = condition.passes(measurable)
        refused[condition.reason] += int(np.sum(~passes))
        measurable = measurable[passes]
        if condition.reason == "region":
            in_region = measurable
    return _Sifted(len(q), in_region, measurable, refused)


def _refuse_all(drawn: int, refused: Mapping[str, int]) -> None:
    """Raise the error that no pose can be measured, with the reasons.

    Args:
        drawn: Number of poses that were drawn.
        refused: Number of poses that were refused, by reason; reasons with 0 are left out of the message.

    Raises:
        ModelError: Always.
    """
    instrument, hint = "tracker", ""
    if {"focus", "tilt", "image"} & refused.keys():
        instrument, hint = "board or the camera", _HOW_THEY_FACE
    parts = ", ".join(f"{number} by {reason}" for reason, number in refused.items() if number)
    raise ModelError(
        f"None of {drawn} poses drawn can be measured; refused: {parts}. Widen the region or the "
        f"joint ranges, move the {instrument}, or drop a condition.{hint}"
    )


def _without_repeats(q: Array) -> Array:
    """Return each pose once, where it was drawn first: narrow ranges have few values of whole steps.

    Args:
        q: Joint values of n poses in the order drawn, shape (n, m), [rad] or [m].

    Returns:
        The different rows of ``q`` in the same order, shape (n or fewer, m).
    """
    _, first = np.unique(q, axis=0, return_index=True)
    return q[np.sort(first)]


def planning_ranges(
    robot: Robot,
    narrowed: Mapping[str, tuple[float, float]],
    margin: float,
    *,
    turns: bool = False,
) -> Array:
    """Return the lowest and highest joint values to plan with, which keep a margin to the URDF's limits.

    Args:
        robot: The robot, with m measured joints.
        narrowed: Lowest and highest value by the joint's name [rad] or for sliding joints [m], for the joints whose
            range is to be narrowed. The others go everywhere they can: those that turn through one whole turn at most,
            the one nearest to zero, and sliding ones without limits 1 m to both sides of zero.
        margin: Distance to the URDF's limits of joints that turn [rad]; sliding joints keep 5 mm, unless it is 0.
        turns: True: joints that turn, and are not narrowed, go from limit to limit, also where these are more than a
            turn apart, or infinite.

    Returns:
        Shape (m, 2), lowest and highest value, [rad] or [m], in the order of ``robot.joint_names``, read-only.

    Raises:
        ModelError: The margin leaves nothing of a range.
        CalibError: A narrowed joint that the robot does not have, or a range that its limits do not allow.
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
    """Round joint values to what a table writes: whole steps of 0.001 deg or, of sliding joints, 0.001 mm.

    Args:
        robot: The robot, with m measured joints.
        q: Joint values of n poses, shape (n, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.
        ranges: Lowest and highest value of each joint, shape (m, 2), [rad] or [m], between which the rounded values
            stay; None: they may be anywhere.

    Returns:
        The rounded values, still in [rad] or [m], shape (n, m).
    """
    unit = _table_units(robot)
    counts = np.round(q / unit * _STEPS)
    if ranges is not None:
        low, high = ranges.T / unit * _STEPS
        counts = np.clip(counts, np.ceil(low), np.floor(high))
    # The number in a table, times the factor that its reader uses: the same to the last bit.
    return np.asarray(counts / _STEPS * unit)


def _table_units(robot: Robot) -> Array:
    """Return the unit of each column of a planned table, 1 deg or of sliding joints 1 mm, shape (m,), [rad] or [m]."""
    slides = [joint.type == "prismatic" for joint in robot.inputs]
    return np.where(slides, UNITS["mm"].to_si, UNITS["deg"].to_si)
