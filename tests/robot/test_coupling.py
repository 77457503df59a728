from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib.errors import UrdfError
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf, find_urdf

LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'


def joint(
    name: str, parent: str, child: str, mimic: str = "", kind: str = "revolute", numbers: str = ""
) -> str:
    inside = f'<mimic joint="{mimic}" {numbers}/>' if mimic else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.1 0.2 0.3" rpy="0.1 0 0.2"/><axis xyz="0 1 2"/>{LIMIT}{inside}</joint>'
    )


def urdf(links: str, *joints: str) -> Urdf:
    text = "".join(f'<link name="{link}"/>' for link in links.split())
    return Urdf.from_bytes(f'<robot name="r">{text}{"".join(joints)}</robot>'.encode(), "r.urdf")


def by_pinocchio_with_mimics(robot: Robot, q: np.ndarray) -> np.ndarray:
    """T_base_tip from Pinocchio's own mimic joints, given the columns alone."""
    model = pin.buildModelFromXML(robot.urdf.data.decode(robot.urdf.encoding), mimic=True)
    data = model.createData()
    ends = [model.getFrameId(link, pin.FrameType.BODY) for link in (robot.base, robot.tip)]
    poses = []
    for values in q:
        v = np.zeros(model.nv)
        for name, value in zip(robot.joint_names, values, strict=True):
            v[model.idx_vs[model.getJointId(name)]] = value
        pin.framesForwardKinematics(model, data, pin.integrate(model, pin.neutral(model), v))
        poses.append((data.oMf[ends[0]].inverse() * data.oMf[ends[1]]).homogeneous)
    return np.array(poses)


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
    assert robot.coupling.shape == (joints, columns)
    q = np.random.default_rng(1).uniform(-1, 1, (4, columns))
    np.testing.assert_allclose(
        robot.poses(q), by_pinocchio_with_mimics(robot, q), rtol=0, atol=1e-12
    )


def test_multiplier_and_offset():
    robot = Robot.from_urdf(
        urdf(
            "a b c",
            joint("1", "a", "b"),
            joint("2", "b", "c", "1", "prismatic", 'multiplier="-0.5" offset="0.25"'),
        ),
        tip="c",
    )
    assert robot.joint_names == ("1",)
    np.testing.assert_array_equal(robot.coupling, [[1.0], [-0.5]])
    np.testing.assert_allclose(robot.chain_values([[0.0], [2.0]]), [[0, 0.25], [2, -0.75]])
    np.testing.assert_allclose(robot.chain_values([2.0]), [[2, -0.75]])
    values = robot.urdf_values([[0.0], [2.0]])
    np.testing.assert_allclose(values["2"], [0.25, -0.75])


def test_one_column_for_two_followers_in_the_order_of_first_use():
    robot = Robot.from_urdf(
        urdf(
            "r a b c d e",
            joint("driver", "r", "e"),
            joint("1", "r", "a", "driver", numbers='multiplier="2"'),
            joint("free", "a", "b"),
            joint("2", "b", "c", "driver"),
            joint("3", "c", "d", "free", numbers='offset="1"'),
        ),
        tip="d",
    )
    assert robot.joint_names == ("driver", "free")
    np.testing.assert_array_equal(robot.coupling, [[2, 0], [0, 1], [1, 0], [0, 1]])
    np.testing.assert_allclose(robot.chain_values([0.1, 0.2]), [[0.2, 0.2, 0.1, 1.2]])


def test_a_mimic_of_a_fixed_joint_or_by_zero_stands_still():
    robot = Robot.from_urdf(
        urdf(
            "a b c d e",
            joint("1", "a", "b"),
            joint("welded", "b", "c", kind="fixed"),
            joint("2", "c", "d", "welded", numbers='offset="0.3"'),
            joint("3", "d", "e", "1", numbers='multiplier="0" offset="0.4"'),
        ),
        tip="e",
    )
    assert robot.joint_names == ("1",)
    np.testing.assert_allclose(robot.chain_values([0.2]), [[0.2, 0.3, 0.4]])


def test_a_follower_follows_a_held_driver_and_may_be_held_itself():
    chain = urdf("a b c d", joint("1", "a", "b"), joint("2", "b", "c", "1"), joint("3", "c", "d"))
    held = Robot.from_urdf(chain, tip="d", held={"1": 0.7})
    assert held.joint_names == ("3",)
    np.testing.assert_allclose(held.chain_values([0.1]), [[0.7, 0.7, 0.1]])
    held = Robot.from_urdf(chain, tip="d", held={"2": 0.7})
    assert held.joint_names == ("1", "3")
    np.testing.assert_allclose(held.chain_values([0.1, 0.2]), [[0.1, 0.7, 0.2]])


# What is refused


@pytest.mark.parametrize(
    ("joints", "message", "held"),
    [
        (
            [joint("1", "a", "b"), joint("2", "b", "c", "finger1")],
            r"joint '2' mimics 'finger1', which does not exist.*hold '2' at a value",
            {"2": 0.2},
        ),
        (
            [joint("1", "a", "b", "1"), joint("2", "b", "c")],
            r"'1' mimics '1', which follows it in turn.*hold '1' at a value",
            {"1": 0.2},
        ),
        (
            [joint("1", "a", "b"), joint("2", "b", "c", "3"), joint("3", "c", "d", kind="planar")],
            r"joint '2' mimics '3', which is of type 'planar'.*Hold '2' at a value",
            {"2": 0.2},
        ),
    ],
)
def test_a_mimic_of_nothing_is_refused_unless_held(joints, message, held):
    tree = urdf("a b c d" if len(joints) == 3 else "a b c", *joints)
    with pytest.raises(UrdfError, match=message):
        Robot.from_urdf(tree, "a", "c")
    robot = Robot.from_urdf(tree, "a", "c", held=held)
    assert {*robot.joint_names, *held} == {"1", "2"}


@pytest.mark.parametrize(
    ("held", "message"),
    [
        ({"elbow": 0.1}, r"'elbow', to be held at 0.1, does not exist.*did you mean 'elbow_joint'"),
        (
            {"tool0": 0.1},
            r"'tool0', to be held at 0.1, does not exist.*Joints that can be held: 's",
        ),
        ({"base_link-base_fixed_joint": 1}, r"is of type 'fixed'.*can be held: 'shoulder_pan"),
        ({"elbow_joint": np.nan}, r"'elbow_joint' is to be held at nan; give a finite number"),
        ({"elbow_joint": np.inf}, r"'elbow_joint' is to be held at inf"),
    ],
)
def test_joints_that_cannot_be_held_are_refused(held, message):
    with pytest.raises(UrdfError, match=message):
        Robot.load("ur3", held=held)


def test_a_chain_with_every_joint_held_is_refused():
    chain = urdf("a b c", joint("1", "a", "b"), joint("2", "b", "c", "1"))
    with pytest.raises(UrdfError, match=r"joints of the chain are '1', '2', and none of them is"):
        Robot.from_urdf(chain, tip="c", held={"1": 0.0})


def test_followers_beside_the_chain_follow_too():
    robot = Robot.load("panda", "panda_link0", "panda_leftfinger")
    values = robot.urdf_values(np.full((2, 8), 0.03))
    np.testing.assert_array_equal(values["panda_finger_joint2"], [0.03, 0.03])
    # a joint that mimics nothing that there is stays at zero
    alex = Robot.from_urdf(Urdf.read(find_urdf("alex_psyonic_hands")), tip="SpineRollLink")
    values = alex.urdf_values(np.full((1, len(alex.joint_names)), 0.1))
    assert values["Left_index_q2"] == 0.0
