"""Shapes of robots are read and placed where their URDF and forward kinematics put them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import trimesh

from calib.basics.arrays import rigid_inverse
from calib.robot.meshes import mesh_folders
from calib.robot.robot import Robot
from calib.show.scene.posed_robot import (
    PosedRobot,
    _box_corners,
    creased,
    read_visuals,
    root_poses,
    translation,
)
from calib.verbs.view.robots_page import pose_robots
from calib.verbs.view.view import View
from tests.view_fixtures import registered

#: The corners of a unit cube and its twelve triangles.
CUBE = np.array(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij")).reshape(3, -1).T.astype(float)
CUBE_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip


def obj(vertices, faces) -> str:
    lines = ["v {:.6f} {:.6f} {:.6f}".format(*v) for v in vertices]
    return "\n".join(lines + ["f {} {} {}".format(*f) for f in np.asarray(faces) + 1])


def test_meshes_that_are_missing_or_empty(with_mesh, tmp_path):
    urdf, file = with_mesh("../m.obj"), tmp_path / "m.obj"
    visuals, (warning,) = read_visuals(urdf)
    assert warning == "link 'a': the mesh '../m.obj' was not found; a simple shape stands for it"
    assert visuals[0].mesh is None
    assert len(visuals[1].mesh[1]) == 12  # a box
    file.write_text("no mesh")
    visuals, (warning,) = read_visuals(urdf)
    assert visuals[0].mesh is None
    assert warning.endswith("; a simple shape stands for it")
    file = tmp_path / "found.obj"
    file.write_text(obj(CUBE, CUBE_FACES))
    visuals, warnings = read_visuals(with_mesh("../found.obj"))
    assert warnings == ()
    np.testing.assert_array_equal(np.ptp(visuals[0].mesh[0], axis=0), 2)  # the scale


def test_simple_shapes_and_their_origins(with_mesh, tmp_path):
    (tmp_path / "t.obj").write_text(obj(CUBE, CUBE_FACES))
    more = """
      <visual><origin xyz="1 2 3" rpy="0 0 1.5707963267948966"/><geometry><sphere radius="0.2"/></geometry></visual>
      <visual><geometry><cylinder radius="0.2" length="0.5"/></geometry></visual>
      <visual><geometry><capsule radius="0.2" length="0.5"/></geometry></visual>
      <visual><geometry><box size="1 0 1"/></geometry></visual>
      <visual><geometry><cone/></geometry></visual>"""
    visuals, warnings = read_visuals(with_mesh("../t.obj", more))
    meshes = [v.mesh for v in visuals[1:]]
    sizes = [None if mesh is None else np.ptp(mesh[0], axis=0) for mesh in meshes]
    for size, expected in zip(
        sizes[:3], [[0.4] * 3, [0.4, 0.4, 0.5], [0.4, 0.4, 0.5]], strict=True
    ):
        np.testing.assert_allclose(size, expected, rtol=1e-3)
    assert sizes[3:5] == [None, None]
    assert warnings == ("link 'a': a visual has no geometry that can be drawn",)
    T_expected = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    np.testing.assert_allclose(visuals[1].T_link_shape, T_expected, atol=1e-15)


def test_vertices_are_doubled_on_edges_only():
    vertices, faces = creased(CUBE, CUBE_FACES)
    assert len(vertices) == 24  # each corner once for each of its three sides
    np.testing.assert_array_equal(vertices[faces], CUBE[CUBE_FACES])
    ball = trimesh.creation.icosphere(3)
    assert len(creased(ball.vertices, ball.faces)[0]) == len(ball.vertices)  # it has no crease


PANDA = [0.3, -0.5, 0.2, -2.0, 0.1, 1.8, 0.6]


def link_poses(robot: Robot, q) -> dict[str, np.ndarray]:
    """T_base_link of every link."""
    at = root_poses(robot, np.array(q)[None])
    return {link: rigid_inverse(at[robot.base][0]) @ T[0] for link, T in at.items()}


def alone(robot: Robot, q) -> PosedRobot:
    """One robot in its base."""
    q = np.atleast_2d(q)
    eye = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    return PosedRobot.of(robot, q, read_visuals(robot.urdf)[0], eye, np.eye(4))


def test_visuals_stand_where_pinocchio_puts_them(panda_with_hand):
    text = panda_with_hand.urdf.data.decode()
    model = pin.buildModelFromXML(text)
    folders = [str(folder) for folder in mesh_folders(panda_with_hand.urdf)]
    geometry = pin.buildGeomFromUrdfString(
        model, text, pin.GeometryType.VISUAL, package_dirs=folders
    )
    placed = geometry.createData()
    configuration = pin.neutral(model)
    configuration[:7] = PANDA
    pin.updateGeometryPlacements(model, model.createData(), geometry, placed, configuration)
    posed = alone(panda_with_hand, PANDA)
    names = [f"{posed.links[mover]}_0" for mover, _, _ in posed.parts]
    assert names == [o.name for o in geometry.geometryObjects]
    for (mover, _, T_mover_shape), T in zip(posed.parts, placed.oMg, strict=True):
        at = posed.poses[0, mover] @ T_mover_shape
        np.testing.assert_allclose(at, T.homogeneous, atol=1e-12)


def test_links_without_shapes_are_sticks(gantry, with_mesh):
    posed = alone(gantry, [[0.0, 0.0, 0.0], [1.5, 0.0, 0.0]])
    assert posed.links == tuple(gantry.urdf.links)
    joints = {(j.parent, j.child) for j in gantry.urdf.joints}
    assert {(posed.links[a], posed.links[b]) for a, b in posed.rods} == joints
    at = [posed.links.index(link) for link in ("rail", "bridge")]
    lengths = [np.linalg.norm(np.subtract(*posed.poses[n, at, :3, 3])) for n in (0, 1)]
    np.testing.assert_allclose(lengths, [0.5, np.hypot(0.5, 1.5)])
    posed = alone(Robot.from_urdf(with_mesh("gone.stl")), [0.0])
    assert len(posed.parts) == 1  # the box
    assert [tuple(posed.links[k] for k in rod) for rod in posed.rods] == [("a", "b")]


@pytest.mark.parametrize("fixture", ["gantry", "fingers"])
def test_every_mover_is_where_the_robot_s_forward_kinematics_put_it(request, disturb, fixture):
    robot = request.getfixturevalue(fixture)
    disturbed = disturb(robot)
    q = np.random.default_rng(2).uniform(-0.5, 0.5, (2, len(robot.joint_names)))
    shift = translation([0.01, -0.02, 0.03])
    view = View(robot, disturbed, q, nominal_target=translation([0, 0.1, 0.2]))
    view = registered(view, shift)
    shown = pose_robots(
        view, {name: read_visuals(arm.urdf)[0] for name, arm in view.robots.items()}
    )
    for name, arm in (("nominal", robot), ("calibrated", disturbed)):  # each at its own base
        posed = shown[name]
        for n in range(2):
            poses, tip = link_poses(arm, q[n]), arm.poses(q[n])[0]
            expected = [*(poses[k] for k in posed.links), np.eye(4), tip]
            np.testing.assert_allclose(posed.poses[n, :-1], expected, atol=1e-12)
        base = shift[:3, 3] if name == "nominal" else np.zeros(3)  # as registered
        np.testing.assert_allclose(
            posed.poses[:, -1, :3, 3] + base, view.predicted[int(name != "nominal")], atol=1e-12
        )


def test_corners_enclose_a_mesh():
    vertices = np.array([[0.1, 0.2, 0.3], [0.5, -0.2, 0.4], [0.2, 0.0, 0.9]])
    corners = _box_corners(vertices)
    np.testing.assert_allclose(corners.min(axis=0), [0.1, -0.2, 0.3, 1.0])
    np.testing.assert_allclose(corners.max(axis=0), [0.5, 0.2, 0.9, 1.0])
    assert len(np.unique(corners, axis=0)) == 8
