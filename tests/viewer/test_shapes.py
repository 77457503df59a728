"""What links look like: meshes found, read, shaded and kept small."""

from __future__ import annotations

import os

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from calib.robot.meshes import mesh_folders
from calib.robot.robot import Robot, rigid_inverse
from calib.robot.urdf import Urdf
from calib.viewer import shapes
from calib.viewer.page import puppets
from calib.viewer.shapes import (
    MOST_TRIANGLES,
    Box,
    Cylinder,
    Puppet,
    Sphere,
    Triangles,
    clustered,
    packed,
    read_visuals,
    rod_between,
    root_poses,
    same_visuals,
    shaded,
    stage_poses,
)
from calib.viewer.view import View, translated

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


def test_a_heavy_robot_is_simplified_and_says_so(with_mesh, tmp_path, monkeypatch):
    monkeypatch.setattr(shapes, "MOST_TRIANGLES", 10_000)
    n = 80
    x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
    z = 0.1 * np.sin(20 * x) * np.cos(20 * y)
    lines = [f"v {a:.6f} {b:.6f} {c:.6f}" for a, b, c in zip(x.flat, y.flat, z.flat, strict=True)]
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel() + 1
    lines += [f"f {k} {k + n} {k + n + 1}\nf {k} {k + n + 1} {k + 1}" for k in i]
    (tmp_path / "fine.obj").write_text("\n".join(lines))
    visuals, (warning,) = read_visuals(with_mesh("../fine.obj"))
    assert warning.startswith("mesh '../fine.obj' is drawn simplified to ")
    assert warning.endswith(" mm")
    assert 3_000 < len(visuals[0].shape.faces) <= 10_000


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


def test_a_fan_with_very_many_faces_has_unit_normals():
    vertices, _ = cylinder(2000)
    top = np.concatenate([vertices[2000:], [[0, 0, 1]]])
    i = np.arange(2000)
    mesh = shaded(top, np.stack([i, (i + 1) % 2000, 0 * i + 2000], 1))
    np.testing.assert_array_equal(mesh.normals, np.tile([0, 0, 127], (len(mesh.normals), 1)))


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


Q = {
    "ur3": [0.3, -1.2, 0.8, -0.5, 1.1, 2.0],
    "panda": [0.3, -0.5, 0.2, -2.0, 0.1, 1.8, 0.6],
    "gantry": [0.4, -0.3, 2.5],
    "head_and_arm": [0.3, -0.5, 0.2, -1.0, 0.1, 1.8, 0.6, -0.4, 0.7],
}


def link_poses(robot: Robot, q) -> dict[str, np.ndarray]:
    """T_base_link of every link."""
    at = root_poses(robot, np.array(q)[None])
    return {link: rigid_inverse(at[robot.base][0]) @ T[0] for link, T in at.items()}


def alone(robot: Robot, q) -> Puppet:
    """One robot in its base."""
    q = np.atleast_2d(q)
    eye = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    return Puppet.of(robot, q, read_visuals(robot.urdf)[0], eye, np.eye(4))


def puppets_of(view: View):
    return puppets(view, {who: read_visuals(robot.urdf)[0] for who, robot in view.robots.items()})


@pytest.mark.parametrize("name", Q)
@pytest.mark.parametrize("corrected", [False, True])
def test_the_tip_is_where_the_robot_says(request, disturb, name, corrected):
    robot = request.getfixturevalue(name)
    shown = disturb(robot) if corrected else robot
    poses = link_poses(shown, Q[name])
    np.testing.assert_allclose(poses[robot.tip], shown.poses(Q[name])[0], rtol=0, atol=1e-9)
    assert list(poses) == list(robot.urdf.links)
    moved = np.abs(poses[robot.tip] - robot.poses(Q[name])[0]).max()
    assert (moved > 1e-4) == corrected


