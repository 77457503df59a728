"""The order in which poses are driven: a short way through all of them, without moves that collide.

A move takes as long as its slowest joint,

    c(a, b) = max_k |q_bk - q_ak| / speed_k,

and the order is an open path through all poses, from where the robot stands if that is said. It is found by nearest
neighbours, improved by turning pieces round (2-opt) and by putting short pieces elsewhere (or-opt), then by kicks from
which the same is done again. Whether the way of a move is free is asked only for moves that the path has; those that
are not are made dear, and the path is improved again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
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
        cost: The sum of the moves, in [s] for speeds in [rad/s] and [m/s]; the way from the start included.
        blocked: Pairs of poses (from, to) whose straight move in joint space is not free, in the order driven;
            `START` is where the robot begins.
    """

    indices: Path
    cost: float
    blocked: tuple[tuple[int, int], ...] = ()


def order(
    q: ArrayLike,
    speed: ArrayLike | None = None,
    start: ArrayLike | None = None,
    free_path: FreePath | None = None,
) -> Tour:
    """A short open path through all poses, the same for the same poses.

    Joint values count as they are: a joint that can turn without end does not take the short way round, for
    controllers do not.

    Args:
        q: shape (N, m), [rad] or [m].
        speed: shape (m,), or one for all, [rad/s] or [m/s]; default 1.
        start: shape (m,), where the robot stands before; None: it begins at any of the poses.
        free_path: Whether a straight move between two poses is free, both shape (m,), the same there and back.

    Raises:
        CalibError: Shapes do not fit, a value is not finite, or a speed not positive.
    """
    poses, scaled = _checked(q, speed, start)
    count = len(poses) - (start is not None)
    if count == 0:
        return Tour(_whole(np.arange(0)), 0.0)
    costs = _costs(scaled, count)
    path = _shortest(costs, count)
    refused: set[tuple[int, int]] = set()
    if free_path is not None:
        path, refused = _around(costs, path, poses, free_path)
    moves = [(a, b) for a, b in pairwise(path[:-1].tolist()) if a < len(poses)]
    blocked = tuple((START if a == count else a, b) for a, b in moves if _pair(a, b) in refused)
    total = float(costs[path[:-1], path[1:]].sum())
    return Tour(_whole(path[1:-1]), total, blocked)


def _checked(q: ArrayLike, speed: ArrayLike | None, start: ArrayLike | None) -> tuple[Array, Array]:
    """The poses, with the start behind them, and the same in times of each joint."""
    poses = np.asarray(q, dtype=np.float64)
    if poses.ndim != 2 or not np.isfinite(poses).all():
        message = (
            f"Poses to order are finite numbers of shape (N, m); given was shape {poses.shape}."
        )
        raise CalibError(message)
    width = poses.shape[1]
    speeds = np.asarray(1.0 if speed is None else speed, dtype=np.float64)
    if speeds.shape not in ((), (width,)) or not (np.isfinite(speeds) & (speeds > 0.0)).all():
        message = f"Joint speeds are positive, one for all or one for each of {width} joints; given was {speed!r}."
        raise CalibError(message)
    if start is not None:
        first = np.asarray(start, dtype=np.float64)
        if first.shape != (width,) or not np.isfinite(first).all():
            message = (
                f"The start has one finite value for each of {width} joints; given was {start!r}."
            )
            raise CalibError(message)
        poses = np.vstack([poses, first])
    return read_only(poses), poses / speeds


