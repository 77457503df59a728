"""The order in which poses are driven: a short way through all of them, without moves that collide.

A move takes as long as the joint that moves farthest,

    c(a, b) = max_k |q_bk - q_ak|,

and the order is an open path through all poses, from where the robot stands if that is said. It is found by nearest
neighbours, improved by turning pieces round (2-opt) and by putting short pieces elsewhere (or-opt), then by kicks from
which the same is done again. Whether the way of a move is free is asked only for moves that the path has; those that
are not are made dear, and the path is improved again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.errors import CalibError
from calib.model.robot import read_only

Array = NDArray[np.float64]
Path = NDArray[np.intp]
FreePath = Callable[[Array, Array], bool]

#: What stands for the place where the robot begins, in `Tour.blocked`.
START = -1

#: How many kicks are tried, in all and of one path; the time that a kick takes grows as the square of the poses.
_KICKS, _KICK_WORK = 200, 1.0e6

#: So many nearest neighbour paths are improved, from first poses spread over all; fewer of many poses.
_BEGINNINGS, _MANY = 6, 1200

#: Pieces of up to this many poses are put elsewhere.
_PIECE = 3

#: Kicks swap stretches among so many neighbours, or shuffle so many.
_WINDOW, _SHUFFLED = 30, 8

#: A gain below this, as a part of a typical move, is rounding.
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Tour:
    """An order of poses.

    Attributes:
        indices: shape (N,), the poses in the order to drive; read-only.
        cost: The sum of the moves [rad] or [m]; the way from the start included.
        blocked: Pairs of poses (from, to) whose straight move in joint space is not free, in the order driven;
            `START` is where the robot begins.
    """

    indices: Path
    cost: float
    blocked: tuple[tuple[int, int], ...] = ()


def order(
    q: ArrayLike,
    start: ArrayLike | None = None,
    free_path: FreePath | None = None,
) -> Tour:
    """A short open path through all poses, the same for the same poses.

    Joint values count as they are: a joint that can turn without end does not take the short way round, for
    controllers do not.

    Args:
        q: shape (N, m), [rad] or [m].
        start: shape (m,), where the robot stands before; None: it begins at any of the poses.
        free_path: Whether a straight move between two poses is free, both shape (m,), the same there and back.

    Raises:
        CalibError: Shapes do not fit, a value is not finite, or a speed not positive.
    """
    poses = _checked(q, start)
    count = len(poses) - (start is not None)
    if count == 0:
        return Tour(_whole(np.arange(0)), 0.0)
    costs = _costs(poses, count)
    path = _shortest(costs, count)
    refused: set[tuple[int, int]] = set()
    if free_path is not None:
        path, refused = _around(costs, path, poses, free_path)
    moves = [(a, b) for a, b in pairwise(path[:-1].tolist()) if a < len(poses)]
    blocked = tuple((START if a == count else a, b) for a, b in moves if _pair(a, b) in refused)
    total = float(costs[path[:-1], path[1:]].sum())
    return Tour(_whole(path[1:-1]), total, blocked)


def _checked(q: ArrayLike, start: ArrayLike | None) -> Array:
    """The poses, with the start behind them."""
    poses = np.asarray(q, dtype=np.float64)
    if poses.ndim == 2 and start is not None and np.shape(start) == poses.shape[1:]:
        poses = np.vstack([poses, np.asarray(start, dtype=np.float64)])
        start = None
    if poses.ndim != 2 or start is not None or not np.isfinite(poses).all():
        raise CalibError(
            f"Poses to order are finite numbers of shape (N, m), the start of shape (m,); given was {np.shape(q)} and "
            f"{start!r}."
        )
    return read_only(poses)


def _costs(poses: Array, count: int) -> Array:
    """Costs between the poses and, at the end, the two ends of the path: begin and finish, shape (N + 2, N + 2).

    Beginning costs the way from the start, nothing without one; finishing costs nothing.
    """
    costs = np.zeros((count + 2, count + 2))
    for k in range(
        poses.shape[1]
    ):  # one joint after the other: the differences of all at once are many
        column = poses[:, k]
        apart = np.abs(column[:, None] - column[None, :])
        np.maximum(costs[: len(poses), : len(poses)], apart, out=costs[: len(poses), : len(poses)])
    return costs


def _shortest(costs: Array, count: int) -> Path:
    """A short path, its ends included: nearest neighbours from several poses, improved, and the best of them kicked."""
    begun = costs[count, :count].any()
    several = min(_BEGINNINGS, max(_MANY // count, 1))
    firsts = [None] if begun else sorted({*np.linspace(0, count - 1, several).astype(int).tolist()})
    paths = [_improved(_nearest(costs, count, first), costs) for first in firsts]
    best = min(paths, key=lambda path: _length(path, costs))
    return _kicked(best, costs)


def _nearest(costs: Array, count: int, first: int | None) -> Path:
    """From the begin, or from one pose, always on to the nearest pose that is left."""
    left = np.ones(count, dtype=np.bool_)
    path, at = [count], count if first is None else first
    if first is not None:
        path.append(first)
        left[first] = False
    while left.any():
        free = np.flatnonzero(left)
        at = int(free[np.argmin(costs[at, free])])
        path.append(at)
        left[at] = False
    return np.array([*path, count + 1], dtype=np.intp)


def _length(path: Path, costs: Array) -> float:
    """The cost of a path with its ends."""
    return float(costs[path[:-1], path[1:]].sum())


def _improved(path: Path, costs: Array) -> Path:
    """The path after 2-opt and or-opt, the best move first, until none gains; ends stay where they are."""
    least = _ROUNDING * max(float(costs.max()), 1e-300)
    while True:
        near = costs[np.ix_(path, path)]
        moves = [_reversal(near), *(m for n in range(1, _PIECE + 1) for m in _shifts(near, n))]
        gain, first, length, place, turned = min(moves, key=lambda move: move[0])
        if gain > -least:
            return path
        piece = path[first : first + length]
        rest = np.delete(path, slice(first, first + length))
        path = np.insert(rest, place, piece[::-1] if turned else piece)


#: How much longer the path becomes (negative is better); the first place and the length of the piece that is taken out;
#: where it is put into the rest; whether it is turned round.
_Move = tuple[float, int, int, int, bool]


def _reversal(near: Array) -> _Move:
    """The best stretch to turn round where it is."""
    step = np.diagonal(near, 1)  # from place i to i + 1
    gain = near[:-2, 1:-1] + near[1:-1, 2:] - step[:-1, None] - step[None, 1:]
    gain[np.tri(len(gain), dtype=np.bool_)] = 0.0
    i, j = np.unravel_index(np.argmin(gain), gain.shape)
    return float(gain[i, j]), int(i) + 1, int(j - i) + 1, int(i) + 1, True


def _shifts(near: Array, length: int) -> Iterator[_Move]:
    """The best piece of a length to put between two other places, as it is and turned round."""
    size = len(near)
    if size - 2 <= length:
        return
    step = np.diagonal(near, 1)
    i, j = np.arange(1, size - length), np.arange(size - 1)
    last = i + length - 1
    closed = near[i - 1, last + 1] - step[i - 1] - step[last]
    within = (j >= i[:, None] - 1) & (j <= last[:, None])
    for turned in (False, True):
        head, tail = (last, i) if turned else (i, last)
        opened = near[j[None, :], head[:, None]] + near[tail[:, None], j[None, :] + 1]
        gain = np.where(within, 0.0, closed[:, None] + opened - step[None, :])
        a, b = np.unravel_index(np.argmin(gain), gain.shape)
        place = int(b) + 1 if b < i[a] else int(b) + 1 - length
        yield float(gain[a, b]), int(i[a]), length, place, turned


def _kicked(path: Path, costs: Array) -> Path:
    """The path after kicks, each improved, and kept if it is no longer than before."""
    size = len(path)
    if size - 2 < 3:
        return path
    random = np.random.default_rng(0)
    length = _length(path, costs)
    for k in range(max(min(_KICKS, int(_KICK_WORK / size**2)), 4)):
        kick = _swapped if k % 2 and size - 2 > _SHUFFLED else _shuffled
        other = _improved(kick(path, random), costs)
        if (reached := _length(other, costs)) <= length:
            path, length = other, reached
    return path


def _swapped(path: Path, random: np.random.Generator) -> Path:
    """Two neighbouring stretches change places, which neither 2-opt nor or-opt can undo."""
    window = min(_WINDOW, len(path) - 2)
    low = int(random.integers(1, len(path) - window))
    a, b, c = (low + np.sort(random.choice(window, 3, replace=False))).tolist()
    swapped: Path = np.concatenate([path[:a], path[b:c], path[a:b], path[c:]])
    return swapped


def _shuffled(path: Path, random: np.random.Generator) -> Path:
    """A stretch of a few poses in any order; of few poses, all of them."""
    window = min(_SHUFFLED, len(path) - 2)
    low = int(random.integers(1, len(path) - window))
    other: Path = path.copy()
    other[low : low + window] = random.permutation(path[low : low + window])
    return other


def _around(
    costs: Array, path: Path, poses: Array, free_path: FreePath
) -> tuple[Path, set[tuple[int, int]]]:
    """The path improved again and again with the refused moves made dear, until all of its moves are known."""
    dear = costs.copy()
    # More than any path costs: one refused move less is worth every detour.
    penalty = float(costs.max()) * len(costs) + 1.0
    known: dict[tuple[int, int], bool] = {}
    kicked = True  # the path comes from kicks on the costs as they were
    while True:
        fresh = False
        for a, b in pairwise(path.tolist()):
            if max(a, b) >= len(poses) or _pair(a, b) in known:
                continue  # begin without a start, and finish, are no moves
            free = known[_pair(a, b)] = bool(free_path(poses[a], poses[b]))
            if not free:
                dear[[a, b], [b, a]] += penalty
                fresh = True
        if not fresh and kicked:
            return path, {pair for pair, free in known.items() if not free}
        # Kicks take longest: only once no move that is asked for is refused any more.
        path, kicked = (_improved(path, dear), False) if fresh else (_kicked(path, dear), True)


def _pair(a: int, b: int) -> tuple[int, int]:
    """Two poses, the smaller first."""
    return (a, b) if a < b else (b, a)


def _whole(values: NDArray[np.intp]) -> Path:
    """A read-only copy of indices."""
    copied = np.array(values, dtype=np.intp)
    copied.setflags(write=False)
    return copied
