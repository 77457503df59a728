"""Route of a plan: the order to drive its poses, whole turns of joints, and poses to drive by if moves are blocked.

A move takes as long as its largest joint move, c(a, b) = max_k |q_bk - q_ak|; controllers do not turn joints the short
way round. The order is a short open path through all poses: paths that always go to the nearest pose that is left, from
several first poses, are improved by reversing pieces of them (2-opt), and the shortest is taken. Only the moves of a
path are tested for collisions. Blocked ones get a penalty, and the path is improved again. If a joint has room for more
than one turn, the other side of an obstacle may be reached by turning it 360 deg further.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations, pairwise, product
from typing import NamedTuple

import numpy as np

from calib.basics.arrays import Array, Integers, Mask, read_only
from calib.numerics.moves import last_moves
from calib.robot.robot import Robot
from calib.verbs.plan.approach import visits
from calib.verbs.plan.pose_candidates import rounded

#: Returns whether the straight move in joint space between two poses (m,) is free, the same there and back.
FreePath = Callable[[Array, Array], bool]

#: Number of first poses, spread over all, from which paths are tried.
_BEGINNINGS = 20

#: Largest number of joints that are turned at once.
_MOST_JOINTS = 2

#: Number of moves to a stretch of poses that are tried for each turn, the shortest ones.
_TRIES = 60

#: Number of poses to drive by that are tried for one move, the shortest ways first.
_STOPS = 300

#: A gain below this share of the largest cost is rounding.
_ROUNDING = 1e-9

_TURN = 2.0 * np.pi


class Blocked(NamedTuple):
    """Move whose straight way in joint space is not free."""

    #: Pose at which it begins, from 1 in the order to drive; 0: the robot's pose before the first move.
    start: int
    #: Pose to which it leads, from 1.
    end: int
    #: Shape (m,), joint values by which the way is free, [rad] or [m]; None: none was found.
    by: Array | None


class Route(NamedTuple):
    """Poses in the order to drive."""

    #: Shape (N, m), joint values, some turned by whole turns, [rad] or [m].
    joints: Array
    #: Shape (N, m), last move of each joint before each pose [rad] or [m].
    moves: Array
    #: Shape (N,), which of the given poses each is, from 0; several times if it is approached from several sides.
    order: Integers
    #: Sum over all moves of the largest move of a joint [rad or m], straight ways assumed.
    travel: float
    #: The moves that are not free.
    blocked: tuple[Blocked, ...]


def find_route(
    robot: Robot,
    joints: Array,
    limits: Array,
    start: Array | None = None,
    free_path: FreePath | None = None,
    stops: Callable[[], Array] | None = None,
    sides: Array | None = None,
) -> Route:
    """Order poses; if moves are blocked, turn some joints by whole turns, or name poses to drive by.

    Args:
        robot: The robot, with m measured joints.
        joints: Joint values of the poses, shape (N, m), [rad] or for sliding joints [m].
        limits: Lowest and highest value of each joint, shape (m, 2), [rad] or [m], between which poses stay.
        start: The robot's joint values before the first move, shape (m,), [rad] or [m]; None: any pose may be the
            first.
        free_path: Tests a move; None: all moves are free.
        stops: Returns joint values of free poses to drive by, shape (n, m); called only if moves remain blocked. None:
            there are none.
        sides: Moves by which the joints arrive at each pose, shape (s, m): the route comes to each pose from all of
            them, one after the other. None, or s = 0: straight from the pose before.

    Returns:
        The route, the same for the same poses, with as few blocked moves as are found. Moves by which poses are
        approached are not tested.
    """
    sides = joints[:0] if sides is None else sides
    route = order_poses(joints, start, free_path)
    if free_path is not None and route.blocked:
        turned = rounded(robot, _turn(robot, joints, limits, route, free_path))
        with_turns = order_poses(turned, start, free_path)
        if len(with_turns.blocked) < len(route.blocked):
            route = with_turns
    if len(sides):
        route = _approached(route, sides, start, free_path)
    if not route.blocked or stops is None or free_path is None:
        return route
    by_poses = stops()
    entries = route.joints - route.moves if len(sides) else route.joints
    blocked = []
    for first, end, _ in route.blocked:
        before = start if first == 0 and start is not None else route.joints[first - 1]
        by = _detour(before, entries[end - 1], by_poses, free_path)
        blocked.append(Blocked(first, end, by))
    return route._replace(blocked=tuple(blocked))


def _approached(
    route: Route, sides: Array, start: Array | None, free_path: FreePath | None
) -> Route:
    """Return a route whose poses are visited once from each side, by moves (s, m) that end there.

    The way to a visit leads from the visit before, or the start (m,), to its entry, where the last move begins. Ways to
    a pose's first visit are tested; those between its visits are as short as the moves.
    """
    joints, moves = visits(route.joints, sides)
    path = np.stack([joints - moves, joints], axis=1).reshape(-1, joints.shape[1])
    if start is not None:
        path = np.vstack([start, path])
    blocked = []
    if free_path is not None:
        entries = joints - moves
        for first in range(0, len(joints), len(sides)):
            before = joints[first - 1] if first else start
            if before is not None and not free_path(before, entries[first]):
                blocked.append(Blocked(first, first + 1, None))
    travel = float(np.abs(np.diff(path, axis=0)).max(axis=1).sum())
    order = np.repeat(route.order, len(sides))
    return Route(read_only(joints), read_only(moves), order, travel, tuple(blocked))


def order_poses(q: Array, start: Array | None = None, free_path: FreePath | None = None) -> Route:
    """Find a short open path through poses (N, m) as they are, with few blocked moves; for the rest see `find_route`.

    A move is as long as the largest change of a joint in it [rad] or [m].
    """
    # Imported late, because it takes long.
    from scipy.spatial.distance import cdist

    count = len(q)
    poses = q if start is None else np.vstack([q, start])
    # Two more nodes: the start of a path, which is the robot's or any pose, and its end, which costs nothing.
    costs = np.zeros((count + 2, count + 2))
    costs[: len(poses), : len(poses)] = cdist(poses, poses, "chebyshev")
    path = _shortest_path(costs)
    penalised = costs.copy()
    penalty = float(costs.max()) * len(costs) + 1.0  # a blocked move is worse than any detour
    is_free: dict[tuple[int, int], bool] = {}  # of the moves that were tested, there and back
    is_settled = False
    while free_path is not None and not is_settled:
        is_settled = True
        for a, b in pairwise(path.tolist()):
            if max(a, b) < len(poses) and (a, b) not in is_free:
                is_free[a, b] = is_free[b, a] = free_path(poses[a], poses[b])
                if not is_free[a, b]:
                    penalised[[a, b], [b, a]] += penalty
                    is_settled = False
        path = _improve(path, penalised)
    driven = enumerate(pairwise(path[:-1].tolist()))
    blocked = [Blocked(k, k + 1, None) for k, move in driven if not is_free.get(move, True)]
    order = path[1:-1]
    joints = read_only(q[order])
    # The first pose has a move if the robot's start is known.
    visited = joints if start is None else np.vstack([start, joints])
    moves = last_moves(visited)[len(visited) - count :]
    return Route(joints, read_only(moves), order, _length(path, costs), tuple(blocked))


def _shortest_path(costs: Array) -> Integers:
    """Return the shortest of several paths, as n + 2 indices, by the costs (n + 2, n + 2) of the moves between nodes.

    The nodes are n poses, then the start, whose moves cost nothing if any pose may be the first, then the end. Each
    path begins at another pose, goes to the nearest pose that is left, and is improved.
    """
    count = len(costs) - 2
    firsts = np.unique(np.linspace(0, count - 1, _BEGINNINGS).astype(int)).tolist() if count else []
    if count == 0 or costs[count].any():  # the path begins at the robot's start
        firsts.append(count)
    paths = []
    for first in firsts:
        path = [count] if first == count else [count, first]
        is_left = np.ones(count, dtype=np.bool_)
        is_left[path[1:]] = False
        while is_left.any():
            path.append(int(np.argmin(np.where(is_left, costs[path[-1], :count], np.inf))))
            is_left[path[-1]] = False
        paths.append(_improve(np.array([*path, count + 1]), costs))
    return min(paths, key=lambda path: _length(path, costs))


def _improve(path: Integers, costs: Array) -> Integers:
    """Improve a path by reversing the piece whose reversal shortens it most, until none does; its ends stay.

    The path has the indices of the n nodes in their order, and costs are those of the moves between nodes, (n, n).
    Reversing the places i to j replaces the steps (i - 1, i) and (j, j + 1) by (i - 1, j) and (i, j + 1).
    """
    least_gain = _ROUNDING * float(costs.max())
    upper = np.triu(np.ones((len(path) - 2, len(path) - 2), dtype=np.bool_), 1)
    while upper.any():
        by_place = costs[np.ix_(path, path)]
        step = np.diagonal(by_place, 1)  # from place i to i + 1
        added = by_place[:-2, 1:-1] + by_place[1:-1, 2:] - step[:-1, None] - step[1:]
        i, j = np.unravel_index(np.argmin(np.where(upper, added, np.inf)), added.shape)
        if added[i, j] >= -least_gain:
            break
        path = np.concatenate([path[: i + 1], path[i + 1 : j + 2][::-1], path[j + 2 :]])
    return path


def _length(path: Integers, costs: Array) -> float:
    """Return the length of a path with both ends, the sum of the costs of its moves [rad or m]."""
    return float(costs[path[:-1], path[1:]].sum())


def _turn(robot: Robot, q: Array, limits: Array, route: Route, free_path: FreePath) -> Array:
    """Return poses (N, m) with whole turns of joints, so that free moves lead from the longest stretch to the others.

    Each stretch between blocked moves is shifted as a whole by the fewest turns, 0 included, with which one of the
    shortest moves from a stretch reached so far is free; otherwise it stays.
    """
    joints = np.flatnonzero(_turning_joints(robot, limits)).tolist()
    shifts: list[Array] = []
    for count in range(min(_MOST_JOINTS, len(joints)) + 1):
        for chosen, signs in product(combinations(joints, count), product((-1, 1), repeat=count)):
            shift = np.zeros(q.shape[1])
            shift[list(chosen)] = np.multiply(signs, _TURN)
            shifts.append(shift)
    stretches = np.split(route.order, [move.end - 1 for move in route.blocked])
    turned: Array = q.copy()
    longest = reached = max(stretches, key=len)
    for stretch in stretches:
        if stretch is longest or not len(stretch):
            continue
        for shift in shifts:
            there = turned[stretch] + shift
            if not ((there >= limits[:, 0]) & (there <= limits[:, 1])).all():
                continue
            here = turned[reached]
            lengths = np.max(np.abs(here[:, None] - there[None]), axis=2)
            shortest = np.argsort(lengths, axis=None, kind="stable")[:_TRIES]
            moves = zip(*np.unravel_index(shortest, lengths.shape), strict=True)
            if any(free_path(here[a], there[b]) for a, b in moves):
                turned[stretch] = there
                reached = np.concatenate([reached, stretch])
                break
    return turned


def _turning_joints(robot: Robot, limits: Array) -> Mask:
    """Return which joints (m,) turn within limits (m, 2) [rad] of more than one turn, and do so alone.

    Joints that others follow, or whose readings are coupled, are not among them.
    """
    slides = np.array([joint.type == "prismatic" for joint in robot.inputs])
    followers = {
        joint.name: row != 0.0
        for chain in robot.chains
        for joint, row in zip(chain.joints, chain.mimic_matrix, strict=True)
    }
    is_alone = np.sum([*followers.values()], axis=0) <= 1
    has_factors = robot.reading_matrix != np.eye(len(slides))
    is_coupled = has_factors.any(axis=0) | has_factors.any(axis=1)
    return np.asarray(~slides & is_alone & ~is_coupled & (np.ptp(limits, axis=1) > _TURN))


def _detour(start: Array, end: Array, poses: Array, free_path: FreePath) -> Array | None:
    """Return the pose (m,), of several (n, m), by which the way between two others is free and shortest.

    None if no way by one of those with the shortest ways is free.
    """
    to_pose = np.max(np.abs(poses - start), axis=1)
    from_pose = np.max(np.abs(poses - end), axis=1)
    for k in np.argsort(to_pose + from_pose, kind="stable")[:_STOPS]:
        if free_path(start, poses[k]) and free_path(poses[k], end):
            return read_only(poses[k])
    return None
