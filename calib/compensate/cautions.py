"""Cautions: what to know of a command before it goes to a robot, in words, row by row.

Each begins with the same words for every row that it is said of, so that they can be counted.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calib.compensate.inverse import Solved
from calib.compensate.matching import POSE, WEIGHTED, Matching
from calib.compensate.pair import Pair
from calib.compensate.starts import Starts
from calib.model.robot import Robot

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Words = list[tuple[str, ...]]

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

#: What is left below this is nothing [m], [rad].
_NOTHING = (1e-8, 1e-8)

#: How much worse an angle may get for the sake of the position [rad].
_WORSE = np.radians(0.2)


def nominal_cannot(reaches: Mask) -> Words:
    """Where the nominal robot itself cannot reach the pose; shape (N,)."""
    return [() if one else ("the nominal robot cannot reach the pose itself",) for one in reaches]


def near_singularity(pair: Pair, matching: Matching, starts: Starts, solved: Solved) -> Words:
    """Where small motions of the tool take large ones of a joint, before the correction or behind it."""
    robot = pair.true.robot
    scaled = Matching(matching.name, 1.0)
    smallest = np.full(len(solved.q), np.inf)
    worst: Array = np.zeros((len(solved.q), 2, len(robot.joint_names)))
    for twists in (pair.believed.motion(starts.q)[1], solved.twists):
        motion = scaled.jacobian(twists)
        even = motion.copy()
        even[:, :3] /= pair.reach
        smallest = np.minimum(smallest, np.linalg.svd(even, compute_uv=False)[:, -1])
        inverse = np.linalg.pinv(motion, rcond=1e-12)
        by_length = np.linalg.norm(inverse[:, :, :3], axis=2)
        by_angle = np.linalg.norm(inverse[:, :, 3:], axis=2)
        worst = np.maximum(worst, np.stack([1e-3 * by_length, np.radians(0.1) * by_angle], axis=1))
    said: Words = []
    for near, moved in zip(smallest < NEAR_SINGULAR, worst, strict=True):
        if not near:
            said.append(())
            continue
        parts = [f"1 mm of the tool may take {_furthest(robot, moved[0])}"]
        if matching.rows > 3:
            parts.append(f"0.1 deg of it {_furthest(robot, moved[1])}")
        said.append((f"near a singularity: {', '.join(parts)}",))
    return said


def pose_moved(moved: Array, limit: tuple[float, float]) -> Words:
    """Where the pose to send is changed by more than a limit.

    Args:
        moved: shape (N, 2), [m], [rad].
        limit: [m], [rad].
    """
    said: Words = []
    for distance, angle in moved:
        words = []
        if distance > limit[0]:
            words.append(
                f"the pose moves by {1e3 * distance:.2f} mm, more than {1e3 * limit[0]:g} mm"
            )
        if angle > limit[1]:
            turned, allowed = np.degrees(angle), np.degrees(limit[1])
            words.append(f"the pose turns by {turned:.2f} deg, more than {allowed:g} deg")
        said.append(tuple(words))
    return said


def joints_moved(robot: Robot, before: Array, after: Array) -> Words:
    """Where a joint is corrected by much, shapes (N, m) [rad] or [m]."""
    slides = np.array([robot.joint_types[name] == "prismatic" for name in robot.joint_names])
    allowed = np.where(slides, JOINT_LIMIT[1], JOINT_LIMIT[0])
    return [
        (f"a joint is corrected by much: {_furthest(robot, row)}",) if (row > allowed).any() else ()
        for row in np.abs(after - before)
    ]


def left_over(left: Array, missed: Array, matching: Matching) -> Words:
    """Where the true robot still misses: by what was accepted, or by what a weighted match gave away.

    Args:
        left: shape (N, 2), with the command [m], [rad].
        missed: shape (N, 2), without [m], [rad].
        matching: What is matched.
    """
    said: Words = []
    for (distance, angle), before in zip(left, missed, strict=True):
        if matching.name == WEIGHTED:
            worse = angle > before[1] + _WORSE
            text = (
                f"the tool is turned by {np.degrees(angle):.3f} deg, without correction by "
                f"{np.degrees(before[1]):.3f}"
            )
        else:
            worse = distance > _NOTHING[0] or angle > _NOTHING[1]
            turned = "" if np.isnan(angle) else f" and {np.degrees(angle):.4f} deg"
            text = f"an error is left: {1e3 * distance:.4f} mm{turned}"
        said.append((text,) if worse else ())
    return said


def by_pose(left: Array, elsewhere: Mask) -> Words:
    """Where a controller may come to other joint values if the pose is sent.

    Args:
        left: shape (N, 2), how far the true robot then misses [m], [rad].
        elsewhere: shape (N,), where that is further than by joint values.
    """
    return [
        (
            f"sent as a pose it may end {1e3 * misses[0]:.3g} mm off: the controller can come to other joint "
            "values",
        )
        if far
        else ()
        for misses, far in zip(left, elsewhere, strict=True)
    ]


def outside(pair: Pair, q: Array) -> Words:
    """Where joint values, shape (N, m), lie outside of the range that was measured."""
    said: Words = [()] * len(q)
    if pair.result is not None:
        for row in pair.result.outside_of_measured(q):
            joints = ", ".join(map(str, row.beyond))
            said[row.index] = (f"outside the joint range that was measured: {joints}",)
    return said


def jumps(
    pair: Pair, T_wanted: Array, before: Array, after: Array, labels: Sequence[str], reached: Mask
) -> Words:
    """Where the arm moves further from the row before than the program has it, or turns over.

    Args:
        pair: The two models.
        T_wanted: shape (N, 4, 4), [m].
        before: shape (N, m), joint values of the nominal robot [rad] or [m].
        after: shape (N, m), those to command.
        labels: What each row is called.
        reached: shape (N,), which rows have a command: others are passed over, as the robot does.
    """
    robot = pair.true.robot
    said: Words = [()] * len(after)
    rows = np.flatnonzero(reached)
    apart = Matching(POSE, 1.0).misses(T_wanted[rows[:-1]], T_wanted[rows[1:]])
    close = (apart[:, 0] < _CLOSE[0] * pair.reach) & (apart[:, 1] < _CLOSE[1])
    for first, row, near in zip(rows[:-1], rows[1:], close, strict=True):
        planned = np.abs(before[row] - before[first])
        moved = np.abs(after[row] - after[first])
        if near and planned.max() > _TURNED_OVER:
            said[row] = (
                f"the arm turns over: from {labels[first]}, close by, it moves {_furthest(robot, moved)}",
            )
        elif (moved > _STEP_FACTOR * planned.max() + _STEP_MORE).any():
            said[row] = (
                f"a jump: from {labels[first]} it moves {_furthest(robot, moved)}, where the program moves no joint by "
                f"more than {_furthest(robot, planned)}",
            )
    return said


def far_from_given(robot: Robot, given: Array | None, before: Array) -> Words:
    """Where the nominal robot's joint values, shape (N, m), are not those near which they were looked for."""
    if given is None:
        return [()] * len(before)
    return [
        (f"far from the joint values given: {_furthest(robot, row)}",)
        if row.max() > _FAR_FROM_GIVEN
        else ()
        for row in np.abs(before - given)
    ]


def _furthest(robot: Robot, moved: Array) -> str:
    """The joint that moves furthest of all, and by how much: ``7.4 deg of 'wrist_1_joint'``."""
    joint = int(np.argmax(moved))
    name = robot.joint_names[joint]
    if robot.joint_types[name] == "prismatic":
        return f"{min(1e3 * moved[joint], 1e6):.1f} mm of '{name}'"
    return f"{min(np.degrees(moved[joint]), 360.0):.1f} deg of '{name}'"
