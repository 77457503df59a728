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

from calib.basics.arrays import Array, read_only

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

    #: Change of the path's cost [rad or m]; negative: it gets shorter.
    gain: float
    #: First place of the piece, from 0, the begin of the path.
    first: int
    #: Number of its places.
    length: int
    #: Its first place afterwards.
    place: int
    #: Whether it is reversed.
    turned: bool


def order(q: Array, start: Array | None = None, free_path: FreePath | None = None) -> Route:
    """Find a short open path through all poses, the same for the same poses.

    The length of a move is the largest move of a joint, max_k |q_bk - q_ak|: a joint that can turn without end does not
    take the short way round, for controllers do not.

    Args:
        q: Joint values of the poses, shape (N, m), [rad] or for sliding joints [m].
        start: The robot's joint values before the first move, shape (m,), [rad] or [m]; None: the path begins at any
            pose.
        free_path: Function of the joint values of two poses, shape (m,) each, that returns whether the straight move
            between them is free, the same there and back; None: all moves are free.

    Returns:
        ``joints``, the poses in the order to drive, shape (N, m); ``indices``, the index in ``q`` of each, from 0,
        shape (N,); ``length``, the sum of the lengths of all moves [rad or m]; and the moves that are ``blocked``, by
        the places of their two poses in the order, from 1 (0: ``start``), each with ``by`` None.
    """
    count = len(q)
    if count == 0:
        return Route(q, np.arange(0), 0.0, ())
    poses = q if start is None else np.vstack([q, start])
    costs = _costs(poses, count)
    path = _kicked(_best_beginning(costs), costs)
    tested: dict[tuple[int, int], bool] = {}
    if free_path is not None:
        path, tested = _around_blocked_moves(path, costs, poses, free_path)
    blocked = []
    for k, move in enumerate(pairwise(path[:-1].tolist())):
        if not tested.get(move, True):
            blocked.append(Blocked(k, k + 1, None))
    indices = path[1:-1]
    return Route(read_only(q[indices]), indices, _length(path, costs), tuple(blocked))


def _best_beginning(costs: Array) -> Indices:
    """Return the shortest of several nearest neighbour paths, each improved by 2-opt and or-opt.

    They begin at six poses spread over the list; where the move from the robot's start costs something, one path begins
    at the pose nearest to it instead.

    Args:
        costs: Costs of moves between ``count`` poses [rad or m], shape (count + 2, count + 2), symmetric; index
            ``count`` is the begin of a path, ``count + 1`` its finish, see `_costs`.

    Returns:
        The path, shape (count + 2,): ``count`` (begin), the indices of the poses, 0 to count - 1, in the order to
        drive, ``count + 1`` (finish).
    """
    count = len(costs) - 2
    first_poses = {*np.linspace(0, count - 1, _BEGINNINGS).astype(int).tolist()}
    if costs[count, :count].any():
        first_poses = {count}
    paths = [_improved(_nearest(costs, first), costs) for first in sorted(first_poses)]
    return min(paths, key=lambda path: _length(path, costs))


def _costs(poses: Array, count: int) -> Array:
    """Return the costs of moves between poses, and between them and the ends of a path.

    A move costs the largest move of a joint, max_k |q_bk - q_ak|. The two ends come last, begin and finish: beginning
    costs the move from the start, and nothing without one; finishing costs nothing.

    Args:
        poses: Joint values, shape (count, m), or (count + 1, m) with the robot's start as the last row, [rad] or for
            sliding joints [m].
        count: Number of poses to order.

    Returns:
        Costs [rad or m], shape (count + 2, count + 2), symmetric; index ``count`` is begin, ``count + 1`` finish.
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
) -> tuple[Indices, dict[tuple[int, int], bool]]:
    """Improve a path with a penalty on its moves that are blocked, until it has no untested ones.

    The penalty is more than any path costs, so that the number of blocked moves counts first. Some may remain.

    Args:
        path: Path with both ends, shape (count + 2,): ``count`` (begin), the indices of the poses, 0 to count - 1, in
            order, ``count + 1`` (finish).
        costs: Costs of moves [rad or m], shape (count + 2, count + 2), with begin and finish last, see `_costs`.
        poses: Joint values, shape (count, m), or (count + 1, m) with the robot's start as the last row, [rad] or [m].
        free_path: Function of the joint values of two poses, shape (m,) each, that returns whether the straight move
            between them is free.

    Returns:
        The improved path with both ends; and, by the indices of its two poses in ``poses``, there and back, whether
        each move that was tested is free. A move that is not in it was not tested.
    """
    tested: dict[tuple[int, int], bool] = {}
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
            return path, tested
        # Kicks take longest: only once no further move of the path is blocked.
        if found_blocked:
            path, is_kicked = _improved(path, penalised), False
        else:
            path, is_kicked = _kicked(path, penalised), True


def _nearest(costs: Array, first: int) -> Indices:
    """Return the path that always goes on to the nearest pose that is left.

    Args:
        costs: Costs of moves between ``count`` poses [rad or m], shape (count + 2, count + 2); index ``count`` is the
            begin of a path, ``count + 1`` its finish, see `_costs`.
        first: Index of the first pose, from 0; ``count``: the pose nearest to the begin, the robot's start, comes
            first.

    Returns:
        The path with both ends, shape (count + 2,): ``count`` (begin), the poses in order, ``count + 1`` (finish).
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
    """Return the length of a path, the sum of the costs of its moves [rad or m].

    Args:
        path: Path with both ends, shape (count + 2,): ``count`` (begin), the indices of the poses, 0 to count - 1, in
            order, ``count + 1`` (finish).
        costs: Costs of moves [rad or m], shape (count + 2, count + 2); those of the begin are of the move from the
            robot's start or 0, those of the finish 0.
    """
    return float(costs[path[:-1], path[1:]].sum())


