"""Which commands can be given out, why the others cannot, and what to know of those that are, row by row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.compensation.inverse import POSE, Matching, Solved
from calib.compensation.nominal_actual import Pair
from calib.compensation.program import Program
from calib.robot.readback import column_limits

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Joint values may pass their limits by this, for rounding [rad or m].
_ROUNDING = 1e-9

#: What is no error [m], [rad]; and the error below which the nominal robot reaches a pose.
_NOTHING, _NOMINAL = (1e-8, 1e-8), (1e-6, 1e-6)

#: Near a singularity: the smallest singular value of the tool's motion, lengths in units of the arm's reach.
NEAR_SINGULAR = 0.01

#: Corrections that are larger than real arms need: of a joint [rad], [m], and of the pose to send [m], [rad].
JOINT_LIMIT, POSE_LIMIT = (np.radians(5.0), 0.02), (0.01, np.radians(2.0))

#: Joints may move from row to row by this more than the nominal ones [rad or m], and by this factor.
_STEP_MORE, _STEP_FACTOR = np.radians(2.0), 1.5

#: Another configuration: a joint moves further than this [rad or m] between poses that are nearer than that to each
#: other (a share of the reach, and [rad]).
_TURNED_OVER, _CLOSE = 0.5, (0.1, 0.3)

#: Joint values given to start at are followed if the solution is no further from them [rad or m].
_FAR_FROM_GIVEN = np.radians(45.0)

Code = Literal[
    "unreachable",
    "beyond limit",
    "other branch",
    "nominal unreachable",
    "error left",
    "near singularity",
    "large pose correction",
    "large joint correction",
    "configuration change",
    "jump",
    "far from start",
    "ambiguous pose",
    "outside measured range",
]
"""The first three are reasons why a row has no command, the others warnings; docs/compensation.md says what to do."""

#: Their numbers are a distance and an angle, not of a joint.
_OF_POSES = ("nominal unreachable", "error left", "large pose correction", "ambiguous pose")


class Finding(NamedTuple):
    """What to know of a row: numbers in SI units, and the joint and the other row that it is about.

    ``numbers`` by code: "unreachable", "error left", "large pose correction", "ambiguous pose": position [m] and angle
    [rad], NaN where it is not matched; "beyond limit": value and limit; "near singularity": what 1 mm of the tool may
    take of the joint; of the others how far the joint moves, or is away.
    """

    code: Code
    numbers: tuple[float, ...] = ()
    joint: str = ""
    row: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Attempt:
    """What was found for a program, before it is judged.

    ``T_wanted`` (N, 4, 4) is in the base [m]; ``starts`` is the nominal robot, ``before`` the actual one at the same
    joint values, ``solved`` at those to command; ``left_by_pose`` (N, 2): how far it misses if poses are sent.
    """

    pair: Pair
    program: Program
    matching: Matching
    T_wanted: Array
    starts: Solved
    before: Solved
    solved: Solved
    left_by_pose: Array

    def misses(self, at: Solved) -> Array:
        """Distance [m] and angle [rad] to the poses that are wanted, shape (N, 2)."""
        return self.matching.misses(at.T_base_tool, self.T_wanted)

    @property
    def nominal_reaches(self) -> Mask:
        """Which poses the nominal robot reaches, shape (N,)."""
        return within(self.misses(self.starts), _NOMINAL)


def within(misses: Array, allowed: tuple[float, float]) -> Mask:
    """Which misses (N, 2) [m], [rad] are small enough; an angle that is not matched is."""
    return np.asarray((misses[:, 0] <= allowed[0]) & ~(misses[:, 1] > allowed[1]))


def reasons_of(a: Attempt, accept: tuple[float, float]) -> list[Finding | None]:
    """For each row why it has no command: more than ``accept`` [m], [rad] is left, a limit, or another branch."""
    robot = a.pair.actual.robot
    low, high = column_limits(robot).T
    found: list[Finding | None] = [None] * len(a.T_wanted)
    if len(robot.joint_names) == a.matching.rows:
        # The determinant has turned its sign: a singularity was passed on the way.
        before, after = (
            np.linalg.slogdet(a.matching.jacobian(one.twists))[0] for one in (a.before, a.solved)
        )
        for row in np.flatnonzero(before * after < 0):
            found[row] = Finding("other branch")
    beyond = np.maximum(low - a.solved.q, a.solved.q - high)
    for row in np.flatnonzero(beyond.max(axis=1) > _ROUNDING):
        joint = int(np.argmax(beyond[row]))
        value = float(a.solved.q[row, joint])
        bound = float(low[joint] if value < low[joint] else high[joint])
        found[row] = Finding("beyond limit", (value, bound), robot.joint_names[joint])
    left = a.misses(a.solved)
    for row in np.flatnonzero(~within(left, accept)):
        found[row] = Finding("unreachable", tuple(left[row].tolist()))
    return found


def warnings_of(
    a: Attempt, reached: Mask, accept: tuple[float, float]
) -> tuple[tuple[Finding, ...], ...]:
    """For each row that is reached what to know of its command; ``accept``: the error that may be left [m], [rad]."""
    pair, program, starts, solved = a.pair, a.program, a.starts, a.solved
    robot = pair.actual.robot
    found: list[list[Finding]] = [[] for _ in program.labels]

    def say(code: Code, rows: Mask, sizes: Array, from_row: Sequence[str] | None = None) -> None:
        """A warning of some rows, with the sizes of each: of each joint (N, m) the largest, or numbers (N, 2)."""
        for row in np.flatnonzero(rows & reached).tolist():
            numbers, name = sizes[row], ""
            if code not in _OF_POSES:
                joint = int(np.argmax(numbers))
                numbers, name = numbers[[joint]], robot.joint_names[joint]
            other = from_row[row] if from_row else ""
            found[row].append(Finding(code, tuple(numbers.tolist()), name, other))

    left = a.misses(solved)
    say("nominal unreachable", ~a.nominal_reaches, a.misses(starts))
    say("error left", ~within(left, _NOTHING), left)
    say("near singularity", *_near_singularity(a))
    whole = Matching(POSE, 1.0)
    moved = whole.misses(pair.nominal.poses(solved.q), starts.T_base_tool)
    say("large pose correction", ~within(moved, POSE_LIMIT), moved)
    changes = np.abs(solved.q - starts.q)
    slides = [robot.joint_types[name] == "prismatic" for name in robot.joint_names]
    allowed = np.where(slides, *JOINT_LIMIT[::-1])
    say("large joint correction", np.any(changes > allowed, axis=1), changes)
    # From the row before that has a command: others are passed over, as the robot does.
    rows = np.flatnonzero(reached)
    before = np.arange(len(found))
    before[rows[1:]] = rows[:-1]
    from_row = [program.labels[i] for i in before]
    planned, after = (np.abs(q - q[before]) for q in (starts.q, solved.q))
    close = (_CLOSE[0] * pair.reach, _CLOSE[1])
    near = within(whole.misses(a.T_wanted[before], a.T_wanted), close)
    over = np.asarray(near & (planned.max(axis=1) > _TURNED_OVER))
    say("configuration change", over, after, from_row)
    most = _STEP_FACTOR * planned.max(axis=1) + _STEP_MORE
    say("jump", np.asarray(~over & (after.max(axis=1) > most)), after, from_row)
    if program.T_wanted is not None and program.q is not None:
        apart = np.abs(starts.q - program.q)
        say("far from start", apart.max(axis=1) > _FAR_FROM_GIVEN, apart)
    say("ambiguous pose", ~within(a.left_by_pose - left, accept), a.left_by_pose)
    for outside in [] if pair.result is None else pair.result.outside_of_measured(solved.q):
        for one in outside.beyond if reached[outside.index] else ():
            found[outside.index].append(
                Finding("outside measured range", (float(one.by),), one.joint)
            )
    return tuple(map(tuple, found))


def _near_singularity(a: Attempt) -> tuple[Mask, Array]:
    """Where small motions of the tool take large ones of a joint (N,); what 1 mm takes of each (N, m) [rad or m]."""
    scaled = Matching(a.matching.name, 1.0)
    smallest, worst = [], []
    for one in (a.starts, a.solved):
        motion = scaled.jacobian(one.twists)
        inverse = np.linalg.pinv(motion, rcond=1e-12)
        worst.append(1e-3 * np.linalg.norm(inverse[:, :, :3], axis=2))
        motion[:, :3] /= a.pair.reach
        smallest.append(np.linalg.svd(motion, compute_uv=False)[:, -1])
    return np.minimum(*smallest) < NEAR_SINGULAR, np.maximum(*worst)
