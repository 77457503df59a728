"""The default tip: through joints that follow others inside an arm, and not into grippers and hands."""

from __future__ import annotations

import pytest

from calib.errors import UrdfError
from calib.robot.robot import Robot
from tests.robot.shared import joint, urdf_of


def chain_of(links: str, *joints: str, **options) -> Robot:
    """The robot of links, named in one text, and joints, to its default tip."""
    return Robot.from_urdf(urdf_of(links, *joints), **options)


def follower(name: str, parent: str, child: str, driver: str) -> str:
    return joint(name, parent, child, mimic=f'joint="{driver}" multiplier="-1"')


@pytest.mark.parametrize(
    ("name", "tip", "joints"),
    [
        ("panda", "panda_link8", 7),
        ("so101", "gripper_frame_link", 5),
        ("z1", "link06", 6),
        ("kinova", "j2s6s200_end_effector", 6),
        ("tiago", "wrist_ft_tool_link", 8),
        ("talos_left_arm", "wrist_left_ft_tool_link", 6),
        ("finger_edu", "finger_tip_link", 3),  # nothing but a finger
    ],
)
def test_the_default_tip_is_before_a_gripper_or_hand(name, tip, joints):
    robot = Robot.load(name)
    assert (robot.tip, len(robot.joint_names)) == (tip, joints)


def test_a_hand_with_columns_does_not_move_the_default_tip():
    names = [joint.name for joint in Robot.load("panda").urdf.joints]
    assert Robot.load("panda", measured=names).tip == "panda_link8"
    assert Robot.load("panda", measured=["panda_finger_joint1"]).joint_names != ()


@pytest.mark.parametrize(
    ("joint_name", "link", "tip"),
    [
        ("gripper_yaw", "wrist", "wrist"),  # an axis of the wrist
        ("gripper_joint", "clamp", "arm"),
        ("slide", "left_finger", "arm"),
    ],
)
def test_what_makes_a_joint_one_of_a_hand(joint_name, link, tip):
    robot = chain_of(f"base arm {link}", joint("1", "base", "arm"), joint(joint_name, "arm", link))
    assert robot.tip == tip


def test_measured_joints_restrict_the_default_tip():
    arm = [f"panda_joint{i}" for i in range(1, 8)]
    assert Robot.load("panda", tip="panda_leftfinger").joint_names == (*arm, "panda_finger_joint1")
    assert Robot.load("panda", measured=arm).joint_names == tuple(arm)
    assert Robot.load("panda", measured=arm[:3]).joint_names == tuple(arm[:3])


# Joints that follow others

SHOULDER = joint("j1", "base", "l1")

#: What stands behind the shoulder, and the joints of the chain that is wanted.
ARMS = {
    "a parallelogram's closing joint": (
        (joint("j2", "l1", "l2"), follower("back", "l2", "rod", "j2"), joint("j3", "rod", "l3")),
        "l3",
        ("j1", "j2", "j3"),
    ),
    "with its other rods beside the chain": (
        (
            joint("j2", "l1", "l2"),
            follower("lever", "l1", "crank", "j2"),
            follower("push", "crank", "push_rod", "j2"),
            follower("back", "l2", "rod", "j2"),
            joint("j3", "rod", "l3"),
        ),
        "l3",
        ("j1", "j2", "j3"),
    ),
    "a telescope": (
        (joint("j2", "l1", "l2", "prismatic"), follower("stage", "l2", "l3", "j2")),
        "l3",
        ("j1", "j2"),
    ),
    "driven by a motor beside the chain": (
        (joint("motor", "l1", "disc"), follower("j2", "l1", "l2", "motor"), joint("3", "l2", "l3")),
        "l3",
        ("j1", "motor", "3"),
    ),
    "a gripper of any name": (
        (
            joint("j2", "l1", "l2"),
            joint("mount", "l2", "palm", "fixed"),
            joint("m7", "palm", "p1"),
            follower("m7_b", "p1", "p1_pad", "m7"),
            follower("m8", "palm", "p2", "m7"),
        ),
        "l2",
        ("j1", "j2"),
    ),
    "a gripper without a palm": (
        (joint("j2", "l1", "l2"), joint("m", "l2", "p1"), follower("m2", "l2", "p2", "m")),
        "l2",
        ("j1", "j2"),
    ),
    "a gripper driven from within": (
        (
            joint("j2", "l1", "l2"),
            joint("m", "l2", "screw", "prismatic"),
            follower("m1", "l2", "p1", "m"),
            follower("m2", "l2", "p2", "m"),
        ),
        "l2",
        ("j1", "j2"),
    ),
    "a pair of clamps that turn and close": (
        (
            joint("j2", "l1", "l2"),
            joint("spread", "l2", "k1"),
            follower("spread_2", "l2", "k2", "spread"),
            joint("close", "k1", "p1"),
            follower("close_2", "k2", "p2", "close"),
        ),
        "l2",
        ("j1", "j2"),
    ),
}


