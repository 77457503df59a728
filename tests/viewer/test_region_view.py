"""The page of a region: voxels in bands about the robot, and what Chromium makes of it."""

from __future__ import annotations

import base64
import re
from dataclasses import replace

import numpy as np
import pytest
import umsgpack

from calib import example
from calib.data.measurements import Measurements
from calib.design.workspace import Checked, Density, RegionView, workspace
from calib.robot.readback import joint_ranges
from calib.viewer.design_view import region_page


@pytest.fixture(scope="module")
def view(ur3):
    rows = Measurements.read(example.paper_measurements(), ur3.joint_names, ur3.joint_types)
    q = rows.joints_for(ur3.joint_names)
    ranges = joint_ranges(ur3, like=q[rows.estimation], margin=np.radians(5.0))
    target = np.array(example.PAPER_TARGET)
    density = Density.of(workspace(ur3, target, ranges, 2**16))
    checked = Checked(rows, rows.points, np.ones(len(rows), dtype=bool))
    return RegionView(ur3, target, ranges, density, density.region(0.95), checked)


@pytest.fixture(scope="module")
def page(view):
    return region_page(view)


def scene_of(page) -> dict:
    text = re.search(rb'id="scene">([^<]*)<', page.html).group(1)
    return umsgpack.unpackb(base64.b64decode(text))


def positions(scene: dict, node: str) -> np.ndarray:
    """The points of a cloud, shape (N, 3)."""
    (command,) = [
        c for c in scene["commands"] if c["type"] == "set_object" and c["path"] == f"/robots/{node}"
    ]
    (name,) = command["object"]["geometries"]
    packed = scene["geometries"][name]["data"]["attributes"]["position"]["array"]
    return np.frombuffer(packed.data, dtype="<f4").reshape(-1, 3)


def moved(scene: dict, path: str) -> np.ndarray:
    """The transform of a node, shape (4, 4)."""
    (command,) = [
        c for c in scene["commands"] if c["type"] == "set_transform" and c["path"] == path
    ]
    return np.array(command["matrix"]).reshape(4, 4).T


def test_the_bands_are_the_voxels_of_the_region(view, page):
    scene = scene_of(page)
    clouds = [positions(scene, f"band{i}") for i in range(3)]
    voxels = np.count_nonzero(view.region.cells)
    assert sum(map(len, clouds)) == voxels
    for cloud, (low, high) in zip(clouds, ((0, 0.5), (0.5, 0.8), (0.8, 0.951)), strict=True):
        points = cloud.astype(float)
        needed = view.density.share_of(points)
        # A point rounded to 32 bits may fall into the next voxel.
        assert np.mean((needed > low) & (needed <= high + 1e-3)) > 0.999
    assert b"the densest 50 %" in page.html
    assert b"up to 95 %" in page.html


def test_rows_and_target_stand_where_they_were(view, page):
    scene = scene_of(page)
    rows = view.checked
    np.testing.assert_allclose(
        moved(scene, "/robots/estimation/003")[:3, 3], rows.points[3], atol=1e-12
    )
    np.testing.assert_allclose(
        moved(scene, "/robots/validation/004")[:3, 3], rows.points[34], atol=1e-12
    )
    T = view.robot.poses(view.ranges.mean(axis=1))[0]
    target = moved(scene, "/robots/nominal/target")[:3, 3]
    np.testing.assert_allclose(target, T[:3, :3] @ view.target + T[:3, 3], atol=1e-12)
    links = r"/robots/nominal/robot/links/\d+/\d+"
    meshes = [c for c in scene["commands"] if re.fullmatch(links, c["path"])]
    assert len(meshes) == 14  # shape and pose of each link
    assert page.warnings == ()


def test_many_voxels_are_thinned_out_and_a_share_has_its_bands(view, ur3):
    small = region_page(replace(view, region=view.density.region(0.3)))
    assert b"the densest 30 %" in small.html
    assert b"band1" not in small.html
    density = Density.of(workspace(ur3, count=2**18), 0.02)
    big = replace(view, density=density, region=density.region(1.0), checked=None)
    assert np.count_nonzero(big.region.cells) > 70_000
    scene = scene_of(region_page(big))
    assert sum(len(positions(scene, f"band{i}")) for i in range(3)) == 60_000


@pytest.mark.slow
def test_chromium_shows_robot_bands_and_rows_and_calls_nobody(browser, view, tmp_path):
    path = region_page(view).write(tmp_path / "view.html")
    with browser.open(path.as_uri()) as tab:
        picture = tab.screenshot().astype(int)
        assert tab.console == []
        assert tab.elsewhere == []
    middle = picture[80:640, 200:1080]
    red, green, blue = np.moveaxis(middle, -1, 0)
    counts = {
        "steel": (blue - red > 20) & (blue < 225),
        "seldom": (red > 210) & (green > 140) & (blue < 120),
        "often": (red > 100) & (red - green > 70) & (red - blue > 30) & (green < 100),
        "validation": (green - red > 80) & (green > 110),
        "estimation": np.max(middle, axis=-1) < 60,
    }
    for what, mask in counts.items():
        assert mask.sum() > 100, what
