"""Route of a plan: the order to drive, whole turns of joints, and poses to drive by where a straight way is blocked.

Where a joint has room for more than one turn, the other side of an obstacle may be reached by turning it 360 deg
further; else a pose is named by which the way is free.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from calib.basics.arrays import Array, read_only
from calib.robot.robot import Robot
from calib.verbs.plan.candidates import rounded
from calib.verbs.plan.ordering import Blocked, FreePath, Indices, Route, order

#: Whole turns are tried of at most this many joints at once.
_MOST_JOINTS = 2

#: Ways between two stretches that are tried, the shortest ones.
_TRIES = 60

#: Poses to drive by that are tried for one move.
_STOPS = 300

_TURN = 2.0 * np.pi


def route(
    robot: Robot,
    joints: Array,
    limits: Array,
    start: Array | None = None,
    free_path: FreePath | None = None,
    stops: Callable[[], Array] | None = None,
) -> Route:
    """Order poses; where a move is blocked, turn some joints once more, or name a pose to drive by.

    Args:
        robot: The robot, with m measured joints.
        joints: Joint values of the poses, shape (K, m), [rad] or for sliding joints [m], columns as
            ``robot.joint_names``.
        limits: Lowest and highest value of each joint, shape (m, 2), [rad] or [m], between which poses stay.
        start: The robot's joint values before the first move, shape (m,), [rad] or [m]; None: the route begins at any
            pose.
        free_path: Function of the joint values of two poses, shape (m,) each, that returns whether the straight move
            between them is free, the same there and back; None: all moves are free.
        stops: Function that returns joint values of free poses to drive by, shape (n, m), called only where moves
            remain blocked; None: there are none.

    Returns:
        ``joints``, the poses in the order to drive, shape (K, m), some turned by whole turns of joints; ``indices``,
        the index in the argument ``joints`` of each, from 0, shape (K,); ``length``, the sum over all moves of the
        largest move of a joint [rad or m], straight ways assumed; and the moves that remain ``blocked``, by the places
        of their two poses in the order, from 1 (0: ``start``), each with a pose to drive by, shape (m,), or None.
    """
    tour = order(joints, start, free_path)
    if free_path is None or not tour.blocked:
        return tour
    tour = _with_turns(robot, joints, limits, start, free_path, tour)
    by_poses = joints[:0]
    if tour.blocked and stops is not None:
        by_poses = stops()
    blocked = []
    for first, end, _ in tour.blocked:
        is_first_move = first == 0 and start is not None
        before = start if is_first_move else tour.joints[first - 1]
        assert before is not None
        by = detour(before, tour.joints[end - 1], by_poses, free_path)
        blocked.append(Blocked(first, end, by))
    return tour._replace(blocked=tuple(blocked))


def _with_turns(
    robot: Robot,
    joints: Array,
    limits: Array,
    start: Array | None,
    free_path: FreePath,
    tour: Route,
) -> Route:
    """Return the route with whole turns of joints if it has fewer blocked moves, else the route as it is.

    Args:
        robot: The robot, with m measured joints.
        joints: Joint values of the poses, shape (K, m), [rad] or for sliding joints [m].
        limits: Lowest and highest value of each joint, shape (m, 2), [rad] or [m], between which poses stay.
        start: The robot's joint values before the first move, shape (m,); None: the route begins at any pose.
        free_path: Function of the joint values of two poses, shape (m,) each, that returns whether the straight move
            between them is free.
        tour: The route without turns: ``tour.indices``, the indices in ``joints`` of the poses in order, from 0, shape
            (K,); ``tour.blocked``, the moves that are not free, with ``end`` the place of the pose that each leads to,
            from 1.

    Returns:
        The better of the two routes, each with the poses in the order to drive, shape (K, m), their indices in
        ``joints``, the length [rad or m], and the moves that are blocked.
    """
    cuts = [move.end - 1 for move in tour.blocked]
    stretches = [part for part in np.split(tour.indices, cuts) if len(part)]
    turned = with_whole_turns(joints, stretches, limits, turning(robot, limits), free_path)
    turned_tour = order(rounded(robot, turned), start, free_path)
    return turned_tour if len(turned_tour.blocked) < len(tour.blocked) else tour


def detour(start: Array, end: Array, poses: Array, free_path: FreePath) -> Array | None:
    """Find a pose by which the way between two others is free: the shortest such way, of the 300 shortest.

    The length of a move is the largest move of a joint.

    Args:
        start: Joint values of the pose to leave, shape (m,), [rad] or for sliding joints [m].
        end: Joint values of the pose to reach, shape (m,), likewise.
        poses: Joint values of free poses to drive by, shape (n, m), likewise; n may be 0.
        free_path: Function of the joint values of two poses, shape (m,) each, that returns whether the straight move
            between them is free.

    Returns:
        Joint values of the pose to drive by, shape (m,), read-only; None where none is found.
    """
    first_part = np.max(np.abs(poses - start), axis=1)
    second_part = np.max(np.abs(poses - end), axis=1)
    length = first_part + second_part
    for k in np.argsort(length, kind="stable")[:_STOPS]:
        if free_path(start, poses[k]) and free_path(poses[k], end):
            return read_only(poses[k])
    return None


def turning(robot: Robot, ranges: Array) -> NDArray[np.bool_]:
    """Find the joints that can be turned by a whole turn, after which the tip is where it was.

    They turn, their range is more than one turn, no mimic joint follows them, which would end elsewhere, and their
    readings are not coupled.

    Args:
        robot: The robot, with m measured joints; ``robot.inputs`` are these joints, ``robot.mimic_matrix``, shape
            (n, m), is the derivative of the n joints of the chain by them.
        ranges: Lowest and highest value of each joint, shape (m, 2), [rad] or for sliding joints [m].

    Returns:
        True for such joints, shape (m,), in the order of ``robot.joint_names``.
    """
    slides = np.array([joint.type == "prismatic" for joint in robot.inputs])
    is_alone = np.sum(robot.mimic_matrix != 0.0, axis=0) <= 1
    has_factors = robot.reading_matrix != np.eye(len(slides))
    is_coupled = has_factors.any(axis=0) | has_factors.any(axis=1)
    return np.asarray(~slides & is_alone & ~is_coupled & (np.ptp(ranges, axis=1) > _TURN))


def with_whole_turns(
    q: Array,
    stretches: Sequence[Indices],
    ranges: Array,
    turns: NDArray[np.bool_],
    free_path: FreePath,
) -> Array:
    """Add whole turns of joints to stretches of poses, so that a free way leads to them from the longest stretch.

    Each of the others in turn is shifted as a whole by the fewest turns, 0 included, with which a straight way to it is
    free from the poses reached so far.

    Args:
        q: Joint values of the poses, shape (N, m), [rad] or for sliding joints [m]; they are not changed.
        stretches: Indices of poses in ``q``, from 0, in the order driven; within each stretch all moves are free.
        ranges: Lowest and highest value of each joint, shape (m, 2), [rad] or [m], between which poses stay.
        turns: Which joints may be turned by whole turns, shape (m,), see `turning`.
        free_path: Function of the joint values of two poses, shape (m,) each, that returns whether the straight move
            between them is free.

    Returns:
        The joint values with the turns added, shape (N, m), in the order of ``q``; a stretch to which no turn leads
        stays as it is.
    """
    turned_q: Array = q.copy()
    longest = reached = max(stretches, key=len)
    shifts = _shifts(turns)
    for stretch in stretches:
        if stretch is longest:
            continue
        for shift in shifts:
            turned = turned_q[stretch] + shift
            in_range = (turned >= ranges[:, 0]) & (turned <= ranges[:, 1])
            if np.all(in_range) and _is_reached(turned_q[reached], turned, free_path):
                turned_q[stretch] = turned
                reached = np.concatenate([reached, stretch])
                break
    return turned_q


def _shifts(turns: NDArray[np.bool_]) -> list[Array]:
    """Return the whole turns that are tried, of at most two joints at once.

    Args:
        turns: Which joints may be turned by whole turns, shape (m,).

    Returns:
        Changes of the joint values, shape (m,) each, 0 or plus or minus 2 pi [rad]; the fewest joints first, and before
        them no turn at all.
    """
    joints = np.flatnonzero(turns).tolist()
    shifts: list[Array] = []
    for count in range(min(_MOST_JOINTS, len(joints)) + 1):
        for chosen in combinations(joints, count):
            for signs in product((-_TURN, _TURN), repeat=count):
                shift = np.zeros(len(turns))
                shift[list(chosen)] = signs
                shifts.append(shift)
    return shifts


def _is_reached(reached: Array, turned: Array, free_path: FreePath) -> bool:
    """Test whether one of the 60 shortest straight ways from poses that are reached to those of a stretch is free.

    The length of a way is the largest move of a joint.

    Args:
        reached: Joint values of the poses that are reached, shape (a, m), [rad] or for sliding joints [m].
        turned: Joint values of the poses of the stretch, shape (b, m), likewise.
        free_path: Function of the joint values of two poses, shape (m,) each, that returns whether the straight move
            between them is free.
    """
    length = np.max(np.abs(reached[:, None] - turned[None]), axis=2)
    shortest = np.argsort(length, axis=None, kind="stable")[:_TRIES]
    ways = [divmod(int(k), len(turned)) for k in shortest]
    return any(free_path(reached[a], turned[b]) for a, b in ways)
