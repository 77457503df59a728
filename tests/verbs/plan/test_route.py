"""Whole turns: a stretch of poses that nothing but a turn more of a joint can reach."""

import numpy as np
import pytest

from calib.robot.robot import Robot
from calib.verbs.plan.candidates import planning_ranges
from calib.verbs.plan.route import detour, route, turning, with_whole_turns

WIDE = np.array([[-2.0 * np.pi, 2.0 * np.pi], [-np.pi, np.pi]])


def floor(a, b):
    """A bar on its first joint must not pass through straight down, 90 deg (and that less or more turns)."""
    path = a[0] + np.linspace(0.0, 1.0, 181) * (b[0] - a[0])
    return bool(np.all(np.abs(np.mod(path, 2.0 * np.pi) - 0.5 * np.pi) > 0.05))


def poses(*degrees):
    return np.array([[np.radians(d), 0.1 * k] for k, d in enumerate(degrees)])


def test_a_bar_goes_over_the_top():
    q = poses(-120.0, -80.0, -10.0, 150.0, 170.0)
    near, far = np.arange(3), np.arange(3, 5)
    assert not floor(q[2], q[3])
    turned = with_whole_turns(q, [near, far], WIDE, np.array([True, False]), floor)
    assert turned[:3] == pytest.approx(q[:3])
    assert np.degrees(turned[3:, 0]) == pytest.approx([-210.0, -190.0])
    assert turned[3:, 1] == pytest.approx(q[3:, 1])
    assert floor(turned[0], turned[3])


def test_joints_of_more_than_a_turn():
    ur3 = Robot.load("urdf/ur3.urdf", base="base", tip="tool0")
    limits = planning_ranges(ur3, {"wrist_1_joint": (-1.0, 1.0)}, np.radians(5.0), turns=True)
    assert np.degrees(limits[0]) == pytest.approx([-355.0, 355.0])
    assert limits[3] == pytest.approx([-1.0, 1.0])
    # The elbow has one turn, and a joint with a range is kept in it.
    assert turning(ur3, limits).tolist() == [True, True, False, False, True, True]
    # A turn of a reading that another joint counts would turn that one as well, and the other way round.
    coupling = {"elbow_joint": {"shoulder_lift_joint": 1.0}, "wrist_3_joint": {"elbow_joint": 1.0}}
    coupled = Robot.load("urdf/ur3.urdf", base="base", tip="tool0", coupling=coupling)
    assert turning(coupled, limits).tolist() == [True, False, False, False, True, False]


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
    found = detour(start, end, grid, free)
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

    way = route(ur3, q, limits, free_path=free)
    assert way.blocked == ()
    assert sorted(np.degrees(way.joints[:, 1])) == pytest.approx([-210, -190, -120, -80, -10])
    narrow = np.array(limits)
    narrow[1] = -np.pi, np.pi
    way = route(ur3, q, narrow, start=q[0], free_path=free, stops=lambda: q[:0])
    (one,) = way.blocked
    assert (one.start, one.end, one.by) == (3, 4, None)
    # Without anything in the way there is only the order.
    way = route(ur3, q, narrow)
    assert (way.blocked, sorted(way.indices)) == ((), [0, 1, 2, 3, 4])
    assert way.length == pytest.approx(np.radians(290.0))
