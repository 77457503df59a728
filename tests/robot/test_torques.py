from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib.robot.robot import Robot
from calib.robot.torques import GRAVITY, Payload, gravity_load
from calib.robot.urdf import Urdf

STEP = 1e-5

#: Robot, base, tip: an arm, prismatic and continuous joints, two arms, arm and head, turned round, followers.
ROBOTS = [
    ("ur3", "base", "tool0"),
    ("panda", "panda_link0", "panda_link8"),
    ("kinova", None, "j2s6s200_end_effector"),
    ("tiago_no_hand", None, "wrist_ft_tool_link"),
    ("tiago_no_hand", "xtion_rgb_optical_frame", "wrist_ft_tool_link"),
    ("baxter", "right_gripper", "left_gripper"),
    ("pr2", "r_gripper_tool_frame", "l_gripper_tool_frame"),
    ("ur3", "tool0", "base"),
    ("panda", "panda_rightfinger", "panda_link2"),
]


def potential(robot, values, payload=None, gravity=GRAVITY) -> float:
    """The potential energy of all links and of the payload, joint by joint in a model of its own [J].

    ``values`` are those of the URDF's joints by name; the payload is reckoned by hand.
    """
    model = pin.buildModelFromXML(robot.urdf.data.decode(robot.urdf.encoding))
    model.gravity.linear = np.array(gravity)
    data = model.createData()
    v = np.zeros(model.nv)
    for name, value in values.items():
        v[model.idx_vs[model.getJointId(name)]] = value
    q = pin.integrate(model, pin.neutral(model), v)
    energy = pin.computePotentialEnergy(model, data, q)
    if payload is not None:
        pin.framesForwardKinematics(model, data, q)
        tip = data.oMf[model.getFrameId(robot.tip, pin.FrameType.BODY)]
        energy -= payload.mass * np.dot(gravity, tip.act(np.array(payload.com)))
    return float(energy)


def load_by_differences(robot, q, payload=None, gravity=GRAVITY) -> np.ndarray:
    """- dU / dq of each joint of the chain, by central differences of the potential energy, shape (n,)."""
    values = {name: float(column[0]) for name, column in robot.urdf_values(q).items()}
    result = []
    for joint in robot.joints:
        ends = []
        for step in (-STEP, STEP):
            moved = values | {joint.name: values[joint.name] + step}
            ends.append(potential(robot, moved, payload, gravity))
        result.append(-(ends[1] - ends[0]) / (2 * STEP))
    return np.array(result)


@pytest.mark.parametrize("payload", [None, Payload(5.0, (0.05, -0.02, 0.1))])
@pytest.mark.parametrize(("name", "base", "tip"), ROBOTS)
def test_the_load_is_the_slope_of_the_potential_energy(name, base, tip, payload):
    robot = Robot.load(name, base, tip)
    q = np.random.default_rng(2).uniform(-1.2, 1.2, (3, len(robot.joint_names)))
    gravity = (1.0, -2.0, -9.0)
    load = gravity_load(robot, q, payload, gravity)
    assert load.shape == (3, len(robot.joints))
    for row, values in zip(load, q, strict=True):
        expected = load_by_differences(robot, values, payload, gravity)
        np.testing.assert_allclose(row, expected, rtol=0, atol=1e-5)


@pytest.fixture(scope="module")
def pendulum() -> Urdf:
    """A rod of 2 kg, its centre 0.5 m along x, that turns about y; a slide of 3 kg along z; a beam beside them."""
    mass = '<inertial><origin xyz="{}"/><mass value="{}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    limit = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'

    def link(name: str, com: str, kg: float) -> str:
        return f'<link name="{name}">{mass.format(com, kg)}</inertial></link>'

    def joint(name: str, parent: str, child: str, kind: str, axis: str, inside: str = "") -> str:
        return (
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<axis xyz="{axis}"/>{limit}{inside}</joint>'
        )

    text = (
        '<robot name="p"><link name="a"/>'
        + link("lift", "0 0 0", 3)
        + link("rod", "0.5 0 0", 2)
        + link("beam", "0.2 0 0", 4)
        + joint("slide", "a", "lift", "prismatic", "0 0 1")
        + joint("turn", "lift", "rod", "revolute", "0 1 0")
        + joint("swing", "rod", "beam", "revolute", "0 1 0")
        + "</robot>"
    )
    return Urdf.from_bytes(text.encode(), "p.urdf")


def test_signs_and_units_by_hand(pendulum):
    # Horizontal: gravity pulls the rod down, which is the positive sense about y, and the slide down its axis.
    robot = Robot.from_urdf(pendulum, tip="rod")
    g = 9.81
    load = gravity_load(robot, [[0.0, 0.0], [0.0, np.pi / 2]], Payload(1.0, (1.0, 0.0, 0.0)))
    weight, moment = (3 + 2 + 4 + 1) * g, (2 * 0.5 + 4 * 0.2 + 1 * 1.0) * g
    np.testing.assert_allclose(load, [[-weight, moment], [-weight, 0.0]], atol=1e-12)


def test_joints_beside_the_chain_stand_where_they_are_held(pendulum):
    # The beam beyond the tip hangs straight down instead of along the rod.
    held = Robot.from_urdf(pendulum, tip="rod", held={"swing": np.pi / 2})
    load = gravity_load(held, [[0.0, 0.0]])
    np.testing.assert_allclose(load[0, 1], 2 * 0.5 * 9.81, atol=1e-12)
    # A held joint of the chain keeps its place among the loads.
    held = Robot.from_urdf(pendulum, tip="rod", held={"turn": np.pi / 2})
    np.testing.assert_allclose(gravity_load(held, [[0.1]]), [[-9 * 9.81, 0.0]], atol=1e-12)


def test_the_load_does_not_ask_from_which_side_the_chain_is_seen():
    there = Robot.load("tiago_no_hand", "xtion_rgb_optical_frame", "wrist_ft_tool_link")
    back = Robot.load("tiago_no_hand", "wrist_ft_tool_link", "xtion_rgb_optical_frame")
    q = np.random.default_rng(2).uniform(-1, 1, (3, 9))
    np.testing.assert_allclose(
        gravity_load(there, q), gravity_load(back, q[:, ::-1])[:, ::-1], atol=1e-12
    )


# What is refused
