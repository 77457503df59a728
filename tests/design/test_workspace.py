"""Density and region against what is known without counting: a planar arm, a gantry, the paper's table; the file."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calib import example
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.design.workspace import (
    MOST_VOXELS,
    Density,
    Region,
    RegionView,
    read_region,
    read_rows,
    row_points,
    workspace,
    write_region,
)
from calib.errors import CalibError, FileError, MeasurementError
from calib.robot.ranges import joint_ranges
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

TARGET = np.array(example.PAPER_TARGET)
L1, L2 = 0.4, 0.3

PLANAR = f"""<robot name="planar">
  <link name="a"/><link name="b"/><link name="c"/><link name="d"/>
  <joint name="j1" type="continuous"><parent link="a"/><child link="b"/>
    <origin xyz="0 0 0.1"/><axis xyz="0 0 1"/></joint>
  <joint name="j2" type="continuous"><parent link="b"/><child link="c"/>
    <origin xyz="{L1} 0 0"/><axis xyz="0 0 1"/></joint>
  <joint name="end" type="fixed"><parent link="c"/><child link="d"/><origin xyz="{L2} 0 0"/></joint>
</robot>"""

GANTRY = """<robot name="gantry">
  <link name="a"/><link name="b"/><link name="c"/><link name="d"/>
  <joint name="x" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="{size}" effort="1" velocity="1"/></joint>
  <joint name="y" type="prismatic"><parent link="b"/><child link="c"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="{size}" effort="1" velocity="1"/></joint>
  <joint name="z" type="prismatic"><parent link="c"/><child link="d"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="{size}" effort="1" velocity="1"/></joint>
