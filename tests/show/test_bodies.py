import numpy as np
import pinocchio as pin
import pytest

from calib.model.meshes import mesh_folders
from calib.model.robot import Robot
from calib.show.bodies import bodies, link_poses, rod_pose
from calib.show.triangles import Triangles
from calib.show.visuals import Cylinder, Sphere, read_visuals

Q = {
    "ur3": [0.3, -1.2, 0.8, -0.5, 1.1, 2.0],
    "panda": [0.3, -0.5, 0.2, -2.0, 0.1, 1.8, 0.6],
    "gantry": [0.4, -0.3, 2.5],
    "head_and_arm": [0.3, -0.5, 0.2, -1.0, 0.1, 1.8, 0.6, -0.4, 0.7],
}


@pytest.mark.parametrize("name", Q)
@pytest.mark.parametrize("corrected", [False, True])
def test_the_tip_is_where_the_robot_says(request, disturb, name, corrected):
    robot = request.getfixturevalue(name)
    shown = disturb(robot) if corrected else robot
    q = np.array(Q[name])
    poses = link_poses(shown, q)
    np.testing.assert_allclose(poses[robot.tip], shown.poses(q)[0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(poses[robot.base], np.eye(4), atol=1e-15)
    assert list(poses) == list(robot.urdf.links)
    moved = np.abs(poses[robot.tip] - robot.poses(q)[0]).max()
    assert (moved > 1e-4) == corrected


def test_followers_and_held_joints_are_drawn_where_they_are(fingers):
    poses = link_poses(fingers, np.array([0.03]))
    np.testing.assert_allclose(poses["panda_rightfinger"], fingers.poses([0.03])[0], atol=1e-12)
    # The other finger is the driver itself, and no link of the chain.
    left = Robot.load("panda", "panda_hand", "panda_leftfinger")
    np.testing.assert_allclose(poses["panda_leftfinger"], left.poses([0.03])[0], atol=1e-12)
    held = Robot.load("panda", "panda_link0", "panda_link8", held={"panda_finger_joint1": 0.02})
    poses = link_poses(held, np.full(7, 0.3))
    gap = poses["panda_leftfinger"][:3, 3] - poses["panda_rightfinger"][:3, 3]
    assert np.linalg.norm(gap) == pytest.approx(0.04)


def test_visuals_stand_where_pinocchio_puts_them(panda):
    q = np.array(Q["panda"])
    text = panda.urdf.data.decode()
    model = pin.buildModelFromXML(text)
    folders = [str(folder) for folder in mesh_folders(panda.urdf)]
    geometry = pin.buildGeomFromUrdfString(
        model, text, pin.GeometryType.VISUAL, package_dirs=folders
    )
    placed = geometry.createData()
    configuration = pin.neutral(model)
    configuration[: len(q)] = q
    pin.updateGeometryPlacements(model, model.createData(), geometry, placed, configuration)
    drawn = bodies(panda, q, read_visuals(panda.urdf)[0])
    assert [f"{body.link}_0" for body in drawn] == [o.name for o in geometry.geometryObjects]
    for body, T in zip(drawn, placed.oMg, strict=True):
        np.testing.assert_allclose(body.T_base_shape, T.homogeneous, atol=1e-12)


def test_a_robot_without_visuals_is_a_stick_figure(gantry):
    q = np.array(Q["gantry"])
    drawn = bodies(gantry, q, ())
    balls = [body for body in drawn if isinstance(body.shape, Sphere)]
    rods = [body for body in drawn if isinstance(body.shape, Cylinder)]
    assert [ball.link for ball in balls] == list(gantry.urdf.links)
    assert len(rods) == len(gantry.urdf.joints)
    poses = link_poses(gantry, q)
    for joint, rod in zip(gantry.urdf.joints, rods, strict=True):
        start, end = poses[joint.parent][:3, 3], poses[joint.child][:3, 3]
        half = 0.5 * rod.shape.length * rod.T_base_shape[:3, 2]
        np.testing.assert_allclose(rod.T_base_shape[:3, 3] - half, start, atol=1e-12)
        np.testing.assert_allclose(rod.T_base_shape[:3, 3] + half, end, atol=1e-12)


def test_a_missing_mesh_is_a_stick_and_the_rest_is_not(with_mesh):
    urdf = with_mesh("gone.stl")
    drawn = bodies(Robot.from_urdf(urdf), np.zeros(1), read_visuals(urdf)[0])
    assert [type(body.shape).__name__ for body in drawn] == ["Box", "Sphere", "Cylinder"]
    assert drawn[2].shape.length == 1.0


@pytest.mark.parametrize("end", [[0, 0, 2], [0, 0, -2], [1, 0, 0], [0.3, -4, 1]])
def test_a_rod_points_from_one_point_to_the_other(end):
    start, end = np.array([1.0, 2.0, 3.0]), np.array([1.0, 2.0, 3.0]) + end
    T = rod_pose(start, end)
    np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-15)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
    along = np.linalg.norm(end - start) * T[:3, 2]
    np.testing.assert_allclose(along, end - start, atol=1e-12)


def test_the_outline_holds_the_shape(ur3):
    for body in bodies(ur3, np.array(Q["ur3"]), read_visuals(ur3.urdf)[0]):
        assert isinstance(body.shape, Triangles)
        R, p = body.T_base_shape[:3, :3], body.T_base_shape[:3, 3]
        everything = body.shape.vertices @ R.T + p
        low, high = body.outline().min(axis=0), body.outline().max(axis=0)
        np.testing.assert_allclose(low, everything.min(axis=0), atol=1e-6)
        np.testing.assert_allclose(high, everything.max(axis=0), atol=1e-6)
