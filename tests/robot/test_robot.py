from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib.basics.units import Angle, Length
from calib.errors import ModelError, UrdfError
from calib.robot.readback import check_written
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from tests.robot.shared import (
    SOME_AND_SLOWLY_ALL,
    by_pinocchio,
    displaced,
    joint,
    random_q,
    urdf_of,
)


def load(links: str, *joints: str, tip: str | None = None, **options) -> Robot:
    return Robot.from_urdf(urdf_of(links, *joints), tip=tip, **options)


# Finding and loading


def test_the_name_ur3_gives_the_ur3_not_a_ur5():
    robot = Robot.load("ur3")
    lengths = [np.linalg.norm(T[:3, 3]) for T in robot.placements]
    np.testing.assert_allclose(lengths[0], 0.1519, atol=1e-12)
    np.testing.assert_allclose(lengths[2], np.hypot(0.24365, 0.0925), atol=1e-12)
    np.testing.assert_allclose(lengths[3], 0.21325, atol=1e-12)
    assert (robot.name, robot.base, robot.tip) == ("ur3", "world", "tool0")


def test_an_unknown_name_lists_the_known():
    with pytest.raises(UrdfError, match=r"'urr3' is neither a file .*similar names.*'ur3'"):
        Robot.load("urr3")


@pytest.mark.parametrize(
    ("name", "similar"),
    [
        ("ur9e", ""),
        ("ur4", ""),
        ("iiwa7", ""),
        ("talos", "'talos_full_v2'"),
        ("panda_arm", "'panda')"),
        ("pnada", "'panda'"),
        ("UR5-b", "'ur5')"),
        ("nothing_like_it", ""),
    ],
)
def test_a_similar_name_is_not_said_to_be_the_robot_that_is_meant(name: str, similar: str):
    with pytest.raises(UrdfError) as caught:
        Robot.load(name)
    said = str(caught.value)
    assert ("which may be other robots" in said) == bool(similar)
    assert similar in said
    assert "did you mean" not in said
    assert "'tiago')" not in said


def test_a_name_is_read_in_any_case():
    assert Robot.load("UR5") == Robot.load("ur5")


# Refused chains


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_a_joint_of_more_coordinates_is_refused(kind):
    with pytest.raises(UrdfError, match=rf"joint '2' of type '{kind}' is not one of"):
        load("a b c", joint("1", "a", "b"), joint("2", "b", "c", kind), tip="c")


# Poses


@pytest.mark.parametrize("path", SOME_AND_SLOWLY_ALL)
def test_poses_agree_with_the_full_model(path):
    robot = Robot.load(path)
    q = random_q(robot)
    np.testing.assert_allclose(robot.poses(q), by_pinocchio(robot, q), rtol=0, atol=1e-12)


@pytest.mark.parametrize("shape", [(3, 5), (7,), (2, 2, 6), ()])
def test_joint_values_of_the_wrong_shape_are_refused(ur3, shape):
    with pytest.raises(ModelError, match=r"has 6 joints: 'shoulder_pan_joint', .*'wrist_3_joint'"):
        ur3.poses(np.zeros(shape))


def test_a_chain_that_starts_below_moving_joints():
    robot = Robot.load("pr2", base="torso_lift_link", tip="l_wrist_roll_link")
    assert "torso_lift_joint" not in robot.joint_names
    q = random_q(robot)
    np.testing.assert_allclose(robot.poses(q), by_pinocchio(robot, q), atol=1e-12)
    # wherever the torso stands, and with a correction too
    placements = robot.placements.copy()
    placements[0] = placements[0] @ pin.exp6(np.full(6, 2e-3)).homogeneous
    moved = robot.with_placements(placements)
    np.testing.assert_allclose(moved.poses(q), by_pinocchio(moved, q), atol=1e-12)
    assert np.abs(moved.poses(q) - robot.poses(q)).max() > 1e-3


# Columns, held joints


