"""Workspace and density against formulas: a planar arm, a gantry, the paper's table."""

from __future__ import annotations

import numpy as np
import pytest

from calib import example
from calib.data.measurements import Measurements
from calib.robot.ranges import joint_ranges
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.verbs.workspace.region import MOST_VOXELS, Density
from calib.verbs.workspace.workspace import workspace, workspace_points

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
    region = Density.of(workspace_points(ur3, TARGET, ranges, 2**17)).region(0.95)
    inside = region.contains(paper.points)
    assert inside[30:].tolist() == [True, True, True, False, False]
    assert inside[:30].all()


# Truths that need no counting.


def test_a_planar_arm_has_the_radial_density_of_the_formula(planar):
    points = workspace_points(planar, count=2**16, seed=3)
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
    density = Density.of(workspace_points(robot, count=2**17), size / 16)
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
    density = Density.of(workspace_points(robot, target, count=2**14))
    assert density.counts.size <= MOST_VOXELS
    region = density.region(0.9)
    if name != "one point":  # a single voxel holds all of it
        assert 0.9 <= region.held < 0.95
    new = workspace_points(robot, target, count=2**13, seed=5)
    assert np.mean(region.contains(new)) == pytest.approx(region.held, abs=0.03)
    assert region.volume > 0


# The region


def test_the_region_of_a_workspace_is_that_of_its_points(ur3):
    region = workspace(ur3, TARGET, share=0.9, count=2**13, seed=2)
    points = workspace_points(ur3, TARGET, count=2**13, seed=2)
    expected = Density.of(points).region(0.9)
    assert np.array_equal(region.cells, expected.cells)
    assert (region.share, region.voxel) == (0.9, expected.voxel)
    assert region.held == pytest.approx(region.contains(points).mean())