@pytest.mark.parametrize("case", ARMS)
def test_a_follower_on_the_way_leads_on_and_a_gripper_does_not(case):
    joints, tip, names = ARMS[case]
    links = ["base", "l1", *(text.split('child link="')[1].split('"')[0] for text in joints)]
    robot = chain_of(" ".join(links), SHOULDER, *joints)
    assert (robot.tip, robot.joint_names) == (tip, names)


def test_followers_of_measured_joints_lead_on():
    joints = (SHOULDER, joint("j2", "l1", "l2"), follower("back", "l2", "rod", "j2"))
    joints += (joint("j3", "rod", "l3"), joint("j4", "l3", "l4"))
    measured = ["j1", "j2", "j3"]
    assert chain_of("base l1 l2 rod l3 l4", *joints, measured=measured).tip == "l3"
    assert chain_of("base l1 l2 rod l3 l4", *joints, measured=["j1"]).tip == "l1"


def test_followers_of_a_held_joint_lead_on_and_do_not_count():
    joints = (SHOULDER, joint("j2", "l1", "l2"), follower("back", "l2", "rod", "j2"))
    robot = chain_of("base l1 l2 rod l3", *joints, joint("j3", "rod", "l3"), held={"j2": 0.1})
    assert (robot.tip, robot.joint_names) == ("l3", ("j1", "j3"))


def test_a_mimic_of_nothing_is_not_passed():
    joints = (SHOULDER, follower("lost", "l1", "l2", "nothing"), joint("j3", "l2", "l3"))
    assert chain_of("base l1 l2 l3", *joints).tip == "l1"


def test_a_gripper_alone_ends_at_the_finger_that_is_driven():
    joints = (joint("m", "palm", "p1"), follower("m2", "palm", "p2", "m"))
    assert chain_of("palm p1 p2", *joints).joint_names == ("m",)
    assert chain_of("palm p1 p2", *joints).tip == "p1"


def test_two_measured_arms_are_named_and_none_is_chosen():
    links = "body l1 l2 l3 left_tip r1 r2 r3 right_tip"
    sides = {"left": ("l1", "l2", "l3"), "right": ("r1", "r2", "r3")}
    joints = []
    for side, (a, b, c) in sides.items():
        joints += [joint(a, "body", a), joint(b, a, b), joint(c, b, c)]
        joints.append(joint(f"{side}_fixed", c, f"{side}_tip", "fixed"))
    both = ["l1", "l2", "l3", "r1", "r2", "r3"]
    with pytest.raises(UrdfError, match=r"2 arms.*'left_tip', 'right_tip'.*--tip left_tip") as e:
        chain_of(links, *joints, measured=both)
    assert "--tip NAME=left_tip --tip NAME=right_tip" in str(e.value)
    assert chain_of(links, *joints, measured=both, tip="left_tip").joint_names == tuple(both[:3])
    # One arm alone, one that is longer, and a robot without a table are as before.
    assert chain_of(links, *joints, measured=both[:3]).tip == "left_tip"
    assert chain_of(links, *joints, measured=both[:5]).tip == "left_tip"
    assert chain_of(links, *joints).tip == "right_tip"
