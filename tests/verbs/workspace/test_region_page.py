"""The page of a region: its voxels, the target and the rows of a table where they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib import example
from calib.data.measurements import Measurements
from calib.robot.ranges import joint_ranges
from calib.verbs.workspace.region import Density
from calib.verbs.workspace.region_page import region_page
from calib.verbs.workspace.region_rows import Checked, RegionView
from calib.verbs.workspace.workspace import workspace_points
from tests.view_fixtures import moved, positions, scene_of

TARGET = np.array(example.PAPER_TARGET)


@pytest.fixture(scope="module")
def view(ur3):
    rows = Measurements.read(example.paper_measurements(), ur3.joint_names, ur3.joint_types)
    q = rows.joints_for(ur3.joint_names)
    ranges = joint_ranges(ur3, like=q[rows.estimation], margin=np.radians(5.0))
    density = Density.of(workspace_points(ur3, TARGET, ranges, 2**16))
    checked = Checked(rows, rows.points, np.ones(len(rows), dtype=bool))
    return RegionView(ur3, TARGET, ranges, density, density.region(0.95), checked)


def test_bands_rows_and_target_of_a_region(view):
    page = region_page(view)
    scene = scene_of(page)
    clouds = [positions(scene, f"band{i}") for i in range(3)]
    assert sum(map(len, clouds)) == np.count_nonzero(view.region.cells)
    for cloud, (low, high) in zip(clouds, ((0, 0.5), (0.5, 0.8), (0.8, 0.951)), strict=True):
        needed = view.density.share_of(cloud)
        # A point rounded to 32 bits may fall into the next voxel.
        assert np.mean((needed > low) & (needed <= high + 1e-3)) > 0.999
    assert b"the densest 50 %" in page.html
    assert b"up to 95 %" in page.html
    rows = view.checked
    for node, row in (("estimation/003", 3), ("validation/004", 34)):
        np.testing.assert_allclose(moved(scene, node)[0, :3, 3], rows.points[row], atol=1e-12)
    T = view.robot.poses(view.ranges.mean(axis=1))[0]
    target = moved(scene, "nominal/target")[0, :3, 3]
    np.testing.assert_allclose(target, T[:3, :3] @ view.target + T[:3, 3], atol=1e-12)
    assert page.warnings == ()


def test_many_voxels_are_thinned_out_and_a_share_has_its_bands(view, ur3):
    small = region_page(replace(view, region=view.density.region(0.3)))
    assert b"the densest 30 %" in small.html
    assert b"band1" not in small.html
    density = Density.of(workspace_points(ur3, count=2**18), 0.02)
    big = replace(view, density=density, region=density.region(1.0), checked=None)
    assert np.count_nonzero(big.region.cells) > 70_000
    scene = scene_of(region_page(big))
    assert sum(len(positions(scene, f"band{i}")) for i in range(3)) == 60_000
