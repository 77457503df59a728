from __future__ import annotations

import numpy as np
import pytest

from calib.compensate.ur_models import MODELS, mount, recognised, the_mount, ur_model, ur_robot
from calib.errors import ModelError
from calib.model.readback import check_written
from calib.model.robot import Robot
from tests.compensate.ur_cases import CASES

Q = np.random.default_rng(8).uniform(-np.pi, np.pi, (20, 6))


@pytest.mark.parametrize("name", CASES["models"]["rows"])
def test_the_nominal_rows(name):
    given = CASES["models"]["rows"][name]
    for column in ("theta", "a", "d", "alpha"):
        assert getattr(ur_model(name).nominal, column).tolist() == given[column]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_the_bare_urdf_of_each_arm(model):
    robot = ur_robot(model)
    expected = model.nominal.poses(Q)
    np.testing.assert_allclose(robot.poses(Q), expected, rtol=0, atol=1e-14)
    assert model in recognised(robot)
    # Nominal numbers are the data sheet's, digit for digit.
    assert f'xyz="{model.nominal.a[1]} 0.0 0.0" rpy="0.0 0.0 0.0"'.encode() in robot.urdf.data
    limits = {joint.name: joint.upper for joint in robot.joints}
    assert limits["elbow_joint"] == np.pi
    assert limits["wrist_3_joint"] == 2 * np.pi


def test_two_readers_agree_on_the_bare_urdf():
    robot = ur_robot("UR5e")
    check_written(robot, ur_model("UR5e").nominal.poses(Q), Q)


def test_the_links_and_joints_of_the_ros_2_description():
    urdf = ur_robot("UR10e").urdf
    assert [joint.name for joint in urdf.joints if joint.type == "revolute"] == [
        "shoulder_pan_joint",
        "shoulder_lift_joint",
        "elbow_joint",
        "wrist_1_joint",
        "wrist_2_joint",
        "wrist_3_joint",
    ]
    assert {"base_link", "base_link_inertia", "base", "flange", "ft_frame", "tool0"} <= set(
        urdf.links
    )


@pytest.mark.parametrize("text", ["ur5e", "UR5E", " Ur_5-e"])
def test_a_name_in_any_spelling(text):
    assert ur_model(text).name == "UR5e"


def test_an_unknown_name_is_told_the_names():
    with pytest.raises(ModelError, match=r"'UR6' is not an arm .* 'UR3', .* 'UR30'\. .* urcontrol"):
        ur_model("UR6")


@pytest.mark.parametrize(
    ("base", "tip"),
    [
        ("base", "tool0"),
        ("base_link", "tool0"),
        ("base_link_inertia", "wrist_3_link"),
        ("base_link", "flange"),
    ],
)
def test_any_base_and_tip_of_the_description(base, tip):
    robot = ur_robot("UR16e").rebuilt(base=base, tip=tip)
    assert [model.name for model in recognised(robot)] == ["UR16e"]
    model, mounted = the_mount(robot)
    chain = mounted.chain_of(robot)
    np.testing.assert_allclose(chain, model.nominal.chain(), rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        mounted.placements_of(chain, robot), robot.placements, rtol=0, atol=1e-14
    )
    poses = mounted.T_base_arm @ model.nominal.poses(Q) @ mounted.T_flange_tip
    np.testing.assert_allclose(robot.poses(Q), poses, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "base", "tip", "arm"),
    [
        ("ur3", "base_link", "ee_link", "UR3"),
        ("ur5", "base", "tool0", "UR5"),
        ("ur10", "world", "wrist_3_link", "UR10"),
        ("ur5_gripper", None, None, "UR5"),
    ],
)
def test_the_old_description_with_other_frames(name, base, tip, arm):
    robot = Robot.load(name, base, tip) if base else Robot.load(name, "base_link", "tool0")
    model, mounted = the_mount(robot)
    assert model.name == arm
    poses = mounted.T_base_arm @ model.nominal.poses(Q) @ mounted.T_flange_tip
    np.testing.assert_allclose(robot.poses(Q), poses, rtol=0, atol=1e-8)


def test_the_paper_s_robot_is_a_ur3(ur3):
    model, mounted = the_mount(ur3)
    assert model.name == "UR3"
    np.testing.assert_allclose(mounted.T_base_arm, np.eye(4), rtol=0, atol=1e-14)
    np.testing.assert_allclose(mounted.T_flange_tip, np.eye(4), rtol=0, atol=1e-9)


def test_arms_of_two_names_have_both():
    assert [model.name for model in recognised(ur_robot("UR7e"))] == ["UR5e", "UR7e"]
    assert the_mount(ur_robot("UR7e"), ur_model("UR7e"))[0].name == "UR7e"


def test_a_corrected_arm_is_not_a_nominal_one(ur3):
    placements = np.array(ur3.placements)
    placements[2, 0, 3] += 1e-5
    robot = ur3.with_placements(placements)
    assert recognised(robot) == ()
    with pytest.raises(ModelError, match=r"of no Universal Robots arm .* Give the nominal URDF"):
        the_mount(robot)
    with pytest.raises(ModelError, match=r"nominal kinematics of the UR3: it has those of no"):
        the_mount(robot, ur_model("UR3"))


def test_another_arm_is_named(ur3):
    with pytest.raises(ModelError, match=r"not the nominal kinematics of the UR5: .* of the UR3\."):
        the_mount(ur3, ur_model("UR5"))


def test_robots_that_are_no_such_arm(panda, ur3, serial_urdf):
    assert recognised(panda) == ()
    assert recognised(ur3.rebuilt(base="shoulder_link")) == ()  # five joints
    assert recognised(ur3.rebuilt(base="tool0", tip="base")) == ()  # the other way round
    held = Robot.from_urdf(ur3.urdf, "base", "tool0", held={"elbow_joint": 0.3})
    assert recognised(held) == ()
    Z = (0, 0, 1)
    slide = [("prismatic", (0, 0, 0.1), (0, 0, 0), Z)]
    turn = [("revolute", (0, 0, 0.1), (0, 0, 0), Z)]
    assert recognised(Robot.from_urdf(serial_urdf(slide + 5 * turn))) == ()
    parallel = Robot.from_urdf(serial_urdf(6 * turn))
    assert mount(parallel, ur_model("UR3")) is None
