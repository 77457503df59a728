from __future__ import annotations

import pytest

from calib.errors import UrdfError
from calib.model.chain import farthest_link
from calib.model.robot import Robot
from calib.model.urdf import Urdf, find_urdf

# What a tip below the base is, is tested in test_robot.py.


@pytest.fixture(scope="module")
def tiago() -> Urdf:
    return Urdf.read(find_urdf("tiago_no_hand"))


ARM = [f"arm_{i}_joint" for i in range(1, 8)]


def test_where_nothing_moves_below_the_base_the_way_leads_over_the_fork(tiago):
    robot = Robot.from_urdf(tiago, "xtion_rgb_optical_frame")
    names = ("head_2_joint", "head_1_joint", *ARM)
    assert robot.joint_names[: len(names)] == names


def test_measured_joints_lead_over_the_fork_too(tiago):
    head = ["head_1_joint", "head_2_joint"]
    robot = Robot.from_urdf(tiago, "xtion_rgb_optical_frame", measured=[*head, *ARM[:4]])
    assert robot.joint_names == (*head[::-1], *ARM[:4])
    # and without the head's no further than the arm's own mount, which does not move: all joints count then
    robot = Robot.from_urdf(tiago, "xtion_rgb_optical_frame", measured=ARM)
    assert set(ARM) < set(robot.joint_names)


def test_a_tip_turned_round_has_the_base_at_its_end():
    assert Robot.load("ur3", base="tool0").joint_names[-1] == "shoulder_pan_joint"


def test_held_joints_lead_on_but_do_not_count(tiago):
    measured = [*ARM, "head_1_joint"]
    assert farthest_link(tiago, tiago.root, measured) in tiago.links
    held = {"torso_lift_joint": 0.1}
    tip = farthest_link(tiago, tiago.root, ARM[:1], held)
    assert Robot.from_urdf(tiago, tip=tip, held=held).joint_names == ("arm_1_joint",)


def test_a_robot_without_moving_joints_has_its_base_for_a_tip():
    urdf = Urdf.read(find_urdf("iris_simple"))
    assert farthest_link(urdf, urdf.root) in urdf.links


def test_a_base_that_is_no_link(tiago):
    with pytest.raises(UrdfError, match="no link 'xtion'"):
        farthest_link(tiago, "xtion")
