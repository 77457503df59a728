"""A region as voxels, membership, volume and depth, and as a file."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calib import example
from calib.data.ranges import joint_ranges
from calib.design.region import Region, RegionFile
from calib.design.workspace import Density, workspace
from calib.errors import CalibError, FileError

#: 3 x 2 x 1 voxels of 0.1 m from (1, 2, 3), of which an L of four belongs to the region.
CELLS = np.array([[[1], [1]], [[1], [0]], [[1], [0]]], dtype=bool)
TARGET = np.array(example.PAPER_TARGET)
ELL = Region(np.array([1.0, 2.0, 3.0]), 0.1, CELLS, 0.5, 0.6)


def distance_to_box(points, low, high):
    return np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=-1)


def test_points_in_voxels():
    points = [[1.05, 2.05, 3.05], [1.05, 2.15, 3.05], [1.15, 2.15, 3.05], [1.29, 2.01, 3.09]]
    assert ELL.contains(points).tolist() == [True, True, False, True]
    assert ELL.contains([[0.99, 2.05, 3.05], [1.05, 2.05, 3.11], [1.31, 2.05, 3.05]]).sum() == 0
    assert ELL.volume == pytest.approx(4e-3, rel=1e-12)
    np.testing.assert_allclose(ELL.bounds, [[1.0, 2.0, 3.0], [1.3, 2.2, 3.1]], rtol=1e-12)
    points = np.array([[1.05, 2.05, 3.04], [1.25, 2.05, 3.05], [1.15, 2.12, 3.05], [0.9, 2.0, 3.0]])
    np.testing.assert_allclose(ELL.depth(points), [0.04, 0.05, -0.02, -0.1], atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_depth_agrees_with_a_search_through_every_voxel(seed):
    rng = np.random.default_rng(seed)
    cells = rng.random(rng.integers(1, 5, 3)) < 0.6
    cells.flat[0] = True
    region = Region(np.zeros(3), 0.5, cells, 0.9, 0.9)
    points = rng.uniform(-1.0, 3.0, (40, 3))
    inside, outside = [], []
    for index in itertools.product(*[range(-1, n + 1) for n in cells.shape]):
        corner = 0.5 * np.array(index)
        known = all(0 <= i < n for i, n in zip(index, cells.shape, strict=True))
        part = inside if known and cells[index] else outside
        part.append(distance_to_box(points, corner, corner + 0.5))
    to_inside = np.min(inside, axis=0)
    expected = np.where(to_inside > 0, -to_inside, np.min(outside, axis=0))
    np.testing.assert_allclose(region.depth(points), expected, atol=1e-9)
    sure = np.abs(expected) > 1e-9
    np.testing.assert_array_equal(region.contains(points)[sure], expected[sure] > 0)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"origin": np.zeros(2)}, r"origin of shape \(2,\)"),
        ({"voxel": 0.0}, "voxels of 0.0 m"),
        ({"cells": np.zeros((2, 2, 2), dtype=bool)}, "The region is empty"),
    ],
)
def test_what_makes_no_region_is_refused(change, said):
    values = {"origin": np.zeros(3), "voxel": 0.1, "cells": CELLS, "share": 0.5, "held": 0.6}
    with pytest.raises(CalibError, match=said):
        Region(**{**values, **change})


@pytest.fixture(scope="module")
def stored(ur3):
    ranges = joint_ranges(ur3, {"elbow_joint": (0.1, 1.2)})
    region = Density.of(workspace(ur3, TARGET, ranges, 2**13, 4)).region(0.9)
    return RegionFile.of(region, ur3, TARGET, ranges, 2**13, 4)


@pytest.fixture
def path(stored, tmp_path):
    return stored.write(tmp_path / "region.json")


def test_what_is_read_is_what_was_written(stored, path):
    again = RegionFile.read(path)
    assert again.about["robot"] == stored.about["robot"]
    assert again.about["target_xyz_m"] == list(example.PAPER_TARGET)
    for name in ("origin", "cells", "voxel", "share", "held"):
        np.testing.assert_array_equal(getattr(again.region, name), getattr(stored.region, name))
    assert again.write(path, overwrite=True).read_bytes() == path.read_bytes()


@pytest.mark.parametrize("first", [True, False])
def test_runs_begin_with_those_outside(tmp_path, first):
    cells = np.array([[[first, True, True], [False, False, True]]])
    region = Region(np.zeros(3), 0.1, cells, 0.5, 0.5)
    path = tmp_path / "small.json"
    robot = {"name": "r", "base": "b", "tip": "t", "joints": []}
    about = {"robot": robot, "target_xyz_m": [0, 0, 0], "samples": 9, "seed": 0}
    RegionFile(region, about).write(path)
    table = json.loads(path.read_text())
    assert table["runs"] == ([0, 3, 2, 1] if first else [1, 2, 2, 1])
    assert table["shape"] == [1, 2, 3]
    np.testing.assert_array_equal(RegionFile.read(path).region.cells, cells)


def test_a_region_belongs_to_a_base_a_tip_and_a_target(stored, ur3):
    stored.check_fits(ur3, TARGET)
    stored.check_fits(ur3, TARGET + 1e-3)
    stored.check_fits(ur3)
    with pytest.raises(CalibError, match="made for the base base, and now it is base_link"):
        stored.check_fits(ur3.rebuilt(base="base_link", tip="tool0"))
    with pytest.raises(CalibError, match="made for the tip tool0"):
        stored.check_fits(ur3.rebuilt(base="base", tip="ee_link"))
    with pytest.raises(CalibError, match="now it is 300 mm away"):
        stored.check_fits(ur3, TARGET + np.array([0.0, 0.3, 0.0]))


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("schema", "region 2", "'region 2'"),
        ("robot", {}, "'name' is missing"),
        ("origin_m", None, "damaged"),
        ("runs", [1, 2], "damaged"),
    ],
)
def test_a_damaged_file_is_refused(path, key, value, said):
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))
    with pytest.raises(FileError, match=said):
        RegionFile.read(path)
