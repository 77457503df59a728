from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import ModelError
from calib.fit.registration.table_rows import rows_and_setup
from calib.robot.gravity import GRAVITY, Payload, check_masses, finite_vector, gravity_loads
from calib.robot.kernel import BLOCK
from calib.robot.robot import Robot

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


def test_masses_that_only_geoms_tell_are_asked_for(tmp_path):
    world = '<body><joint name="{}"/><geom size="1"/>{}</body>'
    world = world.format(
        "j", world.format("k", "<inertial pos='0 0 0' mass='1' diaginertia='1 1 1'/>")
    )
    (tmp_path / "m.xml").write_text(f"<mujoco><worldbody>{world}</worldbody></mujoco>")
    robot = Robot.load(tmp_path / "m.xml")
    with pytest.raises(ModelError, match="'body_1' follow from geoms"):
        check_masses(robot, "placement+compliance")
    q = np.zeros((3, 2))
    table = Measurements(robot.joint_names, q, np.ones((3, 3)))
    with pytest.raises(ModelError, match="'body_1' follow from geoms"):
        rows_and_setup(robot, table, Cell(model="placement+compliance"))
    rows_and_setup(robot, table, Cell(model="placement+gravity"))
    rows_and_setup(robot, table, Cell())
    check_masses(Robot.load("ur3"), "placement+compliance")


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


def depths(robot, values, gravity) -> np.ndarray:
    """How deep, along gravity, the origins of the chain's joints and of its ends lie, shape (n + 2,), [m]."""
    model = pin.buildModelFromXML(robot.urdf.data.decode(robot.urdf.encoding))
    data, v = model.createData(), np.zeros(model.nv)
    for name, value in values.items():
        v[model.idx_vs[model.getJointId(name)]] = value
    pin.framesForwardKinematics(model, data, pin.integrate(model, pin.neutral(model), v))
    points = [data.oMi[model.getJointId(joint.name)].translation for joint in robot.joints]
    ends = (model.getFrameId(link, pin.FrameType.BODY) for link in (robot.tip, robot.base))
    points += [data.oMf[end].translation for end in ends]
    return np.array(points) @ gravity / np.linalg.norm(gravity)


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
    load = gravity_loads(robot, q, payload, gravity)[..., 0]
    assert load.shape == (3, len(robot.joints))
    for row, values in zip(load, q, strict=True):
        expected = load_by_differences(robot, values, payload, gravity)
        np.testing.assert_allclose(row, expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize(("name", "base", "tip"), ROBOTS)
def test_a_lever_arm_is_how_much_deeper_a_joint_moves_a_point(name, base, tip):
    robot = Robot.load(name, base, tip)
    q = np.random.default_rng(3).uniform(-1.2, 1.2, (2, len(robot.joint_names)))
    gravity = (1.0, -2.0, -9.0)
    levers = gravity_loads(robot, q, Payload(2.0), gravity)[..., 1:]
    for i, row in enumerate(levers):
        values = {name: float(column[i]) for name, column in robot.urdf_values(q).items()}
        for joint, found in zip(robot.joints, row, strict=True):
            low, high = (
                depths(robot, values | {joint.name: values[joint.name] + step}, gravity)
                for step in (-STEP, STEP)
            )
            np.testing.assert_allclose(found, (high - low) / (2 * STEP), rtol=0, atol=1e-8)


def by_pinocchio(robot, values, payload, gravity) -> np.ndarray:
    """Load and lever arms at one set of joint values, from Pinocchio's own Jacobian, shape (n, n + 3)."""
    model = pin.buildModelFromXML(robot.urdf.data.decode(robot.urdf.encoding))
    model.gravity.linear = np.array(gravity)
    tip, base = (
        model.frames[model.getFrameId(link, pin.FrameType.BODY)] for link in (robot.tip, robot.base)
    )
    mass = pin.Inertia(payload.mass, np.array(payload.com), np.zeros((3, 3)))
    model.appendBodyToJoint(tip.parentJoint, mass, tip.placement)
    data, v = model.createData(), np.zeros(model.nv)
    for name, value in values.items():
        v[model.idx_vs[model.getJointId(name)]] = value
    q = pin.integrate(model, pin.neutral(model), v)
    numbers = [model.getJointId(joint.name) for joint in robot.joints]
    columns = [model.idx_vs[number] for number in numbers]
    load = -pin.computeGeneralizedGravity(model, data, q)[columns]
    J = pin.computeJointJacobians(model, data, q)[:, columns]
    points = [(number, data.oMi[number].translation) for number in numbers]
    points += [
        (end.parentJoint, data.oMi[end.parentJoint].act(end.placement.translation))
        for end in (tip, base)
    ]
    down = np.array(gravity) / np.linalg.norm(gravity)
    arms = [
        [
            (J[:3, i] + np.cross(J[3:, i], point)) @ down * (k in model.supports[carrier])
            for carrier, point in points
        ]
        for i, k in enumerate(numbers)
    ]
    return np.column_stack([load, arms])


@pytest.mark.parametrize(("name", "base", "tip"), ROBOTS)
def test_many_rows_are_what_pinocchio_says_of_each(name, base, tip):
    robot = Robot.load(name, base, tip)
    q = np.random.default_rng(4).uniform(-1.2, 1.2, (BLOCK + 2, len(robot.joint_names)))
    payload, gravity = Payload(2.0, (0.05, -0.02, 0.1)), (1.0, -2.0, -9.0)
    found = gravity_loads(robot, q, payload, gravity)
    assert found.shape == (len(q), len(robot.joints), len(robot.joints) + 3)
    columns = robot.urdf_values(q)
    for i in (0, BLOCK - 1, BLOCK, BLOCK + 1):
        values = {name: float(column[i]) for name, column in columns.items()}
        expected = by_pinocchio(robot, values, payload, gravity)
        np.testing.assert_allclose(found[i], expected, rtol=0, atol=1e-12)


def test_without_gravity_there_is_no_load_and_no_arm(ur3):
    assert not gravity_loads(ur3, np.ones((2, 6)), Payload(1.0), (0.0, 0.0, 0.0)).any()


def test_a_payload_keeps_a_copy_of_its_centre_of_mass():
    com = np.array([0.1, 0.2, 0.3])
    payload = Payload(2.0, com)
    com[0] = 9.0
    np.testing.assert_array_equal(payload.com, [0.1, 0.2, 0.3])
    assert not payload.com.flags.writeable
    np.testing.assert_array_equal(Payload(0.0).com, np.zeros(3))


@pytest.mark.parametrize("mass", [-1e-9, np.nan, np.inf])
def test_a_mass_that_cannot_be(mass):
    with pytest.raises(ModelError, match="The mass of a payload"):
        Payload(mass)


@pytest.mark.parametrize("values", [(0.0, 1.0), (0.0, 1.0, np.nan), np.zeros((1, 3)), 1.0])
def test_what_is_no_vector_of_three_finite_numbers(values):
    with pytest.raises(ModelError, match=r"The force is .*; give three finite numbers \[N\]"):
        finite_vector(values, "force", "[N]")
