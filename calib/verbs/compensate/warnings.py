"""Reasons why a row of a program has no command, and warnings about rows that have one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.basics.arrays import Array, Mask
from calib.robot.ranges import column_limits
from calib.robot.robot import Robot
from calib.verbs.compensate.inverse import POSE, Matching, Solution
from calib.verbs.compensate.nominal_actual import Pair

Code = Literal[
    "unreachable",
    "beyond limit",
    "other branch",
    "near singularity",
    "large pose correction",
    "large joint correction",
    "jump",
    "ambiguous pose",
    "outside measured range",
]
"""The first three are reasons why a row has no command, the others warnings; docs/compensation.md says what to do."""

#: A joint value beyond its limit by less than this is rounding [rad or m].
_EXACT = 1e-9

#: Near a singularity: the smallest singular value of the tool's motion, lengths in units of the arm's reach.
_NEAR_SINGULAR = 0.01

#: Corrections of a joint that turns that are larger than real arms need [rad].
_TURN_LIMIT = np.radians(5.0)

#: Corrections of a joint that slides that are larger than real arms need [m].
_SLIDE_LIMIT = 0.02

#: Corrections of the pose to send that are larger than real arms need [m], [rad].
_POSE_LIMIT = (0.01, np.radians(2.0))

#: A jump: joints move from row to row farther than the nominal ones by this factor ...
_STEP_FACTOR = 1.5

#: ... and by this on top of it [rad or m];
_STEP_MORE = np.radians(2.0)

#: or the nominal ones move farther than this [rad or m] ...
_TURNED_OVER = 0.5

#: ... between poses that are nearer to each other than this: a share of the reach [-], and an angle [rad].
_CLOSE = (0.1, 0.3)


class CommandWarning(NamedTuple):
    """Reason why a row has no command, or warning about its command."""

    code: Code
    #: Of "unreachable", "large pose correction", "ambiguous pose": position [m] and angle [rad], NaN where it is not
    #: matched; "beyond limit": value and limit; "near singularity": joint motion for 1 mm of the tool; else the motion
    #: of the joint, or its distance from the measured range [rad or m].
    numbers: tuple[float, ...] = ()
    #: The joint that it is about; empty if it is about none.
    joint: str = ""
    #: Label of the other row that it is about; empty if it is about none.
    row: str = ""


def within(misses: Array, allowed: tuple[float, float]) -> Mask:
    """Test which misses are small enough; an angle that is not matched is.

    Args:
        misses: Distance [m] and angle [rad] between poses, shape (N, 2); the angle is NaN where it is not matched.
        allowed: The largest of each [m], [rad].

    Returns:
        shape (N,).
    """
    return np.asarray((misses[:, 0] <= allowed[0]) & ~(misses[:, 1] > allowed[1]))


def reasons_without_command(
    pair: Pair,
    matching: Matching,
    nominal: Solution,
    solution: Solution,
    misses: Array,
    tolerance: tuple[float, float],
) -> list[CommandWarning | None]:
    """Find why rows have no command: another branch, a joint beyond its limit, or a pose out of reach.

    Args:
        pair: The nominal and the actual robot.
        matching: What of the poses is matched.
        nominal: The actual robot at the nominal joint values, N rows.
        solution: The actual robot at the joint values to command.
        misses: What it misses there of the wanted poses, shape (N, 2): position [m], angle [rad].
        tolerance: What it may miss: position [m], angle [rad].

    Returns:
        The last of these reasons that applies to each row; None for a row that has a command.
    """
    reasons: list[CommandWarning | None] = [None] * len(misses)
    for row in _rows_in_another_branch(matching, nominal, solution):
        reasons[row] = CommandWarning("other branch")
    for row, reason in _rows_beyond_limits(pair.actual.robot, solution.q):
        reasons[row] = reason
    for row in np.flatnonzero(~within(misses, tolerance)):
        reasons[row] = CommandWarning("unreachable", tuple(misses[row].tolist()))
    return reasons


def _rows_in_another_branch(
    matching: Matching, nominal: Solution, solution: Solution
) -> NDArray[np.int_]:
    """Find the rows whose solution lies across a singularity: the determinant of the Jacobian has changed its sign.

    Args:
        matching: What of the poses is matched.
        nominal: The actual robot at the nominal joint values.
        solution: The actual robot at the joint values to command.

    Returns:
        Numbers of the rows, from 0; none where the Jacobian is not square.
    """
    joint_count = solution.q.shape[1]
    if joint_count != matching.rows:
        return np.array([], dtype=np.int_)
    sign_before = np.linalg.slogdet(matching.jacobian(nominal.twists))[0]
    sign_after = np.linalg.slogdet(matching.jacobian(solution.twists))[0]
    return np.flatnonzero(sign_before * sign_after < 0)


def _rows_beyond_limits(robot: Robot, q: Array) -> Iterator[tuple[int, CommandWarning]]:
    """Yield the rows with a joint beyond its limit, numbers from 0, and the joint that is farthest beyond.

    Args:
        robot: Has the joints and their limits.
        q: Joint values to command, shape (N, m), [rad] or [m].
    """
    values = robot.input_values(q)
    low, high = column_limits(robot).T
    excess = np.maximum(low - values, values - high)
    for row in np.flatnonzero(excess.max(axis=1) > _EXACT).tolist():
        joint = int(np.argmax(excess[row]))
        value = float(values[row, joint])
        limit = float(low[joint] if value < low[joint] else high[joint])
        yield row, CommandWarning("beyond limit", (value, limit), robot.joint_names[joint])


@dataclass(frozen=True, slots=True, eq=False)
class ReachedRows:
    """The n rows of a program that have a command."""

    #: The nominal and the actual robot
    pair: Pair
    #: What of the poses is matched
    match: str
    #: What messages call each row
    labels: tuple[str, ...]
    #: (n, 4, 4), wanted poses of the tool in the frame of the poses [m]
    T_wanted: Array
    #: (n, m), joint values of the nominal robot for them [rad] or [m]
    q_nominal: Array
    #: (n, m), joint values to command [rad] or [m]
    q: Array
    #: (n, 2), distance of the pose to send from the wanted one [m], [rad]
    pose_corrections: Array
    #: (n, 2), what the actual robot misses at ``q`` [m], [rad]
    misses: Array
    #: (n, 2), what it misses if the pose is sent [m], [rad]
    misses_by_pose: Array


def warnings_of(rows: ReachedRows, tolerance: tuple[float, float]) -> list[list[CommandWarning]]:
    """Find what a person should know of the commands.

    Args:
        rows: The n rows that have a command.
        tolerance: What the actual robot may miss: position [m], angle [rad].

    Returns:
        The warnings of each of the n rows.
    """
    robot = rows.pair.nominal.robot
    warnings: list[list[CommandWarning]] = [[] for _ in rows.labels]
    if not warnings:
        return warnings
    near_singular, joint_motion = _near_singularity(rows)
    _warn_of_joints(warnings, robot, "near singularity", near_singular, joint_motion)
    large_pose = ~within(rows.pose_corrections, _POSE_LIMIT)
    _warn_of_poses(warnings, "large pose correction", large_pose, rows.pose_corrections)
    large_joint, joint_corrections = _large_joint_corrections(rows)
    _warn_of_joints(warnings, robot, "large joint correction", large_joint, joint_corrections)
    jumps, moves, previous = _jumps(rows)
    _warn_of_joints(warnings, robot, "jump", jumps, moves, previous)
    ambiguous = ~within(rows.misses_by_pose - rows.misses, tolerance)
    _warn_of_poses(warnings, "ambiguous pose", ambiguous, rows.misses_by_pose)
    _warn_of_ranges(warnings, rows)
    return warnings


def _warn_of_poses(
    warnings: list[list[CommandWarning]],
    code: Code,
    which: Mask,
    values: Array,
) -> None:
    """Add a warning to some rows, with position and angle of each.

    Args:
        warnings: Those of each of the n rows, which are added to.
        code: Of the warning.
        which: The rows that it is added to, shape (n,).
        values: Position [m] and angle [rad], shape (n, 2).
    """
    for i in np.flatnonzero(which).tolist():
        warnings[i].append(CommandWarning(code, tuple(values[i].tolist())))


def _warn_of_joints(
    warnings: list[list[CommandWarning]],
    robot: Robot,
    code: Code,
    which: Mask,
    values: Array,
    others: Sequence[str] | None = None,
) -> None:
    """Add a warning to some rows, with the joint of the largest of its values (n, m), [rad] or [m].

    Args:
        warnings: Those of each of the n rows, which are added to.
        robot: Names the m joints.
        code: Of the warning.
        which: The rows that it is added to, shape (n,).
        values: Of each joint, shape (n, m), [rad] or [m].
        others: Label of the other row that it is about, for each row; None: it is about none.
    """
    for i in np.flatnonzero(which).tolist():
        joint = int(np.argmax(values[i]))
        number = float(values[i, joint])
        other = others[i] if others else ""
        warnings[i].append(CommandWarning(code, (number,), robot.joint_names[joint], other))


def _large_joint_corrections(rows: ReachedRows) -> tuple[Mask, Array]:
    """Find rows with a joint whose correction is larger than real arms need.

    Args:
        rows: The n rows that have a command, with nominal and commanded joint values.

    Returns:
        The rows, shape (n,), and the size of each joint's correction, shape (n, m), [rad] or [m].
    """
    robot = rows.pair.nominal.robot
    corrections = np.abs(rows.q - rows.q_nominal)
    slides = [robot.joint_types[name] == "prismatic" for name in robot.joint_names]
    allowed = np.where(slides, _SLIDE_LIMIT, _TURN_LIMIT)
    return np.any(corrections > allowed, axis=1), corrections


def _near_singularity(rows: ReachedRows) -> tuple[Mask, Array]:
    """Find rows near a singularity of the actual robot.

    Args:
        rows: The n rows that have a command, with the joint values to command.

    Returns:
        The rows, shape (n,), and each joint's largest motion for 1 mm of the tool, shape (n, m), [rad] or [m].
    """
    _, twists = rows.pair.actual.motion(rows.q)
    jacobian = Matching(rows.match, 1.0).jacobian(twists)
    inverse = np.linalg.pinv(jacobian, rcond=1e-12)
    joint_motion = 1e-3 * np.linalg.norm(inverse[:, :, :3], axis=2)
    jacobian[:, :3] /= rows.pair.reach
    smallest = np.linalg.svd(jacobian, compute_uv=False)[:, -1]
    return smallest < _NEAR_SINGULAR, joint_motion


def _jumps(rows: ReachedRows) -> tuple[Mask, Array, list[str]]:
    """Find rows to which joints jump from the row before that has a command: others are passed over.

    Args:
        rows: The n rows that have a command, in the order of the program; the first one jumps from none.

    Returns:
        The rows, shape (n,); the motion of each joint, shape (n, m), [rad] or [m]; the label of the row before each.
    """
    before = np.maximum(np.arange(len(rows.q)) - 1, 0)
    nominal_move = np.abs(rows.q_nominal - rows.q_nominal[before]).max(axis=1)
    moves = np.abs(rows.q - rows.q[before])
    close = (_CLOSE[0] * rows.pair.reach, _CLOSE[1])
    distances = Matching(POSE, 1.0).misses(rows.T_wanted[before], rows.T_wanted)
    turned_over = within(distances, close) & (nominal_move > _TURNED_OVER)
    farther = moves.max(axis=1) > _STEP_FACTOR * nominal_move + _STEP_MORE
    return turned_over | farther, moves, [rows.labels[i] for i in before]


def _warn_of_ranges(warnings: list[list[CommandWarning]], rows: ReachedRows) -> None:
    """Add a warning for each joint value to command outside of the range of the rows that a result was fitted to.

    Args:
        warnings: Those of each of the n rows, which are added to.
        rows: The n rows that have a command; two robots without a result have no such ranges.
    """
    if rows.pair.result is None:
        return
    for outside in rows.pair.result.outside_of_measured(rows.q):
        for joint in outside.beyond:
            warning = CommandWarning("outside measured range", (float(joint.by),), joint.joint)
            warnings[outside.index].append(warning)
