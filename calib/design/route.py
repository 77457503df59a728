"""The way to drive: poses in a short order, whole turns of joints and poses in between where a straight way is blocked.

A move takes as long as the joint that moves farthest, c(a, b) = max_k |q_bk - q_ak|. The order is an open path through
all poses: nearest neighbours, improved by 2-opt and or-opt, then by kicks. Whether a move is free is asked only for
moves that the path has; those that are not are made dear, and the path is improved again. Where a joint has more than
one turn, the other side may be reached by turning it 360 deg further; else a pose is named by which the way is free.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from itertools import combinations, pairwise, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.design.candidates import rounded
from calib.robot.robot import Robot, read_only
from calib.units import Array

Indices = NDArray[np.intp]
FreePath = Callable[[Array, Array], bool]

#: How many kicks are tried, in all and of one path; the time that a kick takes grows as the square of the poses.
_KICKS, _KICK_WORK = 200, 1.0e6

#: So many nearest neighbour paths are improved, from first poses spread over all.
_BEGINNINGS = 6

#: Pieces of up to so many poses are put elsewhere; kicks swap stretches among so many neighbours, or shuffle so many.
_PIECE, _WINDOW, _SHUFFLED = 3, 30, 8

#: A gain below this, as a part of a typical move, is rounding.
_ROUNDING = 1e-9

#: Whole turns are tried of at most so many joints at once; so many ways between two stretches, and poses in between.
_MOST_JOINTS, _TRIES, _STOPS = 2, 60, 300

_TURN = 2.0 * np.pi


class Blocked(NamedTuple):
    """A move whose straight way in joint space is not free.

    From pose ``start`` to pose ``end``, from 1 in the order to drive (0: where the robot stands before), and joint
    values ``by`` which the way is free, shape (m,), [rad] or [m]; None where none was found.
    """

    start: int
    end: int
    by: Array | None


class Route(NamedTuple):
    """Poses in the order to drive.

    ``joints``, shape (K, m), [rad] or [m]; ``indices``, shape (K,), which of the poses each is; ``length``, the sum of
    the largest joint move over all moves; and the moves that are not free.
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

    ``joints``, shape (K, m), stay between ``limits``, shape (m, 2); ``start``, shape (m,), is where the robot stands
    before. ``free_path`` says whether the straight way between two poses is free, ``stops`` gives free poses to drive
    by.
    """
    tour = order(joints, start, free_path)
    if free_path is None or not tour.blocked:
        return tour
    cuts = [move.end - 1 for move in tour.blocked]
    stretches = [part for part in np.split(tour.indices, cuts) if len(part)]
    turned = with_whole_turns(joints, stretches, limits, turning(robot, limits), free_path)
    again = order(rounded(robot, turned), start, free_path)
    if len(again.blocked) < len(tour.blocked):
        tour = again
    free, path, blocked = joints[:0], tour.joints, []
    if tour.blocked and stops is not None:
        free = stops()
    for first, end, _ in tour.blocked:
        before = path[first - 1] if first or start is None else start
        blocked.append(Blocked(first, end, detour(before, path[end - 1], free, free_path)))
    return tour._replace(blocked=tuple(blocked))


# The order


def order(q: Array, start: Array | None = None, free_path: FreePath | None = None) -> Route:
    """A short open path through all poses, shape (N, m), the same for the same poses.

    A joint that can turn without end does not take the short way round, for controllers do not. ``free_path``: whether
    a straight move between two poses of shape (m,) is free, the same there and back.
    """
    from scipy.spatial.distance import cdist

    count = len(q)
    if count == 0:
        return Route(q, np.arange(0), 0.0, ())
    poses = q if start is None else np.vstack([q, start])
    # The two ends of the path come last, begin and finish: beginning costs the way from the start, nothing without one.
    costs = np.zeros((count + 2, count + 2))
    costs[: len(poses), : len(poses)] = cdist(poses, poses, "chebyshev")
    firsts = sorted({*np.linspace(0, count - 1, _BEGINNINGS).astype(int).tolist()})
    if costs[count, :count].any():
        firsts = [count]
    paths = [_improved(_nearest(costs, first), costs) for first in firsts]
    path = _kicked(min(paths, key=lambda one: _length(one, costs)), costs)
    # More than any path costs: one refused move less is worth every detour.
    dear, penalty = costs.copy(), float(costs.max()) * len(costs) + 1.0
    known: dict[tuple[int, int], bool] = {}
    kicked = True  # the path comes from kicks on the costs as they were
    while free_path is not None:
        fresh = False
        for a, b in pairwise(path.tolist()):
            # Begin without a start, and finish, are no moves.
            if max(a, b) < len(poses) and (a, b) not in known:
                known[a, b] = known[b, a] = bool(free_path(poses[a], poses[b]))
                if not known[a, b]:
                    dear[[a, b], [b, a]] += penalty
                    fresh = True
        if kicked and not fresh:
            break
        # Kicks take longest: only once no move that is asked for is refused any more.
        path, kicked = (_improved(path, dear), False) if fresh else (_kicked(path, dear), True)
    moves = enumerate(pairwise(path[:-1].tolist()))
    blocked = tuple(Blocked(k, k + 1, None) for k, one in moves if not known.get(one, True))
    return Route(read_only(q[path[1:-1]]), path[1:-1], _length(path, costs), blocked)


def _nearest(costs: Array, first: int) -> Indices:
    """From one pose, or the begin, always on to the nearest pose that is left; with both ends."""
    count = len(costs) - 2
    left = np.arange(count) != first
    path = [count] if first == count else [count, first]
    while left.any():
        free = np.flatnonzero(left)
        path.append(int(free[np.argmin(costs[path[-1], free])]))
        left[path[-1]] = False
    return np.array([*path, count + 1], dtype=np.intp)


def _length(path: Indices, costs: Array) -> float:
    """The cost of a path with its ends."""
    return float(costs[path[:-1], path[1:]].sum())


def _improved(path: Indices, costs: Array) -> Indices:
    """The path after 2-opt and or-opt, the best move first, until none gains; ends stay where they are."""
    least = _ROUNDING * max(float(costs.max()), 1e-300)
    closed = _closed(len(path))
    while True:
        gain, first, length, place, turned = min(
            _moves(costs[np.ix_(path, path)], closed), key=lambda move: move[0]
        )
        if gain > -least:
            return path
        piece = path[first : first + length]
        rest = np.concatenate([path[:first], path[first + length :]])
        piece = piece[::-1] if turned else piece
        path = np.concatenate([rest[:place], piece, rest[place:]])


@lru_cache(maxsize=64)
def _closed(size: int) -> tuple[Array, ...]:
    """What a path of so many places forbids, as an infinite cost.

    First pieces to turn that end before they begin, (size - 2, size - 2); then, for pieces of one place, two places,
    ..., putting them inside of themselves, (first place of the piece, gap between places).
    """
    forbidden = [np.tri(size - 2, dtype=np.bool_)]
    for length in range(1, min(_PIECE, size - 3) + 1):
        first, to = np.arange(1, size - length)[:, None], np.arange(size - 1)
        forbidden.append((to >= first - 1) & (to <= first + length - 1))
    return tuple(read_only(np.where(mask, np.inf, 0.0)) for mask in forbidden)


def _moves(near: Array, closed: tuple[Array, ...]) -> Iterator[tuple[float, int, int, int, bool]]:
    """The best pieces to move or turn.

    Args:
        near: shape (size, size), symmetric, the costs between the places of the path.
        closed: What `_closed` says of such a path.

    Yields:
        What the path gains in length, first place, size, new place, whether turned.
    """
    size, step = len(near), np.diagonal(near, 1)  # from place i to i + 1
    gain = near[:-2, 1:-1] + near[1:-1, 2:] - step[:-1, None] - step[1:] + closed[0]
    i, j = divmod(int(np.argmin(gain)), len(gain))
    yield float(gain[i, j]), i + 1, j - i + 1, i + 1, True
    for length, barred in enumerate(closed[1:], start=1):
        # Rows of the pieces' first and last places; the gap that the piece leaves is closed by one step.
        first, last = near[1 : size - length], near[length : size - 1]
        left = np.diagonal(near, length + 1) - step[: size - length - 1] - step[length:]
        rest = left[:, None] - step + barred
        for turned, head, tail in ((False, first, last), (True, last, first)):
            gain = head[:, :-1] + tail[:, 1:] + rest
            a, b = divmod(int(np.argmin(gain)), gain.shape[1])
            yield float(gain[a, b]), a + 1, length, b + 1 if b <= a else b + 1 - length, turned


def _kicked(path: Indices, costs: Array) -> Indices:
    """The path after kicks, each improved, and kept if it is no longer than before."""
    count = len(path) - 2
    random, length = np.random.default_rng(0), _length(path, costs)
    kicks = max(min(_KICKS, int(_KICK_WORK / len(path) ** 2)), 4) if count >= 3 else 0
    for k in range(kicks):
        swap = k % 2 and count > _SHUFFLED
        window = min(_WINDOW if swap else _SHUFFLED, count)
        low = int(random.integers(1, len(path) - window))
        other: Indices = path.copy()
        if swap:
            # Two neighbouring stretches change places, which neither 2-opt nor or-opt can undo.
            a, b, c = (low + np.sort(random.choice(window, 3, replace=False))).tolist()
            other[a:c] = [*path[b:c], *path[a:b]]
        else:
            # A stretch of a few poses in any order; of few poses, all of them.
            other[low : low + window] = random.permutation(path[low : low + window])
        other = _improved(other, costs)
        if (reached := _length(other, costs)) <= length:
            path, length = other, reached
    return path


# Where the straight way is blocked


def detour(start: Array, end: Array, poses: Array, free_path: FreePath) -> Array | None:
    """The pose, of shape (n, m), by which the way is free, and shortest of the 300 tried; None where none is."""
    length = np.max(np.abs(poses - start), axis=1) + np.max(np.abs(poses - end), axis=1)
    for k in np.argsort(length, kind="stable")[:_STOPS]:
        if free_path(start, poses[k]) and free_path(poses[k], end):
            return read_only(poses[k])
    return None


def turning(robot: Robot, ranges: Array) -> NDArray[np.bool_]:
    """Which columns of q have room for more than one turn in their ranges of shape (m, 2), shape (m,).

    A joint that others follow is none: they would end elsewhere.
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
    """Poses, shape (N, m), of which whole stretches are turned, so that a free way leads to them from the longest.

    ``stretches`` are indices of poses between which ways are free; ``ranges``, shape (m, 2), between which values must
    stay; ``turns``, shape (m,), see `turning`. A stretch to which no turn leads stays as it is.
    """
    result: Array = q.copy()
    longest = reached = max(stretches, key=len)
    joints = np.flatnonzero(turns).tolist()
    shifts = [
        np.bincount([*chosen, 0], [*signs, 0.0], len(turns))
        for count in range(min(_MOST_JOINTS, len(joints)) + 1)
        for chosen in combinations(joints, count)
        for signs in product((-_TURN, _TURN), repeat=count)
    ]
    for stretch in stretches:
        for shift in shifts if stretch is not longest else ():
            turned = result[stretch] + shift
            if not np.all((turned >= ranges[:, 0]) & (turned <= ranges[:, 1])):
                continue
            length = np.max(np.abs(result[reached][:, None] - turned[None]), axis=2)
            shortest = np.argsort(length, axis=None, kind="stable")[:_TRIES]
            ways = [divmod(int(k), len(turned)) for k in shortest]
            if any(free_path(result[reached[a]], turned[b]) for a, b in ways):
                result[stretch] = turned
                reached = np.concatenate([reached, stretch])
                break
    return result