def _improved(path: Indices, costs: Array) -> Indices:
    """Improve a path by 2-opt and or-opt, the best change first, until none makes it shorter; its ends stay.

    2-opt reverses a piece of the path, or-opt puts a piece of up to 3 poses elsewhere, as it is or reversed.

    Args:
        path: Path with both ends, shape (count + 2,): ``count`` (begin), the indices of the poses, 0 to count - 1, in
            order, ``count + 1`` (finish).
        costs: Costs of moves [rad or m], shape (count + 2, count + 2), symmetric, by these indices; a penalty may be in
            them.

    Returns:
        The improved path, of the same shape.
    """
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
    """Return the changes that a path cannot make, as infinite costs, to be added to the gains of all changes.

    Args:
        size: Number of places of the path, its ends included.

    Returns:
        Arrays of 0 and infinity. The first is for reversals of a piece, by its first and last place, each from 1, shape
        (size - 2, size - 2): infinite where the last place is not behind the first. Then for pieces of one, two and
        three places (fewer in a path of less than six) that are put elsewhere, by the first place of the piece, from 1,
        and the place before the gap where it is put, from 0, shape (size - length - 1, size - 1): infinite where the
        gap is inside of the piece or beside it.
    """
    forbidden = [np.tri(size - 2, dtype=np.bool_)]
    for length in range(1, min(_PIECE, size - 3) + 1):
        first = np.arange(1, size - length)[:, None]
        gap = np.arange(size - 1)
        forbidden.append((gap >= first - 1) & (gap <= first + length - 1))
    return tuple(read_only(np.where(mask, np.inf, 0.0)) for mask in forbidden)


def _best_moves(costs: Array, barred: tuple[Array, ...]) -> Iterator[_Move]:
    """Yield the best 2-opt move of a path, and the best or-opt moves of each length of a piece.

    Args:
        costs: Costs of moves between the places of the path, in its order [rad or m], shape (size, size), symmetric;
            the first place and the last are its ends.
        barred: Arrays of 0, or infinity for changes that the path cannot make: first of reversals, then of pieces of
            one, two and three places that are put elsewhere, see `_barred`.

    Yields:
        Changes of the path: ``gain``, what each adds to the length of the path [rad or m], negative where it gets
        shorter; ``first``, ``length`` and ``place``, the first place of the piece that is moved, from 0 (the begin of
        the path), the number of its places and its first place afterwards; ``turned``, whether it is reversed.
    """
    yield _best_turn(costs, barred[0])
    for length, of_this_length in enumerate(barred[1:], start=1):
        yield from _best_shifts(costs, of_this_length, length)


