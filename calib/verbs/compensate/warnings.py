"""Reasons why a row of a program has no command, and warnings about rows that have one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.robot.ranges import column_limits
from calib.verbs.compensate.commands import Code, Commands, CommandWarning
from calib.verbs.compensate.inverse import POSE, Matching, Solution
from calib.verbs.compensate.nominal_actual import Pair

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

#: A jump: joints move from row to row farther than the nominal ones, by this factor ...
_STEP_FACTOR = 1.5

#: ... and by this on top of it [rad or m];
_STEP_MORE = np.radians(2.0)

#: or the nominal ones move farther than this [rad or m] ...
_TURNED_OVER = 0.5

#: ... between poses that are nearer to each other than this: a share of the reach [-], and an angle [rad].
_CLOSE = (0.1, 0.3)


def within(misses: Array, allowed: tuple[float, float]) -> Mask:
    """Return which misses are small enough; an angle that is not matched always is.

    Args:
        misses: Distance [m] and angle [rad] between poses, shape (N, 2); the angle is NaN if it is not matched.
        allowed: The largest of each [m], [rad].

    Returns:
        True where distance and angle are at most as large as allowed, shape (N,).
    """
    return np.asarray((misses[:, 0] <= allowed[0]) & ~(misses[:, 1] > allowed[1]))


def find_reasons(
    pair: Pair,
    matching: Matching,
    uncorrected: Solution,
    corrected: Solution,
    misses: Array,
    tolerance: tuple[float, float],
) -> list[CommandWarning | None]:
    """Find why rows have no command: another branch, a joint beyond its limit, or a pose out of reach.

    Args:
        pair: The nominal and the actual robot.
        matching: Part of the poses that is matched.
        uncorrected: The actual robot at the nominal joint values, N rows.
        corrected: The actual robot at the joint values to command.
        misses: Its distances there from the wanted poses, shape (N, 2): position [m], angle [rad].
        tolerance: The largest distances allowed: position [m], angle [rad].

    Returns:
        The last of these reasons that applies to each row; None for a row that has a command.
    """
    reasons: list[CommandWarning | None] = [None] * len(misses)
    joint_count = corrected.q.shape[1]
    if joint_count == matching.rows:
        # Across a singularity the determinant of the square Jacobian has the other sign.
        sign_before, _ = np.linalg.slogdet(matching.jacobian(uncorrected.twists))
        sign_after, _ = np.linalg.slogdet(matching.jacobian(corrected.twists))
        for row in np.flatnonzero(sign_before * sign_after < 0):
            reasons[row] = CommandWarning("other branch")

    robot = pair.actual.robot
    values = robot.input_values(corrected.q)
    low, high = column_limits(robot).T
    excess = np.maximum(low - values, values - high)
    for row in np.flatnonzero(excess.max(axis=1) > _EXACT):
        joint = int(np.argmax(excess[row]))
        value = float(values[row, joint])
        limit = float(low[joint] if value < low[joint] else high[joint])
        reasons[row] = CommandWarning("beyond limit", (value, limit), robot.joint_names[joint])

    for row in np.flatnonzero(~within(misses, tolerance)):
        reasons[row] = CommandWarning("unreachable", tuple(misses[row].tolist()))
    return reasons


def find_warnings(
    commands: Commands, tolerance: tuple[float, float]
) -> tuple[tuple[CommandWarning, ...], ...]:
    """Find what a person should know about each row that has a command.

    That is a singularity nearby, a large correction, a jump from the row before, a pose that the controller may reach
    otherwise, or joint values outside those measured.

    Args:
        commands: The commands, whose own warnings do not count.
        tolerance: The largest distances allowed from the wanted poses: position [m], angle [rad].

    Returns:
        The warnings of each of all rows; none of a row without a command.
    """
    pair, robot = commands.pair, commands.nominal
    warnings: list[list[CommandWarning]] = [[] for _ in range(len(commands))]
    rows = np.flatnonzero(commands.reached)
    if not len(rows):
        return tuple(map(tuple, warnings))

    def warn_of_poses(code: Code, which: Mask, values: Array) -> None:
        """Warn of rows, by a mask (n,), with their values (n, 2): position [m] and angle [rad]."""
        for i in np.flatnonzero(which).tolist():
            warnings[rows[i]].append(CommandWarning(code, tuple(values[i].tolist())))

    def warn_of_joints(
        code: Code, which: Mask, values: Array, other_rows: Sequence[str] | None = None
    ) -> None:
        """Warn of rows, by a mask (n,), with the joint of the largest of their values (n, m), [rad] or [m]."""
        for i in np.flatnonzero(which).tolist():
            joint = int(np.argmax(values[i]))
            number = float(values[i, joint])
            other_row = other_rows[i] if other_rows else ""
            warning = CommandWarning(code, (number,), robot.joint_names[joint], other_row)
            warnings[rows[i]].append(warning)

    # The n rows that have a command.
    q, q_nominal, T_wanted = commands.q[rows], commands.q_nominal[rows], commands.T_wanted[rows]

    singular, joint_motion = _near_singularity(pair, commands.match, q)
    warn_of_joints("near singularity", singular, joint_motion)

    pose_corrections = commands.pose_corrections[rows]
    warn_of_poses("large pose correction", ~within(pose_corrections, _POSE_LIMIT), pose_corrections)

    joint_corrections = np.abs(q - q_nominal)
    slides = [robot.joint_types[name] == "prismatic" for name in robot.joint_names]
    large = np.any(joint_corrections > np.where(slides, _SLIDE_LIMIT, _TURN_LIMIT), axis=1)
    warn_of_joints("large joint correction", large, joint_corrections)

    # From the row before that has a command; the first row has none before it, and moves by nothing.
    previous = np.maximum(np.arange(len(rows)) - 1, 0)
    moves = np.abs(q - q[previous])
    nominal_move = np.abs(q_nominal - q_nominal[previous]).max(axis=1)
    farther = moves.max(axis=1) > _STEP_FACTOR * nominal_move + _STEP_MORE
    distances = Matching(POSE, 1.0).misses(T_wanted[previous], T_wanted)
    close = (_CLOSE[0] * pair.reach, _CLOSE[1])
    turned_over = within(distances, close) & (nominal_move > _TURNED_OVER)
    labels = [commands.program.labels[row] for row in rows[previous]]
    warn_of_joints("jump", turned_over | farther, moves, labels)

    more_by_pose = commands.left_by_pose[rows] - commands.left[rows]
    ambiguous = ~within(more_by_pose, tolerance)
    warn_of_poses("ambiguous pose", ambiguous, commands.left_by_pose[rows])

    if pair.result is not None:
        names = pair.nominal.robot.joint_names
        for outside in pair.result.outside_of_measured(pair.of_all_joints(q)):
            for joint in outside.beyond:
                if joint.joint not in names:  # of another hand, which is not commanded
                    continue
                number = float(joint.by)
                warning = CommandWarning("outside measured range", (number,), joint.joint)
                warnings[rows[outside.index]].append(warning)
    return tuple(map(tuple, warnings))


def _near_singularity(pair: Pair, match: str, q: Array) -> tuple[Mask, Array]:
    """Return which joint values (n, m) are near a singularity, (n,), and each joint's largest motion for 1 mm of tool.

    The motions, (n, m) [rad] or [m], are norms of rows of the Jacobian's pseudoinverse.
    """
    _, twists = pair.actual.motion(q)
    jacobian = Matching(match, 1.0).jacobian(twists)
    inverse = np.linalg.pinv(jacobian, rcond=1e-12)
    joint_motion = 1e-3 * np.linalg.norm(inverse[:, :, :3], axis=2)
    jacobian[:, :3] /= pair.reach
    smallest = np.linalg.svd(jacobian, compute_uv=False)[:, -1]
    return smallest < _NEAR_SINGULAR, joint_motion
