"""What moves, and where it is at each pose."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.model.robot import Robot
from calib.show.bodies import bodies, link_poses
from calib.show.puppet import packed, puppets, rod_between, stage_poses
from calib.show.view import View, translated
from calib.show.visuals import read_visuals


def puppets_of(view: View):
    return puppets(view, {who: read_visuals(robot.urdf)[0] for who, robot in view.robots.items()})


@pytest.mark.parametrize("name", ["ur3", "gantry", "fingers"])
def test_every_shape_is_where_the_robot_s_forward_kinematics_put_it(request, disturb, name):
    robot = request.getfixturevalue(name)
    other = disturb(robot)
    rng = np.random.default_rng(2)
    q = rng.uniform(-0.5, 0.5, (4, len(robot.joint_names)))
    shift = translated([0.01, -0.02, 0.03])
    view = View(robot, other, q, T_base_nominal=shift, nominal_target=translated([0, 0.1, 0.2]))
    shown = puppets_of(view)
    for who, one, T_stage_base in (("nominal", robot, shift), ("calibrated", other, np.eye(4))):
        puppet = shown[who]
        for n in range(4):
            poses = link_poses(one, q[n])
            for k, link in enumerate(puppet.links):
                wanted = T_stage_base @ poses[link]
                np.testing.assert_allclose(puppet.poses[n, k], wanted, atol=1e-12)
            tip = T_stage_base @ one.poses(q[n])[0]
            np.testing.assert_allclose(puppet.poses[n, -2], tip, atol=1e-12)
            np.testing.assert_allclose(puppet.poses[n, -3], T_stage_base, atol=1e-12)
    wanted = (shift @ robot.poses(q) @ view.nominal_target)[:, :3, 3]
    np.testing.assert_allclose(shown["nominal"].targets, wanted, atol=1e-12)


def test_a_puppet_with_meshes_has_the_shapes_of_the_robot(ur3):
    q = np.full((1, 6), 0.4)
    visuals = read_visuals(ur3.urdf)[0]
    (puppet,) = puppets(View(ur3, None, q), {"nominal": visuals}).values()
    assert puppet.rods == ()
    for mine, theirs in zip(puppet.bodies(0), bodies(ur3, q[0], visuals), strict=True):
        np.testing.assert_allclose(mine.T_base_shape, theirs.T_base_shape, atol=1e-12)
        assert mine.shape is theirs.shape


def test_the_rods_of_a_stick_figure_follow_sliding_joints(gantry):
    q = np.array([[0.0, 0.0, 0.0], [1.5, 0.0, 0.0]])
    (puppet,) = puppets_of(View(gantry, None, q)).values()
    joints = {(j.parent, j.child) for j in gantry.urdf.joints}
    assert {(puppet.links[a], puppet.links[b]) for a, b in puppet.rods} == joints
    at = [puppet.links.index(link) for link in ("rail", "bridge")]
    lengths = [np.linalg.norm(np.subtract(*puppet.poses[n, at, :3, 3])) for n in (0, 1)]
    np.testing.assert_allclose(lengths, [0.5, np.hypot(0.5, 1.5)])
    drawn = [b.shape.length for b in puppet.bodies(1) if hasattr(b.shape, "length")]
    assert np.min(np.abs(np.array(drawn) - np.hypot(0.5, 1.5))) < 1e-9


def test_a_robot_whose_base_moves_stands_on_its_root(head_and_arm, disturb):
    """A camera on the head looks at the arm: the picture stands still, and the head moves."""
    q = np.array([[-0.6, 0.4, 0.2, -1.0, 0.1, 1.8, 0.6, -0.4, 0.7], [0.4, -0.5, *[0.1] * 7]])
    view = View(head_and_arm, disturb(head_and_arm), q)
    on_stage = stage_poses(view)
    camera = Robot.load("tiago_no_hand", "base_footprint", head_and_arm.base)
    for n in range(2):
        values = dict(zip(head_and_arm.joint_names, q[n], strict=True))
        at_head = [values.get(name, 0.0) for name in camera.joint_names]
        T_root_base = camera.poses(at_head)[0]
        np.testing.assert_allclose(on_stage[n], T_root_base, atol=1e-9)
    puppet = puppets_of(view)["nominal"]
    legs, camera = puppet.links.index("base_link"), -3
    np.testing.assert_allclose(puppet.poses[0, legs], puppet.poses[1, legs], atol=1e-9)
    assert np.abs(puppet.poses[0, camera] - puppet.poses[1, camera]).max() > 0.1


def test_the_reach_holds_every_shape_at_every_pose(ur3):
    rng = np.random.default_rng(5)
    view = View(ur3, None, rng.uniform(-2, 2, (5, 6)))
    (puppet,) = puppets_of(view).values()
    reach = puppet.reach()
    low, high = reach.min(axis=0) - 1e-9, reach.max(axis=0) + 1e-9
    for n in range(5):
        for body in puppet.bodies(n):
            points = body.outline()
            assert np.all((points >= low) & (points <= high))
    # It is no larger than the boxes about the links: less than a link away from what is drawn.
    drawn = np.concatenate([b.outline() for n in range(5) for b in puppet.bodies(n)])
    assert np.all(drawn.min(axis=0) - low < 0.2)
    assert np.all(high - drawn.max(axis=0) < 0.2)


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
