import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from calib.model.meshes import mesh_folders
from calib.model.urdf import Urdf
from calib.show.triangles import Triangles
from calib.show.visuals import (
    MOST_TRIANGLES,
    Box,
    Cylinder,
    Sphere,
    read_visuals,
    same_visuals,
)

TETRAHEDRON = """solid t
facet normal 0 0 -1
outer loop
vertex 0 0 0
vertex 0 1 0
vertex 1 0 0
endloop
endfacet
facet normal 0 -1 0
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 0 1
endloop
endfacet
facet normal -1 0 0
outer loop
vertex 0 0 0
vertex 0 0 1
vertex 0 1 0
endloop
endfacet
facet normal 1 1 1
outer loop
vertex 1 0 0
vertex 0 1 0
vertex 0 0 1
endloop
endfacet
endsolid t
"""


def test_the_meshes_of_the_ur3_are_found_and_read(ur3):
    visuals, warnings = read_visuals(ur3.urdf)
    assert warnings == ()
    assert [v.link for v in visuals] == [
        "base_link",
        "shoulder_link",
        "upper_arm_link",
        "forearm_link",
        "wrist_1_link",
        "wrist_2_link",
        "wrist_3_link",
    ]
    assert all(isinstance(v.shape, Triangles) for v in visuals)
    upper_arm = visuals[2].shape
    assert (
        0.3 < np.ptp(upper_arm.vertices, axis=0).max() < 0.4
    )  # a2 is 243.65 mm, joints on both ends


def test_a_mesh_used_twice_is_one(panda):
    visuals, warnings = read_visuals(panda.urdf)
    assert warnings == ()
    by_link = {v.link: v.shape for v in visuals}
    assert by_link["panda_leftfinger"] is by_link["panda_rightfinger"]
    assert sum(len(shape.faces) for shape in set(by_link.values())) <= MOST_TRIANGLES


@pytest.mark.parametrize(
    ("filename", "place"),
    [
        ("t.stl", "robot/t.stl"),
        ("meshes/t.stl", "robot/meshes/t.stl"),
        ("../t.stl", "t.stl"),
        ("package://robot/meshes/t.stl", "robot/meshes/t.stl"),
        ("package://other/t.stl", "other/t.stl"),
        ("file://{tmp}/with%20blank/t.stl", "with blank/t.stl"),
        ("{tmp}/absolute/t.stl", "absolute/t.stl"),
        ("package://described/t.stl", "ros/described/t.stl"),
        ("package://itself/meshes/t.stl", "ros/itself/meshes/t.stl"),
        ("package://installed/t.stl", "ament/share/installed/t.stl"),
    ],
)
def test_where_a_mesh_may_lie(with_mesh, tmp_path, monkeypatch, filename, place):
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path}/ros{os.pathsep}{tmp_path}/ros/itself")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path}/ament")
    (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / place).write_text(TETRAHEDRON)
    visuals, warnings = read_visuals(with_mesh(filename.format(tmp=tmp_path)))
    assert warnings == ()
    shape = visuals[0].shape
    assert isinstance(shape, Triangles)
    assert len(shape.faces) == 4
    np.testing.assert_array_equal(np.ptp(shape.vertices, axis=0), [2, 2, 2])  # the scale


@pytest.mark.parametrize(
    "filename", ["none.stl", "package://nowhere/x.dae", "http://example.org/x.stl", "", "a" * 300]
)
def test_a_mesh_that_is_missing_is_named_and_the_others_stay(with_mesh, filename):
    visuals, (warning,) = read_visuals(with_mesh(filename))
    assert warning == f"link 'a': the mesh '{filename}' was not found; a simple shape stands for it"
    assert visuals[0].shape is None
    assert visuals[1].shape == Box((0.1, 0.2, 0.3))


@pytest.mark.parametrize("content", [b"", b"no mesh", b"\x00" * 84, bytes(range(256)) * 4])
@pytest.mark.parametrize("suffix", ["stl", "dae", "obj", "xyz"])
def test_a_mesh_that_cannot_be_read_is_named(with_mesh, tmp_path, suffix, content):
    (tmp_path / f"bad.{suffix}").write_bytes(content)
    visuals, (warning,) = read_visuals(with_mesh(f"../bad.{suffix}"))
    assert warning.startswith(f"link 'a': the mesh '../bad.{suffix}' ")
    assert warning.endswith("a simple shape stands for it")
    assert visuals[0].shape is None


