"""What links look like: meshes found, read, shaded and kept small."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from calib.model.meshes import mesh_folders
from calib.model.urdf import Urdf
from calib.show.shapes import (
    MOST_TRIANGLES,
    Box,
    Cylinder,
    Sphere,
    Triangles,
    clustered,
    read_visuals,
    same_visuals,
    shaded,
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
    "filename", ["none.stl", "package://nowhere/x.dae", "http://example.org/x.stl", ""]
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
    assert warnings == ("a visual of link 'a' has no geometry that can be drawn",)
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
    assert len(warnings) == 3
    assert warnings[0].startswith("link 'a': the mesh '../t.stl' reaches 2e+30 m far")


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


CUBE = np.array(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij")).reshape(3, -1).T.astype(float)
CUBE_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip


def cylinder(sides: int) -> tuple[np.ndarray, np.ndarray]:
    """The side wall of a cylinder about z, its faces outward."""
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    i = np.arange(sides)
    j = (i + 1) % sides
    faces = np.concatenate([np.stack([i, j, j + sides], 1), np.stack([i, j + sides, i + sides], 1)])
    return np.concatenate([ring, ring + np.array([0, 0, 1])]), faces


def test_a_cube_keeps_its_edges():
    mesh = shaded(CUBE, CUBE_FACES)
    assert len(mesh.vertices) == 24  # each corner once for each of its three faces
    assert len(mesh.faces) == 12
    # The normals are those of the faces, outward.
    corners = mesh.vertices[mesh.faces].astype(float)
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    for k in range(3):
        np.testing.assert_array_equal(mesh.normals[mesh.faces[:, k]], 127 * flat)
    outward = np.einsum("ij,ij->i", mesh.vertices - 0.5, mesh.normals)
    assert (outward > 0).all()


def test_a_fine_cylinder_is_smooth_and_a_coarse_one_is_not():
    vertices, faces = cylinder(36)
    smooth = shaded(vertices, faces)
    assert len(smooth.vertices) == 72
    radial = smooth.vertices * [1, 1, 0]
    np.testing.assert_allclose(smooth.normals / 127.0, radial, atol=0.02)
    assert len(shaded(*cylinder(6)).vertices) == 24  # turned by 60 deg: every corner twice


def test_equal_vertices_are_welded_and_slivers_left_out():
    soup = CUBE[CUBE_FACES].reshape(-1, 3)
    faces = np.arange(36).reshape(-1, 3)
    extra = np.array([[0, 0, 1], [0, 1, 1]])
    mesh = shaded(soup, np.concatenate([faces, extra]))
    reference = shaded(CUBE, CUBE_FACES)
    assert len(mesh.vertices) == 24
    assert len(mesh.faces) == len(reference.faces)


def test_a_fan_with_very_many_faces_has_unit_normals():
    vertices, _ = cylinder(2000)
    top = np.concatenate([vertices[2000:], [[0, 0, 1]]])
    i = np.arange(2000)
    mesh = shaded(top, np.stack([i, (i + 1) % 2000, 0 * i + 2000], 1))
    np.testing.assert_array_equal(mesh.normals, np.tile([0, 0, 127], (len(mesh.normals), 1)))


def test_large_meshes_have_wide_indices():
    n = 200
    x, y = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    vertices = np.stack([x, y, np.sin(x) * 20 + np.cos(y) * 20], -1).reshape(-1, 3).astype(float)
    i = (x[:-1, :-1] * n + y[:-1, :-1]).ravel()
    faces = np.concatenate([np.stack([i, i + n, i + n + 1], 1), np.stack([i, i + n + 1, i + 1], 1)])
    mesh = shaded(vertices, faces)
    assert len(mesh.vertices) > 65536
    assert mesh.faces.dtype == np.uint32
    assert mesh.faces.max() == len(mesh.vertices) - 1
    assert shaded(CUBE, CUBE_FACES).faces.dtype == np.uint16


@settings(max_examples=30, deadline=None)
@given(most=st.integers(60, 700), seed=st.integers(0, 99))
def test_clustering_moves_no_vertex_farther_than_it_says(most, seed):
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(400, 3))
    vertices = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    faces = ConvexHull(vertices).simplices.astype(np.int64)
    assert len(faces) > 700
    fewer, merged, cell = clustered(vertices, faces, most)
    assert cell > 0
    assert 0 < len(merged) <= most
    distance = np.linalg.norm(vertices[:, None] - fewer[None], axis=2).min(axis=1)
    assert distance.max() <= np.sqrt(3) * cell * (1 + 1e-9)


def test_a_small_mesh_is_left_alone():
    vertices, faces, cell = clustered(CUBE, CUBE_FACES, 12)
    assert cell == 0
    assert vertices is CUBE
    assert faces is CUBE_FACES


def test_faces_without_area_leave_nothing():
    line = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    assert shaded(line, np.array([[0, 1, 2]])) is None
