from __future__ import annotations

import importlib.metadata
import io
import pickle
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy

import calib.example
from calib.errors import ModelError, UrdfError
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.units import Angle, Length

LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
BAD = ("quadrotor_base.urdf", "ur3.urdf", "iris_simple.urdf")  # no joints, or none that moves
FILES = [
    path
    for path in sorted(
        Path(str(file.locate()))
        for file in importlib.metadata.files("example-robot-data") or []
        if file.suffix == ".urdf"
    )
    if path.name not in BAD
]
#: A few in each run, all of them in the slow one.
SOME_AND_SLOWLY_ALL = [
    pytest.param(
        path,
        marks=() if i % 12 == 0 else pytest.mark.slow,
        id=f"{path.parents[1].name}/{path.name}",
    )
    for i, path in enumerate(FILES)
]


def joint(name: str, parent: str, child: str, kind: str = "revolute", inside: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.1 0.2 0.3" rpy="0.1 0 0.2"/><axis xyz="0 0 1"/>{LIMIT}{inside}</joint>'
    )


def load(links: str, *joints: str, base: str | None = None, tip: str | None = None) -> Robot:
    text = "".join(f'<link name="{link}"/>' for link in links.split())
    urdf = Urdf.from_bytes(f'<robot name="r">{text}{"".join(joints)}</robot>'.encode(), "r.urdf")
    return Robot.from_urdf(urdf, base, tip)


def random_q(robot: Robot, count: int = 5) -> np.ndarray:
    return np.random.default_rng(3).uniform(-1, 1, (count, len(robot.joint_names)))


def by_pinocchio(robot: Robot, q: np.ndarray) -> np.ndarray:
    """T_base_tip from the full model of the URDF: nothing locked, nothing merged by calib."""
    model = pin.buildModelFromXML(robot.urdf.data.decode(robot.urdf.encoding))
    data = model.createData()
    frames = [model.getFrameId(link, pin.FrameType.BODY) for link in (robot.base, robot.tip)]
    poses = []
    for values in q:
        v = np.zeros(model.nv)
        for name, value in zip(robot.joint_names, values, strict=True):
            v[model.idx_vs[model.getJointId(name)]] = value
        pin.framesForwardKinematics(model, data, pin.integrate(model, pin.neutral(model), v))
        poses.append((data.oMf[frames[0]].inverse() * data.oMf[frames[1]]).homogeneous)
    return np.array(poses)


def by_yourdfpy(robot: Robot, q: np.ndarray) -> np.ndarray:
    model = yourdfpy.URDF.load(
        io.BytesIO(robot.urdf.data), load_meshes=False, load_collision_meshes=False
    )
    poses = []
    for values in q:
        model.update_cfg(dict(zip(robot.joint_names, values, strict=True)))
        poses.append(model.get_transform(robot.tip, robot.base))
    return np.array(poses)


# Finding and loading


def test_the_name_ur3_gives_the_ur3_not_a_ur5():
    robot = Robot.load("ur3")
    lengths = [np.linalg.norm(T[:3, 3]) for T in robot.placements]
    np.testing.assert_allclose(lengths[0], 0.1519, atol=1e-12)
    np.testing.assert_allclose(lengths[2], np.hypot(0.24365, 0.0925), atol=1e-12)
    np.testing.assert_allclose(lengths[3], 0.21325, atol=1e-12)
    assert (robot.name, robot.base, robot.tip) == ("ur3", "world", "tool0")


def test_an_unknown_name_lists_the_known():
    with pytest.raises(UrdfError, match=r"'urr3' is neither a file .* 'panda'.*'ur3'"):
        Robot.load("urr3")


@pytest.mark.parametrize("end", ["base", "tip"])
def test_an_unknown_link_lists_the_links(end):
    with pytest.raises(UrdfError, match=r"no link 'tool00' \(did you mean 'tool0'"):
        Robot.load("ur3", **{end: "tool00"})


# Base and tip


def test_the_default_tip_has_the_most_moving_joints():
    robot = load("a b c d", joint("1", "a", "b"), joint("2", "a", "c"), joint("3", "c", "d"))
    assert (robot.base, robot.tip, robot.joint_names) == ("a", "d", ("2", "3"))


@pytest.mark.parametrize("usual", ["tool0", "tcp", "tool", "flange", "ee_link"])
def test_a_usual_name_breaks_a_tie(usual):
    ends = [joint(f"f{end}", "b", end, "fixed") for end in ("x", usual, "y")]
    assert load(f"a b x {usual} y", joint("1", "a", "b"), *ends).tip == usual


def test_measured_joints_restrict_the_default_tip():
    arm = [f"panda_joint{i}" for i in range(1, 8)]
    assert len(Robot.load("panda").joints) == 8  # a finger is one more
    assert Robot.load("panda", measured=arm).joint_names == tuple(arm)
    assert Robot.load("panda", measured=arm[:3]).joint_names == tuple(arm[:3])


def test_mimic_joints_are_never_in_a_default_chain():
    mimic = joint("3", "c", "d", inside='<mimic joint="1"/>')
    robot = load("a b c d", joint("1", "a", "b"), joint("2", "b", "c"), mimic)
    assert (robot.tip, robot.joint_names) == ("c", ("1", "2"))


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_joints_of_more_coordinates_are_never_in_a_default_chain(kind):
    free = joint("0", "w", "a", kind)
    assert load("w a b c", free, joint("1", "w", "c"), joint("2", "a", "b")).joint_names == ("1",)
    assert load("w a b c", free, joint("1", "w", "c"), joint("2", "a", "b"), base="a").tip == "b"


