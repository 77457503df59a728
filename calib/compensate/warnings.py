"""Which commands can be given out, why the others cannot, and what to know of those that are, row by row.

Each warning begins with the same words for every row that it is said of, so that they can be counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.compensate.inverse import POSE, WEIGHTED, Matching, Solved
from calib.compensate.nominal_actual import Pair
from calib.compensate.program import Program
from calib.measure.ranges import column_limits
from calib.model.robot import Robot

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Joint values may pass their limits by this, for rounding [rad or m].
_ROUNDING = 1e-9

#: What may be left where the nominal robot is held to be at the pose, and what is nothing [m], [rad].
_NOMINAL, _NOTHING = (1e-6, 1e-6), (1e-8, 1e-8)

#: Near a singularity: the smallest singular value of the tool's motion, lengths in units of the arm's reach.
NEAR_SINGULAR = 0.01

#: Corrections of a joint larger than this are told [rad], [m]: an arm is off by a tenth of it.
JOINT_LIMIT = (np.radians(5.0), 0.02)

#: Joints may move from row to row by this more than the nominal ones [rad or m], and by this factor.
_STEP_MORE, _STEP_FACTOR = np.radians(2.0), 1.5

#: Another configuration: a joint moves further than this [rad or m] between poses that are nearer than that to each
#: other (a share of the reach, and [rad]).
_TURNED_OVER, _CLOSE = 0.5, (0.1, 0.3)

#: Joint values given to start at are followed if the solution is no further from them [rad or m].
_FAR_FROM_GIVEN = np.radians(45.0)

#: How much worse an angle may get for the sake of the position [rad].
_WORSE = np.radians(0.2)

_OTHER_BRANCH = "next to a singularity: the solution lies in another branch of the arm"


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """What is said of N rows.

    Attributes:
        reached: Which have a command, shape (N,).
        nominal_reaches: Which poses the nominal robot reaches, shape (N,).
        missed: shape (N, 2), how far the actual robot misses at the nominal joint values [m], [rad].
        left: shape (N, 2), how far it misses at those to command [m], [rad].
        reasons: Why a row has no command, or nothing.
        warnings: What to know of one that has.
    """

    reached: Mask
    nominal_reaches: Mask
    missed: Array
    left: Array
    reasons: tuple[str, ...]
    warnings: tuple[tuple[str, ...], ...]


def judged(
    pair: Pair,
    program: Program,
    T_wanted: Array,
    starts: Solved,
    solved: Solved,
    left_by_pose: Array,
    matching: Matching,
    *,
    accept: tuple[float, float],
    limit: tuple[float, float],
) -> Judged:
    """Say of each row whether its command can be given out.

    Args:
        pair: The two robots.
        program: What was asked for.
        T_wanted: shape (N, 4, 4), poses of the tool in the base [m].
        starts: Joint values of the nominal robot.
        solved: Joint values of the actual one.
        left_by_pose: shape (N, 2), what is left if poses are sent [m], [rad].
        matching: What is matched.
        accept: What may be left: position [m], angle [rad]. A weighted match may leave a position as large as the
            limit, and any angle.
        limit: Corrections of the pose larger than this are warned of: position [m], angle [rad].
    """
    robot = pair.actual.robot
    T_actual, twists_before = pair.actual.motion(starts.q)
    missed = matching.misses(T_actual, T_wanted)
    left = matching.misses(solved.T_base_tool, T_wanted)
    weighted = matching.name == WEIGHTED
    may_be_left = (limit[0], np.inf) if weighted else accept
    nominal_left = matching.misses(starts.T_base_tool, T_wanted)
    nominal_reaches = _within(nominal_left, may_be_left if weighted else _NOMINAL)
    far = ~_within(left, may_be_left)
    turned = _other_branch(matching.jacobian(twists_before), matching.jacobian(solved.twists))
    passed = _limits_passed(robot, solved.q, starts.q)
    reasons = tuple(
        _unreached(robot, matching, left[row])
        if far[row]
        else passed[row] or (_OTHER_BRANCH if turned[row] else "")
        for row in range(len(left))
    )
    reached = np.array([not reason for reason in reasons])
    given = None if program.T_wanted is None else program.q
    said: list[list[str]] = [[] for _ in reasons]
    for row in np.flatnonzero(~nominal_reaches).tolist():
        said[row].append("the nominal robot cannot reach the pose itself")
    _left_over(said, left, missed, matching)
    _near_singularity(said, pair, matching, starts, solved)
    moved = Matching(POSE, 1.0).misses(pair.nominal.poses(solved.q), starts.T_base_tool)
    _moved(said, robot, moved, np.abs(solved.q - starts.q), limit)
    _jumps(said, pair, T_wanted, starts.q, solved.q, program.labels, np.flatnonzero(reached))
    if given is not None:
        for words, apart in zip(said, np.abs(starts.q - given), strict=True):
            if apart.max() > _FAR_FROM_GIVEN:
                words.append(f"far from the joint values given: {_furthest(robot, apart)}")
    for row in np.flatnonzero(~_within(left_by_pose - left, accept)).tolist():
        off = f"{1e3 * left_by_pose[row, 0]:.3g} mm"
        said[row].append(
            f"sent as a pose it may end {off} off: the controller can come to other joint values"
        )
    if pair.result is not None:
        for outside in pair.result.outside_of_measured(solved.q):
            joints = ", ".join(map(str, outside.beyond))
            said[outside.index].append(f"outside the joint range that was measured: {joints}")
    return Judged(
        reached=reached,
        nominal_reaches=nominal_reaches,
        missed=missed,
        left=left,
        reasons=reasons,
        warnings=tuple(
            tuple(words) if one else () for one, words in zip(reached, said, strict=True)
        ),
    )


# Why there is no command


def _within(misses: Array, allowed: tuple[float, float]) -> Mask:
    """Which misses are small enough; an angle that is not matched is."""
    return np.asarray((misses[:, 0] <= allowed[0]) & ~(misses[:, 1] > allowed[1]))


def _unreached(robot: Robot, matching: Matching, left: Array) -> str:
    """How far a row is from being reached, and why, as far as it can be told."""
    count = len(robot.joint_names)
    where = "at the edge of its reach or in a singularity"
    if count < matching.rows and matching.name != WEIGHTED:
        where = f"for it has {count} joints and cannot match {matching.rows} numbers"
    angle = "" if np.isnan(left[1]) else f" and {np.degrees(left[1]):.4f} deg"
    return (
        f"the true robot cannot reach it: {1e3 * left[0]:.4f} mm{angle} would be left near the nominal joint values, "
        f"{where}"
    )


def _limits_passed(robot: Robot, q: Array, before: Array) -> list[str]:
    """For each row the joint that would pass its limit, in words; nothing where none does.

    Args:
        robot: The robot.
        q: shape (N, m), joint values to command [rad] or [m].
        before: shape (N, m), those of the nominal robot.
    """
    low, high = column_limits(robot).T
    beyond = np.maximum(low - q, q - high)
    said = [""] * len(q)
    for row in np.flatnonzero(beyond.max(axis=1) > _ROUNDING):
        joint = int(np.argmax(beyond[row]))
        name, value, own = robot.joint_names[joint], q[row, joint], before[row, joint]
        slides = robot.joint_types[name] == "prismatic"
        scale, unit = (1e3, "mm") if slides else (180.0 / np.pi, "deg")
        bound = low[joint] if value < low[joint] else high[joint]
        text = f"'{name}' would have to be at {scale * value:.4f} {unit}, beyond its limit {scale * bound:.4f}"
        if not low[joint] - _ROUNDING <= own <= high[joint] + _ROUNDING:
            text += f"; without correction it is beyond it too, at {scale * own:.4f}"
        said[row] = text
    return said


def _other_branch(before: Array, after: Array) -> Mask:
    """Which rows have passed a singularity on their way: the determinant has turned its sign."""
    if before.shape[1] != before.shape[2]:
        return np.zeros(len(before), dtype=bool)
    return np.asarray(np.linalg.slogdet(before)[0] * np.linalg.slogdet(after)[0] < 0)


# What to know of a command


def _left_over(said: list[list[str]], left: Array, missed: Array, matching: Matching) -> None:
    """Where the actual robot still misses: by what was accepted, or by what a weighted match gave away.

    Args:
        said: What is said of each row, added to.
        left: shape (N, 2), with the command [m], [rad].
        missed: shape (N, 2), without [m], [rad].
        matching: What is matched.
    """
    for words, (distance, angle), before in zip(said, left, missed, strict=True):
        if matching.name == WEIGHTED:
            if angle > before[1] + _WORSE:
                words.append(
                    f"the tool is turned by {np.degrees(angle):.3f} deg, without correction by "
                    f"{np.degrees(before[1]):.3f}"
                )
        elif distance > _NOTHING[0] or angle > _NOTHING[1]:
            turned = "" if np.isnan(angle) else f" and {np.degrees(angle):.4f} deg"
            words.append(f"an error is left: {1e3 * distance:.4f} mm{turned}")


def _near_singularity(
    said: list[list[str]], pair: Pair, matching: Matching, starts: Solved, solved: Solved
) -> None:
    """Where small motions of the tool take large ones of a joint, before the correction or behind it."""
    robot, scaled = pair.actual.robot, Matching(matching.name, 1.0)
    smallest = np.full(len(said), np.inf)
    worst: Array = np.zeros((len(said), 2, len(robot.joint_names)))
    for twists in (starts.twists, solved.twists):
        motion = scaled.jacobian(twists)
        even = motion.copy()
        even[:, :3] /= pair.reach
        smallest = np.minimum(smallest, np.linalg.svd(even, compute_uv=False)[:, -1])
        inverse = np.linalg.pinv(motion, rcond=1e-12)
        by_length = np.linalg.norm(inverse[:, :, :3], axis=2)
        by_angle = np.linalg.norm(inverse[:, :, 3:], axis=2)
        worst = np.maximum(worst, np.stack([1e-3 * by_length, np.radians(0.1) * by_angle], axis=1))
    for row in np.flatnonzero(smallest < NEAR_SINGULAR):
        text = f"near a singularity: 1 mm of the tool may take {_furthest(robot, worst[row, 0])}"
        if matching.rows > 3:
            text += f", 0.1 deg of it {_furthest(robot, worst[row, 1])}"
        said[row].append(text)


def _moved(
    said: list[list[str]], robot: Robot, poses: Array, joints: Array, limit: tuple[float, float]
) -> None:
    """Where the pose to send is changed by more than a limit, or a joint is corrected by much.

    Args:
        said: What is said of each row, added to.
        robot: The robot.
        poses: shape (N, 2), how far the pose moves [m], [rad].
        joints: shape (N, m), how far each joint does [rad] or [m].
        limit: [m], [rad].
    """
    slides = np.array([robot.joint_types[name] == "prismatic" for name in robot.joint_names])
    allowed = np.where(slides, JOINT_LIMIT[1], JOINT_LIMIT[0])
    for words, (distance, angle), moved in zip(said, poses, joints, strict=True):
        if distance > limit[0]:
            words.append(
                f"the pose moves by {1e3 * distance:.2f} mm, more than {1e3 * limit[0]:g} mm"
            )
        if angle > limit[1]:
            turned, most = np.degrees(angle), np.degrees(limit[1])
            words.append(f"the pose turns by {turned:.2f} deg, more than {most:g} deg")
        if (moved > allowed).any():
            words.append(f"a joint is corrected by much: {_furthest(robot, moved)}")


def _jumps(
    said: list[list[str]],
    pair: Pair,
    T_wanted: Array,
    before: Array,
    after: Array,
    labels: Sequence[str],
    rows: NDArray[np.int_],
) -> None:
    """Where the arm moves further from the row before than the program has it, or turns over.

    Args:
        said: What is said of each row, added to.
        pair: The two robots.
        T_wanted: shape (N, 4, 4), [m].
        before: shape (N, m), joint values of the nominal robot [rad] or [m].
        after: shape (N, m), those to command.
        labels: What each row is called.
        rows: Those that have a command: others are passed over, as the robot does.
    """
    robot = pair.actual.robot
    apart = Matching(POSE, 1.0).misses(T_wanted[rows[:-1]], T_wanted[rows[1:]])
    close = (apart[:, 0] < _CLOSE[0] * pair.reach) & (apart[:, 1] < _CLOSE[1])
    for first, row, near in zip(rows[:-1], rows[1:], close, strict=True):
        planned, moved = (np.abs(q[row] - q[first]) for q in (before, after))
        if near and planned.max() > _TURNED_OVER:
            said[row].append(
                f"the arm turns over: from {labels[first]}, close by, it moves {_furthest(robot, moved)}"
            )
        elif (moved > _STEP_FACTOR * planned.max() + _STEP_MORE).any():
            said[row].append(
                f"a jump: from {labels[first]} it moves {_furthest(robot, moved)}, where the program moves no joint by "
                f"more than {_furthest(robot, planned)}"
            )


def _furthest(robot: Robot, moved: Array) -> str:
    """The joint that moves furthest of all, and by how much: ``7.4 deg of 'wrist_1_joint'``."""
    joint = int(np.argmax(moved))
    name = robot.joint_names[joint]
    if robot.joint_types[name] == "prismatic":
        return f"{min(1e3 * moved[joint], 1e6):.1f} mm of '{name}'"
    return f"{min(np.degrees(moved[joint]), 360.0):.1f} deg of '{name}'"
