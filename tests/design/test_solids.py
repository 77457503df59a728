"""The geometry of links: found where pictures find it, and named where it is not."""

import numpy as np
import pytest

from calib.design.solids import read_solids
from calib.errors import UrdfError
from calib.robot.urdf import Urdf

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


@pytest.mark.parametrize(
    ("filename", "place", "folders"),
    [
        ("t.obj", "robot/t.obj", ()),
        ("package://mine/meshes/t.obj", "elsewhere/mine/meshes/t.obj", ("elsewhere",)),
        ("file://{tmp}/there/t.obj", "there/t.obj", ()),
    ],
)
def test_where_a_mesh_may_lie(tmp_path, filename, place, folders):
    (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / place).write_text(TETRAHEDRON)
    urdf = urdf_with(tmp_path, filename.format(tmp=tmp_path))
    ((solid,), *_) = read_solids(urdf, [tmp_path / folder for folder in folders])
    assert solid.link == "a"
    np.testing.assert_array_equal(solid.T_link_shape[:3, 3], [1, 0, 0])
    solid.geometry.computeLocalAABB()
    np.testing.assert_allclose(np.ravel(solid.geometry.aabb_local.max_), [2, 2, 2])  # the scale


def test_a_mesh_that_is_missing_is_named(tmp_path):
    with pytest.raises(UrdfError, match=r"link 'a': the mesh 'package://nowhere/t\.stl' was not"):
        read_solids(urdf_with(tmp_path, "package://nowhere/t.stl"), [tmp_path / "mine"])


@pytest.mark.parametrize(
    ("content", "said"), [(b"no mesh", "is empty"), (b"", "cannot be read|is empty")]
)
def test_a_mesh_that_cannot_be_read_is_named(tmp_path, content, said):
    (tmp_path / "bad.stl").write_bytes(content)
    with pytest.raises(
        UrdfError, match=rf"link 'a': the mesh '.*bad\.stl' ({said}); or plan without"
    ):
        read_solids(urdf_with(tmp_path, "../bad.stl"))


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
    solids, _, unchecked = read_solids(urdf_with(tmp_path, "../t.obj", more))
    tops = []
    for solid in solids[1:]:
        solid.geometry.computeLocalAABB()
        tops.append(np.ravel(solid.geometry.aabb_local.max_))
    np.testing.assert_allclose(
        tops, [[0.1, 0.2, 0.3], [0.1, 0.1, 0.3], [0.1, 0.1, 0.4], [0.3, 0.3, 0.3]]
    )
    assert unchecked == ("a",)  # not all of it
