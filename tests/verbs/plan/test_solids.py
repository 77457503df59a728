"""The shapes of a URDF's links as coal has them, and rods between points."""

from __future__ import annotations

import numpy as np
import pytest

from calib.errors import UrdfError
from calib.robot.urdf import Urdf
from calib.verbs.plan.solids import clusters, read_solids, rods

TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def urdf_with(folder, filename: str, more: str = "") -> Urdf:
    """A URDF of one joint whose first link has a mesh of that name, in ``folder/robot``."""
    (folder / "robot").mkdir(exist_ok=True)
    path = folder / "robot" / "r.urdf"
    path.write_text(f"""<robot name="r">
      <link name="a"><collision><origin xyz="1 0 0"/><geometry><mesh filename="{filename}" scale="2 2 2"/></geometry>
        </collision>{more}</link>
      <link name="b"/>
      <joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
        <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>""")
    return Urdf.read(path)


def test_a_mesh_that_is_missing_is_named(tmp_path):
    with pytest.raises(UrdfError, match=r"link 'a': the mesh 'package://nowhere/t\.stl' was not"):
        read_solids(urdf_with(tmp_path, "package://nowhere/t.stl"), [tmp_path / "mine"])


def test_simple_shapes(tmp_path):
    (tmp_path / "t.obj").write_text(TETRAHEDRON)
    kinds = [
        '<box size="0.2 0.4 0.6"/>',
        '<cylinder radius="0.1" length="0.6"/>',
        '<capsule radius="0.1" length="0.6"/>',
        '<sphere radius="0.3"/>',
        '<sphere radius="-1"/>',
    ]
    more = "".join(f"<collision><geometry>{kind}</geometry></collision>" for kind in kinds)
    solids, unchecked = read_solids(urdf_with(tmp_path, "../t.obj", more))
    tops = []
    for solid in solids[1:]:
        solid.geometry.computeLocalAABB()
        tops.append(np.ravel(solid.geometry.aabb_local.max_))
    np.testing.assert_allclose(
        tops, [[0.1, 0.2, 0.3], [0.1, 0.1, 0.3], [0.1, 0.1, 0.4], [0.3, 0.3, 0.3]]
    )
    assert unchecked == ["a"]  # not all of it


def test_a_rod_has_its_ends_at_the_points():
    starts = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [0.5, 0.5, 0.5]])
    ends = np.array([[0.0, 0.3, 0.4], [1.0, 2.0, 1.0], [0.5, 0.5, 0.5]])
    T, half_length = rods(starts, ends.copy())
    np.testing.assert_allclose(half_length, [0.25, 1.0, 0.0], atol=1e-15)
    along = half_length[:, None] * T[:, :3, 2]
    np.testing.assert_allclose(T[:, :3, 3] - along, starts, atol=1e-15)
    np.testing.assert_allclose(T[:, :3, 3] + along, ends, atol=1e-15)
    np.testing.assert_array_equal(T[2, :3, 2], [0.0, 0.0, 1.0])


def test_links_that_fixed_joints_hold_together_are_one_cluster(tmp_path):
    (tmp_path / "t.obj").write_text(TETRAHEDRON)
    urdf = urdf_with(tmp_path, "../t.obj")
    assert clusters(urdf, []) == {"a": "a", "b": "b"}
    assert clusters(urdf, urdf.joints) == {"a": "a", "b": "a"}
