"""Regions as files: what is read is what was written, and what is damaged is named."""

from __future__ import annotations

import json

import numpy as np
import pytest

from calib import example
from calib.data.ranges import joint_ranges
from calib.design.region import Region, RegionFile
from calib.design.workspace import Density, sample_workspace
from calib.errors import CalibError, FileError
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf


@pytest.fixture(scope="module")
def ur3():
    return Robot.load(example.paper_urdf(), base="base", tip="tool0")


@pytest.fixture(scope="module")
def stored(ur3):
    target, ranges = np.array(example.PAPER_TARGET), joint_ranges(ur3, {"elbow_joint": (0.1, 1.2)})
    points = sample_workspace(ur3, target, ranges, 2**13, 4)
    box = [[-0.4, -np.inf, -np.inf], [np.inf, np.inf, 0.6]]
    region = Density.of(points, box=box).region(0.9)
    return RegionFile.of(region, ur3, target, ranges, 2**13, 4)


@pytest.fixture
def path(stored, tmp_path):
    return stored.write(tmp_path / "region.json")


def test_what_is_read_is_what_was_written(stored, path):
    again = RegionFile.read(path)
    for name in ("robot", "base", "tip", "joints", "samples", "seed"):
        assert getattr(again, name) == getattr(stored, name)
    np.testing.assert_array_equal(again.target, stored.target)
    for name in ("origin", "cells", "box", "voxel", "share", "held", "volume"):
        np.testing.assert_array_equal(getattr(again.region, name), getattr(stored.region, name))
    assert again.write(path, overwrite=True).read_bytes() == path.read_bytes()
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (2000, 3))
    inside = stored.region.contains(points)
    assert 0 < inside.sum() < 2000
    np.testing.assert_array_equal(again.region.contains(points), inside)


@pytest.mark.parametrize("first", [True, False])
def test_runs_begin_with_those_outside(tmp_path, first):
    cells = np.array([[[first, True, True], [False, False, True]]])
    region = Region(np.zeros(3), 0.1, cells, 0.5, 0.5)
    path = tmp_path / "small.json"
    joints = [{"name": "j", "low_m": 0.0, "high_m": 1.0}]
    RegionFile(region, "r", "b", "t", joints, np.zeros(3), 9, 0).write(path)
    table = json.loads(path.read_text())
    assert table["runs"] == ([0, 3, 2, 1] if first else [1, 2, 2, 1])
    assert table["shape"] == [1, 2, 3]
    assert table["box_m"] is None
    again = RegionFile.read(path)
    np.testing.assert_array_equal(again.region.cells, cells)
    assert again.joints == joints


# Whose region it is.


def test_it_fits_its_own_robot_and_a_corrected_one(stored, ur3):
    assert stored.check_fits(ur3, stored.target) == ()
    assert stored.check_fits(ur3) == ()
    placements = ur3.placements.copy()
    placements[2, 0, 3] += 1e-3
    assert stored.check_fits(ur3.with_placements(placements), stored.target) == ()


def test_another_name_or_target_is_told(stored, ur3):
    text = ur3.urdf.data.replace(b'robot name="ur3"', b'robot name="ur3e"')
    other = Robot.from_urdf(Urdf.from_bytes(text, "ur3e.urdf"), "base", "tool0")
    (note,) = stored.check_fits(other, stored.target)
    assert note == "The region was made for 'ur3', this robot is 'ur3e'."
    (note,) = stored.check_fits(ur3, stored.target + np.array([0.0, 0.3, 0.0]))
    assert note.startswith("The region was made for a target 300 mm away from this one")
    assert stored.check_fits(ur3, stored.target + 1e-3) == ()


@pytest.mark.parametrize(
    ("base", "tip", "said"),
    [
        ("base_link", "tool0", "for the base 'base' of 'ur3', and the base is 'base_link' now. Give --base base"),
        ("base", "ee_link", "for the tip 'tool0' of 'ur3', and the tip is 'ee_link' now. Give --tip tool0"),
    ],
)  # fmt: skip
def test_another_base_or_tip_is_refused(stored, ur3, base, tip, said):
    with pytest.raises(CalibError, match=said):
        stored.check_fits(ur3.rebuilt(base=base, tip=tip))


def test_other_joints_are_refused(stored, ur3):
    text = ur3.urdf.data.replace(b'"elbow_joint"', b'"knee"')
    other = Robot.from_urdf(Urdf.from_bytes(text, "other.urdf"), "base", "tool0")
    with pytest.raises(CalibError, match=r"for the joints .*'elbow_joint'.* has .*'knee'"):
        stored.check_fits(other)


# Files that are damaged.


def test_files_that_are_no_region_are_refused(tmp_path):
    path = tmp_path / "r.json"
    with pytest.raises(FileError, match=r"region '.*r.json' does not exist"):
        RegionFile.read(path)
    for text, said in (
        ("{", "this is not a JSON file"),
        (
            '{"schema": "region 2"}',
            "its 'schema' is 'region 2'; a region of calib .* has 'region 1'",
        ),
    ):
        path.write_text(text)
        with pytest.raises(FileError, match=said):
            RegionFile.read(path)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("robot", {}, "'name' is missing"),
        ("origin_m", None, "damaged"),
        ("box_m", [[5, 5, 5], [6, 6, 6]], "The region is empty"),
        ("runs", [1, 2], "damaged"),
    ],
)
def test_a_damaged_file_is_named_with_what_is_wrong(path, key, value, said):
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))
    with pytest.raises(FileError, match=said) as error:
        RegionFile.read(path)
    assert str(error.value).startswith(f"{path}: the region is damaged: ")
    assert str(error.value).endswith("Write it again with 'calib workspace -o'.")