def test_a_held_joint_has_no_column(panda):
    held = Robot.load("panda", "panda_link0", "panda_link8", held={"panda_joint4": -0.7})
    assert held.joint_names == tuple(f"panda_joint{i}" for i in (1, 2, 3, 5, 6, 7))
    assert [joint.name for joint in held.joints] == list(panda.joint_names)
    q = random_q(held)
    full = np.insert(q, 3, -0.7, axis=1)
    np.testing.assert_allclose(held.chain_values(q), full, atol=1e-15)
    np.testing.assert_allclose(held.poses(q), panda.poses(full), atol=1e-15)
    with pytest.raises(ModelError, match=r"shape \(4, 7\) were given; .* has 6 joints"):
        held.poses(full)
    assert held.held == {"panda_joint4": -0.7}


def test_rebuilt_keeps_what_is_not_named():
    robot = Robot.load("panda", "panda_link0", "panda_link8", held={"panda_joint4": -0.7})
    assert robot.rebuilt() == robot
    assert robot.rebuilt(tip="panda_hand").held == robot.held
    moved = displaced(robot)
    assert robot.rebuilt(moved.urdf) == moved
    np.testing.assert_allclose(robot.rebuilt(moved.urdf).placements, moved.placements, atol=1e-12)
    assert robot.rebuilt(base="panda_link2").joint_names == robot.joint_names[2:]


def test_urdf_values_are_of_every_joint():
    robot = Robot.load("baxter", tip="left_gripper", held={"head_pan": 0.3, "left_w2": -0.1})
    q = random_q(robot)
    values = robot.urdf_values(q)
    moving = [j.name for j in robot.urdf.joints if j.type in ("revolute", "prismatic")]
    assert list(values) == moving
    for name, column in zip(robot.joint_names, q.T, strict=True):
        np.testing.assert_array_equal(values[name], column)
    np.testing.assert_array_equal(values["head_pan"], np.full(4, 0.3))
    np.testing.assert_array_equal(values["left_w2"], np.full(4, -0.1))
    np.testing.assert_array_equal(values["right_s0"], np.zeros(4))


# Joints that mimic others, and held ones


@pytest.mark.parametrize(
    ("name", "base", "tip", "columns", "joints"),
    [
        ("panda", "panda_link0", "panda_rightfinger", 8, 8),
        ("panda", "panda_leftfinger", "panda_rightfinger", 1, 2),
        ("panda", "panda_rightfinger", "panda_link0", 8, 8),
        ("pr2", "torso_lift_link", "l_gripper_r_finger_tip_link", 8, 9),
        ("pr2", "l_gripper_l_finger_tip_link", "l_gripper_r_finger_tip_link", 1, 4),
        ("pr2", "head_plate_frame", "r_gripper_l_finger_tip_link", 10, 11),
        ("baxter", "base", "l_gripper_r_finger", 8, 8),
        ("tiago_pro", "head_2_link", "gripper_right_fingertip_left_link", 10, 11),
    ],
)
def test_mimic_joints_move_as_pinocchio_s_own(name, base, tip, columns, joints):
    robot = Robot.load(name, base, tip)
    assert (len(robot.joint_names), len(robot.joints)) == (columns, joints)
    assert robot.mimic_matrix.shape == (joints, columns)
    q = np.random.default_rng(1).uniform(-1, 1, (4, columns))
    np.testing.assert_allclose(
        robot.poses(q), by_pinocchio(robot, q, mimic=True), rtol=0, atol=1e-12
    )


ARM = Robot.load("ur3").joint_names
HELD = {
    "a fixed joint": ({"world_joint": 0.1}, "is not a joint that moves"),
    "a misspelt name": ({"elbow": 0.1}, "did you mean 'elbow_joint'"),
    "no number": ({"elbow_joint": np.nan}, "give a finite number"),
    "a length": ({"elbow_joint": Length(0.3)}, "is a length, and the joint turns"),
    "all of them": (dict.fromkeys(ARM, Angle(0.3)), "none of them is left to move"),
}


