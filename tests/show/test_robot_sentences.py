"""Coupled readings in words: every joint, factor and sign."""

from __future__ import annotations

from calib.example import dh_rows
from calib.robot.robot import Robot
from calib.show.robot_sentences import coupling_sentence, rows_sentence


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


def test_the_convention_of_rows_is_named(ur3: Robot):
    assert rows_sentence(ur3) == ""
    said = rows_sentence(Robot.load(dh_rows("franka_panda")))
    assert said.startswith("Made from DH rows, modified convention: M_i = Rx(alpha_(i-1))")
