from __future__ import annotations

import dataclasses
import re

import numpy as np
import pinocchio as pin
import pytest

from calib.errors import UrdfError
from calib.robot.ranges import (
    random_joint_values,
)
from calib.robot.readback import check_written
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf


def corrected(robot: Robot, size: float = 5e-3) -> Robot:
    rng = np.random.default_rng(2)
    moved = robot.placements.copy()
    for i, carrier in enumerate(robot.carriers):
        if carrier is not None:
            moved[i] = moved[i] @ pin.exp6(rng.normal(0, size, 6)).homogeneous
    return robot.with_placements(moved)


@pytest.mark.parametrize(
    ("name", "base", "tip", "held"),
    [
        ("tiago_no_hand", "xtion_rgb_optical_frame", "wrist_ft_tool_link", {}),
        ("tiago_no_hand", "xtion_rgb_optical_frame", "wrist_ft_tool_link", {"head_1_joint": 0.3}),
        ("tiago_no_hand", None, "wrist_ft_tool_link", {"torso_lift_joint": 0.2}),
        ("baxter", "right_gripper", "left_gripper", {}),
        ("ur3", "tool0", "base", {"elbow_joint": -1.0}),
        ("panda", "panda_link0", "panda_rightfinger", {}),
        ("panda", "panda_leftfinger", "panda_rightfinger", {}),
        ("panda", "panda_link0", "panda_rightfinger", {"panda_finger_joint1": 0.02}),
        ("pr2", "head_plate_frame", "r_gripper_l_finger_tip_link", {}),
        ("tiago_pro", "head_2_link", "gripper_right_fingertip_left_link", {}),
    ],
)
def test_columns_that_move_several_joints_and_a_base_that_moves_pass(name, base, tip, held):
    robot = Robot.load(name, base, tip, held=held)
    q = random_joint_values(robot)
    new = corrected(robot)
    check_written(new, new.poses(q), q)
    with pytest.raises(UrdfError, match=r"read back by Pinocchio, has .* It is not writt"):
        check_written(new, robot.poses(q), q)


NAMELESS = b"<robot"
NAMESPACE = b'<robot name="ur3" xmlns="http://example.org/robot"'


@pytest.mark.parametrize("start", [NAMESPACE, NAMELESS])
def test_a_file_that_pinocchio_or_others_refuse_is_read_back_too(ur3, start):
    data = re.sub(rb"<robot\b[^>]*", start, ur3.urdf.data, count=1)
    robot = Robot.from_urdf(Urdf.from_bytes(data, "ur3.urdf"), ur3.base, ur3.tip)
    q = random_joint_values(robot)
    new = corrected(robot)
    assert start in new.urdf.data
    check_written(new, new.poses(q), q)
    # and still sees a fault
    wrong = dataclasses.replace(new, urdf=robot.urdf)
    with pytest.raises(UrdfError, match="read back by Pinocchio"):
        check_written(wrong, new.poses(q), q)


def test_calib_itself_reads_the_file_too(ur3, monkeypatch):
    q = random_joint_values(ur3)
    new = corrected(ur3)
    elsewhere = dataclasses.replace(new, urdf=ur3.urdf)
    monkeypatch.setattr("calib.robot.readback._poses_by_pinocchio", lambda *_: new.poses(q))
    with pytest.raises(UrdfError, match="read back by calib, has"):
        check_written(elsewhere, new.poses(q), q)


@pytest.mark.parametrize("joint", ["shoulder_pan_joint", "wrist_3_link-tool0_fixed_joint"])
@pytest.mark.parametrize("twist", [(2e-9, 0, 0, 0, 0, 0), (0, 0, 0, 0, 2e-8, 0)])
def test_an_origin_that_was_tampered_with_is_refused(ur3, joint, twist):
    origin = ur3.urdf.joint(joint).T_parent_joint @ pin.exp6(np.array(twist)).homogeneous
    tampered = dataclasses.replace(ur3, urdf=ur3.urdf.with_origins({joint: origin}))
    q = random_joint_values(ur3)
    with pytest.raises(
        UrdfError, match=r"read back by Pinocchio, has .* rad away.*1e-09 is allowed"
    ):
        check_written(tampered, ur3.poses(q), q)