@pytest.mark.parametrize(("held", "message"), HELD.values(), ids=HELD)
def test_what_cannot_be_held(held, message):
    with pytest.raises(UrdfError, match=message):
        Robot.load("ur3", held=held)


@pytest.mark.parametrize("mimic", ["nothing", "b", "a"])
def test_a_mimic_of_nothing_or_in_a_ring_is_refused_unless_held(mimic):
    joints = (
        joint("a", "x", "y", mimic=f'joint="{mimic}"'),
        joint("b", "y", "z", mimic='joint="a"'),
    )
    with pytest.raises(UrdfError, match=r"joint '[ab]' mimics .* or hold '[ab]' at a value"):
        load("x y z w", *joints, joint("c", "z", "w"), tip="w")
    assert load("x y z w", *joints, joint("c", "z", "w"), tip="w", held={"a": 0.1}).joint_names == (
        "c",
    )


# Corrections


@pytest.mark.parametrize("name", ["ur3", "panda", "kinova", "pr2", "baxter", "tiago_no_hand"])
def test_the_corrected_urdf_says_what_the_new_robot_says(name):
    tips = {
        "panda": "panda_link8",
        "kinova": "j2s6s200_end_effector",
        "pr2": "l_gripper_tool_frame",
    }
    tips |= {"baxter": "left_gripper", "tiago_no_hand": "wrist_ft_tool_link"}
    robot = Robot.load(name, tip=tips.get(name))
    q = random_q(robot)
    before, bytes_before = robot.poses(q), robot.urdf.data
    new = displaced(robot)
    again = Robot.from_urdf(
        Urdf.from_bytes(new.urdf.data, "again.urdf"), base=robot.base, tip=robot.tip
    )
    np.testing.assert_allclose(again.poses(q), new.poses(q), rtol=0, atol=1e-12)
    np.testing.assert_allclose(again.placements, new.placements, rtol=0, atol=1e-12)
    check_written(new, new.poses(q), q)
    assert np.abs(new.poses(q) - before).max() > 1e-3
    np.testing.assert_array_equal(robot.poses(q), before)
    assert robot.urdf.data == bytes_before
    assert not new.placements.flags.writeable


def test_only_the_changed_origins_differ_in_bytes(ur3):
    new = displaced(ur3, (2, 6))
    pairs = zip(ur3.urdf.data.splitlines(), new.urdf.data.splitlines(), strict=True)
    changed = [i for i, (old, line) in enumerate(pairs, start=1) if old != line]
    assert changed == [117, 241]  # the origins of elbow_joint and of tool0's fixed joint
    assert ur3.carriers == (*ur3.joint_names, "wrist_3_link-tool0_fixed_joint")


def test_the_tip_s_correction_goes_to_the_first_fixed_joint_behind_the_last_moving_one():
    robot = load(
        "a b flange tool camera",
        joint("1", "a", "b"),
        joint("flange_joint", "b", "flange", "fixed"),
        joint("tool_joint", "flange", "tool", "fixed"),
        joint("camera_joint", "flange", "camera", "fixed"),
        tip="tool",
    )
    assert robot.carriers == ("1", "flange_joint")
    new = displaced(robot, (1,))
    was, now = robot.urdf, new.urdf
    assert now.joint("tool_joint").xyz.tolist() == was.joint("tool_joint").xyz.tolist()
    assert now.joint("flange_joint").xyz.tolist() != was.joint("flange_joint").xyz.tolist()
    q = random_q(robot)
    np.testing.assert_allclose(by_pinocchio(new, q), new.poses(q), atol=1e-12)
    # the camera on the same flange moves with it
    camera = [Robot.from_urdf(urdf, tip="camera").poses(q) for urdf in (was, now)]
    assert np.abs(camera[1] - camera[0]).max() > 1e-3
