from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.sparse.csgraph import minimum_spanning_tree

from calib.verbs.plan.ordering import _barred, _best_shifts, _best_turn, order


def moves(q):
    """The cost of every move, shape (N, N)."""
    return np.abs(q[:, None] - q[None, :]).max(axis=2)


def cost_of(tour, q, start=None):
    """The cost of a tour, counted anew."""
    path = q[tour.indices] if start is None else np.vstack([start, q[tour.indices]])
    return float(np.abs(np.diff(path, axis=0)).max(axis=1).sum())


def is_order(tour, count):
    return sorted(tour.indices.tolist()) == list(range(count))


def every_order(count):
    return np.array(list(itertools.permutations(range(count))))


@pytest.mark.parametrize("count", [30])
def test_many_poses_are_in_a_short_order(count):
    random = np.random.default_rng(count)
    q = random.uniform(-3.0, 3.0, (count, 6))
    tour = order(q)
    costs = moves(q)
    # No path is shorter than the tree that joins all poses; of random points the best is a tenth above it.
    assert 1.0 < tour.length / minimum_spanning_tree(costs).sum() < 1.2
    shuffled = [random.permutation(count) for _ in range(50)]
    assert tour.length < 0.65 * min(costs[p[:-1], p[1:]].sum() for p in shuffled)
    assert is_order(tour, count)


def test_none_one_and_the_same_pose_often():
    assert order(np.empty((0, 6))).indices.tolist() == []
    assert order(np.empty((0, 6)), start=np.zeros(6)).length == 0.0
    assert order(np.ones((1, 6))).length == 0.0
    assert order(np.ones((1, 6)), start=np.zeros(6)).length == 1.0
    same = order(np.ones((12, 6)), start=np.zeros(6))
    assert is_order(same, 12)
    assert same.length == 1.0
    pairs = np.repeat(np.random.default_rng(0).uniform(-3.0, 3.0, (10, 6)), 2, axis=0)
    tour = order(pairs)
    assert tour.length == pytest.approx(order(pairs[::2]).length, rel=1e-12)


def wall(a, b):
    """A wall at 0 of the first joint, with a door where the second is above 2."""
    if (a[0] < 0.0) == (b[0] < 0.0):
        return True
    at = a[1] + (b[1] - a[1]) * a[0] / (a[0] - b[0])
    return bool(at > 2.0)


@pytest.mark.parametrize("seed", range(2))
def test_few_poses_have_no_more_blocked_moves_than_needed(seed):
    q = np.random.default_rng(seed).uniform(-3.0, 3.0, (6, 2))
    start = np.array([-3.0, -3.0]) if seed % 2 else None
    tour = order(q, start=start, free_path=wall)
    costs, shut = moves(q), np.array([[not wall(a, b) for b in q] for a in q])
    orders = every_order(6)
    blocked = shut[orders[:, :-1], orders[:, 1:]].sum(axis=1)
    totals = costs[orders[:, :-1], orders[:, 1:]].sum(axis=1)
    if start is not None:
        blocked += np.array([not wall(start, p) for p in q])[orders[:, 0]]
        totals += np.abs(q - start).max(axis=1)[orders[:, 0]]
    fewest = blocked.min()
    assert len(tour.blocked) == fewest
    assert tour.length == pytest.approx(totals[blocked == fewest].min(), rel=1e-9)
    path = [start, *q[tour.indices]]
    assert all(not wall(path[a], path[b]) for a, b, _ in tour.blocked)


def test_blocked_moves_are_avoided_and_few_are_asked_for():
    q = np.random.default_rng(5).uniform(-3.0, 3.0, (30, 2))
    asked = []

    def free(a, b):
        asked.append((a, b))
        return wall(a, b)

    tour = order(q, start=[-3.0, 0.0], free_path=free)
    assert tour.blocked == ()
    path = np.vstack([[-3.0, 0.0], q[tour.indices]])
    assert all(wall(a, b) for a, b in itertools.pairwise(path))
    assert len(asked) < 200  # of 435
    assert is_order(tour, 30)
    assert tour.length == pytest.approx(cost_of(tour, q, start=np.array([-3.0, 0.0])), rel=1e-12)


# Changes of a path


def symmetric_costs(size):
    costs = np.random.default_rng(size).uniform(0.1, 1.0, (size, size))
    return costs + costs.T


def along(path, costs):
    return costs[path[:-1], path[1:]].sum()


def turns(size):
    """Every path that differs from 0, 1, ... by one reversed piece, the ends apart."""
    for first, last in itertools.combinations(range(1, size - 1), 2):
        path = list(range(size))
        path[first : last + 1] = path[first : last + 1][::-1]
        yield path


def shifts(size, length, turned):
    """Every path that differs from 0, 1, ... by one piece that was put elsewhere, the ends apart."""
    for first in range(1, size - length):
        piece = list(range(first, first + length))
        remaining = [place for place in range(size) if place not in piece]
        for place in range(1, len(remaining)):
            if place != first:
                yield remaining[:place] + piece[:: -1 if turned else 1] + remaining[place:]


def changed(move, size):
    """The path 0, 1, ... after a move."""
    piece = list(range(move.first, move.first + move.length))
    remaining = [place for place in range(size) if place not in piece]
    return remaining[: move.place] + piece[:: -1 if move.turned else 1] + remaining[move.place :]


def is_best(move, paths, costs):
    """Whether a move has the gain that it says, and none of the paths is shorter than it makes this one."""
    size = len(costs)
    shortest = min(along(path, costs) for path in map(np.array, paths))
    length = along(np.array(changed(move, size)), costs)
    said = along(np.arange(size), costs) + move.gain
    return length == pytest.approx(shortest, rel=1e-12) == said


@pytest.mark.parametrize("size", [5, 9])
def test_the_best_changes_of_a_path_are_the_best_of_all(size):
    costs = symmetric_costs(size)
    of_turns, *of_lengths = _barred(size)
    assert is_best(_best_turn(costs, of_turns), turns(size), costs)
    for length, barred in enumerate(of_lengths, start=1):
        as_it_is, turned = _best_shifts(costs, barred, length)
        assert (as_it_is.turned, turned.turned) == (False, True)
        for move in (as_it_is, turned):
            assert move.length == length
            assert is_best(move, shifts(size, length, move.turned), costs)
