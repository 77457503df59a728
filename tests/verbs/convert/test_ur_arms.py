"""The arms of Universal Robots: rows, poses, hashes and bare URDFs against published ones, and mounts by link names."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib.errors import ModelError
from calib.robot.robot import Robot
from calib.robot.ur_models import MODELS, chain_of_rows, ur_model
from calib.robot.urdf import Urdf
from calib.verbs.convert.ur_arms import (
    at_flange,
    chain_poses,
    distance_from,
    kinematics_hash,
    the_mount,
    ur_robot,
)
from tests.verbs.convert.ur_cases import CALIBRATIONS, CASES, rows

Q = np.random.default_rng(6).uniform(-2 * np.pi, 2 * np.pi, (100, 6))


by_name = pytest.mark.parametrize("case", CALIBRATIONS, ids=lambda case: case["name"])


@by_name
def test_poses_and_hash_of_factory_calibrations(case):
    full = rows(case["full_dh"])
    poses = chain_poses(chain_of_rows(full), case["fk"]["q"])
    np.testing.assert_allclose(poses, case["fk"]["T"], rtol=0, atol=1e-12)
    assert kinematics_hash(full) == case["driver_hash"]


@pytest.mark.parametrize("case", CASES["flange_positions"], ids=lambda case: case["test"][:22])
def test_universal_robots_own_test_points(case):
    pose = chain_poses(chain_of_rows(rows(case["dh"])), case["q"])[0]
    np.testing.assert_allclose(pose[:3, 3], case["xyz"], rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", CASES["models"]["rows"])
def test_the_driver_s_hash_of_nominal_arms(name):
    # The hashes that Universal Robots publishes with its default kinematics.
    given = CASES["models"]["rows"][name]
    assert kinematics_hash(rows(given)) == given["default_hash"]
    assert kinematics_hash(ur_model(name).rows) == given["default_hash"]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_the_bare_urdf_has_the_rows_poses(model):
    robot = ur_robot(model)
    wanted = chain_poses(chain_of_rows(model.rows), Q)
    np.testing.assert_allclose(robot.poses(Q), wanted, rtol=0, atol=1e-12)
    mounted = the_mount(robot, model)
    assert mounted.nominal
    np.testing.assert_allclose(mounted.T_base_arm, np.eye(4), rtol=0, atol=1e-12)


@by_name
def test_the_frame_of_joint_six_is_brought_to_the_flange(case):
    chain = chain_of_rows(rows(case["full_dh"]))
    result = at_flange(chain)
    np.testing.assert_allclose(chain_poses(result, Q), chain_poses(chain, Q), rtol=0, atol=1e-9)
    assert result[6, 2, 3] == pytest.approx(0.0, abs=1e-12)
    assert result[6, 1, 0] == pytest.approx(result[6, 0, 1], abs=1e-9)


# Mounts


NEAR = np.random.default_rng(8).uniform(-np.pi, np.pi, (20, 6))


def arm_poses(mounted, robot: Robot) -> np.ndarray:
    """The robot's poses by the arm's chain."""
    made = chain_poses(mounted.chain_of(robot), NEAR)
    return mounted.T_base_arm @ made @ mounted.T_flange_tip


@pytest.mark.parametrize(
    ("name", "base", "tip", "arm"),
    [
        ("UR16e", "base", "tool0", "UR16e"),
        ("UR16e", "base_link_inertia", "wrist_3_link", "UR16e"),
        ("UR16e", "base_link", "flange", "UR16e"),
        ("ur3", "base_link", "ee_link", "UR3"),
        ("ur5", "base", "tool0", "UR5"),
        ("ur10", "world", "wrist_3_link", "UR10"),
        ("ur5_gripper", "base_link", "tool0", "UR5"),
    ],
)
def test_any_base_and_tip_of_the_descriptions(name, base, tip, arm):
    robot = (
        Robot.load(name, base, tip)
        if name.islower()
        else ur_robot(name).rebuilt(base=base, tip=tip)
    )
    mounted = the_mount(robot)
    assert (mounted.model.name, mounted.nominal) == (arm, True)
    nominal = chain_poses(chain_of_rows(mounted.model.rows), NEAR)
    poses = mounted.T_base_arm @ nominal @ mounted.T_flange_tip
    np.testing.assert_allclose(robot.poses(NEAR), poses, rtol=0, atol=1e-8)
    chain = mounted.chain_of(robot)
    back = mounted.placements_of(chain, robot)
    np.testing.assert_allclose(back, robot.placements, rtol=0, atol=1e-14)


def corrected(robot: Robot, size: float = 1e-3) -> Robot:
    """The robot with every origin of its joints displaced."""
    twists = np.random.default_rng(3).normal(size=(7, 6)) * size
    if robot.carriers[6] is None:
        twists[6] = 0.0
    pairs = zip(robot.placements, twists, strict=True)
    return robot.with_placements(np.array([P @ pin.exp6(t).homogeneous for P, t in pairs]))


@pytest.mark.parametrize("name", ["ur3", "ur5e"])
@pytest.mark.parametrize(("base", "tip"), [("base", "tool0"), ("base_link", "wrist_3_link")])
def test_the_base_and_flange_of_a_corrected_arm_are_found_by_name(name, base, tip, ur3):
    nominal = (ur3 if name == "ur3" else ur_robot(name)).rebuilt(base=base, tip=tip)
    robot = corrected(nominal)
    mounted, expected = the_mount(robot), the_mount(nominal)
    assert not mounted.nominal
    assert mounted.model.name.lower() == name
    np.testing.assert_allclose(mounted.T_base_arm, expected.T_base_arm, rtol=0, atol=1e-9)
    if tip == "tool0":
        np.testing.assert_allclose(mounted.T_flange_tip, expected.T_flange_tip, rtol=0, atol=1e-9)
    np.testing.assert_allclose(arm_poses(mounted, robot), robot.poses(NEAR), rtol=0, atol=1e-14)
    if name == "ur5e":  # the new description's frames are the arm's own
        origins = [robot.urdf.joint(joint.name).T_parent_joint for joint in robot.joints]
        chain = mounted.chain_of(robot)
        np.testing.assert_allclose(chain[1:6], origins[1:6], rtol=0, atol=1e-14)


def test_names_may_have_a_prefix():
    robot = corrected(ur_robot("UR20"))
    data = robot.urdf.data
    for name in (*(joint.name for joint in robot.joints), "base_link", "tool0"):
        data = data.replace(f'"{name}"'.encode(), f'"left_{name}"'.encode())
    urdf = Urdf.from_bytes(data, "left.urdf")
    mounted = the_mount(Robot.from_urdf(urdf, "left_base_link", "left_tool0"))
    assert mounted.model.name == "UR20"
    np.testing.assert_allclose(mounted.T_base_arm, np.diag([-1, -1, 1, 1]), rtol=0, atol=1e-12)


def test_robots_that_are_no_such_arm(panda, ur3):
    assert the_mount(ur_robot("UR7e"), ur_model("UR7e")).model.name == "UR7e"
    urdf = Urdf.from_bytes(ur3.urdf.data.replace(b"elbow", b"ellbow"), "renamed.urdf")
    held = Robot.from_urdf(ur3.urdf, "base", "tool0", held={"elbow_joint": 0.3})
    renamed = Robot.from_urdf(urdf, "base", "tool0")
    five = ur3.rebuilt(base="shoulder_link")
    for robot in (panda, five, held, renamed, corrected(ur3, 0.1)):
        with pytest.raises(ModelError, match="is not an arm of Universal Robots"):
            the_mount(robot)
    with pytest.raises(ModelError, match="is not a UR5"):
        the_mount(ur3, ur_model("UR5"))


@pytest.mark.parametrize(("row", "column"), [(0, 0), (5, 0), (0, 2), (5, 2)])
@pytest.mark.parametrize(("base", "tip"), [("base", "tool0"), ("base_link", "wrist_3_link")])
def test_a_calibration_of_the_first_or_last_row_alone_is_not_nominal(row, column, base, tip):
    """No axis shows such an error: the base and the flange stay, and the arm has it."""
    robot = ur_robot("UR5e").rebuilt(base=base, tip=tip)
    nominal, deltas = the_mount(robot), np.zeros((6, 4))
    deltas[row, column] = 2e-3
    chain = chain_of_rows(ur_model("UR5e").rows + deltas)
    calibrated = robot.with_placements(nominal.placements_of(chain, robot))
    mounted = the_mount(calibrated)
    assert not mounted.nominal
    np.testing.assert_allclose(mounted.T_base_arm, nominal.T_base_arm, rtol=0, atol=1e-12)
    np.testing.assert_allclose(mounted.T_flange_tip, nominal.T_flange_tip, rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        arm_poses(mounted, calibrated), calibrated.poses(NEAR), rtol=0, atol=1e-13
    )


def test_the_distance_is_that_of_the_flange():
    arm = ur_model("UR5e")
    chain = np.array(arm.chain)
    assert distance_from(chain, arm) == 0.0
    chain[0, 2, 3] += 3e-3  # the whole arm stands higher
    assert distance_from(chain, arm) == pytest.approx(3e-3, rel=1e-9)
