from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib.model.joint_errors import joint_displacements, joint_parameters
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameter_sets import error_model
from calib.robot.gravity import Payload, gravity_loads
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from tests.robot.shared import LIMIT, joint, urdf_of

GAIN, ECCENTRICITY, COMPLIANCE = "gain", "eccentricity", "compliance"


@pytest.fixture(scope="module")
def mixed() -> Robot:
    """One of each type, followers by a multiplier and an offset, a driver outside, a held joint."""
    joints = (
        joint("outside", "base", "elsewhere"),
        joint("turn", "base", "a"),
        joint("slide", "a", "b", "prismatic", axis="1 1 0"),
        joint("spin", "b", "c", "continuous", axis="0 2 1"),
        joint("follower", "c", "d", mimic='joint="turn" multiplier="-0.5" offset="0.3"'),
        joint("slider", "d", "e", "prismatic", mimic='joint="turn" multiplier="0.2"'),
        joint("driven", "e", "f", mimic='joint="outside" multiplier="3"'),
        joint("still", "f", "tip"),
    )
    urdf = urdf_of("base elsewhere a b c d e f tip", *joints)
    return Robot.from_urdf(urdf, "base", "tip", held={"still": 0.4})


CHAIN = ("turn", "slide", "spin", "follower", "slider", "driven", "still")
COLUMNS = ("turn", "slide", "spin", "outside")
Q = np.array([[0.5, 0.02, 4.0, -0.3], [-1.2, 0.1, -7.0, 0.8]])


def displacements(
    robot: Robot, family: str, load: np.ndarray | None = None
) -> dict[str, np.ndarray]:
    """By parameter, how far a unit of it moves each joint, shape (N, n)."""
    terms = joint_parameters(robot, family)
    moved = joint_displacements(robot, terms, Q, load)
    assert moved.shape == (len(Q), len(robot.joints), len(terms))
    return {term.name: moved[:, :, k] for k, term in enumerate(terms)}


def expected(**columns: np.ndarray) -> np.ndarray:
    """Displacements of the chain's joints, shape (2, 7), zero for those not named."""
    result = np.zeros((2, len(CHAIN)))
    for name, values in columns.items():
        result[:, CHAIN.index(name)] = values
    return result


# Displacements


def test_a_gain_moves_its_joint_by_its_value_and_followers_by_their_multiplier(mixed):
    moved = displacements(mixed, GAIN)
    turn, slide, spin, outside = Q.T
    # the offset of a mimic joint is no part of what the drive turned
    np.testing.assert_allclose(
        moved["turn.gain"], expected(turn=turn, follower=-0.5 * turn, slider=0.2 * turn), atol=1e-16
    )
    np.testing.assert_array_equal(moved["slide.gain"], expected(slide=slide))
    # a continuous joint's value is what the table says, more than a turn too
    np.testing.assert_array_equal(moved["spin.gain"], expected(spin=spin))
    np.testing.assert_allclose(moved["outside.gain"], expected(driven=3 * outside), atol=1e-16)


def test_eccentricities_are_sine_and_cosine_of_the_column(mixed):
    moved = displacements(mixed, ECCENTRICITY)
    for part, function in (("sin", np.sin), ("cos", np.cos)):
        turn, _, spin, outside = function(Q.T)
        np.testing.assert_allclose(
            moved[f"turn.{part}"],
            expected(turn=turn, follower=-0.5 * turn, slider=0.2 * turn),
            atol=1e-16,
        )
        np.testing.assert_array_equal(moved[f"spin.{part}"], expected(spin=spin))
        np.testing.assert_allclose(
            moved[f"outside.{part}"], expected(driven=3 * outside), atol=1e-16
        )


# The sign of compliance: things sag


@pytest.mark.parametrize("axis", ["0 1 0", "0 -1 0"])
@pytest.mark.parametrize("payload", [0.0, 5.0])
def test_a_beam_sags_by_compliance_times_torque(axis, payload):
    # A massive beam along x, turning about y at its end: whichever way the axis points, it goes down.
    text = (
        '<robot name="beam"><link name="base"/><link name="beam"><inertial><mass value="10"/>'
        '<origin xyz="0.5 0 0"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
        '</inertial></link><link name="tip"/>'
        '<joint name="hinge" type="revolute"><parent link="base"/><child link="beam"/>'
        f'<axis xyz="{axis}"/>{LIMIT}</joint>'
        '<joint name="end" type="fixed"><parent link="beam"/><child link="tip"/>'
        '<origin xyz="1 0 0"/></joint></robot>'
    )
    robot = Robot.from_urdf(Urdf.from_bytes(text.encode(), "beam.urdf"))
    q = np.zeros((1, 1))
    load = gravity_loads(robot, q, Payload(payload))
    torque = 9.81 * (10 * 0.5 + payload * 1.0)
    model = error_model(robot, "frames+compliance", target=False)
    kinematics = Kinematics(robot, model, np.eye(4), np.eye(4))
    c = 1e-4
    (point,) = kinematics.points(np.array([c]), Samples.at(q, load))
    np.testing.assert_allclose(
        point, [np.cos(c * torque), 0, -np.sin(c * torque)], rtol=0, atol=1e-15
    )


