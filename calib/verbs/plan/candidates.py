"""Candidates: joint values at which the robot can be measured, drawn and sifted by conditions until there are enough.

An instrument that sees most poses gets a scrambled Sobol sequence over the joints' ranges. Poses that lie in the
measurement region, whatever else is wrong with them, are kept too: they are where accuracy is wanted.

Random joint values rarely show a camera its board. So viewpoints are drawn first, and the robot is brought to each as
near as inverse kinematics lead, from the joint values whose view is nearest to it. What it reaches is tested, not what
was wanted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import chain
from typing import NamedTuple

import numpy as np

from calib.basics.arrays import Array, Mask, read_only
from calib.basics.jobs import Progress
from calib.basics.units import UNITS
from calib.errors import ModelError
from calib.instruments.instrument import Condition, Instrument, Sightline
from calib.robot.ranges import column_limits, joint_ranges, margins_by_joint, spread_between
from calib.robot.robot import Robot
from calib.verbs.compensate.inverse import POSE, Matching, solve
from calib.verbs.compensate.nominal_actual import Arm

#: What is easily mistaken if no image can be taken.
_HOW_THEY_FACE = (
    " Check how both are turned (--camera-at, --board-at): z of a camera is its line of sight, and z of a board points "
    "into the page, so that one that lies face up is turned by 180 deg about x."
)

#: Steps to a degree or millimetre of planned joint values, so that robot, table and plan have the same numbers.
_STEPS = 1000

#: Viewpoints drawn for each that is tried: of those with the board in the image the robot tries the nearest.
_CHOICE = 8

#: Joint values among which those to start at are looked for.
_STARTS = 2048

#: Distance that counts as much as a turn by one radian between views, and for inverse kinematics [m].
_RADIAN = 0.3

#: Steps of the inverse kinematics at most.
_STEPS_TO_REACH = 8

_TURN = 2.0 * np.pi


class Drawing(NamedTuple):
    """How many poses are drawn."""

    #: Candidates that are enough, unless a number is given.
    enough: int
    #: Poses of one batch; a power of two keeps the sequence even.
    batch: int
    #: At most this many times the wanted number of poses are drawn, or this many batches if that is more.
    most: int
    #: At most this many batches are drawn until the first pose that can be measured.
    none_yet: int


#: Of an instrument that sees most poses.
EVEN = Drawing(enough=20_000, batch=4096, most=40, none_yet=10)

#: Towards viewpoints: an image has many rows, and good ones are alike.
TOWARDS_VIEWPOINTS = Drawing(enough=600, batch=512, most=10, none_yet=8)


class Pool(NamedTuple):
    """Candidates of a plan."""

    #: Shape (n, m), the poses that passed all conditions, all different, [rad] or [m]; fewer than were wanted if
    #: drawing ended before.
    q: Array
    #: Shape (k, m), poses over which accuracy counts, whatever else refused them, [rad] or [m].
    workspace: Array
    #: Shape (k, m), as many poses at which something is measured, [rad] or [m].
    measurable: Array
    #: Number of poses that were drawn.
    drawn: int
    #: Number that each condition refused, of those that had passed the ones before it.
    refused: dict[str, int]


def drawing_of(instrument: Instrument) -> Drawing:
    """Return how candidates of an instrument are drawn."""
    return TOWARDS_VIEWPOINTS if instrument.VIEWPOINT_NUMBERS else EVEN


def draw(
    robot: Robot,
    ranges: Array,
    conditions: Sequence[Condition],
    count: int,
    seed: int,
    progress: Progress | None = None,
) -> Pool:
    """Draw readings, evenly over the joints' ranges, until enough have passed all conditions, or too many are drawn.

    Values are rounded to whole steps of 0.001 deg or 0.001 mm, as tables are written.

    Args:
        robot: The robot, with m measured joints.
        ranges: Lowest and highest value of each joint, shape (m, 2), [rad] or for sliding joints [m], see
            `planning_ranges`.
        conditions: What a pose must pass, in this order; that with the reason ``"region"``, if any, first.
        count: Number of candidates that is enough, 1 or more.
        seed: Seed of the Sobol sequence: the same one draws the same poses.
        progress: Called after each batch with the number of candidates so far and ``count``; None: nothing is called.

    Returns:
        The candidates in the order drawn. The workspace are the first poses that passed the region's condition (without
        one, all that were drawn), as many as are wanted.

    Raises:
        ModelError: No pose passed.
    """
    batches = (batch[: EVEN.most * count] for batch in _even_batches(robot, ranges, seed))
    return _collect(batches, conditions, EVEN, count, progress)


def draw_towards(
    instrument: Instrument,
    sightline: Sightline,
    ranges: Array,
    conditions: Sequence[Condition],
    count: int,
    seed: int,
    progress: Progress | None = None,
) -> Pool:
    """Draw readings that bring a robot near to an instrument's viewpoints, until enough have passed all conditions.

    Args:
        instrument: Knows from where a target is measured well.
        sightline: The instrument and its target.
        ranges: Lowest and highest value of each joint, shape (m, 2), [rad] or for sliding joints [m]. Readings beyond
            them are refused for ``"limits"``, before all other reasons.
        conditions: What a pose must pass, in this order.
        count: Number of candidates that is enough, 1 or more.
        seed: The same one draws the same poses.
        progress: Called after each batch with the number of candidates so far and ``count``; None: nothing is called.

    Returns:
        The candidates. The workspace are as many poses spread over the joints' ranges, wherever the instrument looks.

    Raises:
        ModelError: The target is seen at no pose that was drawn.
    """
    robot = sightline.robot
    within = Condition("limits", partial(_are_within, robot, ranges))
    batches = _batches_near_viewpoints(instrument, sightline, ranges, seed)
    pool = _collect(batches, [within, *conditions], TOWARDS_VIEWPOINTS, count, progress)
    workspace = robot.readings(spread_between(ranges, len(pool.q)))
    return pool._replace(workspace=read_only(workspace), measurable=pool.q)


def _collect(
    batches: Iterator[Array],
    conditions: Sequence[Condition],
    drawing: Drawing,
    count: int,
    progress: Progress | None,
) -> Pool:
    """Sift batches of poses (any number, m) until enough have passed all conditions, or too many are drawn."""
    refused: dict[str, int] = dict.fromkeys((condition.reason for condition in conditions), 0)
    first = next(batches)
    measurable, in_region, drawn = first[:0], first[:0], 0
    for batch in chain([first], batches):
        drawn += len(batch)
        in_region_now = passed = batch
        for condition in conditions:
            passes = condition.passes(passed) if len(passed) else np.zeros(0, dtype=np.bool_)
            refused[condition.reason] += int(np.sum(~passes))
            passed = passed[passes]
            if condition.reason == "region":
                in_region_now = passed
        in_region = np.concatenate([in_region, in_region_now])
        measurable = np.concatenate([measurable, passed])
        if progress is not None:
            progress(min(len(measurable), count), count)
        most = drawing.most * max(count, drawing.batch)
        if not len(measurable):
            most = drawing.none_yet * drawing.batch
        if len(measurable) >= count or drawn >= most:
            break
    if not len(measurable):
        _refuse_all(drawn, refused)
    # Narrow ranges have few values of whole steps: each pose once, where it was drawn first.
    _, once = np.unique(measurable, axis=0, return_index=True)
    q = read_only(measurable[np.sort(once)][:count])
    workspace = read_only(in_region[:count])
    return Pool(q, workspace, workspace, drawn, refused)


def _refuse_all(drawn: int, refused: Mapping[str, int]) -> None:
    """Raise the `ModelError` that no pose can be measured, with the reasons that refused any."""
    instrument, hint = "tracker", ""
    if {"focus", "tilt", "image"} & refused.keys():
        instrument, hint = "board or the camera", _HOW_THEY_FACE
    parts = ", ".join(f"{number} by {reason}" for reason, number in refused.items() if number)
    raise ModelError(
        f"None of {drawn} poses drawn can be measured; refused: {parts}. Widen the region or the "
        f"joint ranges, move the {instrument}, or drop a condition.{hint}"
    )


def _even_batches(robot: Robot, ranges: Array, seed: int) -> Iterator[Array]:
    """Yield batches of readings (4096, m) at joint values from a scrambled Sobol sequence over ranges, without end."""
    # Not above: SciPy's distributions take as long to import as the rest of calib.
    from scipy.stats import qmc

    sequence = qmc.Sobol(len(ranges), scramble=True, seed=seed)
    is_coupled = bool(robot.reading_coupling)
    low, high = ranges.T
    if is_coupled:
        # Less what the joints move by if all readings are rounded, at most to the middle.
        moved = np.abs(robot.reading_matrix) @ (0.5 / _STEPS * _table_units(robot))
        moved = np.minimum(moved, 0.5 * np.ptp(ranges, axis=1))
        low, high = low + moved, high - moved
    while True:
        unit = sequence.random(EVEN.batch)
        values = low + unit * (high - low)
        if is_coupled:
            yield rounded(robot, robot.readings(values))
        else:
            yield rounded(robot, values, ranges)


def _batches_near_viewpoints(
    instrument: Instrument, sightline: Sightline, ranges: Array, seed: int
) -> Iterator[Array]:
    """Yield batches of readings (512 or fewer, m) that bring the robot near to viewpoints, without end."""
    # Not above: SciPy's distributions take as long to import as the rest of calib.
    from scipy.stats import qmc

    robot = sightline.robot
    slides = np.array([joint.type == "prismatic" for joint in robot.inputs])
    sequence = qmc.Sobol(instrument.VIEWPOINT_NUMBERS, scramble=True, seed=seed)
    starts = robot.readings(spread_between(ranges, _STARTS))
    views = _coordinates(sightline.target_poses(starts))
    while True:
        unit = sequence.random(_CHOICE * TOWARDS_VIEWPOINTS.batch)
        T_instrument_target = instrument.viewpoints(unit)
        wanted = _coordinates(T_instrument_target)
        # By squares of distances, less those that are the same for all.
        start = np.argmin(np.sum(views**2, axis=1) - 2.0 * wanted @ views.T, axis=1)
        distance = np.linalg.norm(views[start] - wanted, axis=1)
        near = np.argsort(distance)[: TOWARDS_VIEWPOINTS.batch]
        T_base_tip = sightline.tip_poses(T_instrument_target[near])
        q = reach(robot, ranges, T_base_tip, starts[start[near]])
        # Joints that turn are moved by whole turns into their ranges, if that can be.
        values = robot.input_values(q)
        inside = values - _TURN * np.round((values - ranges.mean(axis=1)) / _TURN)
        yield rounded(robot, robot.readings(np.where(slides, values, inside)))


def reach(robot: Robot, ranges: Array, T_base_tip: Array, start: Array) -> Array:
    """Bring the tip of a robot as near to poses as a few steps of inverse kinematics lead: near is enough.

    Args:
        robot: The robot.
        ranges: Lowest and highest value of each joint, shape (m, 2), [rad] or for sliding joints [m].
        T_base_tip: Wanted poses, shape (N, 4, 4), [m].
        start: Readings of the joints to start at, shape (N, m), [rad] or [m].

    Returns:
        Readings, shape (N, m), [rad] or [m]; those of an arm without redundant joints may be beyond their ranges.
    """
    arm = Arm.of(robot, np.eye(4))
    return solve(arm, T_base_tip, start, Matching(POSE, _RADIAN), ranges, steps=_STEPS_TO_REACH).q


def _coordinates(T: Array) -> Array:
    """Return poses (n, 4, 4) as coordinates (n, 12) [m], whose distances weigh shifts and turns."""
    # Of a small turn by an angle a, the nine entries of the matrix change by a sqrt(2) in all.
    turns = T[:, :3, :3].reshape(-1, 9) * (_RADIAN / np.sqrt(2.0))
    return np.concatenate([T[:, :3, 3], turns], axis=1)


def _are_within(robot: Robot, ranges: Array, q: Array) -> Mask:
    """Test whether all joints are between their lowest and highest values (m, 2), at readings (n, m); shape (n,)."""
    values = robot.input_values(q)
    return np.asarray(((values >= ranges[:, 0]) & (values <= ranges[:, 1])).all(axis=1))


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
        turns: True: joints that turn, and are not narrowed, go from limit to limit, also if these are more than a turn
            apart, or infinite.

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