def test_followers_and_held_joints_are_drawn_where_they_are(fingers):
    poses = link_poses(fingers, [0.03])
    np.testing.assert_allclose(poses["panda_rightfinger"], fingers.poses([0.03])[0], atol=1e-12)
    # The other finger is the driver itself, and no link of the chain.
    left = Robot.load("panda", "panda_hand", "panda_leftfinger")
    np.testing.assert_allclose(poses["panda_leftfinger"], left.poses([0.03])[0], atol=1e-12)
    held = Robot.load("panda", "panda_link0", "panda_link8", held={"panda_finger_joint1": 0.02})
    poses = link_poses(held, np.full(7, 0.3))
    gap = poses["panda_leftfinger"][:3, 3] - poses["panda_rightfinger"][:3, 3]
    assert np.linalg.norm(gap) == pytest.approx(0.04)


def test_visuals_stand_where_pinocchio_puts_them(panda):
    text = panda.urdf.data.decode()
    model = pin.buildModelFromXML(text)
    folders = [str(folder) for folder in mesh_folders(panda.urdf)]
    geometry = pin.buildGeomFromUrdfString(
        model, text, pin.GeometryType.VISUAL, package_dirs=folders
    )
    placed = geometry.createData()
    configuration = pin.neutral(model)
    configuration[:7] = Q["panda"]
    pin.updateGeometryPlacements(model, model.createData(), geometry, placed, configuration)
    puppet = alone(panda, Q["panda"])
    names = [f"{puppet.links[part.mover]}_0" for part in puppet.parts]
    assert names == [o.name for o in geometry.geometryObjects]
    for part, T in zip(puppet.parts, placed.oMg, strict=True):
        at = puppet.poses[0, part.mover] @ part.T_mover_shape
        np.testing.assert_allclose(at, T.homogeneous, atol=1e-12)


def test_a_robot_without_visuals_is_a_stick_figure_that_follows_sliding_joints(gantry):
    puppet = alone(gantry, [[0.0, 0.0, 0.0], [1.5, 0.0, 0.0]])
    assert puppet.links == tuple(gantry.urdf.links)
    assert all(isinstance(part.shape, Sphere) for part in puppet.parts)
    joints = {(j.parent, j.child) for j in gantry.urdf.joints}
    assert {(puppet.links[a], puppet.links[b]) for a, b in puppet.rods} == joints
    at = [puppet.links.index(link) for link in ("rail", "bridge")]
    lengths = [np.linalg.norm(np.subtract(*puppet.poses[n, at, :3, 3])) for n in (0, 1)]
    np.testing.assert_allclose(lengths, [0.5, np.hypot(0.5, 1.5)])


def test_a_missing_mesh_is_a_stick_and_the_rest_is_not(with_mesh):
    puppet = alone(Robot.from_urdf(with_mesh("gone.stl")), [0.0])
    assert [type(part.shape).__name__ for part in puppet.parts] == ["Box", "Sphere"]
    assert [tuple(puppet.links[k] for k in rod) for rod in puppet.rods] == [("a", "b")]


@pytest.mark.parametrize("name", ["ur3", "gantry", "fingers"])
def test_every_shape_is_where_the_robot_s_forward_kinematics_put_it(request, disturb, name):
    robot = request.getfixturevalue(name)
    other = disturb(robot)
    rng = np.random.default_rng(2)
    q = rng.uniform(-0.5, 0.5, (2, len(robot.joint_names)))
    shift = translated([0.01, -0.02, 0.03])
    view = View(robot, other, q, T_base_nominal=shift, nominal_target=translated([0, 0.1, 0.2]))
    shown = puppets_of(view)
    for who, one, T_stage_base in (("nominal", robot, shift), ("calibrated", other, np.eye(4))):
        puppet = shown[who]
        for n in range(2):
            poses = link_poses(one, q[n])
            for k, link in enumerate(puppet.links):
                wanted = T_stage_base @ poses[link]
                np.testing.assert_allclose(puppet.poses[n, k], wanted, atol=1e-12)
            tip = T_stage_base @ one.poses(q[n])[0]
            np.testing.assert_allclose(puppet.poses[n, -2], tip, atol=1e-12)
            np.testing.assert_allclose(puppet.poses[n, -3], T_stage_base, atol=1e-12)
    wanted = (shift @ robot.poses(q) @ view.nominal_target)[:, :3, 3]
    np.testing.assert_allclose(shown["nominal"].targets, wanted, atol=1e-12)


