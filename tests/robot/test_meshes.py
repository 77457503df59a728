"""Where meshes are looked for, and what is in a link's shapes."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from pinocchio import hppfcl

from calib.robot.meshes import (
    KINDS,
    _binary_stl,
    _by_trimesh,
    find_mesh,
    link_shapes,
    load_mesh,
    mesh_folders,
    read_mesh,
)
from calib.robot.urdf import Urdf, find_urdf

TEXT = """<robot name="r"><link name="a">
  <visual><origin xyz="1 2 3" rpy="0 0 1.5707963267948966"/><geometry><box size="1 2 3"/></geometry></visual>
  <visual><geometry/></visual>
  <collision><geometry><mesh filename="a.stl" scale="1 2 3"/></geometry></collision>
  <collision><origin xyz="1 2"/><geometry><mesh filename="b.stl"/></geometry></collision>
  <collision><geometry><sphere radius="0"/></geometry></collision>
  <collision><geometry><cylinder radius="0.5"/></geometry></collision></link><link name="b"/>
  <joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint></robot>"""


def test_shapes_of_each_kind():
    urdf = Urdf.from_bytes(TEXT.encode(), "r.urdf")
    (box,) = link_shapes(urdf, "visual")
    assert (box.link, box.sizes, box.mesh) == ("a", (1.0, 2.0, 3.0), None)
    expected = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    np.testing.assert_allclose(box.T_link_shape, expected, atol=1e-15)
    shapes = list(link_shapes(urdf, "collision"))
    assert [shape.mesh for shape in shapes] == [
        ("a.stl", (1.0, 2.0, 3.0)),
        ("b.stl", (1.0, 1.0, 1.0)),
        None,
        None,
    ]
    assert [shape.sizes for shape in shapes] == [None] * 4
    np.testing.assert_array_equal(shapes[1].T_link_shape, np.eye(4))


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("package://p/x/t.obj", "p/x/t.obj"),
        ("model://p/t.obj", "p/t.obj"),
        ("package:///p/x/t.obj", "p/x/t.obj"),
        ("x/t.obj", "x/t.obj"),
        ("file://{tmp}/with%20blank/t.obj", "with blank/t.obj"),
    ],
)
def test_a_mesh_is_found_and_read(tmp_path, name, place):
    assert find_mesh(name.format(tmp=tmp_path), [tmp_path]) is None
    (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / place).write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    path = find_mesh(name.format(tmp=tmp_path), [tmp_path])
    assert path is not None
    (vertices, faces), problem = read_mesh(path, (1.0, 2.0, 3.0))
    assert problem == ""
    np.testing.assert_array_equal(np.ptp(vertices, axis=0), [1, 2, 0])
    assert faces.shape == (1, 3)


#: A triangle of 4 units along x, as COLLADA.
DAE = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>{unit}</asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="a" count="9">0 0 0 4 0 0 0 4 0</float_array><technique_common>
<accessor source="#a" count="3" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#g"/></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


@pytest.mark.parametrize(
    ("unit", "length"),
    [
        ("", 4.0),
        ('<unit name="meter" meter="1"/>', 4.0),
        ('<unit name="millimeter" meter="0.001"/>', 4e-3),
        ("<unit meter='2.54e-2' name='inch'/>", 0.1016),
    ],
)
def test_a_collada_file_is_as_large_as_it_says(tmp_path, unit, length):
    (tmp_path / "t.dae").write_text(DAE.format(unit=unit))
    (vertices, _), problem = read_mesh(tmp_path / "t.dae", (1.0, 1.0, 1.0))
    assert problem == ""
    np.testing.assert_allclose(np.ptp(vertices, axis=0), [length, length, 0], rtol=1e-6)


@pytest.mark.parametrize("robot", ["ur5"])
def test_meshes_are_those_that_coal_reads(robot):
    """Of STL and COLLADA and OBJ, by assimp, in another language; the faces by their area."""

    def extent(vertices, faces):
        sides = vertices[faces[:, 1:]] - vertices[faces[:, :1]]
        area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum()
        used = vertices[np.unique(faces)]
        return [*used.min(axis=0), *used.max(axis=0), area]

    urdf = Urdf.read(find_urdf(robot))
    paths = {
        find_mesh(s.mesh[0], mesh_folders(urdf)) for s in link_shapes(urdf, "collision") if s.mesh
    }
    assert paths
    for path in sorted(paths)[:4]:
        (vertices, faces), problem = read_mesh(path, (1.0, 2.0, 3.0))
        assert problem == ""
        theirs = hppfcl.MeshLoader().load(str(path), np.array([1.0, 2.0, 3.0]))
        corners = [theirs.tri_indices(i) for i in range(theirs.num_tris)]
        expected = extent(theirs.vertices(), np.array([(c[0], c[1], c[2]) for c in corners]))
        np.testing.assert_allclose(extent(vertices, faces), expected, rtol=1e-4, atol=1e-6)


def test_a_binary_stl_is_read_as_trimesh_reads_it(tmp_path):
    whole = tmp_path / "part.STL"
    whole.write_bytes(trimesh.creation.icosphere(2).export(file_type="stl"))
    ours = _binary_stl(whole)
    assert ours is not None
    for our, their in zip(ours, _by_trimesh(whole), strict=True):
        np.testing.assert_array_equal(our, their)
    assert _binary_stl(whole.rename(tmp_path / "part.obj")) is None
    (tmp_path / "half.stl").write_bytes((tmp_path / "part.obj").read_bytes()[:-30])
    assert read_mesh(tmp_path / "half.stl", (1, 1, 1))[0] is None


def test_files_that_are_no_meshes(tmp_path):
    (tmp_path / "bad.dae").write_bytes(b"no mesh")
    assert load_mesh(tmp_path / "bad.dae", (1, 1, 1)) == (None, "cannot be read")
    (tmp_path / "point.obj").write_text("v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n")
    mesh, problem = load_mesh(tmp_path / "point.obj", (1, 1, 1))
    assert mesh is None
    assert problem in ("is empty", "cannot be read")
    assert load_mesh(tmp_path / "none.stl", (1, 1, 1)) == (None, "cannot be read")
    (tmp_path / "m.fbx").write_bytes(b"")
    mesh, problem = load_mesh(tmp_path / "m.fbx", (1, 1, 1))
    assert mesh is None
    assert problem.startswith("is of a kind that is not read; save it as one of .stl, .obj, .dae")


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != ".dae"])
def test_each_kind_is_read_as_trimesh_writes_it(tmp_path: Path, kind: str):
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    box.export(tmp_path / f"box{kind}")
    (vertices, faces), problem = read_mesh(tmp_path / f"box{kind}", (1.0, 1.0, 1.0))
    assert problem == ""
    assert faces.shape == (12, 3)
    corners = np.unique(vertices.round(6), axis=0)
    np.testing.assert_allclose(corners, np.unique(box.vertices, axis=0), atol=1e-6)
