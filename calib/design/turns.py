"""Whole turns: the same pose with a joint turned once more, where that makes a blocked way free.

A joint of more than one turn reaches each pose in more than one way. A robot that cannot swing its arm down through the
table gets to the other side over the top: the target is measured in the same place, and the joint stands 360 deg
further.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from calib.model.robot import Robot

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
FreePath = Callable[[Array, Array], bool]

_TURN = 2.0 * np.pi

#: Turned by whole turns at once are at most this many joints.
_MOST_JOINTS = 2

#: Ways between two stretches that are tried, the shortest first.
_TRIES = 60


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
