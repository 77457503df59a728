from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib.errors import ModelError
from calib.formats.ur_arms import FullDH, chain_poses, ur_model, ur_robot
from calib.formats.ur_mount import mount, recognised, the_mount
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

Q = np.random.default_rng(8).uniform(-np.pi, np.pi, (20, 6))


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


def test_arms_of_two_names_have_both():
    assert [model.name for model in recognised(ur_robot("UR7e"))] == ["UR5e", "UR7e"]
    assert the_mount(ur_robot("UR7e"), ur_model("UR7e"))[0].name == "UR7e"


def renamed(robot: Robot, old: str, new: str) -> Robot:
    """The robot with other names in its URDF."""
    urdf = Urdf.from_bytes(robot.urdf.data.replace(old.encode(), new.encode()), "renamed.urdf")
    return Robot.from_urdf(urdf, robot.base.replace(old, new), robot.tip.replace(old, new))


def corrected(robot: Robot, size: float = 1e-3) -> Robot:
    """The robot with every origin of its joints displaced."""
    twists = np.random.default_rng(3).normal(size=(7, 6)) * size
    if robot.carriers[6] is None:
        twists[6] = 0.0
    return robot.with_placements(
        np.array(
            [P @ pin.exp6(t).homogeneous for P, t in zip(robot.placements, twists, strict=True)]
        )
    )


@pytest.mark.parametrize("name", ["ur3", "ur5e"])
@pytest.mark.parametrize(("base", "tip"), [("base", "tool0"), ("base_link", "wrist_3_link")])
def test_the_base_and_flange_of_a_corrected_arm_are_found_by_name(name, base, tip, ur3):
    nominal = (ur3 if name == "ur3" else ur_robot(name)).rebuilt(base=base, tip=tip)
    robot = corrected(nominal)
    model, mounted = the_mount(robot)
    assert 1e-4 < mounted.off < 0.02
    assert model.name.lower() == name
    expected = the_mount(nominal)[1]
    np.testing.assert_allclose(mounted.T_base_arm, expected.T_base_arm, rtol=0, atol=1e-9)
    if tip == "tool0":
        np.testing.assert_allclose(mounted.T_flange_tip, expected.T_flange_tip, rtol=0, atol=1e-9)
    # Whatever stands between, the arm's chain is the robot's.
    made = chain_poses(mounted.chain_of(robot), Q)
    made = mounted.T_base_arm @ made @ mounted.T_flange_tip
    np.testing.assert_allclose(made, robot.poses(Q), rtol=0, atol=1e-14)
    if name == "ur5e":  # the new description's frames are the arm's own
        origins = [robot.urdf.joint(joint.name).T_parent_joint for joint in robot.joints]
        chain = mounted.chain_of(robot)
        np.testing.assert_allclose(chain[1:6], origins[1:6], rtol=0, atol=1e-14)


def test_a_urdf_with_rounded_angles_is_still_that_arm():
    data = ur_robot("UR5").urdf.data.replace(b"1.570796327", b"1.5708")
    robot = Robot.from_urdf(Urdf.from_bytes(data, "rounded.urdf"), "base", "tool0")
    assert recognised(robot) == ()
    model, mounted = the_mount(robot)
    assert model.name == "UR5"
    assert 1e-6 < mounted.off < 1e-5


def test_names_may_have_a_prefix():
    robot = corrected(ur_robot("UR20"))
    data = robot.urdf.data
    for name in (*(joint.name for joint in robot.joints), "base_link", "tool0"):
        data = data.replace(f'"{name}"'.encode(), f'"left_{name}"'.encode())
    urdf = Urdf.from_bytes(data, "left.urdf")
    prefixed = Robot.from_urdf(urdf, "left_base_link", "left_tool0")
    model, mounted = the_mount(prefixed)
    assert model.name == "UR20"
    np.testing.assert_allclose(mounted.T_base_arm, np.diag([-1, -1, 1, 1]), rtol=0, atol=1e-12)


