"""The file of a region: what is read is what was written; damage and another robot are refused."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from calib import example
from calib.errors import CalibError, FileError
from calib.robot.ranges import joint_ranges
from calib.verbs.workspace.region import Density, Region
from calib.verbs.workspace.region_file import read_region, write_region
from calib.verbs.workspace.region_rows import RegionView
from calib.verbs.workspace.workspace import workspace_points

TARGET = np.array(example.PAPER_TARGET)


@pytest.fixture(scope="module")
def stored(ur3):
    ranges = joint_ranges(ur3, {"elbow_joint": (0.1, 1.2)})
    density = Density.of(workspace_points(ur3, TARGET, ranges, 2**13, 4))
    return RegionView(ur3, TARGET, ranges, density, density.region(0.9))


@pytest.fixture
def path(stored, tmp_path):
    return write_region(stored, tmp_path / "region.json", 4)


def test_what_is_read_is_what_was_written(ur3, stored, path):
    again = read_region(path, ur3, TARGET + 1e-3)
    for name in ("origin", "cells", "voxel", "share", "held"):
        np.testing.assert_array_equal(getattr(again, name), getattr(stored.region, name))
    table = json.loads(path.read_text())
    assert (table["samples"], table["seed"], table["volume_m3"]) == (2**13, 4, again.volume)
    elbow = {"name": "elbow_joint", "low_rad": 0.1, "high_rad": 1.2}
    assert table["robot"]["joints"][2] == elbow


@pytest.mark.parametrize("first", [True, False])
def test_runs_begin_with_those_outside(stored, tmp_path, first):
    cells = np.array([[[first, True, True], [False, False, True]]])
    region = Region(np.zeros(3), 0.1, cells, 0.5, 0.5)
    path = write_region(replace(stored, region=region), tmp_path / "small.json", 0)
    table = json.loads(path.read_text())
    assert table["runs"] == ([0, 3, 2, 1] if first else [1, 2, 2, 1])
    np.testing.assert_array_equal(read_region(path).cells, cells)


@pytest.mark.parametrize(
    ("base", "tip", "by"),
    [("base_link", "tool0", 0.0), ("base", "ee_link", 0.0), ("base", "tool0", 0.3)],
)
def test_a_region_belongs_to_a_base_a_tip_and_a_target(path, ur3, base, tip, by):
    with pytest.raises(CalibError, match="made for the base base, the tip tool0"):
        read_region(path, ur3.rebuilt(base=base, tip=tip), TARGET + np.array([0.0, by, 0.0]))


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("schema", "region 2", "'region 2'"),
        ("robot", {}, "'base' is missing"),
        ("origin_m", None, "damaged"),
        ("runs", [1, 2], "damaged"),
    ],
)
def test_a_damaged_file_is_refused(path, key, value, said):
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))
    with pytest.raises(FileError, match=said):
        read_region(path)
