"""Files with faults that do not bear on kinematics: refused by urdfdom, read by calib, corrected and written."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib.robot.full_model import full_model
from calib.robot.kinematic_text import kinematic_text
from calib.robot.ranges import random_joint_values
from calib.robot.readback import check_written
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from tests.robot.shared import by_pinocchio, displaced

PLAIN = """<robot name="r">
  <material name="white"><color rgba="1 1 1 1"/></material>
  <link name="a"><visual><geometry><box size="1 2 3"/></geometry></visual></link>
  <link name="b"><inertial><origin xyz="0 0.1 0"/><mass value="2"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <link name="c"/>
  <joint name="one" type="revolute"><origin xyz="0 0.2 0.1" rpy="0.1 0 0.3"/><parent link="a"/><child link="b"/>
    <axis xyz="0 1 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="two" type="prismatic"><origin xyz="0.5 0 0"/><parent link="b"/><child link="c"/>
    <axis xyz="2 0 0"/><limit lower="0" upper="0.3" effort="1" velocity="1"/></joint>
</robot>
"""

BOX = '<geometry><box size="1 2 3"/></geometry>'

#: What is replaced, and by what.
FAULTS = {
    "a material twice": (
        '<material name="white">',
        '<material name="white"><color rgba="0 0 0 1"/></material><material name="white">',
    ),
    "a colour of three numbers": ('rgba="1 1 1 1"', 'rgba="1 1 1"'),
    "a colour in words": ('rgba="1 1 1 1"', 'rgba="white"'),
    "a material without colour": ("</geometry>", '</geometry><material name=""/>'),
    "a robot without a name": ('<robot name="r">', "<robot>"),
    "a negative effort": ('effort="1"', 'effort="-1.0"'),
    "no effort": ('effort="1"', ""),
    "an effort without end": ('effort="1"', 'effort="inf"'),
    "a tab between numbers": ("0 0.2 0.1", "0\t0.2   0.1 "),
    "a line end between numbers": ("0 1 1", "0 1\n1"),
    "an empty geometry": (BOX, "<geometry/>"),
    "no geometry": (BOX, ""),
    "a capsule": (BOX, '<geometry><capsule radius="1" length="2"/></geometry>'),
    "a mesh without a file": (BOX, "<geometry><mesh/></geometry>"),
    "a box of two numbers": ("1 2 3", "1 2"),
    "a shape's place in words": (BOX, BOX + '<origin xyz="here"/>'),
    "no moments of inertia": (
        '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>',
        "<inertia/>",
    ),
    "a damping in words": ("</joint>", '<dynamics damping="high"/></joint>'),
    "half a safety controller": ("</joint>", "<safety_controller/></joint>"),
    "half a calibration": ("</joint>", '<calibration rising="up"/></joint>'),
}  # fmt: skip


def spoilt(case: str) -> str:
    old, new = FAULTS[case]
    assert old in PLAIN
    return PLAIN.replace(old, new)


@pytest.mark.parametrize("case", FAULTS)
def test_a_fault_beside_the_kinematics_is_read_over_and_kept(case, capfd):
    text = spoilt(case)
    robot = Robot.from_urdf(Urdf.from_bytes(text.encode(), "r.urdf"))
    q = random_joint_values(robot)
    plain = Robot.from_urdf(Urdf.from_bytes(PLAIN.encode(), "r.urdf"))
    np.testing.assert_array_equal(robot.poses(q), plain.poses(q))
    np.testing.assert_allclose(robot.poses(q), by_pinocchio(plain, q), rtol=0, atol=1e-12)
    new = displaced(robot)
    check_written(new, new.poses(q), q)
    # Whatever was wrong is still there, and no reader's own words were printed.
    assert new.urdf.data.count(b"\n") == text.count("\n")
    assert FAULTS[case][1].encode() in new.urdf.data or "numbers" in case
    assert capfd.readouterr().err == ""


def test_masses_are_kept_and_moments_of_inertia_are_not():
    urdf = Urdf.from_bytes(PLAIN.encode(), "r.urdf")
    inertia = full_model(urdf).inertias[1]
    assert inertia.mass == 2.0
    np.testing.assert_array_equal(inertia.lever, [0.0, 0.1, 0.0])
    np.testing.assert_array_equal(inertia.inertia, np.zeros((3, 3)))


@pytest.mark.parametrize("fault", [('value="2"', 'value="heavy"'), ('xyz="0 0.1 0"', 'xyz="0 up"')])
def test_a_link_without_a_readable_mass_has_none(fault):
    urdf = Urdf.from_bytes(PLAIN.replace(*fault).encode(), "r.urdf")
    assert full_model(urdf).inertias[1].mass == 0.0


@pytest.mark.parametrize("name", ["ur3", "panda", "talos_reduced", "tiago_pro", "pr2"])
def test_pinocchio_finds_the_same_robot_in_it(name):
    urdf = Robot.load(name).urdf
    model = pin.buildModelFromXML(kinematic_text(urdf))
    whole = pin.buildModelFromXML(urdf.data.decode(urdf.encoding))
    assert list(model.names) == list(whole.names)
    for ours, theirs in zip(model.jointPlacements, whole.jointPlacements, strict=True):
        assert ours == theirs
    masses = [[inertia.mass for inertia in each.inertias] for each in (model, whole)]
    np.testing.assert_allclose(*masses, rtol=1e-12)
    levers = [[inertia.lever for inertia in each.inertias] for each in (model, whole)]
    np.testing.assert_allclose(*levers, rtol=0, atol=1e-12)


def test_it_has_the_numbers_of_the_file():
    text = kinematic_text(Urdf.from_bytes(PLAIN.replace("0.5 0 0", "5.0e-1 0  -0").encode(), "r"))
    assert 'xyz="5.0e-1 0 -0"' in text
    assert 'xyz="2 0 0"' in text
    assert "material" not in text
    assert "geometry" not in text