def test_both_sides_of_the_fork_sag_as_the_full_robot_does():
    # The hand as the head's camera sees it, all joints giving way: the same as the whole URDF at these values.
    robot = Robot.load("tiago_no_hand", "xtion_rgb_optical_frame", "wrist_ft_tool_link")
    q = np.random.default_rng(2).uniform(-1, 1, (3, len(robot.joint_names)))
    load = gravity_loads(robot, q, Payload(3.0))
    model = error_model(robot, "frames+compliance", target=False)
    x = np.random.default_rng(3).uniform(0, 1e-4, len(model))
    poses = Kinematics(robot, model, np.eye(4), np.eye(4)).poses(x, Samples.at(q, load))
    full = pin.buildModelFromXML(robot.urdf.data.decode(robot.urdf.encoding))
    data = full.createData()
    ends = [full.getFrameId(link, pin.FrameType.BODY) for link in (robot.base, robot.tip)]
    for i, expected_pose in enumerate(poses):
        v = np.zeros(full.nv)
        for k, one in enumerate(robot.joints):
            value = robot.urdf_values(q)[one.name][i] + x[k] * load[i, k, 0]
            v[full.idx_vs[full.getJointId(one.name)]] = value
        pin.framesForwardKinematics(full, data, pin.integrate(full, pin.neutral(full), v))
        T_base_tip = data.oMf[ends[0]].inverse() * data.oMf[ends[1]]
        np.testing.assert_allclose(T_base_tip.homogeneous, expected_pose, rtol=0, atol=1e-12)


# Coupled readings


@pytest.fixture(scope="module")
def coupled(mixed: Robot) -> Robot:
    """The spin counts the turn's reading, the turn the outside's, which a slide moves too [rad/m]."""
    coupling = {"spin": {"turn": -1.0}, "turn": {"outside": 0.5}, "outside": {"slide": 2.0}}
    return Robot.from_urdf(mixed.urdf, "base", "tip", held=mixed.held, coupling=coupling)


@pytest.mark.parametrize("family", [GAIN, ECCENTRICITY])
def test_errors_are_of_the_joint_s_value_and_not_of_its_reading(mixed, coupled, family):
    terms = joint_parameters(coupled, family)
    assert [term.name for term in terms] == [term.name for term in joint_parameters(mixed, family)]
    turn, slide, spin, outside = Q.T
    values = np.stack([turn + 0.5 * outside, slide, spin - turn, outside + 2.0 * slide], axis=1)
    moved = joint_displacements(coupled, terms, Q, None)
    np.testing.assert_allclose(
        moved, joint_displacements(mixed, terms, values, None), rtol=0, atol=1e-14
    )


def test_the_jacobian_of_coupled_readings_agrees_with_differences(coupled):
    model = error_model(coupled, "placement+gain+eccentricity+compliance", target=True)
    place = pin.exp6(np.arange(6.0) / 10.0).homogeneous
    kinematics = Kinematics(coupled, model, np.eye(4), place)
    q = np.vstack([Q, 0.3 * Q + 0.1])
    samples = Samples.at(q, gravity_loads(coupled, q, Payload(2.0, (0.1, 0.0, 0.2))))
    x = np.random.default_rng(2).normal(size=len(model)) * 1e-3
    _, twists = kinematics.twists(x, samples)
    step = 1e-6
    for k, unit in enumerate(np.eye(len(model))):
        T_before = kinematics.poses(x - step * unit, samples)
        T_after = kinematics.poses(x + step * unit, samples)
        velocity = (T_after[:, :3, 3] - T_before[:, :3, 3]) / (2.0 * step)
        np.testing.assert_allclose(twists[:, :3, k], velocity, rtol=0, atol=1e-6)
        spin = (T_after[:, :3, :3] - T_before[:, :3, :3]) / (2.0 * step)
        turning = spin @ np.swapaxes(kinematics.poses(x, samples)[:, :3, :3], 1, 2)
        angular = np.stack([turning[:, 2, 1], turning[:, 0, 2], turning[:, 1, 0]], axis=1)
        np.testing.assert_allclose(twists[:, 3:, k], angular, rtol=0, atol=1e-6)


def test_gravity_loads_of_readings_are_those_of_the_joint_values(mixed, coupled):
    loads = gravity_loads(coupled, Q, Payload(2.0, (0.1, 0.0, 0.2)))
    values = coupled.input_values(Q)
    of_values = gravity_loads(mixed, values, Payload(2.0, (0.1, 0.0, 0.2)))
    assert np.abs(loads).max() > 1.0
    np.testing.assert_allclose(loads, of_values, rtol=0, atol=1e-12)