def test_a_robot_whose_base_moves_stands_on_its_root(head_and_arm, disturb):
    """A camera on the head looks at the arm: the picture stands still, and the head moves."""
    q = np.array([[-0.6, 0.4, 0.2, -1.0, 0.1, 1.8, 0.6, -0.4, 0.7], [0.4, -0.5, *[0.1] * 7]])
    on_stage = stage_poses(head_and_arm, q)
    camera = Robot.load("tiago_no_hand", "base_footprint", head_and_arm.base)
    for n in range(2):
        values = dict(zip(head_and_arm.joint_names, q[n], strict=True))
        at_head = [values.get(name, 0.0) for name in camera.joint_names]
        np.testing.assert_allclose(on_stage[n], camera.poses(at_head)[0], atol=1e-9)
    puppet = puppets_of(View(head_and_arm, disturb(head_and_arm), q))["nominal"]
    legs, camera = puppet.links.index("base_link"), -3
    np.testing.assert_allclose(puppet.poses[0, legs], puppet.poses[1, legs], atol=1e-9)
    assert np.abs(puppet.poses[0, camera] - puppet.poses[1, camera]).max() > 0.1


def test_outline_and_reach_hold_every_shape(ur3):
    puppet = alone(ur3, np.random.default_rng(5).uniform(-2, 2, (5, 6)))
    reach = puppet.reach()
    for n in range(5):
        outline, every = puppet.outline(n), [reach]
        for part in puppet.parts:
            assert isinstance(part.shape, Triangles)
            T = puppet.poses[n, part.mover] @ part.T_mover_shape
            every.append(part.shape.vertices @ T[:3, :3].T + T[:3, 3])
        drawn = np.concatenate(every[1:])
        assert np.all(drawn.min(axis=0) >= reach.min(axis=0) - 1e-6)
        assert np.all(drawn.max(axis=0) <= reach.max(axis=0) + 1e-6)
        # The outline is known to some millimetres: its points are the outermost in 26 directions of the link.
        assert np.abs(np.ptp(drawn, axis=0) - np.ptp(outline, axis=0)).max() < 0.02


def test_packed_poses_are_the_poses():
    turns = Rotation.random(6, random_state=3)
    T = np.tile(np.eye(4), (2, 3, 1, 1))
    T[..., :3, :3] = turns.as_matrix().reshape(2, 3, 3, 3)
    T[..., :3, 3] = np.arange(18).reshape(2, 3, 3)
    values = packed(T)
    assert values.shape == (2, 3, 7)
    assert values.dtype == np.float32
    back = Rotation.from_quat(values[..., 3:].reshape(-1, 4)).as_matrix().reshape(2, 3, 3, 3)
    np.testing.assert_allclose(back, T[..., :3, :3], atol=1e-6)
    np.testing.assert_array_equal(values[..., :3], T[..., :3, 3])


@pytest.mark.parametrize("end", [[0, 0, 2.0], [0, 0, -2.0], [1.0, -2.0, 0.5]])
def test_a_rod_lies_between_its_ends(end):
    start, end = np.array([0.3, 0.1, -0.2]), np.array(end)
    T, length = rod_between(start, end)
    half = np.array([0, 0, 0.5 * length, 1])
    np.testing.assert_allclose((T @ half)[:3], end, atol=1e-12)
    np.testing.assert_allclose((T @ (half * [1, 1, -1, 1]))[:3], start, atol=1e-12)
    assert rod_between(start, start)[1] == 0
