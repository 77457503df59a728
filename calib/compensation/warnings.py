"""Which commands can be given out, why the others cannot, and what to know of those that are, row by row."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.compensation.inverse import POSE, WEIGHTED, Matching, Solved
from calib.compensation.nominal_actual import Pair
from calib.compensation.program import Program
from calib.data.ranges import column_limits
from calib.robot.robot import Robot

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Joint values may pass their limits by this, for rounding [rad or m].
_ROUNDING = 1e-9

#: What is no error [m], [rad].
_NOTHING = (1e-8, 1e-8)

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

TEXTS = {
    "nominal": "the nominal robot cannot reach the pose itself",
    "turned": "the tool is turned by {:.3f} deg, without correction by {:.3f}",
    "left": "an error is left: {:.4f} mm and {:.4f} deg",
    "left position": "an error is left: {:.4f} mm",
    "singular": "near a singularity: 1 mm of the tool may take {}, 0.1 deg of it {}",
    "singular position": "near a singularity: 1 mm of the tool may take {}",
    "pose moves": "the pose moves by {:.2f} mm, more than {:g} mm",
    "pose turns": "the pose turns by {:.2f} deg, more than {:g} deg",
    "joint": "a joint is corrected by much: {}",
    "turns over": "the arm turns over: from {}, close by, it moves {}",
    "jump": "a jump: from {} it moves {}, where the program moves no joint by more than {}",
    "far": "far from the joint values given: {}",
    "by pose": "sent as a pose it may end {:.3g} mm off: the controller can come to other joint values",
    "outside": "outside the joint range that was measured: {}",
}
"""What is said of each code of a warning."""


class Warned(NamedTuple):
    """A warning: one of `TEXTS`, and what its text holds: numbers in mm and deg, and names; ``str()`` is the text."""

    code: str
    numbers: tuple[float | str, ...] = ()

    def __str__(self) -> str:
        """The text."""
        return TEXTS[self.code].format(*self.numbers)


def within(misses: Array, allowed: tuple[float, float]) -> Mask:
    """Which misses (N, 2) [m], [rad] are small enough; an angle that is not matched is."""
    return np.asarray((misses[:, 0] <= allowed[0]) & ~(misses[:, 1] > allowed[1]))


def reasons_of(
    pair: Pair,
    matching: Matching,
    starts: Solved,
    solved: Solved,
    left: Array,
    allowed: tuple[float, float],
) -> list[str]:
    """For each row why it has no command; empty where it has one.

    ``starts`` and ``solved`` are the actual robot at the nominal joint values and at those to command; ``left`` (N, 2)
    is what is left of the error there [m], [rad], ``allowed`` what may be.
    """
    robot, count = pair.actual.robot, len(pair.actual.robot.joint_names)
    low, high = column_limits(robot).T
    said = [""] * len(left)
    jacobians = [matching.jacobian(twists) for twists in (starts.twists, solved.twists)]
    if count == matching.rows:
        # The determinant has turned its sign: a singularity was passed on the way.
        signs = [np.linalg.slogdet(jacobian)[0] for jacobian in jacobians]
        for row in np.flatnonzero(signs[0] * signs[1] < 0):
            said[row] = "next to a singularity: the solution lies in another branch of the arm"
    beyond = np.maximum(low - solved.q, solved.q - high)
    for row in np.flatnonzero(beyond.max(axis=1) > _ROUNDING):
        joint = int(np.argmax(beyond[row]))
        name, value, own = robot.joint_names[joint], solved.q[row, joint], starts.q[row, joint]
        scale, unit = _shown(robot, name)
        bound = low[joint] if value < low[joint] else high[joint]
        said[row] = (
            f"'{name}' would have to be at {scale * value:.4f} {unit}, beyond its limit {scale * bound:.4f}"
        )
        if not low[joint] - _ROUNDING <= own <= high[joint] + _ROUNDING:
            said[row] += f"; without correction it is beyond it too, at {scale * own:.4f}"
    where = "at the edge of its reach or in a singularity"
    if count < matching.rows and matching.name != WEIGHTED:
        where = f"for it has {count} joints and cannot match {matching.rows} numbers"
    for row in np.flatnonzero(~within(left, allowed)):
        angle = "" if np.isnan(left[row, 1]) else f" and {np.degrees(left[row, 1]):.4f} deg"
        said[row] = (
            f"the true robot cannot reach it: {1e3 * left[row, 0]:.4f} mm{angle} would be left near the nominal joint "
            f"values, {where}"
        )
    return said


def warnings_of(
    pair: Pair,
    program: Program,
    matching: Matching,
    T_wanted: Array,
    starts: Solved,
    solved: Solved,
    *,
    reached: Mask,
    nominal_reaches: Mask,
    missed: Array,
    left: Array,
    left_by_pose: Array,
    accept: tuple[float, float],
    limit: tuple[float, float],
) -> tuple[tuple[Warned, ...], ...]:
    """For each row what to know of its command.

    ``T_wanted`` (N, 4, 4) and ``starts`` are in the base and of the nominal robot, ``solved`` is of the actual one.
    ``missed``, ``left`` and ``left_by_pose`` (N, 2) [m], [rad]: how far that misses without a command, with it, and if
    poses are sent; ``accept``: what may be left; ``limit``: corrections of the pose that are warned of.
    """
    robot, shown = pair.actual.robot, np.array([1e3, 180.0 / np.pi])
    said: list[list[Warned]] = [[] for _ in program.labels]

    def say(
        code: str, rows: Mask | np.bool_, *columns: Sequence[float | str] | Array | float
    ) -> None:
        """A warning of some rows: its numbers, for each row or for all; of values of joints the largest."""
        for row in np.flatnonzero(rows & reached).tolist():
            own = [c if isinstance(c, float) else c[row] for c in columns]
            said[row].append(
                Warned(code, tuple(_furthest(robot, c) if np.ndim(c) else c for c in own))  # type: ignore[arg-type]
            )

    part = "" if matching.rows > 3 else " position"
    say("nominal", ~nominal_reaches)
    if matching.name == WEIGHTED:
        angles = np.degrees([left[:, 1], missed[:, 1]])
        say("turned", left[:, 1] > missed[:, 1] + _WORSE, *angles)
    else:
        say(f"left{part}", ~within(left, _NOTHING), *(shown * left).T)
    singular, worst = _near_singularity(pair, matching, (starts.twists, solved.twists))
    say(f"singular{part}", singular, *worst[: 1 if part else 2])
    moved = Matching(POSE, 1.0).misses(pair.nominal.poses(solved.q), starts.T_base_tool)
    for i, code in enumerate(("pose moves", "pose turns")):
        say(code, moved[:, i] > limit[i], shown[i] * moved[:, i], float(shown[i] * limit[i]))
    changes = np.abs(solved.q - starts.q)
    slides = [robot.joint_types[name] == "prismatic" for name in robot.joint_names]
    say("joint", (changes > np.where(slides, *JOINT_LIMIT[::-1])).any(axis=1), changes)
    # From the row before that has a command: others are passed over, as the robot does.
    rows = np.flatnonzero(reached)
    before = np.arange(len(said))
    before[rows[1:]] = rows[:-1]
    from_row = [program.labels[i] for i in before]
    planned, after = (np.abs(q - q[before]) for q in (starts.q, solved.q))
    close = within(
        Matching(POSE, 1.0).misses(T_wanted[before], T_wanted), (_CLOSE[0] * pair.reach, _CLOSE[1])
    )
    over = close & (planned.max(axis=1) > _TURNED_OVER)
    say("turns over", over, from_row, after)
    most = _STEP_FACTOR * planned.max(axis=1) + _STEP_MORE
    say("jump", ~over & (after.max(axis=1) > most), from_row, after, planned)
    if program.T_wanted is not None and program.q is not None:
        apart = np.abs(starts.q - program.q)
        say("far", apart.max(axis=1) > _FAR_FROM_GIVEN, apart)
    say("by pose", ~within(left_by_pose - left, accept), 1e3 * left_by_pose[:, 0])
    if pair.result is not None:
        for outside in pair.result.outside_of_measured(solved.q):
            if reached[outside.index]:
                far = [(one.joint, one.by, *_shown(robot, one.joint)) for one in outside.beyond]
                joints = ", ".join(f"'{n}' {scale * by:.3g} {unit}" for n, by, scale, unit in far)
                said[outside.index].append(Warned("outside", (joints,)))
    return tuple(map(tuple, said))


def _near_singularity(
    pair: Pair, matching: Matching, twists: tuple[Array, Array]
) -> tuple[Mask, Array]:
    """Where small motions of the tool take large ones of a joint, before the correction or behind it.

    Returns:
        Which rows, shape (N,); and what 1 mm and 0.1 deg of the tool may take of each joint, shape (2, N, m).
    """
    scaled = Matching(matching.name, 1.0)
    smallest, worst = [], []
    for one in twists:
        motion = scaled.jacobian(one)
        inverse = np.linalg.pinv(motion, rcond=1e-12)
        by_length = np.linalg.norm(inverse[:, :, :3], axis=2)
        by_angle = np.linalg.norm(inverse[:, :, 3:], axis=2)
        worst.append(np.stack([1e-3 * by_length, np.radians(0.1) * by_angle]))
        motion[:, :3] /= pair.reach
        smallest.append(np.linalg.svd(motion, compute_uv=False)[:, -1])
    return np.minimum(*smallest) < NEAR_SINGULAR, np.maximum(*worst)


def _shown(robot: Robot, name: str) -> tuple[float, str]:
    """What a joint's value is multiplied by to be shown, and its unit then."""
    return (1e3, "mm") if robot.joint_types[name] == "prismatic" else (180.0 / np.pi, "deg")


def _furthest(robot: Robot, moved: Array) -> str:
    """The joint that moves furthest of all, and by how much: ``7.4 deg of 'wrist_1_joint'``."""
    joint = int(np.argmax(moved))
    scale, unit = _shown(robot, robot.joint_names[joint])
    most = min(scale * moved[joint], 1e6 if unit == "mm" else 360.0)
    return f"{most:.1f} {unit} of '{robot.joint_names[joint]}'"
