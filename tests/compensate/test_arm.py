from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calib.identify.stored import StoredLarger

from calib.compensate.arm import Arm
from calib.compensate.matching import Matching
from calib.identify.evaluation import Known
from calib.model.error_model import error_model
from calib.model.kinematics import Kinematics, Samples
from calib.model.readback import random_joint_values
from calib.model.robot import Robot, read_only
from calib.model.torques import GRAVITY, Payload, gravity_load
from tests.compensate.arms import off, turned

#: Chains that are more than a serial arm on a base: name, base, tip.
CHAINS = {
    "ur3": ("ur3", "base", "tool0"),
    "continuous": ("kinova", None, "j2s6s200_end_effector"),
    "two branches": ("tiago_no_hand", "xtion_rgb_optical_frame", "wrist_ft_tool_link"),
    "mimic and prismatic": ("panda", "panda_link0", "panda_leftfinger"),
    "turned round": ("ur3", "wrist_3_link", "base"),
}


def larger(robot: Robot, families: str, seed: int = 3) -> StoredLarger:
    """A larger model with errors drawn."""
    model = error_model(robot, "zeros" + families, target=False)
    sizes = {"m": 5e-4, "rad": 2e-3, "1": 1e-3, "m/m": 1e-3, "rad/Nm": 1e-5, "m/N": 1e-6}
    rng = np.random.default_rng(seed)
    x = {p.name: float(rng.normal() * sizes[p.unit]) for p in model.parameters}
    nowhere = Known({"": np.eye(4)}, {"": np.eye(4)})
    payload = Payload(3.0, read_only([0.02, 0.0, 0.1]))
    return StoredLarger(model.name, x, {}, nowhere, payload, read_only(GRAVITY))


def differences(arm: Arm, q: np.ndarray, step: float = 1e-6) -> np.ndarray:
    """How the tool moves with each joint, by central differences."""
    now = arm.poses(q)
    columns = []
    for c in range(q.shape[1]):
        d = np.zeros(q.shape[1])
        d[c] = step
        ahead, behind = (Matching("pose", 1.0).error(now, arm.poses(q + s * d)) for s in (1, -1))
        columns.append((ahead - behind) / (2.0 * step))
    return np.stack(columns, axis=2)


@pytest.mark.parametrize("case", CHAINS)
def test_the_motion_of_any_chain_is_its_difference(case):
    robot = Robot.load(*CHAINS[case])
    arm = Arm.of_robot(robot, turned(2))
    q = random_joint_values(robot, 4)
    poses, twists = arm.motion(q)
    assert poses == pytest.approx(robot.poses(q) @ turned(2), abs=1e-12)
    assert twists == pytest.approx(differences(arm, q), abs=2e-9)


@pytest.mark.parametrize("families", ["+gain+eccentricity", "+gain+eccentricity+compliance"])
@pytest.mark.parametrize("case", ["ur3", "mimic and prismatic", "two branches"])
def test_joints_that_err_with_their_state(case, families):
    robot = Robot.load(*CHAINS[case])
    found = larger(robot, families)
    arm = Arm.of_larger(found, robot, turned(2))
    q = random_joint_values(robot, 4)
    poses, twists = arm.motion(q)
    # By another path: the kinematics that the fit took.
    load = gravity_load(robot, q, found.payload, found.gravity)
    expected = found.tip_poses(robot, Samples.at(q, load)) @ turned(2)
    assert poses == pytest.approx(expected, abs=1e-12)
    # The load changes with q too, which is left out: a part in a thousand.
    scale = np.abs(twists).max()
    tolerance = 1e-3 * scale if "compliance" in families else 2e-9
    assert twists == pytest.approx(differences(arm, q), abs=tolerance)


def test_the_payload_that_is_given_wins(ur3):
    found = larger(ur3, "+compliance")
    q = random_joint_values(ur3, 5)
    heavy = Payload(20.0)
    arm = Arm.of_larger(found, ur3, np.eye(4), heavy)
    assert arm.poses(q) == pytest.approx(
        Arm.of_larger(replace(found, payload=heavy), ur3, np.eye(4)).poses(q), abs=1e-15
    )
    assert np.abs(arm.poses(q) - Arm.of_larger(found, ur3, np.eye(4)).poses(q)).max() > 1e-5


def test_a_calibrated_robot_is_an_arm_too(ur3):
    true = off(ur3)
    q = random_joint_values(ur3, 5)
    model = error_model(ur3, "placement", target=False)
    x = np.random.default_rng(1).normal(size=len(model))
    x *= np.where(np.array(model.units) == "m", 0.5e-3, 2e-3)
    straight = Kinematics(ur3, model, np.eye(4), np.eye(4)).poses(x, q)
    assert Arm.of_robot(true, np.eye(4)).poses(q) == pytest.approx(straight, abs=1e-12)
