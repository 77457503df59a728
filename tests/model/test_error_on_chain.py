"""Errors of limbs on chains that pass them upwards or share them, against differences and the corrected URDF."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from calib.basics.arrays import Array
from calib.data.cell_chains import robot_of_cell
from calib.errors import ModelError
from calib.model.error_on_chain import model_on_chain
from calib.model.kinematics import Kinematics, Samples
from calib.model.parameter_sets import error_model
from calib.robot.gravity import gravity_loads
from calib.robot.robot import Robot
from calib.robot.urdf import read_urdf
from tests.two_handed import CELL

#: Base and tip of chains of a robot with two arms and a head: two down, one up and down, one from hand to hand, one
#: that ends in the middle of an arm.
ENDS = (
    ("base_footprint", "arm_left_7_link"),
    ("base_footprint", "arm_right_7_link"),
    ("head_2_link", "arm_right_7_link"),
    ("arm_left_7_link", "arm_right_7_link"),
    ("head_2_link", "arm_left_5_link"),
)

#: Poses of each chain.
COUNT = 3

DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot.from_urdf(read_urdf("tiago_dual"), *ENDS[0], branches=ENDS[1:])


@pytest.fixture(scope="module")
def samples(robot: Robot) -> Samples:
    rng = np.random.default_rng(1)
    q = rng.uniform(-0.8, 0.8, (COUNT * len(ENDS), len(robot.joint_names)))
    first = np.zeros(len(q), dtype=np.int_)
    return Samples(q, first, first, gravity_loads(robot, q), chain=np.arange(len(q)) % len(ENDS))


def kinematics_of(robot: Robot, name: str) -> Kinematics:
    model = error_model(robot, name, frame={"f": DIRECTIONS}, targets=("t",))
    return Kinematics(robot, model, np.eye(4), np.eye(4))


def errors_of(kinematics: Kinematics) -> Array:
    """Errors of 5 mm and 5 mrad, those of compliances so that joints bend as much."""
    rng = np.random.default_rng(2)
    x = 5e-3 * rng.standard_normal(len(kinematics.model))
    bends = kinematics.model.family("compliance", "gravity")
    return np.where(bends, 1e-2 * x, x)


def test_each_column_is_the_difference_quotient_on_every_chain(robot: Robot, samples: Samples):
    kinematics = kinematics_of(robot, "placement+gain+compliance+gravity")
    x = errors_of(kinematics)
    poses, twists = kinematics.twists(x, samples)
    assert np.allclose(poses, kinematics.poses(x, samples), rtol=0.0, atol=1e-14)
    step = 1e-6
    for k in range(len(x)):
        change = np.zeros(len(x))
        change[k] = step
        slope = kinematics.poses(x + change, samples) - kinematics.poses(x - change, samples)
        slope /= 2.0 * step
        spin = slope[:, :3, :3] @ poses[:, :3, :3].swapaxes(1, 2)
        angular = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        assert np.allclose(twists[:, :3, k], slope[:, :3, 3], rtol=0.0, atol=2e-8)
        assert np.allclose(twists[:, 3:, k], angular, rtol=0.0, atol=2e-8)


def test_the_corrected_urdf_has_the_same_poses_on_every_chain(robot: Robot, samples: Samples):
    model = error_model(robot, "placement", target=False)
    kinematics = Kinematics(robot, model, np.eye(4), np.eye(4))
    x = errors_of(kinematics)
    corrected = model.apply(robot, x)
    expected = kinematics.poses(x, samples)
    assert np.allclose(corrected.poses(samples.q, samples.chain), expected, rtol=0.0, atol=1e-13)
    assert np.abs(robot.poses(samples.q, samples.chain) - expected).max() > 0.01
    # As Pinocchio alone reads it.
    read = pin.buildModelFromXML(corrected.urdf.data.decode())
    data = read.createData()
    for q, chain, pose in zip(samples.q, samples.chain, expected, strict=True):
        configuration = pin.neutral(read)
        for name, value in zip(robot.joint_names, q, strict=True):
            configuration[read.joints[read.getJointId(name)].idx_q] = value
        pin.framesForwardKinematics(read, data, configuration)
        base, tip = (data.oMf[read.getFrameId(link)] for link in ENDS[chain])
        assert np.allclose((base.inverse() * tip).homogeneous, pose, rtol=0.0, atol=1e-12)


def test_the_corrected_urdf_has_a_further_robot_where_it_stands():
    """Its mount displaced by 5 mm and 5 mrad, or as it was if it stands as stated."""
    robot = robot_of_cell(read_urdf("panda"), CELL)
    model = error_model(robot, "placement", target=False)
    kinematics = Kinematics(robot, model, np.eye(4), np.eye(4))
    x = errors_of(kinematics)
    rng = np.random.default_rng(3)
    q = rng.uniform(-0.8, 0.8, (6, len(robot.joint_names)))
    first = np.zeros(6, dtype=np.int_)
    samples = Samples(q, first, first, chain=np.arange(6) % 2)
    expected = kinematics.poses(x, samples)
    corrected = model.apply(robot, x)
    assert np.allclose(corrected.poses(q, samples.chain), expected, rtol=0.0, atol=1e-13)
    of_mount = np.array([parameter.place == "right/mount" for parameter in model.parameters])
    assert np.sum(of_mount) == 6
    of_arms = model.apply(robot, np.where(of_mount, 0.0, x))
    stated = robot.urdf.joint("right/mount").T_parent_joint
    np.testing.assert_array_equal(of_arms.urdf.joint("right/mount").T_parent_joint, stated)


def test_a_chain_by_itself_and_among_others_is_the_same(robot: Robot, samples: Samples):
    alone = Robot.from_urdf(robot.urdf, *ENDS[0])
    columns = [robot.joint_names.index(name) for name in alone.joint_names]
    of_chain = samples.select(samples.rows_of_chain(0))
    one, several = kinematics_of(alone, "placement"), kinematics_of(robot, "placement")
    x = errors_of(several)
    own = [several.model.index(name) for name in one.model.names]
    on_own = replace(of_chain, q=of_chain.q[:, columns], load=None, chain=None)
    poses, twists = one.twists(x[own], on_own)
    expected_poses, expected_twists = several.twists(x, of_chain)
    assert np.allclose(poses, expected_poses, rtol=0.0, atol=1e-15)
    assert np.allclose(twists, expected_twists[:, :, own], rtol=0.0, atol=1e-15)
    others = np.setdiff1d(np.arange(len(x)), own)
    assert not expected_twists[:, :, others].any()


def test_limbs_have_each_error_once(robot: Robot):
    assert [limb.tip for limb in robot.limbs] == [
        "arm_left_7_link",
        "arm_right_7_link",
        "head_2_link",
    ]
    names = error_model(robot, "placement", target=False).names
    assert len(names) == len(set(names)) == 6 * len(robot.all_joints)
    assert names.count("torso_lift_joint.x") == 1
    assert model_on_chain(error_model(robot.chains[0], "dh"), robot.chains[0], robot).name == "dh"
    with pytest.raises(ModelError, match="placement"):
        error_model(robot, "dh")
