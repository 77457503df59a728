"""Candidates: joint values at which the robot can be measured, drawn and sifted by conditions until there are enough.

For an instrument that sees most poses, they are a scrambled Sobol sequence over the joints' ranges. Poses in the
measurement region are kept too, even if another condition refuses them: accuracy is wanted there.

At random joint values a camera rarely sees its board. So viewpoints are drawn first, and inverse kinematics brings the
robot near to each, starting from the joint values whose view is nearest. The pose that it reaches is tested, not the
one that was wanted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, combinations
from typing import NamedTuple

import numpy as np

from calib.basics.arrays import Array, Mask, read_only, rigid_inverse
from calib.basics.jobs import Progress
from calib.basics.units import UNITS
from calib.errors import ModelError
from calib.instruments.instrument import Condition, Instrument, Sightline
from calib.robot.ranges import (
    column_limits,
    joint_ranges,
    margins_by_joint,
    scrambled_sobol,
    spread_between,
)
from calib.robot.robot import Robot
from calib.verbs.compensate.inverse import POSE, Matching, solve
from calib.verbs.compensate.nominal_actual import Arm

#: Hint on the usual mistake if no image can be taken.
_HOW_THEY_FACE = (
    " Check how both are turned (--camera-at, --board-at): z of a camera is its line of sight, and z of a board points "
    "into the page, so that one that lies face up is turned by 180 deg about x."
)

#: Steps to a degree or millimetre of planned joint values, so that robot, table and plan have the same numbers.
_STEPS = 1000

#: Number of viewpoints drawn for each one that is tried: the robot tries the nearest ones.
_CHOICE = 8

#: Number of joint values among which those to start from are chosen.
_STARTS = 2048

#: Distance that counts as much as a rotation by one radian, between views and for inverse kinematics [m].
_RADIAN = 0.3

#: Largest number of steps of the inverse kinematics.
_STEPS_TO_REACH = 8

_TURN = 2.0 * np.pi


class Drawing(NamedTuple):
    """Numbers of poses that are drawn."""

    #: Number of candidates that is enough, unless another one is given.
    enough: int
    #: Number of poses in a batch; a power of two keeps the sequence even.
    batch: int
    #: Largest number of draws for each wanted candidate, or of batches if that is more.
    most: int
    #: Largest number of batches without any pose that can be measured.
    none_yet: int


#: For an instrument that sees most poses.
EVEN = Drawing(enough=20_000, batch=4096, most=40, none_yet=10)

#: Towards viewpoints: an image has many rows, and good images are similar.
TOWARDS_VIEWPOINTS = Drawing(enough=600, batch=512, most=10, none_yet=8)


class Pool(NamedTuple):
    """Candidates of a plan."""

    #: Shape (n, m), the poses that passed all conditions, all different, [rad] or [m]; fewer than were wanted if too
    #: many had to be drawn.
    q: Array
    #: Shape (k, m), poses over which accuracy counts, even if they cannot be measured, [rad] or [m].
    workspace: Array
    #: Shape (k, m), as many poses at which something can be measured, [rad] or [m].
    measurable: Array
    #: Number of poses that were drawn.
    drawn: int
    #: Number of poses that each condition refused, of those that had passed the conditions before it.
    refused: dict[str, int]
    #: Shape (n, v), which of the v views of a cell measure at each candidate; None: all, as there is one.
    seen: Mask | None = None


def drawing_of(instrument: Instrument) -> Drawing:
    """Return the numbers of poses to draw for an instrument: fewer if it has viewpoints."""
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
        conditions: Conditions that a pose must pass, in this order; that with the reason ``"region"``, if any, first.
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
    """Draw readings that bring a robot near the viewpoints of an instrument, until enough have passed all conditions.

    Args:
        instrument: Has the viewpoints.
        sightline: The instrument and its target.
        ranges: Lowest and highest value of each joint, shape (m, 2), [rad] or for sliding joints [m]. Readings beyond
            them are refused for ``"limits"``, before all other reasons.
        conditions: Conditions that a pose must pass, in this order.
        count: Number of candidates that is enough, 1 or more.
        seed: The same one draws the same poses.
        progress: Called after each batch with the number of candidates so far and ``count``; None: nothing is called.

    Returns:
        The candidates. The workspace are as many poses spread over the joints' ranges, wherever the instrument looks.

    Raises:
        ModelError: The target is seen at no pose that was drawn.
    """
    robot = sightline.robot

    def are_within(q: Array) -> Mask:
        """Return at which readings (N, m) all joints are within their ranges, (N,)."""
        values = robot.input_values(q)
        return np.asarray(((values >= ranges[:, 0]) & (values <= ranges[:, 1])).all(axis=1))

    within = Condition("limits", are_within)
    batches = _batches_near_viewpoints(instrument, sightline, ranges, seed)
    pool = _collect(batches, [within, *conditions], TOWARDS_VIEWPOINTS, count, progress)
    workspace = robot.readings(spread_between(ranges, len(pool.q)))
    return pool._replace(workspace=read_only(workspace), measurable=pool.q)


def combined(chains: Sequence[Robot], pools: Sequence[Pool], ranges: Array) -> Array:
    """Return poses at which two views may measure at once, made of a candidate of each, shape (n, m), [rad] or [m].

    The joints that both chains share stay as in the candidate of the first view. Those that the second chain alone has
    bring its target to where it is, before its instrument, in the candidate of the second view whose shared joints are
    nearest: one arm to the board of the other arm's candidate, before a camera on the head as it stands there.

    Args:
        chains: The chain of each view, with the same m columns of q.
        pools: The candidates of each view.
        ranges: Lowest and highest value of each joint, shape (m, 2), [rad] or for sliding joints [m].
    """
    moved = [np.any(chain.mimic_matrix @ chain.reading_matrix, axis=0) for chain in chains]
    poses = [pools[0].q[:0]]
    for v, w in combinations(range(len(pools)), 2):
        own, shared = moved[w] & ~moved[v], moved[w] & moved[v]
        if not own.any():
            continue
        q, other = pools[v].q.copy(), pools[w].q
        if shared.any():
            away = np.abs(q[:, None, shared] - other[None, :, shared]).max(axis=2)
            other = other[np.argmin(away, axis=1)]
        else:
            other = other[np.arange(len(q)) % len(other)]
        q[:, own] = other[:, own]
        joint_is_own = np.any(chains[w].mimic_matrix[:, own], axis=1)
        first = int(np.argmax(joint_is_own))
        if first > 0 and joint_is_own[first:].all():  # its own joints carry the target
            root = chains[w].joints[first].parent
            limb, before = chains[w].rebuilt(base=root), chains[w].rebuilt(tip=root)
            of_limb = [chains[w].joint_names.index(name) for name in limb.joint_names]
            of_before = [chains[w].joint_names.index(name) for name in before.joint_names]
            T_root_base = rigid_inverse(before.poses(q[:, of_before]))
            T_root_tip = T_root_base @ chains[w].poses(other)
            found = reach(limb, ranges[of_limb], T_root_tip, q[:, of_limb])
            q[:, of_limb] = _turned_inside(limb, found, ranges[of_limb])
            values = chains[w].input_values(q)
            q = q[np.all((values >= ranges[:, 0]) & (values <= ranges[:, 1]), axis=1)]
        poses.append(q)
    return np.concatenate(poses)


def _turned_inside(robot: Robot, q: Array, ranges: Array) -> Array:
    """Return rounded readings (n, m) with joints that turn moved by whole turns into ranges (m, 2), if they can be."""
    slides = np.array([joint.type == "prismatic" for joint in robot.inputs])
    values = robot.input_values(q)
    inside = values - _TURN * np.round((values - ranges.mean(axis=1)) / _TURN)
    return rounded(robot, robot.readings(np.where(slides, values, inside)))


def joined_pools(
    robot: Robot,
    ranges: Array,
    pools: Sequence[Pool],
    conditions: Sequence[Sequence[Condition]],
    further: Array,
    free: Sequence[Condition],
) -> Pool:
    """Join the candidates that were drawn for each of several views of a cell, and test what all views see at them.

    Args:
        robot: The robot, with m measured joints.
        ranges: Lowest and highest value of each joint, shape (m, 2), [rad] or for sliding joints [m].
        pools: The candidates of each view.
        conditions: The conditions under which each view measures.
        further: Poses that are candidates if they pass further conditions and any view measures there, shape (n, m).
        free: These conditions, which the candidates of the pools have passed.

    Returns:
        The different candidates, with what is seen. The workspace are as many poses spread over the joints' ranges.
    """
    for condition in free:
        further = further[condition.passes(further)] if len(further) else further
    candidates = np.concatenate([*(pool.q for pool in pools), further])
    _, once = np.unique(candidates, axis=0, return_index=True)
    q = candidates[np.sort(once)]
    seen = np.ones((len(q), len(pools)), dtype=np.bool_)
    for v, of_view in enumerate(conditions):
        for condition in of_view:
            still = np.flatnonzero(seen[:, v])
            if len(still):
                seen[still, v] = condition.passes(q[still])
    q, seen = q[seen.any(axis=1)], seen[seen.any(axis=1)]
    refused: dict[str, int] = {}
    for pool in pools:
        for reason, number in pool.refused.items():
            refused[reason] = refused.get(reason, 0) + number
    return Pool(
        q=read_only(q),
        workspace=read_only(robot.readings(spread_between(ranges, len(q)))),
        measurable=read_only(q),
        drawn=sum(pool.drawn for pool in pools),
        refused=refused,
        seen=seen,
    )


def _collect(
    batches: Iterator[Array],
    conditions: Sequence[Condition],
    drawing: Drawing,
    count: int,
    progress: Progress | None,
) -> Pool:
    """Sift batches of poses (any number, m) until ``count`` have passed all conditions, or too many are drawn.

    It raises `ModelError` if none has passed.
    """
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
        is_image = bool({"focus", "tilt", "image"} & refused.keys())
        parts = ", ".join(f"{number} by {reason}" for reason, number in refused.items() if number)
        raise ModelError(
            f"None of {drawn} poses drawn can be measured; refused: {parts}. Widen the region or the joint ranges, "
            f"move the {'board or the camera' if is_image else 'tracker'}, or drop a condition."
            f"{_HOW_THEY_FACE if is_image else ''}"
        )
    # Narrow ranges have few values of whole steps, which are drawn repeatedly.
    _, once = np.unique(measurable, axis=0, return_index=True)
    q = read_only(measurable[np.sort(once)][:count])
    workspace = read_only(in_region[:count])
    return Pool(q, workspace, workspace, drawn, refused)


def _even_batches(robot: Robot, ranges: Array, seed: int) -> Iterator[Array]:
    """Yield batches, without end, of readings (n, m), [rad] or [m], from a Sobol sequence over ranges (m, 2).

    The ranges are of the joint values; readings are rounded as a table writes them.
    """
    is_coupled = bool(robot.reading_coupling)
    low, high = ranges.T
    if is_coupled:
        # Narrowed by what the joints move if all readings are rounded, at most to the middle.
        moved = np.abs(robot.reading_matrix) @ (0.5 / _STEPS * _table_units(robot))
        moved = np.minimum(moved, 0.5 * np.ptp(ranges, axis=1))
        low, high = low + moved, high - moved
    for unit in scrambled_sobol(len(ranges), EVEN.batch, seed):
        values = low + unit * (high - low)
        if is_coupled:
            yield rounded(robot, robot.readings(values))
        else:
            yield rounded(robot, values, ranges)


def _batches_near_viewpoints(
    instrument: Instrument, sightline: Sightline, ranges: Array, seed: int
) -> Iterator[Array]:
    """Yield batches, without end, of readings (n, m), [rad] or [m], near viewpoints of a Sobol sequence.

    Ranges are (m, 2); the readings that inverse kinematics finds may be beyond them.
    """
    robot = sightline.robot
    starts = robot.readings(spread_between(ranges, _STARTS))
    views = _coordinates(sightline.target_poses(starts))
    size = _CHOICE * TOWARDS_VIEWPOINTS.batch
    for unit in scrambled_sobol(instrument.VIEWPOINT_NUMBERS, size, seed):
        T_instrument_target = instrument.viewpoints(unit)
        wanted = _coordinates(T_instrument_target)
        # The nearest by squared distances, without the terms that are the same for all starts.
        start = np.argmin(np.sum(views**2, axis=1) - 2.0 * wanted @ views.T, axis=1)
        distance = np.linalg.norm(views[start] - wanted, axis=1)
        near = np.argsort(distance)[: TOWARDS_VIEWPOINTS.batch]
        T_base_tip = sightline.tip_poses(T_instrument_target[near])
        q = reach(robot, ranges, T_base_tip, starts[start[near]])
        yield _turned_inside(robot, q, ranges)


def reach(robot: Robot, ranges: Array, T_base_tip: Array, start: Array) -> Array:
    """Bring the tip of a robot near poses by a few steps of inverse kinematics.

    Args:
        robot: The robot.
        ranges: Lowest and highest value of each joint, shape (m, 2), [rad] or for sliding joints [m].
        T_base_tip: Wanted poses, shape (N, 4, 4), [m].
        start: Readings to start from, shape (N, m), [rad] or [m].

    Returns:
        Readings, shape (N, m), [rad] or [m]; those of an arm without redundant joints may be beyond their ranges.
    """
    arm = Arm.of(robot, np.eye(4))
    return solve(arm, T_base_tip, start, Matching(POSE, _RADIAN), ranges, steps=_STEPS_TO_REACH).q


def _coordinates(T: Array) -> Array:
    """Return poses (n, 4, 4) as coordinates (n, 12) [m], with rotations as lengths, so that they have distances."""
    # A small rotation by an angle a changes the nine entries of the matrix by a sqrt(2) in all.
    turns = T[:, :3, :3].reshape(-1, 9) * (_RADIAN / np.sqrt(2.0))
    return np.concatenate([T[:, :3, 3], turns], axis=1)


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
            range is to be narrowed. The others go everywhere they can: revolute joints through one whole turn at most,
            the one nearest to zero, and sliding joints without limits 1 m to both sides of zero.
        margin: Distance to the URDF's limits of revolute joints [rad]; sliding joints keep 5 mm, unless it is 0.
        turns: True: revolute joints that are not narrowed go from limit to limit, even if these are more than a turn
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
    # The number in a table, times the factor that its reader uses, so that both are equal to the last bit.
    return np.asarray(counts / _STEPS * unit)


def _table_units(robot: Robot) -> Array:
    """Return the unit of each column of a planned table, 1 deg or of sliding joints 1 mm, shape (m,), [rad] or [m]."""
    slides = [joint.type == "prismatic" for joint in robot.inputs]
    return np.where(slides, UNITS["mm"].to_si, UNITS["deg"].to_si)
