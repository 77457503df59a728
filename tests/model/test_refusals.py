"""What the models, URDFs and files refuse, in full: what was given, where, what is allowed, the fix."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import calib.data
from calib.errors import CalibError, FileError, ModelError, UrdfError
from calib.measure.quantities import parse_joint_value
from calib.model.anchoring import check_same_joints
from calib.model.error_model import error_model
from calib.model.files import write_atomically
from calib.model.parameters import ErrorModel
from calib.model.robot import Robot
from calib.model.torques import Payload
from calib.model.urdf import Urdf

REVOLUTE = ("revolute", (0.0, 0.0, 0.1), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
FLOATING = ("floating", *REVOLUTE[1:])


def refused(kind: type[CalibError], text: str):
    """The whole message, as it is printed."""
    return pytest.raises(kind, match=f"^{re.escape(text)}$")


def test_a_corrected_robot_with_fewer_joints_than_its_nominal_one(serial_urdf):
    robot = Robot.from_urdf(serial_urdf([REVOLUTE] * 2), "l0", "tip")
    longer = Robot.from_urdf(serial_urdf([REVOLUTE] * 3), "l0", "tip")
    with refused(
        ModelError,
        "The robot 'serial' has the joints 'j1', 'j2', its nominal robot 'serial' 'j1', 'j2', 'j3'. Give the nominal "
        "URDF that the robot was corrected from, with the same base and tip.",
    ):
        check_same_joints(robot, longer)


def test_a_joint_with_more_than_one_coordinate_in_the_chain(serial_urdf):
    with refused(
        UrdfError,
        "serial.urdf: joint 'j2' between 'l0' and 'tip' is of type 'floating'; a chain may hold 'revolute', "
        "'continuous', 'prismatic' and 'fixed' joints. Choose --base and --tip on one side of it.",
    ):
        Robot.from_urdf(serial_urdf([REVOLUTE, FLOATING]), "l0", "tip")


def test_a_joint_held_at_a_value_in_the_unit_of_another_kind(serial_urdf):
    with refused(
        UrdfError,
        "serial.urdf: the value that the joint 'j2' is held at is a length, and the joint turns; give an "
        'angle, such as "30 deg".',
    ):
        Robot.from_urdf(
            serial_urdf([REVOLUTE] * 2),
            "l0",
            "tip",
            held={"j2": parse_joint_value("0.3 m", "--hold")},
        )


def test_a_file_in_a_folder_that_may_not_be_written():
    with pytest.raises(FileError, match=r"cannot be written: .*; choose another folder$"):
        write_atomically(Path("/proc/calib.urdf"), b"", overwrite=False)


def test_a_model_with_a_place_that_the_chain_lacks():
    term = error_model(Robot.load(calib.data.paper_urdf(), "base", "tool0"), "zeros").parameters[0]
    with refused(
        ModelError,
        "The chain has no places 'shoulder_pan_joint'; it has 'tip'.",
    ):
        ErrorModel("own", ("tip",), (term,))


def test_a_vector_of_another_length_than_the_model(ur3):
    with refused(
        ModelError,
        "A parameter vector of shape (5,) was given; the model 'zeros' has 9 parameters: "
        "'shoulder_pan_joint.zero', 'shoulder_lift_joint.zero', 'elbow_joint.zero', 'wrist_1_joint.zero', "
        "'wrist_2_joint.zero', 'wrist_3_joint.zero', 'target_x', 'target_y', 'target_z'.",
    ):
        error_model(ur3, "zeros").values(np.zeros(5))


def test_a_payload_whose_centre_is_no_point():
    with refused(
        ModelError,
        "The centre of mass of a payload is (0.0, 0.1); give three finite numbers [m].",
    ):
        Payload(1.0, (0.0, 0.1))


def test_a_mimic_of_a_joint_that_does_not_exist(serial_urdf):
    urdf = serial_urdf([REVOLUTE] * 2)
    mimic = urdf.data.replace(b'<axis xyz="0.0 0.0 1.0"/>', b'<mimic joint="j3"/>', 1)
    with refused(
        UrdfError,
        "serial.urdf: joint 'j1' mimics 'j3', which does not exist. Correct the <mimic> "
        "in the URDF, or hold 'j1' at a value.",
    ):
        Robot.from_urdf(Urdf.from_bytes(mimic, "serial.urdf"), "l0", "tip")


def test_a_joint_that_is_no_urdfs():
    def urdf(joint):
        text = f'<robot name="r"><link name="a"/><link name="b"/><link name="c"/>\n{joint}</robot>'
        return Urdf.from_bytes(text.encode(), "r.urdf")

    both = '<parent link="a"/><child link="b"/>'
    with refused(UrdfError, "r.urdf, line 2: joint 'j' has 2 <parent>; keep one"):
        urdf(f'<joint name="j" type="fixed"><parent link="a"/>{both}</joint>')
    with refused(UrdfError, "r.urdf, line 2: joint 'j' lacks <child link=\"...\">"):
        urdf('<joint name="j" type="fixed"><parent link="a"/></joint>')
    with refused(
        UrdfError,
        "r.urdf has 2 root links: 'a', 'c'; join them by fixed joints so that one is left",
    ):
        urdf(f'<joint name="j" type="fixed">{both}</joint>')
