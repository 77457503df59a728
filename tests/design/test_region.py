"""A region as voxels: membership, volume, depth, and the part inside of a box."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calib.design.region import Region
from calib.errors import CalibError

#: 3 x 2 x 1 voxels of 0.1 m from (1, 2, 3), of which an L of four belongs to the region.
CELLS = np.array([[[1], [1]], [[1], [0]], [[1], [0]]], dtype=bool)
ELL = Region(np.array([1.0, 2.0, 3.0]), 0.1, CELLS, 0.5, 0.6)


def within(region: Region, box) -> Region:
    return replace(region, box=np.array(box))


def distance_to_box(points, low, high):
    return np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=-1)


def test_points_in_voxels():
    points = [[1.05, 2.05, 3.05], [1.05, 2.15, 3.05], [1.15, 2.15, 3.05], [1.29, 2.01, 3.09]]
    assert ELL.contains(points).tolist() == [True, True, False, True]
    assert ELL.contains([[0.99, 2.05, 3.05], [1.05, 2.05, 3.11], [1.31, 2.05, 3.05]]).sum() == 0
    assert ELL.contains(np.zeros((0, 3))).shape == (0,)


def test_volume_and_bounds():
    assert ELL.volume == pytest.approx(4e-3, rel=1e-12)
    np.testing.assert_allclose(ELL.bounds, [[1.0, 2.0, 3.0], [1.3, 2.2, 3.1]], rtol=1e-12)


def test_the_part_inside_of_a_box():
    half = within(ELL, [[1.05, -np.inf, 0.0], [9.0, 2.15, 3.02]])
    # 0.15 of 0.2 m along y in the first column, cut to half of it along x, and two whole voxels, 0.02 high.
    assert half.volume == pytest.approx((0.05 * 0.15 + 0.2 * 0.1) * 0.02, rel=1e-9)
    points = [[1.04, 2.05, 3.01], [1.06, 2.05, 3.01], [1.06, 2.16, 3.01], [1.06, 2.05, 3.03]]
    assert half.contains(points).tolist() == [False, True, False, False]
    np.testing.assert_allclose(half.bounds, [[1.05, 2.0, 3.0], [1.3, 2.15, 3.02]], rtol=1e-12)


def test_depth_is_the_distance_to_the_border():
    points = np.array([[1.05, 2.05, 3.04], [1.25, 2.05, 3.05], [1.15, 2.12, 3.05], [0.9, 2.0, 3.0]])
    np.testing.assert_allclose(ELL.depth(points), [0.04, 0.05, -0.02, -0.1], atol=1e-12)
    half = within(ELL, [[1.02, -np.inf, -np.inf], [np.inf] * 3])
    np.testing.assert_allclose(half.depth([[1.05, 2.05, 3.04]]), [0.03], atol=1e-12)
    np.testing.assert_allclose(half.depth([[0.9, 2.05, 3.05]]), [-0.12], atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_depth_agrees_with_every_voxel_asked(seed, boxed):
    rng = np.random.default_rng(seed)
    cells = rng.random(rng.integers(1, 5, 3)) < 0.6
    cells.flat[0] = True
    region = Region(np.zeros(3), 0.5, cells, 0.9, 0.9)
    low, high = np.full(3, -np.inf), np.full(3, np.inf)
    if boxed:
        low, high = np.array([-1.0, 0.1, -2.0]), np.array([0.4, 5.0, 1.3])
        region = within(region, [low, high])
    points = rng.uniform(-1.0, 3.0, (40, 3))
    inside, outside = [], []
    for index in itertools.product(*[range(-1, n + 1) for n in cells.shape]):
        corner = 0.5 * np.array(index)
        known = all(0 <= i < n for i, n in zip(index, cells.shape, strict=True))
        a, b = np.maximum(corner, low), np.minimum(corner + 0.5, high)
        if known and cells[index]:
            if np.all(a < b):
                inside.append(distance_to_box(points, a, b))
        else:
            outside.append(distance_to_box(points, corner, corner + 0.5))
    to_inside = np.min(inside, axis=0)
    faces = np.minimum(points - low, high - points).min(axis=1)
    to_outside = np.minimum(np.min(outside, axis=0), faces)
    expected = np.where(to_inside > 0, -to_inside, to_outside)
    np.testing.assert_allclose(region.depth(points), expected, atol=1e-9)
    sure = np.abs(expected) > 1e-9
    np.testing.assert_array_equal(region.contains(points)[sure], expected[sure] > 0)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"origin": np.zeros(2)}, r"origin of shape \(2,\)"),
        ({"cells": np.ones((2, 2), dtype=bool)}, r"of shape \(2, 2\)"),
        ({"voxel": 0.0}, "voxels of 0.0 m"),
        ({"cells": np.zeros((2, 2, 2), dtype=bool)}, "The region is empty"),
        ({"box": np.zeros((2, 3))}, "two corners of three numbers, the second greater"),
        ({"box": [[0, 0, np.nan], [1, 1, 1]]}, "two corners"),
        # The notch of the L.
        ({"box": [[0.1, 0.1, 0.0], [0.3, 0.2, 0.1]]}, "The region is empty: no voxel of it"),
    ],
)
def test_what_makes_no_region_is_refused(change, said):
    values = {"origin": np.zeros(3), "voxel": 0.1, "cells": CELLS, "share": 0.5, "held": 0.6}
    with pytest.raises(CalibError, match=said):
        Region(**{**values, **change})