</robot>"""


def gantry(size: float) -> Robot:
    return Robot.from_urdf(Urdf.from_bytes(GANTRY.format(size=size).encode(), "g.urdf"), "a", "d")


@pytest.fixture(scope="module")
def planar():
    return Robot.from_urdf(Urdf.from_bytes(PLANAR.encode(), "planar.urdf"), "a", "d")


@pytest.fixture(scope="module")
def paper(ur3):
    return Measurements.read(example.paper_measurements(), ur3.joint_names, ur3.joint_types)


def density_values(density: Density) -> np.ndarray:
    """The smoothed density [1/m^3]; its integral is 1."""
    return density.smooth / (density.smooth.sum() * density.voxel**3)


# What the paper says.


def test_the_paper_s_region_holds_rows_31_to_33_and_not_34_and_35(ur3, paper):
    rows = paper.joints_for(ur3.joint_names)[paper.estimation]
    ranges = joint_ranges(ur3, like=rows, margin=np.radians(5.0))
    region = Density.of(workspace(ur3, TARGET, ranges, 2**17)).region(0.95)
    inside = region.contains(paper.points)
    assert inside[30:].tolist() == [True, True, True, False, False]
    assert inside[:30].all()


# Truths that need no counting.


def test_a_planar_arm_has_the_radial_density_of_the_formula(planar):
    points = workspace(planar, count=2**16, seed=3)
    np.testing.assert_allclose(points[:, 2], 0.1, atol=1e-12)
    radius = np.hypot(points[:, 0], points[:, 1])
    for r in (0.15, 0.3, 0.5, 0.6, 0.69):
        below = 1.0 - np.arccos((r**2 - L1**2 - L2**2) / (2 * L1 * L2)) / np.pi
        assert np.mean(radius < r) == pytest.approx(below, abs=1e-3)

    density = Density.of(points, 0.01)
    assert density.counts.shape == (140, 140, 1)
    index = np.argwhere(density.counts)
    centres = density.origin + density.voxel * (index + 0.5)
    r2 = centres[:, 0] ** 2 + centres[:, 1] ** 2
    elbow = (r2 - L1**2 - L2**2) / (2 * L1 * L2)
    smooth = np.abs(elbow) < 0.8  # at the rims the density grows beyond all bounds
    formula = 1.0 / (2 * np.pi**2 * L1 * L2 * np.sqrt(1 - elbow[smooth] ** 2))
    counted = density_values(density)[tuple(index.T)][smooth] * density.voxel
    # An arm's density over the plane, with a voxel's height; 16 samples in a voxel, smoothed over 7.
    assert np.mean(counted / formula) == pytest.approx(1.0, abs=0.01)
    assert np.std(counted / formula) < 0.12


@pytest.mark.parametrize("share", [0.25, 1.0])
def test_a_gantry_s_density_is_even_and_its_region_has_the_share_of_the_volume(share):
    robot, size = gantry(200.0), 200.0
    density = Density.of(workspace(robot, count=2**17), size / 16)
    assert density.counts.shape == (16, 16, 16)
    np.testing.assert_allclose(density_values(density) * size**3, 1.0, atol=0.15)
    region = density.region(share)
    assert region.volume == pytest.approx(share * size**3, rel=0.03)


# Robots of other kinds.


def robots():
    planar = Urdf.from_bytes(PLANAR.encode(), "planar.urdf")
    yield "one joint", Robot.from_urdf(planar, "b", "d"), np.zeros(3)
    yield "one point", Robot.load("panda", tip="panda_link1"), np.zeros(3)
    yield "a lift and an arm", Robot.load("tiago", tip="arm_7_link"), np.zeros(3)


@pytest.mark.parametrize(("name", "robot", "target"), [pytest.param(*r, id=r[0]) for r in robots()])
def test_any_robot_has_a_workspace(name, robot, target):
    density = Density.of(workspace(robot, target, count=2**14))
    assert density.counts.size <= MOST_VOXELS
    region = density.region(0.9)
    if name != "one point":  # a single voxel holds all of it
        assert 0.9 <= region.held < 0.95
    new = workspace(robot, target, count=2**13, seed=5)
    assert np.mean(region.contains(new)) == pytest.approx(region.held, abs=0.03)
    assert region.volume > 0


# Counting itself.


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 300), st.floats(0.01, 1.0))
def test_a_region_is_the_fewest_voxels_of_the_highest_density(seed, count, share):
    points = np.random.default_rng(seed).normal(size=(count, 3))
    density = Density.of(points, 0.7)
    assert density.counts.sum() == count
    assert np.all((density.smooth > 0) == (density.counts > 0))
    region = density.region(share)
    chosen = density.smooth[region.cells]
    left = density.smooth[~region.cells]
    assert chosen.min() >= left.max(initial=0.0)
    held = density.counts[region.cells].sum() / count
    assert held == pytest.approx(region.held, abs=1e-12)
    assert held >= share - 1e-9
    # Without its least dense voxel it would hold less than the share.
    least = density.counts[region.cells][chosen == chosen.min()].max() / count
    assert held - least < share


# Voxels.

#: 3 x 2 x 1 voxels of 0.1 m from (1, 2, 3), of which an L of four belongs to the region.
CELLS = np.array([[[1], [1]], [[1], [0]], [[1], [0]]], dtype=bool)
ELL = Region(np.array([1.0, 2.0, 3.0]), 0.1, CELLS, 0.5, 0.6)


def test_points_in_voxels():
    points = [[1.05, 2.05, 3.05], [1.05, 2.15, 3.05], [1.15, 2.15, 3.05], [1.29, 2.01, 3.09]]
    assert ELL.contains(points).tolist() == [True, True, False, True]
    assert ELL.contains([[0.99, 2.05, 3.05], [1.05, 2.05, 3.11], [1.31, 2.05, 3.05]]).sum() == 0
    assert ELL.volume == pytest.approx(4e-3, rel=1e-12)
    np.testing.assert_allclose(ELL.bounds, [[1.0, 2.0, 3.0], [1.3, 2.2, 3.1]], rtol=1e-12)


# The file.


@pytest.fixture(scope="module")
def stored(ur3):
    ranges = joint_ranges(ur3, {"elbow_joint": (0.1, 1.2)})
    density = Density.of(workspace(ur3, TARGET, ranges, 2**13, 4))
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


# The targets of a table's rows.

HIGHER = TARGET + np.array([0.0, 0.0, 0.1])
T_FRAME_BASE = np.array([[0.0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])


def test_measured_points_are_taken_as_they_are_or_carried_into_the_base(ur3, paper):
    points, measured = row_points(ur3, paper, Cell(), TARGET)
    np.testing.assert_array_equal(points, paper.points)
    assert measured.all()
    points = paper.points @ T_FRAME_BASE[:3, :3].T + T_FRAME_BASE[:3, 3]
    moved = Measurements(paper.joint_names, paper.joints, points)
    back, measured = row_points(ur3, moved, Cell(T_frame_base=T_FRAME_BASE), TARGET)
    np.testing.assert_allclose(back, paper.points, atol=1e-12)
    assert measured.all()
    groups = ("a",) * 20 + ("b",) * 15
    where = np.where(np.arange(35)[:, None] < 20, points, paper.points)
    two = Measurements(paper.joint_names, paper.joints, where, groups=groups)
    cell = Cell(frames={"a": T_FRAME_BASE, "b": np.eye(4)})
    np.testing.assert_allclose(row_points(ur3, two, cell, TARGET)[0], paper.points, atol=1e-12)


def test_in_an_unknown_frame_each_target_is_predicted_at_its_place(ur3, paper):
    names = ("low", "high") * 17 + ("other",)
    two = Measurements(paper.joint_names, paper.joints, paper.points, targets=names)
    cell = Cell(targets={"low": TARGET, "high": HIGHER}, estimate_frame=True)
    points, measured = row_points(ur3, two, cell, np.zeros(3))
    assert not measured.any()
    poses = ur3.poses(paper.joints)
    np.testing.assert_allclose(points[34], poses[34, :3, 3], atol=1e-12)
    at = poses[1, :3, :3] @ HIGHER + poses[1, :3, 3]
    np.testing.assert_allclose(points[1], at, atol=1e-12)
    # The nominal robot is a few mm off.
    assert 1e-4 < np.linalg.norm(points - paper.points, axis=1)[:34:2].max() < 6e-3


def test_tables_without_positions(ur3, paper, tmp_path):
    path = tmp_path / "poses.csv"
    header = ",".join(f"{name} [deg]" for name in paper.joint_names)
    rows = [",".join(f"{v:.6f}" for v in row) for row in np.degrees(paper.joints)]
    expected = row_points(ur3, paper, Cell(estimate_frame=True), TARGET)[0]
    xyz = ",x [mm],y [mm],z [mm]"
    # A plan that is not filled in has the columns, and nothing in them.
    for more, cells in (("", ""), (xyz, ",,,")):
        path.write_text("\n".join([header + more, *[row + cells for row in rows]]))
        points, measured = row_points(ur3, read_rows(path, ur3), Cell(), TARGET)
        assert not measured.any()
        np.testing.assert_allclose(points, expected, atol=1e-6)
    # With a cell that is no number the table is read as it is, and refused.
    path.write_text("\n".join([header + xyz, *[f"{row},a,b,c" for row in rows]]))
    with pytest.raises(MeasurementError, match="is not a finite number"):
        read_rows(path, ur3)
