"""Order in which poses are driven: a short open path through all of them.

A move takes as long as the joint that moves farthest, c(a, b) = max_k |q_bk - q_ak|. The order is an open path through
all poses: nearest neighbours, improved by 2-opt and or-opt, then by kicks (iterated local search). Whether a move is
free is asked only for moves that the path has; blocked moves get a penalty, and the path is improved again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.robot.robot import read_only
from calib.units import Array

Indices = NDArray[np.intp]

#: Whether the straight move in joint space between two poses of shape (m,) is free, the same there and back.
FreePath = Callable[[Array, Array], bool]

#: Number of kicks that are tried at most.
_KICKS = 200

#: Number of kicks times the squared number of poses at most: the time of a kick grows as that square.
_KICK_WORK = 1.0e6

#: Nearest neighbour paths that are improved, from first poses spread over all.
_BEGINNINGS = 6

#: Pieces of up to this many poses are moved by or-opt.
_PIECE = 3

#: A kick that swaps two neighbouring stretches takes them out of this many poses.
_WINDOW = 30

#: A kick that shuffles takes this many poses.
_SHUFFLED = 8

#: A gain below this share of the largest cost is rounding.
_ROUNDING = 1e-9


class Blocked(NamedTuple):
    """Move whose straight way in joint space is not free."""

    #: Pose that it begins at, from 1 in the order to drive; 0: the robot's pose before the first move.
    start: int
    #: Pose that it leads to, from 1.
    end: int
    #: Shape (m,), joint values by which the way is free, [rad] or [m]; None: none was found.
    by: Array | None


class Route(NamedTuple):
    """Poses in the order to drive."""

    #: Shape (K, m), [rad] or [m].
    joints: Array
    #: Shape (K,), which of the given poses each is, from 0.
    indices: Indices
    #: Sum of the largest joint move over all moves [rad or m].
    length: float
    #: The moves that are not free.
    blocked: tuple[Blocked, ...]


class _Move(NamedTuple):
    """Change of a path: a piece of it is put elsewhere, or turned where it is."""

    #: Change of the path's cost; negative: it gets shorter
    gain: float
    #: First place of the piece
    first: int
    #: Number of its places
    length: int
    #: Its first place afterwards
    place: int
    #: Whether it is reversed
    turned: bool


def order(q: Array, start: Array | None = None, free_path: FreePath | None = None) -> Route:
    """Find a short open path through all poses, the same for the same poses.

    A joint that can turn without end does not take the short way round, for controllers do not.

    Args:
        q: The poses, shape (N, m), [rad] or [m].
        start: The robot's pose before the first move, shape (m,); None: the path begins at any pose.
        free_path: Tests a straight move; None: all are free.

    Returns:
        The path; of its blocked moves ``by`` is None.
    """
    count = len(q)
    if count == 0:
        return Route(q, np.arange(0), 0.0, ())
    poses = q if start is None else np.vstack([q, start])
    costs = _costs(poses, count)
    first_poses = {*np.linspace(0, count - 1, _BEGINNINGS).astype(int).tolist()}
    if costs[count, :count].any():
        first_poses = {count}
    paths = [_improved(_nearest(costs, first), costs) for first in sorted(first_poses)]
    shortest = min(paths, key=lambda path: _length(path, costs))
    path = _kicked(shortest, costs)
    tested: dict[tuple[int, int], bool] = {}
    if free_path is not None:
        path = _around_blocked_moves(path, costs, poses, free_path, tested)
    blocked = []
    for k, move in enumerate(pairwise(path[:-1].tolist())):
        if not tested.get(move, True):
            blocked.append(Blocked(k, k + 1, None))
    indices = path[1:-1]
    return Route(read_only(q[indices]), indices, _length(path, costs), tuple(blocked))


def _costs(poses: Array, count: int) -> Array:
    """Return the costs of moves between poses, and between them and the ends of a path.

    The two ends come last, begin and finish: beginning costs the move from the start, and nothing without one.

    Args:
        poses: shape (count, m), or (count + 1, m) with the start.
        count: Number of poses to order.

    Returns:
        shape (count + 2, count + 2).
    """
    # Not above: it takes long to import.
    from scipy.spatial.distance import cdist

    costs = np.zeros((count + 2, count + 2))
    costs[: len(poses), : len(poses)] = cdist(poses, poses, "chebyshev")
    return costs


def _around_blocked_moves(
    path: Indices,
    costs: Array,
    poses: Array,
    free_path: FreePath,
    tested: dict[tuple[int, int], bool],
) -> Indices:
    """Improve a path with a penalty on the moves of it that are blocked, until it has no untested ones.

    Args:
        path: With its ends.
        costs: Of moves.
        poses: The poses, and the start if there is one.
        free_path: Tests a straight move.
        tested: Whether a move is free, by its poses; what is tested is added to it.
    """
    # More than any path costs: one blocked move less is worth every detour.
    penalty = float(costs.max()) * len(costs) + 1.0
    penalised = costs.copy()
    is_kicked = True  # the path comes from kicks on the costs as they were
    while True:
        found_blocked = False
        for a, b in pairwise(path.tolist()):
            is_end = max(a, b) >= len(poses)  # begin without a start, and finish, are no moves
            if is_end or (a, b) in tested:
                continue
            is_free = bool(free_path(poses[a], poses[b]))
            tested[a, b] = tested[b, a] = is_free
            if not is_free:
                penalised[[a, b], [b, a]] += penalty
                found_blocked = True
        if is_kicked and not found_blocked:
            return path
        # Kicks take longest: only once no further move of the path is blocked.
        if found_blocked:
            path, is_kicked = _improved(path, penalised), False
        else:
            path, is_kicked = _kicked(path, penalised), True


def _nearest(costs: Array, first: int) -> Indices:
    """Return the path that always goes on to the nearest pose that is left.

    Args:
        costs: shape (count + 2, count + 2).
        first: The pose that it begins at; ``count``: the nearest one to the begin.

    Returns:
        shape (count + 2,), with both ends.
    """
    count = len(costs) - 2
    remaining = np.arange(count) != first
    path = [count] if first == count else [count, first]
    while remaining.any():
        candidates = np.flatnonzero(remaining)
        nearest = int(candidates[np.argmin(costs[path[-1], candidates])])
        path.append(nearest)
        remaining[nearest] = False
    return np.array([*path, count + 1], dtype=np.intp)


def _length(path: Indices, costs: Array) -> float:
    """Return the cost of a path with its ends."""
    return float(costs[path[:-1], path[1:]].sum())


def _improved(path: Indices, costs: Array) -> Indices:
    """Improve a path by 2-opt and or-opt, the best move first, until none gains; its ends stay where they are."""
    least_gain = _ROUNDING * max(float(costs.max()), 1e-300)
    barred = _barred(len(path))
    while True:
        moves = _best_moves(costs[np.ix_(path, path)], barred)
        best = min(moves, key=lambda move: move.gain)
        if best.gain > -least_gain:
            return path
        end = best.first + best.length
        piece = path[best.first : end]
        remaining = np.concatenate([path[: best.first], path[end:]])
        if best.turned:
            piece = piece[::-1]
        path = np.concatenate([remaining[: best.place], piece, remaining[best.place :]])


@lru_cache(maxsize=64)
def _barred(size: int) -> tuple[Array, ...]:
    """Return the moves that a path cannot make, as infinite costs.

    Args:
        size: Number of places of the path, its ends included.

    Returns:
        First turns of pieces that end before they begin, (size - 2, size - 2); then, for pieces of one place, two
        places, ..., putting them inside of themselves, (first place of the piece, gap between places).
    """
    forbidden = [np.tri(size - 2, dtype=np.bool_)]
    for length in range(1, min(_PIECE, size - 3) + 1):
        first = np.arange(1, size - length)[:, None]
        gap = np.arange(size - 1)
        forbidden.append((gap >= first - 1) & (gap <= first + length - 1))
    return tuple(read_only(np.where(mask, np.inf, 0.0)) for mask in forbidden)


def _best_moves(costs: Array, barred: tuple[Array, ...]) -> Iterator[_Move]:
    """Yield the best 2-opt move, and the best or-opt moves of each length of a piece.

    Args:
        costs: shape (size, size), symmetric, the costs between the places of the path.
        barred: See `_barred`.

    Yields:
        Moves. Their gain is what they add to the length of the path, so that of a move which shortens it is negative.
    """
    size = len(costs)
    step = np.diagonal(costs, 1)  # from place i to i + 1
    gain = costs[:-2, 1:-1] + costs[1:-1, 2:] - step[:-1, None] - step[1:] + barred[0]
    i, j = divmod(int(np.argmin(gain)), len(gain))
    yield _Move(float(gain[i, j]), i + 1, j - i + 1, i + 1, turned=True)
    for length, inside in enumerate(barred[1:], start=1):
        # Rows of the pieces' first and last places; the gap that the piece leaves is closed by one step.
        first = costs[1 : size - length]
        last = costs[length : size - 1]
        left = np.diagonal(costs, length + 1) - step[: size - length - 1] - step[length:]
        fixed = left[:, None] - step + inside
        for turned, head, tail in ((False, first, last), (True, last, first)):
            gain = head[:, :-1] + tail[:, 1:] + fixed
            a, b = divmod(int(np.argmin(gain)), gain.shape[1])
            place = b + 1 if b <= a else b + 1 - length
            yield _Move(float(gain[a, b]), a + 1, length, place, turned)


def _kicked(path: Indices, costs: Array) -> Indices:
    """Improve a path by iterated local search: perturb it, improve that, and keep it if it is no longer."""
    random = np.random.default_rng(0)
    length = _length(path, costs)
    for k in range(_number_of_kicks(len(path))):
        perturbed = _perturbed(path, random, swap=bool(k % 2))
        trial = _improved(perturbed, costs)
        trial_length = _length(trial, costs)
        if trial_length <= length:
            path, length = trial, trial_length
    return path


def _number_of_kicks(size: int) -> int:
    """Return the number of kicks for a path of so many places, its ends included."""
    if size < 5:
        return 0
    return max(min(_KICKS, int(_KICK_WORK / size**2)), 4)


def _perturbed(path: Indices, random: np.random.Generator, *, swap: bool) -> Indices:
    """Return a path in which stretches are swapped, or a few poses shuffled.

    Args:
        path: With its ends, which stay.
        random: Draws the places.
        swap: Whether two neighbouring stretches change places, which neither 2-opt nor or-opt can undo; of few poses a
            stretch is shuffled always.
    """
    count = len(path) - 2
    swap = swap and count > _SHUFFLED
    window = min(_WINDOW if swap else _SHUFFLED, count)
    low = int(random.integers(1, len(path) - window))
    perturbed: Indices = path.copy()
    if swap:
        cuts = low + np.sort(random.choice(window, 3, replace=False))
        a, b, c = cuts.tolist()
        perturbed[a:c] = [*path[b:c], *path[a:b]]
    else:
        perturbed[low : low + window] = random.permutation(path[low : low + window])
    return perturbed