def _best_turn(costs: Array, barred: Array) -> _Move:
    """Find the piece of a path whose reversal shortens it most: the best 2-opt move.

    Reversing the places i to j replaces the steps (i - 1, i) and (j, j + 1) by (i - 1, j) and (i, j + 1).

    Args:
        costs: Costs of moves between the places of the path, in its order [rad or m], shape (size, size), symmetric;
            the first place and the last are its ends, which stay.
        barred: Infinite for pieces that do not end behind their first place, else 0, shape (size - 2, size - 2), by
            first and last place, each from 1.

    Returns:
        The move: what it adds to the length of the path [rad or m], negative where it gets shorter; first place of the
        piece, from 0 (the begin of the path), and number of its places; it stays at its place, reversed.
    """
    step = np.diagonal(costs, 1)  # from place i to i + 1
    gain = costs[:-2, 1:-1] + costs[1:-1, 2:] - step[:-1, None] - step[1:] + barred
    i, j = divmod(int(np.argmin(gain)), len(gain))
    return _Move(float(gain[i, j]), i + 1, j - i + 1, i + 1, turned=True)


def _best_shifts(costs: Array, barred: Array, length: int) -> Iterator[_Move]:
    """Yield the best or-opt moves of pieces of one length: put elsewhere as they are, then put elsewhere reversed.

    Args:
        costs: Costs of moves between the places of the path, in its order [rad or m], shape (size, size), symmetric;
            the first place and the last are its ends, which stay.
        barred: Infinite for gaps that touch the piece or are inside of it, else 0, shape (size - length - 1, size - 1),
            by the first place of the piece, from 1, and the place before the gap, from 0.
        length: Number of places of a piece.

    Yields:
        Two moves, each with what it adds to the length of the path [rad or m], negative where it gets shorter, the
        first place of the piece, from 0 (the begin of the path), the number of its places, its first place afterwards,
        and whether it is reversed.
    """
    size = len(costs)
    step = np.diagonal(costs, 1)  # from place i to i + 1
    # Rows of the pieces' first and last places; the gap that the piece leaves is closed by one step.
    first = costs[1 : size - length]
    last = costs[length : size - 1]
    closing = np.diagonal(costs, length + 1) - step[: size - length - 1] - step[length:]
    fixed = closing[:, None] - step + barred
    for head, tail, turned in ((first, last, False), (last, first, True)):
        gain = head[:, :-1] + tail[:, 1:] + fixed
        yield _best_insertion(gain, length, turned=turned)


def _best_insertion(gain: Array, length: int, *, turned: bool) -> _Move:
    """Return the or-opt move that shortens a path most, or lengthens it least.

    Args:
        gain: What each move adds to the length of the path [rad or m], shape (size - length - 1, size - 1), by the
            first place of the piece, from 1, and the place before the gap where it is put, from 0; infinite for moves
            that cannot be.
        length: Number of places of the piece.
        turned: Whether the piece is reversed.

    Returns:
        The move: its gain, the first place of the piece, from 0 (the begin of the path), the number of its places, its
        first place afterwards, and whether it is reversed.
    """
    row, gap = divmod(int(np.argmin(gain)), gain.shape[1])
    # Places behind the piece move up when it is taken out.
    place = gap + 1 if gap <= row else gap + 1 - length
    return _Move(float(gain[row, gap]), row + 1, length, place, turned)


def _kicked(path: Indices, costs: Array) -> Indices:
    """Improve a path by iterated local search: perturb it, improve that, and keep it unless it is longer.

    Args:
        path: Path with both ends, shape (count + 2,): ``count`` (begin), the indices of the poses, 0 to count - 1, in
            order, ``count + 1`` (finish).
        costs: Costs of moves [rad or m], shape (count + 2, count + 2), symmetric, by these indices; a penalty may be in
            them.

    Returns:
        The path, of the same shape, not longer than before; the same one for the same path and costs, for the seed is
        fixed.
    """
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
    """Return the number of perturbations that are tried on a path.

    It is 200 for 5 to 70 places, then falls with the inverse square of their number, but not below 4; for fewer than 5
    places it is 0.

    Args:
        size: Number of places of the path, its ends included.
    """
    if size < 5:
        return 0
    return max(min(_KICKS, int(_KICK_WORK / size**2)), 4)


def _perturbed(path: Indices, random: np.random.Generator, *, swap: bool) -> Indices:
    """Return a path in which two neighbouring stretches are swapped, or a few poses in a row shuffled, at random.

    Args:
        path: Indices of poses and both ends in order, shape (count + 2,); the ends stay.
        random: Draws the places; its state advances.
        swap: True: two neighbouring stretches within 30 poses change places, which neither 2-opt nor or-opt can undo.
            False, or with 8 poses or fewer: up to 8 poses in a row are shuffled.

    Returns:
        The perturbed path, of the same shape; ``path`` is not changed.
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