def test_simple_shapes_and_their_origins(with_mesh, tmp_path):
    (tmp_path / "t.stl").write_text(TETRAHEDRON)
    more = """
      <visual><origin xyz="1 2 3" rpy="0 0 1.5707963267948966"/><geometry><sphere radius="0.2"/></geometry></visual>
      <visual><origin xyz="1 2"/><geometry><cylinder radius="0.2" length="0.4"/></geometry></visual>
      <visual><geometry><capsule radius="0.2" length="0.5"/></geometry></visual>
      <visual><geometry><box size="1 0 1"/></geometry></visual>
      <visual><geometry><cylinder radius="x" length="0.4"/></geometry></visual>
      <visual><geometry><cone/></geometry></visual>
      <visual><geometry/></visual>"""
    visuals, warnings = read_visuals(with_mesh("../t.stl", more))
    shapes = [v.shape for v in visuals[1:]]
    assert shapes[:3] == [Sphere(0.2), Cylinder(0.2, 0.4), Cylinder(0.2, 0.5)]
    assert shapes[3:] == [None, None, None, Box((0.1, 0.2, 0.3))]
    assert warnings == ("a visual of link 'a' has no geometry that can be drawn",) * 3
    expected = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    np.testing.assert_allclose(visuals[1].T_link_shape, expected, atol=1e-15)
    np.testing.assert_array_equal(visuals[2].T_link_shape, np.eye(4))


def test_what_reaches_absurdly_far_is_left_out_and_named(with_mesh, tmp_path):
    (tmp_path / "t.stl").write_text(TETRAHEDRON.replace("vertex 1 0 0", "vertex 1e30 0 0"))
    more = """
      <visual><geometry><box size="1e300 1 1"/></geometry></visual>
      <visual><origin xyz="0 1e20 0"/><geometry><sphere radius="0.2"/></geometry></visual>
      <visual><origin xyz="0 1e5 0"/><geometry><cylinder radius="0.2" length="1"/></geometry></visual>"""
    visuals, warnings = read_visuals(with_mesh("../t.stl", more))
    assert [v.shape for v in visuals[:4]] == [None, None, None, Cylinder(0.2, 1.0)]
    assert warnings == (
        "link 'a': the mesh '../t.stl' reaches 2e+30 m far; a simple shape stands for it",
        "a visual of link 'a' that reaches 1e+300 m far is left out",
        "a visual of link 'a' that reaches 1e+20 m far is left out",
    )


def test_a_heavy_robot_is_simplified_and_says_so(with_mesh, tmp_path):
    n = 400
    x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
    z = 0.1 * np.sin(20 * x) * np.cos(20 * y)
    lines = [f"v {a:.6f} {b:.6f} {c:.6f}" for a, b, c in zip(x.flat, y.flat, z.flat, strict=True)]
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel() + 1
    lines += [f"f {k} {k + n} {k + n + 1}\nf {k} {k + n + 1} {k + 1}" for k in i]
    (tmp_path / "fine.obj").write_text("\n".join(lines))
    visuals, (warning,) = read_visuals(with_mesh("../fine.obj"))
    assert warning.startswith("mesh '../fine.obj' is drawn simplified to ")
    assert warning.endswith(" mm")
    assert 10_000 < len(visuals[0].shape.faces) <= MOST_TRIANGLES


def test_folders_are_listed_once_and_start_with_the_urdf_s_own(with_mesh, tmp_path):
    urdf = with_mesh("x.stl")
    folders = mesh_folders(urdf)
    assert folders[0] == Path(os.path.realpath(tmp_path)) / "robot"
    assert len(set(folders)) == len(folders)
    assert any((folder / "example-robot-data" / "robots").is_dir() for folder in folders)


def test_a_moved_urdf_loses_its_meshes_and_nothing_else(with_mesh, tmp_path):
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "t.stl").write_text(TETRAHEDRON)
    urdf = with_mesh("t.stl")
    assert read_visuals(urdf)[1] == ()
    shutil.move(tmp_path / "robot" / "t.stl", tmp_path / "gone.stl")
    assert len(read_visuals(urdf)[1]) == 1


def test_a_mesh_is_read_again_when_its_file_changed(with_mesh, tmp_path):
    (tmp_path / "t.stl").write_text(TETRAHEDRON)
    urdf = with_mesh("../t.stl")
    before = read_visuals(urdf)[0][0].shape
    assert read_visuals(with_mesh("../t.stl"))[0][0].shape is before
    (tmp_path / "t.stl").write_text(TETRAHEDRON.replace("vertex 1 0 0", "vertex 3 0 0"))
    after = read_visuals(urdf)[0][0].shape
    assert after is not before
    np.testing.assert_array_equal(np.ptp(after.vertices, axis=0), [6, 2, 2])


def test_a_correction_changes_no_visual(ur3, disturb, tmp_path):
    corrected = disturb(ur3).urdf
    assert corrected != ur3.urdf
    assert same_visuals(ur3.urdf, corrected)
    text = ur3.urdf.data.decode()
    (tmp_path / "same.urdf").write_text(text)
    (tmp_path / "other.urdf").write_text(text.replace("visual/base.dae", "visual/wrist1.dae"))
    same, other = (Urdf.read(tmp_path / f"{name}.urdf") for name in ("same", "other"))
    assert not same_visuals(same, other)
    assert not same_visuals(ur3.urdf, same)  # in another folder other meshes may be found
