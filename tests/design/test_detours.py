"""Detours: by which pose a way round something leads."""

import numpy as np
import pytest

from calib.design.detours import detour

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


def test_no_way_round_is_none():
    below = np.array([(x, -1.0) for x in np.linspace(-3.0, 3.0, 30)])
    assert detour(np.array([-1.0, 0.0]), np.array([1.0, 0.0]), below, free) is None
    assert detour(np.array([-1.0, 0.0]), np.array([1.0, 0.0]), below[:0], free) is None
