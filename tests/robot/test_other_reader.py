"""What yourdfpy finds in a URDF, beside what calib finds."""

from __future__ import annotations

import numpy as np
import pytest

from calib.robot.other_reader import fault_by_yourdfpy
from calib.robot.ranges import random_joint_values
from calib.robot.robot import Robot


@pytest.mark.parametrize("name", ["ur3", "panda", "tiago_dual"])
def test_it_finds_the_same_robot(name):
    robot = Robot.load(name)
    assert fault_by_yourdfpy(robot, random_joint_values(robot, 3, 0)) == ""


def test_it_says_how_far_the_file_is_from_the_robot(ur3):
    """The file's elbow is a tenth of a millimetre further along the upper arm."""
    placements = ur3.placements.copy()
    placements[2, 0, 3] += 1e-4
    elsewhere = ur3.with_urdf(ur3.with_placements(placements).urdf)
    fault = fault_by_yourdfpy(elsewhere, np.zeros((1, 6)))
    assert "'tool0' 0.1 mm" in fault


def test_a_default_namespace_hides_all_joints(ur3, tmp_path):
    """yourdfpy looks for names without a namespace."""
    file = tmp_path / "hidden.urdf"
    file.write_bytes(ur3.urdf.data.replace(b"<robot ", b'<robot xmlns="http://ros.org" ', 1))
    hidden = Robot.load(file, base=ur3.base, tip=ur3.tip)
    assert fault_by_yourdfpy(hidden, np.zeros((1, 6)))