def _costs(scaled: Array, count: int) -> Array:
    """Costs between the poses and, at the end, the two ends of the path: begin and finish, shape (N + 2, N + 2).

    Beginning costs the way from the start, nothing without one; finishing costs nothing.
    """
    costs = np.zeros((count + 2, count + 2))
    for k in range(
        scaled.shape[1]
    ):  # one joint after the other: the differences of all at once are many
        column = scaled[:, k]
        apart = np.abs(column[:, None] - column[None, :])
        np.maximum(
            costs[: len(scaled), : len(scaled)], apart, out=costs[: len(scaled), : len(scaled)]
        )
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
    """The path after 2-opt and or-opt until neither gains; ends stay where they are.

    Each move rearranges one stretch of the path. Those of one round that do not touch each other are done together,
    the best first.
    """
    least = _ROUNDING * max(float(costs.max()), 1e-300)
    size = len(path)
    while True:
        near = costs[np.ix_(path, path)]
        found = [*_reversals(near), *(m for n in range(1, _PIECE + 1) for m in _shifts(near, n))]
        gains = np.concatenate([gain for gain, *_ in found])
        ranked = np.argsort(gains, kind="stable")
        ranked = ranked[gains[ranked] < -least]
        if not ranked.size:
            return path
        firsts = np.concatenate([first for _, first, *_ in found])
        lasts = np.concatenate([last for _, _, last, *_ in found])
        which = np.repeat(np.arange(len(found)), [len(gain) for gain, *_ in found])
        taken = np.zeros(size, dtype=np.bool_)
        path = path.copy()
        for k in ranked.tolist():
            a, b = int(firsts[k]), int(lasts[k])
            if taken[a - 1 : b + 2].any():
                continue
            taken[a - 1 : b + 2] = True
            path[a : b + 1] = _rearranged(path[a : b + 1], *found[which[k]][3:])


_Moves = tuple[Array, Path, Path, str, int]


def _reversals(near: Array) -> list[_Moves]:
    """For each first place the best last one to turn the stretch between round: gain (negative is better), places."""
    step = np.diagonal(near, 1)  # from place i to i + 1
    i, rows, below = _pairs_of_places(len(near))
    gain = near[:-2, 1:-1] + near[1:-1, 2:] - step[:-1, None] - step[None, 1:]
    gain[below] = 0.0
    best = gain.argmin(axis=1)
    return [(gain[rows, best], i, i[best], "turn", 0)]


@lru_cache(maxsize=8)
def _pairs_of_places(size: int) -> tuple[Path, Path, NDArray[np.bool_]]:
    """First places of a stretch, their numbers, and the pairs whose last place is not behind the first."""
    i = np.arange(1, size - 1)
    return _whole(i), _whole(i - 1), i[:, None] >= i[None, :]


def _shifts(near: Array, length: int) -> list[_Moves]:
    """For each piece of a length the best place further on, and further back, as it is and turned round."""
    size = len(near)
    if size - 2 <= length:
        return []
    i, last, rows, on, back = _pieces(size, length)
    step = np.diagonal(near, 1)
    closed = near[i - 1, last + 1] - step[i - 1] - step[last]
    ahead, behind = near[1 : size - length, :-1], near[length : size - 1, :-1]
    ahead_next, behind_next = near[1 : size - length, 1:], near[length : size - 1, 1:]
    base = closed[:, None] - step[None, :]
    found: list[_Moves] = []
    for turned, gain in (
        ("", base + ahead + behind_next),
        (" turned", base + behind + ahead_next),
    ):
        for how, allowed in (("on", on), ("back", back)):
            free = np.where(allowed, gain, 0.0)
            best = free.argmin(axis=1)  # put between this place and the next
            first = i if how == "on" else np.minimum(best + 1, i)
            end = np.maximum(best, last) if how == "on" else last
            found.append((free[rows, best], first, end, how + turned, length))
    return found


@lru_cache(maxsize=24)
def _pieces(
    size: int, length: int
) -> tuple[Path, Path, Path, NDArray[np.bool_], NDArray[np.bool_]]:
    """Of every piece of a length: its first and last place, its number, and which places are on and back from it."""
    i = np.arange(1, size - 1 - length + 1)
    last, j = i + length - 1, np.arange(size - 1)
    on, back = j[None, :] > last[:, None], j[None, :] < i[:, None] - 1
    return _whole(i), _whole(last), _whole(i - 1), on, back


def _rearranged(stretch: Path, how: str, length: int) -> Path:
    """A stretch of a path turned round, or with the piece at one of its ends put at the other."""
    if how == "turn":
        return stretch[::-1]
    forward = how.startswith("on")
    piece = stretch[:length] if forward else stretch[-length:]
    rest = stretch[length:] if forward else stretch[:-length]
    piece = piece[::-1] if how.endswith("turned") else piece
    return np.concatenate([rest, piece] if forward else [piece, rest])


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
