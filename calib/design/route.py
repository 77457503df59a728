"""The way to drive: poses in a short order, whole turns of joints and poses in between where a straight way is blocked.

A joint of more than one turn reaches each pose in more than one way. A robot that cannot swing its arm down through the
table gets to the other side over the top: the target is measured in the same place, and the joint stands 360 deg
further. Where that does not help either, a pose is named by which the way is free.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from calib.design.candidates import rounded
from calib.design.ordering import START, Tour, order
from calib.model.robot import Robot, read_only

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
FreePath = Callable[[Array, Array], bool]

_TURN = 2.0 * np.pi

#: Turned by whole turns at once are at most this many joints.
_MOST_JOINTS = 2

#: Ways between two stretches that are tried, and poses in between, the shortest ways first.
_TRIES, _STOPS = 60, 300


@dataclass(frozen=True, slots=True, eq=False)
class Blocked:
    """A move whose straight way in joint space is not free.

    Attributes:
        start: The pose that it leaves, from 1 in the order to drive; 0 is where the robot stands before.
        end: The pose that it leads to.
        by: shape (m,), joint values by which the way is free, [rad] or [m]; None where none was found.
    """

    start: int
    end: int
    by: Array | None


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """Poses in the order to drive.

    Attributes:
        joints: shape (K, m), [rad] or [m].
        indices: shape (K,), which of the poses each is.
        length: The sum over all moves of the largest move of a joint [rad] or [m].
        blocked: The moves that are not free.
    """

    joints: Array
    indices: Indices
    length: float
    blocked: tuple[Blocked, ...]


def route(
    robot: Robot,
    joints: Array,
    limits: Array,
    start: Array | None = None,
    free_path: FreePath | None = None,
    stops: Callable[[], Array] | None = None,
) -> Route:
    """Poses in the order to drive; where a move is blocked, a turn more of some joints, else a pose to drive by.

    Args:
        robot: The robot.
        joints: shape (K, m), [rad] or [m].
        limits: shape (m, 2), between which joints may stand.
        start: shape (m,), where the robot stands before; None: it begins at any pose.
        free_path: Whether the straight way between two poses is free; None: all are.
        stops: Called where moves are blocked for free poses to drive by, shape (n, m).
    """
    tour = order(joints, start=start, free_path=free_path)
    if free_path is not None and tour.blocked:
        turned = with_whole_turns(
            joints, _stretches(tour), limits, turning(robot, limits), free_path
        )
        turned = rounded(robot, turned)
        again = order(turned, start=start, free_path=free_path)
        if len(again.blocked) < len(tour.blocked):
            joints, tour = turned, again
    blocked = []
    if free_path is not None and tour.blocked:
        free = np.zeros((0, joints.shape[1])) if stops is None else stops()
        place = {int(i): k for k, i in enumerate(tour.indices, 1)} | {START: 0}
        for a, b in tour.blocked:
            first = joints[a] if a != START else np.asarray(start, dtype=np.float64)
            blocked.append(Blocked(place[a], place[b], detour(first, joints[b], free, free_path)))
    return Route(read_only(joints[tour.indices]), tour.indices, tour.cost, tuple(blocked))


def detour(start: Array, end: Array, poses: Array, free_path: FreePath) -> Array | None:
    """The pose by which the way from start to end is free, and the shortest of those tried.

    The length of a straight move is that of the joint that turns farthest, max_k |q_bk - q_ak|.

    Args:
        start: shape (m,), [rad] or [m].
        end: shape (m,).
        poses: shape (n, m), free poses to stop at.
        free_path: Whether the straight way between two poses, both shape (m,), is free.

    Returns:
        shape (m,), or None where none of the 300 shortest ways is free.
    """
    length = np.max(np.abs(poses - start), axis=1) + np.max(np.abs(poses - end), axis=1)
    for k in np.argsort(length, kind="stable")[:_STOPS]:
        if free_path(start, poses[k]) and free_path(poses[k], end):
            return read_only(poses[k])
    return None


def _stretches(tour: Tour) -> list[Indices]:
    """The poses between blocked moves, in the order to drive."""
    place = {int(i): k for k, i in enumerate(tour.indices)}
    cuts = sorted(place[b] for _, b in tour.blocked)
    return [part for part in np.split(tour.indices, cuts) if len(part)]


def turning(robot: Robot, ranges: Array) -> NDArray[np.bool_]:
    """Which columns of q have room for more than one turn, shape (m,).

    A joint that others follow is none: they would end elsewhere.

    Args:
        robot: The robot.
        ranges: shape (m, 2), between which joint values must stay [rad] or [m].
    """
    slides = np.array([joint.type == "prismatic" for joint in robot.inputs])
    alone = np.sum(robot.coupling != 0.0, axis=0) <= 1
    return np.asarray(~slides & alone & (np.ptp(ranges, axis=1) > _TURN))


def with_whole_turns(
    q: Array,
    stretches: Sequence[Indices],
    ranges: Array,
    turns: NDArray[np.bool_],
    free_path: FreePath,
) -> Array:
    """Poses of which whole stretches are turned, so that a free way leads to them from the longest of all.

    Args:
        q: shape (N, m), [rad] or [m].
        stretches: Indices of poses between which ways are free, but from one stretch to another they may not be.
        ranges: shape (m, 2), between which values must stay.
        turns: shape (m,), which joints may be turned by whole turns, see `turning`.
        free_path: Whether the straight way between two poses is free.

    Returns:
        shape (N, m); a stretch to which no turn leads stays as it is.
    """
    result: Array = q.copy()
    longest = max(range(len(stretches)), key=lambda k: len(stretches[k]))
    reached = stretches[longest]
    for k, stretch in enumerate(stretches):
        if k == longest:
            continue
        for shift in _shifts(turns):
            turned = result[stretch] + shift
            inside = np.all((turned >= ranges[:, 0]) & (turned <= ranges[:, 1]))
            if inside and _joined(result[reached], turned, free_path):
                result[stretch] = turned
                reached = np.concatenate([reached, stretch])
                break
    return result


def _joined(some: Array, others: Array, free_path: FreePath) -> bool:
    """Whether a free way leads from one of some poses to one of the others; the shortest ways are tried."""
    length = np.max(np.abs(some[:, None] - others[None]), axis=2)
    for place in np.argsort(length, axis=None, kind="stable")[:_TRIES]:
        a, b = np.unravel_index(place, length.shape)
        if free_path(some[a], others[b]):
            return True
    return False


def _shifts(turns: NDArray[np.bool_]) -> Iterator[Array]:
    """No turn, and one turn either way of each joint and of each pair of joints, shape (m,) each."""
    yield np.zeros(len(turns))
    joints = np.flatnonzero(turns)
    for count in range(1, min(_MOST_JOINTS, len(joints)) + 1):
        for chosen in combinations(joints, count):
            for signs in product((-_TURN, _TURN), repeat=count):
                shift = np.zeros(len(turns))
                shift[list(chosen)] = signs
                yield shift
