"""What moves, and where it is at each pose."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from calib.model.meshes import mesh_folders
from calib.model.robot import Robot, rigid_inverse
from calib.show.puppet import Puppet, packed, rod_between, root_poses, stage_poses
from calib.show.robots_page import puppets
from calib.show.shapes import Sphere, Triangles, read_visuals
from calib.show.view import View, translated

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
