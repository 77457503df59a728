"""Parameters that stay nominal, by the name of a parameter, a joint or a link."""

import numpy as np
import pytest

from calib.model.frozen import frozen_parameters
from calib.model.parameter_sets import error_model
from calib.robot.robot import Robot


@pytest.fixture(scope="module")
def arm() -> Robot:
    return Robot.load("ur3", base="base", tip="tool0")


def frozen(arm: Robot, model: str, *names: str) -> set[str]:
    return {*frozen_parameters(arm, error_model(arm, model).parameters, names)}


def test_parameters_are_themselves_and_unknown_names_stay(arm):
    names = ("theta3", "nothing", "theta3", "target_x")
    parameters = error_model(arm, "dh").parameters
    assert frozen_parameters(arm, parameters, names) == ("theta3", "nothing", "target_x")


def test_a_joint_is_all_that_moves_its_origin_and_its_own_state(arm):
    elbow = {f"elbow_joint.{direction}" for direction in ("x", "y", "z", "rx", "ry", "rz")}
    assert frozen(arm, "placement+gain+lost_motion", "elbow_joint") == {
        *elbow,
        "elbow_joint.gain",
        "elbow_joint.lost_motion",
    }
    # Row 2 ends, and row 3 begins, at the origin of joint 3.
    assert frozen(arm, "dh", "elbow_joint") == {"a2", "alpha2", "d3", "theta3"}
    assert frozen(arm, "zeros+gain", "elbow_joint") == {"elbow_joint.zero", "elbow_joint.gain"}


def test_a_link_is_its_shape_without_the_zeros_of_its_joints(arm):
    # The elbow is mounted on the upper arm; its axis is y.
    assert frozen(arm, "placement+gain", "upper_arm_link") == {
        f"elbow_joint.{direction}" for direction in ("x", "y", "z", "rx", "rz")
    }
    assert frozen(arm, "zeros+gain", "upper_arm_link") == set()


def test_a_frozen_joint_keeps_its_origin(arm):
    model = error_model(arm, "placement", target=False)
    kept = model.without(frozen_parameters(arm, model.parameters, ["elbow_joint"]))
    x = 1e-3 * np.ones(len(kept))
    corrected = kept.apply(arm, x).urdf
    for joint in arm.joints:
        before = arm.urdf.joint(joint.name).T_parent_joint
        moved = np.abs(corrected.joint(joint.name).T_parent_joint - before).max()
        assert (moved == 0.0) == (joint.name == "elbow_joint")


def test_the_fixed_joint_that_carries_the_tip_is_a_joint_as_well(arm):
    names = frozen(arm, "dh", arm.carriers[-1])
    assert names == {"a6", "alpha6"}
