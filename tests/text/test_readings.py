"""Coupled readings in words: every joint, factor and sign."""

from __future__ import annotations

from calib.robot.robot import Robot
from calib.text.readings import coupling_sentence


def test_every_coupling_is_named(ur3: Robot):
    assert coupling_sentence(ur3) == ""
    coupling = {
        "elbow_joint": {"shoulder_lift_joint": -1.0},
        "wrist_3_joint": {"wrist_1_joint": 1.0, "wrist_2_joint": -0.025},
    }
    robot = Robot.from_urdf(ur3.urdf, ur3.base, ur3.tip, coupling=coupling)
    assert coupling_sentence(robot) == (
        "Coupled readings: 'elbow_joint' is at its reading minus that of 'shoulder_lift_joint'; 'wrist_3_joint' is at "
        "its reading plus that of 'wrist_1_joint' minus 0.025 times that of 'wrist_2_joint'."
    )
