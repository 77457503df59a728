"""Route of a plan: short orders, blocked moves, whole turns of joints and poses in between."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.sparse.csgraph import minimum_spanning_tree

from calib.robot.robot import Robot
from calib.verbs.plan.pose_candidates import planning_ranges
from calib.verbs.plan.route import _detour, _turning_joints, find_route, order_poses


def moves(q):
    """The cost of every move, shape (N, N)."""
    return np.abs(q[:, None] - q[None, :]).max(axis=2)


def cost_of(tour, q, start=None):
    """The cost of a tour, counted anew."""
    path = q[tour.order] if start is None else np.vstack([start, q[tour.order]])
    return float(np.abs(np.diff(path, axis=0)).max(axis=1).sum())


def is_order(tour, count):
    return sorted(tour.order.tolist()) == list(range(count))


def every_order(count):
    return np.array(list(itertools.permutations(range(count))))


@pytest.mark.parametrize("count", [30])
def test_many_poses_are_in_a_short_order(count):
    random = np.random.default_rng(count)
    q = random.uniform(-3.0, 3.0, (count, 6))
    tour = order_poses(q)
    costs = moves(q)
    # No path is shorter than the tree that joins all poses; of random points the best is a tenth above it.
    assert 1.0 < tour.travel / minimum_spanning_tree(costs).sum() < 1.2
    shuffled = [random.permutation(count) for _ in range(50)]
    assert tour.travel < 0.65 * min(costs[p[:-1], p[1:]].sum() for p in shuffled)
    assert is_order(tour, count)
    # No reversed piece makes it shorter.
    path = tour.order
    for first, last in itertools.combinations(range(count), 2):
        turned = np.concatenate([path[:first], path[first : last + 1][::-1], path[last + 1 :]])
        assert costs[turned[:-1], turned[1:]].sum() > tour.travel - 1e-9


def test_none_one_and_the_same_pose_often():
    assert order_poses(np.empty((0, 6))).order.tolist() == []
    assert order_poses(np.empty((0, 6)), start=np.zeros(6)).travel == 0.0
    assert order_poses(np.ones((1, 6))).travel == 0.0
    assert order_poses(np.ones((1, 6)), start=np.zeros(6)).travel == 1.0
    same = order_poses(np.ones((12, 6)), start=np.zeros(6))
    assert is_order(same, 12)
    assert same.travel == 1.0
    pairs = np.repeat(np.random.default_rng(0).uniform(-3.0, 3.0, (10, 6)), 2, axis=0)
    tour = order_poses(pairs)
    assert tour.travel == pytest.approx(order_poses(pairs[::2]).travel, rel=1e-12)


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
    tour = order_poses(q, start=start, free_path=wall)
    costs, shut = moves(q), np.array([[not wall(a, b) for b in q] for a in q])
    orders = every_order(6)
    blocked = shut[orders[:, :-1], orders[:, 1:]].sum(axis=1)
    totals = costs[orders[:, :-1], orders[:, 1:]].sum(axis=1)
    if start is not None:
        blocked += np.array([not wall(start, p) for p in q])[orders[:, 0]]
        totals += np.abs(q - start).max(axis=1)[orders[:, 0]]
    fewest = blocked.min()
    assert len(tour.blocked) == fewest
    assert tour.travel == pytest.approx(totals[blocked == fewest].min(), rel=1e-9)
    path = [start, *q[tour.order]]
    assert all(not wall(path[a], path[b]) for a, b, _ in tour.blocked)


def test_blocked_moves_are_avoided_and_few_are_asked_for():
    q = np.random.default_rng(5).uniform(-3.0, 3.0, (30, 2))
    asked = []

    def free(a, b):
        asked.append((a, b))
        return wall(a, b)

    tour = order_poses(q, start=[-3.0, 0.0], free_path=free)
    assert tour.blocked == ()
    path = np.vstack([[-3.0, 0.0], q[tour.order]])
    assert all(wall(a, b) for a, b in itertools.pairwise(path))
    assert len(asked) < 200  # of 435
    assert is_order(tour, 30)
    assert tour.travel == pytest.approx(cost_of(tour, q, start=np.array([-3.0, 0.0])), rel=1e-12)


# Whole turns


def floor(a, b):
    """A bar on its first joint must not pass through straight down, 90 deg (and that less or more turns)."""
    path = a[0] + np.linspace(0.0, 1.0, 181) * (b[0] - a[0])
    return bool(np.all(np.abs(np.mod(path, 2.0 * np.pi) - 0.5 * np.pi) > 0.05))


def test_joints_of_more_than_a_turn():
    ur3 = Robot.load("urdf/ur3.urdf", base="base", tip="tool0")
    limits = planning_ranges(ur3, {"wrist_1_joint": (-1.0, 1.0)}, np.radians(5.0), turns=True)
    assert np.degrees(limits[0]) == pytest.approx([-355.0, 355.0])
    assert limits[3] == pytest.approx([-1.0, 1.0])
    # The elbow has one turn, and a joint with a range is kept in it.
    assert _turning_joints(ur3, limits).tolist() == [True, True, False, False, True, True]
    # A turn of a reading that another joint counts would turn that one as well, and the other way round.
    coupling = {"elbow_joint": {"shoulder_lift_joint": 1.0}, "wrist_3_joint": {"elbow_joint": 1.0}}
    coupled = Robot.load("urdf/ur3.urdf", base="base", tip="tool0", coupling=coupling)
    assert _turning_joints(coupled, limits).tolist() == [True, False, False, False, True, False]


# A pose in between

#: A wall between x = -0.1 and 0.1 that ends at y = 1.
WALL = 0.1, 1.0


def free(a, b):
    """Whether the straight line between two points of the plane misses the wall."""
    for t in np.linspace(0.0, 1.0, 201):
        x, y = a + t * (b - a)
        if abs(x) < WALL[0] and y < WALL[1]:
            return False
    return True


def test_the_shortest_way_round_a_wall():
    axis = np.linspace(-3.0, 3.0, 25)
    grid = np.array([(x, y) for x in axis for y in axis if not (abs(x) < WALL[0] and y < WALL[1])])
    start, end = np.array([-1.0, 0.0]), np.array([1.0, 0.0])
    assert not free(start, end)
    found = _detour(start, end, grid, free)
    assert free(start, found)
    assert free(found, end)
    lengths = [
        max(abs(p - start)) + max(abs(p - end)) for p in grid if free(start, p) and free(p, end)
    ]
    assert max(abs(found - start)) + max(abs(found - end)) == pytest.approx(min(lengths))
    with pytest.raises(ValueError, match="read-only"):
        found[0] = 0.0


# All together


def test_a_route_turns_goes_round_or_says_what_is_blocked():
    ur3 = Robot.load("urdf/ur3.urdf", base="base", tip="tool0")
    limits = planning_ranges(ur3, {}, np.radians(5.0), turns=True)
    q = np.zeros((5, 6))
    q[:, 1] = np.radians([-120.0, -80.0, -10.0, 150.0, 170.0])

    def free(a, b):
        return floor(a[1:], b[1:])

    way = find_route(ur3, q, limits, free_path=free)
    assert way.blocked == ()
    assert sorted(np.degrees(way.joints[:, 1])) == pytest.approx([-210, -190, -120, -80, -10])
    narrow = np.array(limits)
    narrow[1] = -np.pi, np.pi
    way = find_route(ur3, q, narrow, start=q[0], free_path=free, stops=lambda: q[:0])
    (one,) = way.blocked
    assert (one.start, one.end, one.by) == (3, 4, None)
    # Without anything in the way there is only the order.
    way = find_route(ur3, q, narrow)
    assert (way.blocked, sorted(way.order)) == ((), [0, 1, 2, 3, 4])
    assert way.travel == pytest.approx(np.radians(290.0))


def test_a_route_comes_to_every_pose_from_all_sides(ur3):
    q = np.random.default_rng(3).uniform(-1.0, 1.0, (8, 6))
    side = np.full(6, 0.1)
    sides, start = np.stack([side, -side]), np.full(6, -1.0)
    limits = np.tile([-3.0, 3.0], (6, 1))
    route = find_route(ur3, q, limits, start, sides=sides)
    assert sorted(route.order.tolist()) == sorted([*range(8), *range(8)])
    np.testing.assert_array_equal(route.joints, q[route.order])
    np.testing.assert_array_equal(route.moves, np.tile(sides, (8, 1)))
    driven = [start]
    for pose, move in zip(route.joints, route.moves, strict=True):
        driven += [pose - move, pose]
    assert route.travel == pytest.approx(np.abs(np.diff(driven, axis=0)).max(axis=1).sum())


def test_a_way_to_where_the_last_move_begins_is_tested(ur3):
    q = np.random.default_rng(3).uniform(-1.0, 1.0, (5, 6))
    side = np.full((1, 6), 0.1)
    limits = np.tile([-3.0, 3.0], (6, 1))
    straight = find_route(ur3, q, limits, free_path=lambda _a, _b: True)
    third, fourth = straight.joints[2], straight.joints[3]

    def free(a, b):
        """The way from the third pose to where the fourth is approached from is blocked, and no other."""
        return not (np.array_equal(a, third) and np.allclose(b, fourth - 0.1))

    by = np.full((1, 6), 0.5)
    route = find_route(ur3, q, limits, None, free, lambda: by, side)
    (blocked,) = route.blocked
    assert (blocked.start, blocked.end) == (3, 4)
    np.testing.assert_array_equal(blocked.by, by[0])


def test_a_straight_route_has_the_moves_from_pose_to_pose(ur3):
    q = np.random.default_rng(3).uniform(-1.0, 1.0, (5, 6))
    limits, start = np.tile([-3.0, 3.0], (6, 1)), np.full(6, -1.0)
    route = find_route(ur3, q, limits, start)
    np.testing.assert_array_equal(route.moves, np.diff(np.vstack([start, route.joints]), axis=0))
    anywhere = find_route(ur3, q, limits)
    np.testing.assert_array_equal(anywhere.moves[0], np.zeros(6))
    np.testing.assert_array_equal(anywhere.moves[1:], np.diff(anywhere.joints, axis=0))
    assert order_poses(np.empty((0, 6)), start=start).moves.shape == (0, 6)