# Refused chains


def test_no_joint_between_is_refused_and_lists_the_links():
    with pytest.raises(UrdfError, match=r"no joint moves between .*'ee_link'.*'tool0'.*'world'"):
        Robot.load("ur3", base="ee_link", tip="tool0")
    with pytest.raises(UrdfError, match="no joint moves"):
        Robot.load("iris_simple")


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_a_joint_of_more_coordinates_is_refused(kind):
    with pytest.raises(UrdfError, match=rf"joint '2' between 'a' and 'c' is of type '{kind}'"):
        load("a b c", joint("1", "a", "b"), joint("2", "b", "c", kind), tip="c")


# Poses


@pytest.mark.parametrize("path", SOME_AND_SLOWLY_ALL)
def test_poses_agree_with_the_full_model(path):
    robot = Robot.load(path)
    q = random_q(robot)
    np.testing.assert_allclose(robot.poses(q), by_pinocchio(robot, q), rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["ur3", "panda", "kinova", "pr2", "baxter", "tiago_no_hand"])
def test_poses_agree_with_yourdfpy(name):
    robot = Robot.load(name)
    q = random_q(robot)
    np.testing.assert_allclose(robot.poses(q), by_yourdfpy(robot, q), rtol=0, atol=1e-12)


@pytest.mark.parametrize("axis", [(0, 0, -1), (0, 3, 4), (0.1, -0.2, 0.05), (1, 0, 0)])
@pytest.mark.parametrize("kind", ["revolute", "continuous", "prismatic"])
def test_axes_in_any_direction_and_of_any_length(serial_urdf, kind, axis):
    urdf = serial_urdf([(kind, (0.1, 0.2, 0.3), (0.3, 0.2, 0.1), axis)])
    robot = Robot.from_urdf(urdf)
    unit = np.array(axis) / np.linalg.norm(axis)
    moved = np.eye(4)
    if kind == "prismatic":
        moved[:3, 3] = 0.7 * unit
    else:
        moved[:3, :3] = pin.exp3(0.7 * unit)
    expected = robot.placements[0] @ moved @ robot.placements[1]
    np.testing.assert_allclose(robot.poses([0.7])[0], expected, atol=1e-14)


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
    with pytest.raises(ModelError, match=r"shape \(5, 7\) were given; .* has 6 joints"):
        held.poses(full)
    assert held.held == {"panda_joint4": -0.7}


def test_held_joints_tell_robots_apart(panda):
    ends = ("panda", "panda_link0", "panda_link8")
    held = {"panda_joint1": 0.1, "panda_joint2": 0.2}
    one, other = Robot.load(*ends, held=held), Robot.load(*ends, held=dict(reversed(held.items())))
    assert one == other
    assert hash(one) == hash(other)
    assert one != panda
    assert one != Robot.load(*ends, held=held | {"panda_joint2": 0.3})


def test_a_joint_is_held_in_a_unit_of_its_own():
    ends = ("tiago_no_hand", None, "arm_7_link")
    with pytest.raises(
        UrdfError, match="'torso_lift_joint' is held at is an angle, and the joint slides"
    ):
        Robot.load(*ends, held={"torso_lift_joint": Angle(0.3)})
    with pytest.raises(
        UrdfError, match="'arm_1_joint' is held at is a length, and the joint turns"
    ):
        Robot.load(*ends, held={"arm_1_joint": Length(0.3)})
    held = Robot.load(*ends, held={"torso_lift_joint": Length(0.3)}).held
    assert held == {"torso_lift_joint": 0.3}


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
    np.testing.assert_array_equal(values["head_pan"], np.full(5, 0.3))
    np.testing.assert_array_equal(values["left_w2"], np.full(5, -0.1))
    np.testing.assert_array_equal(values["right_s0"], np.zeros(5))


# Immutability


def test_a_robot_goes_to_another_process_and_stays_what_it_is():
    robot = Robot.load("panda", "panda_rightfinger", "panda_link0", held={"panda_joint2": 0.3})
    again = pickle.loads(pickle.dumps(robot))
    assert again == robot
    q = random_q(robot)
    np.testing.assert_array_equal(again.poses(q), robot.poses(q))


def test_robots_are_equal_when_urdf_base_and_tip_are(ur3):
    assert ur3 == Robot.load(calib.example.paper_urdf(), base="base", tip="tool0")
    assert hash(ur3) == hash(Robot.load(calib.example.paper_urdf(), base="base", tip="tool0"))
    assert ur3 != Robot.load(calib.example.paper_urdf(), base="base", tip="ee_link")
    assert ur3 != displaced(ur3)


# Corrections


def displaced(robot: Robot, places: tuple[int, ...] = ()) -> Robot:
    rng = np.random.default_rng(5)
    placements = robot.placements.copy()
    for i in places or range(len(placements)):
        placements[i] = placements[i] @ pin.exp6(rng.normal(0, 5e-3, 6)).homogeneous
    return robot.with_placements(placements)


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
    np.testing.assert_allclose(by_yourdfpy(new, q), new.poses(q), rtol=0, atol=1e-12)
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


def test_a_tip_without_a_fixed_joint_behind_it_takes_no_correction():
    robot = load("a b c", joint("1", "a", "b"), joint("2", "b", "c"))
    assert robot.carriers == ("1", "2", None)
    assert len(displaced(robot, (0, 1)).joints) == 2
    with pytest.raises(UrdfError, match=r"tip 'c' of 'r' is moved by its last joint.*Add a fixed"):
        displaced(robot, (2,))
