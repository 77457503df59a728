"""Which arm of UFACTORY or Flexiv a robot's URDF is, with any prefix, nominal or calibrated."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib.errors import ModelError
from calib.robot.arm_models import ARMS, arm_model, arm_urdf
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.verbs.convert.joint_arms import (
    NumberedJoints,
    arm_robot,
    check_arm,
    flange_distance,
    is_nominal,
    known_arm,
)


def prefixed(robot: Robot, prefix: str) -> Robot:
    """The same robot, with a prefix before every name of a link or joint."""
    text = robot.urdf.data.decode()
    for name in (*robot.urdf.links, *(joint.name for joint in robot.urdf.joints)):
        text = text.replace(f'"{name}"', f'"{prefix}{name}"')
    urdf = Urdf.from_bytes(text.encode(), "prefixed")
    return Robot.from_urdf(urdf, prefix + robot.base, prefix + robot.tip)


def displaced(robot: Robot, size: float) -> Robot:
    twists = np.random.default_rng(2).normal(size=(len(robot.placements), 6)) * size
    pairs = zip(robot.placements, twists, strict=True)
    return robot.with_placements(np.array([P @ pin.exp6(t).homogeneous for P, t in pairs]))


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_every_arm_is_recognised(arm):
    robot = displaced(prefixed(arm_robot(arm), "left_"), 1e-3)
    numbered = NumberedJoints.of(robot)
    assert numbered is not None
    assert (numbered.prefix, len(numbered.joints)) == ("left_", len(arm.axes))
    assert known_arm(robot) is arm
    assert [is_nominal(r) for r in (robot, prefixed(arm_robot(arm), "left_"))] == [False, True]
    check_arm(robot, arm)
    for other in ARMS:
        if other is not arm and len(other.axes) != len(arm.axes):
            with pytest.raises(ModelError, match=other.name):
                check_arm(robot, other)


def test_other_robots_are_none_of_them(ur3):
    assert NumberedJoints.of(ur3) is None
    assert known_arm(ur3) is None
    arm = arm_model("xArm6")
    assert known_arm(arm_robot(arm).rebuilt(tip="link5")) is None
    far = displaced(arm_robot(arm), 0.2)
    assert known_arm(far) is None
    with pytest.raises(ModelError, match="--arm"):
        check_arm(far, arm)
    # An arm that turns about y where Flexiv's turns about z is another one.
    text = arm_urdf(arm_model("Rizon4")).replace(b'<axis xyz="0 1 0"/>', b'<axis xyz="0 0 1"/>')
    assert known_arm(Robot.from_urdf(Urdf.from_bytes(text, "z"), "base_link", "flange")) is None


def test_how_far_apart_two_flanges_are():
    short, long = (arm_robot(arm_model(name)) for name in ("Rizon4", "Rizon4s"))
    assert flange_distance(short, long) == pytest.approx(0.043, abs=1e-9)