def test_a_corrected_arm_with_other_names_or_too_far_off_is_refused(ur3):
    message = r"of no Universal Robots arm .* nor their links' names\. Give the arm's nominal URDF"
    with pytest.raises(ModelError, match=message):
        the_mount(renamed(corrected(ur3), "elbow", "ellbow"))
    with pytest.raises(ModelError, match=message):
        the_mount(renamed(renamed(corrected(ur3), "base", "ground"), "tool0", "end"))
    with pytest.raises(ModelError, match=message):
        the_mount(corrected(ur3, 0.1))
    with pytest.raises(ModelError, match=r"nominal kinematics of the UR5: it has those of no"):
        the_mount(corrected(ur3), ur_model("UR5"))


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


# Errors that no axis shows


def with_deltas(robot: Robot, theta=(0, 0), d=(0, 0)) -> Robot:
    """A bare UR5e with deltas of its first and last row."""
    model = ur_model("UR5e")
    columns = np.zeros((4, 6))
    columns[0, [0, 5]], columns[2, [0, 5]] = theta, d
    _, mounted = the_mount(robot, model)
    chain = (model.nominal + FullDH(*columns)).chain()
    return robot.with_placements(mounted.placements_of(chain, robot))


ENDS = {
    "zero of the first": {"theta": (0.01, 0)},
    "zero of the last": {"theta": (0, 0.02)},
    "height": {"d": (1e-3, 0)},
    "flange": {"d": (0, 2e-3)},
    "a little": {"d": (2e-6, 0)},
}


@pytest.mark.parametrize("deltas", ENDS.values(), ids=ENDS)
@pytest.mark.parametrize(
    ("base", "tip"), [("base", "tool0"), ("base_link", "wrist_3_link"), ("base_link", "tool0")]
)
def test_a_calibration_of_the_first_or_last_row_alone_is_not_nominal(deltas, base, tip):
    robot = ur_robot("UR5e").rebuilt(base=base, tip=tip)
    calibrated = with_deltas(robot, **deltas)
    assert recognised(robot) != ()
    assert recognised(calibrated) == ()
    model, mounted = the_mount(calibrated)
    assert model.name == "UR5e"
    assert max(mounted.off, mounted.turned) > 1e-6
    assert mounted.turned == pytest.approx(sum(deltas.get("theta", (0, 0))), abs=1e-6)
    # The base and the flange stay, and the arm has the error.
    nominal = the_mount(robot)[1]
    np.testing.assert_allclose(mounted.T_base_arm, nominal.T_base_arm, rtol=0, atol=1e-12)
    np.testing.assert_allclose(mounted.T_flange_tip, nominal.T_flange_tip, rtol=0, atol=1e-12)
    made = mounted.T_base_arm @ chain_poses(mounted.chain_of(calibrated), Q) @ mounted.T_flange_tip
    np.testing.assert_allclose(made, calibrated.poses(Q), rtol=0, atol=1e-13)


@pytest.mark.parametrize("joint", ["base_link-base_fixed_joint", "flange-tool0"])
def test_a_base_or_flange_that_was_moved_by_itself_is_not_nominal(joint):
    bare = ur_robot("UR5e")
    T = np.array(bare.urdf.joint(joint).T_parent_joint)
    T[:3, 3] += [1e-3, 0, 2e-3]
    moved = Robot.from_urdf(bare.urdf.with_origins({joint: T}), "base", "tool0")
    assert recognised(moved) == ()
    _, mounted = the_mount(moved)
    np.testing.assert_allclose(mounted.T_base_arm, np.eye(4), rtol=0, atol=1e-12)
    np.testing.assert_allclose(mounted.T_flange_tip, np.eye(4), rtol=0, atol=1e-12)
    # Nor between links that were not moved: two links with one meaning do not agree.
    assert recognised(moved.rebuilt(base="base_link", tip="wrist_3_link")) == ()
