"""One URDF of two robots, read by Pinocchio, and each robot's own URDF back from it."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from calib.errors import UrdfError
from calib.numerics.geometry import pose_of
from calib.robot.joined_urdf import Part, joined_urdf, path_of_robot
from calib.robot.robot import Robot
from calib.robot.urdf import read_urdf

MOUNT = pose_of(xyz=[1.1, 0.2, 0.05], rotation=pin.exp3(np.array([0.05, -0.02, 2.8])))


def test_pinocchio_finds_the_second_robot_on_its_mount():
    panda, ur3 = read_urdf("panda"), read_urdf("ur3")
    parts = (Part("right", ur3),)
    joined = joined_urdf(panda, parts, {"right": MOUNT})
    model = pin.buildModelFromXML(joined.data.decode())
    own = pin.buildModelFromXML(ur3.data.decode())
    rng = np.random.default_rng(0)
    q = rng.uniform(-1.0, 1.0, own.nq)
    values = pin.neutral(model)
    for name, value in zip(own.names[1:], q, strict=True):
        values[model.joints[model.getJointId(f"right/{name}")].idx_q] = value
    data, own_data = model.createData(), own.createData()
    pin.framesForwardKinematics(model, data, values)
    pin.framesForwardKinematics(own, own_data, q)
    expected = MOUNT @ own_data.oMf[own.getFrameId("tool0")].homogeneous
    found = data.oMf[model.getFrameId("right/tool0")].homogeneous
    assert np.allclose(found, expected, rtol=0.0, atol=1e-12)
    assert joined.data.startswith(panda.data[:1000])


def test_a_chain_leads_from_hand_to_hand_and_each_gets_its_own_origins():
    panda = read_urdf("panda")
    parts = (Part("", panda, estimated=False), Part("right", panda))
    joined = joined_urdf(panda, parts[1:], {"right": MOUNT})
    robot = Robot.from_urdf(joined, "panda_link8", "right/panda_link8", parts=parts)
    assert robot.mounts == ("right/mount",)
    assert robot.is_tree
    assert [limb.tip for limb in robot.limbs] == ["panda_link8", "right/panda_link8"]
    placements = [limb.placements.copy() for limb in robot.limbs]
    placements[1][2, 0, 3] += 1e-3
    moved = robot.with_limbs(placements, {"right/mount": np.eye(4)})
    own = moved.own_urdfs()
    assert own[""].data == panda.data
    before = panda.joint("panda_joint3").T_parent_joint
    after = own["right"].joint("panda_joint3").T_parent_joint
    assert np.allclose(after[:3, 3] - before[:3, 3], [1e-3, 0.0, 0.0], rtol=0.0, atol=1e-15)
    assert np.array_equal(moved.urdf.joint("right/mount").T_parent_joint, np.eye(4))


@pytest.mark.parametrize("names", [("a", "a"), ("",)])
def test_each_robot_needs_a_name_of_its_own(names: tuple[str, ...]):
    panda = read_urdf("panda")
    parts = tuple(Part(name, panda) for name in names)
    with pytest.raises(UrdfError, match="name"):
        joined_urdf(panda, parts, dict.fromkeys(names, np.eye(4)))


def test_a_name_that_the_first_robot_has_is_refused():
    panda = read_urdf("panda")
    first = joined_urdf(panda, (Part("right", panda),), {"right": MOUNT})
    with pytest.raises(UrdfError, match="'right'"):
        joined_urdf(first, (Part("right", panda),), {"right": MOUNT})


def test_the_urdf_of_each_robot_is_beside_that_of_the_cell():
    assert path_of_robot("out/cell.urdf", "right") == Path("out/cell_right.urdf")
    assert path_of_robot("out/cell.urdf", "") == Path("out/cell_first.urdf")
