"""What programs, commands and the files of other programs are refused for, in full."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from calib.compensate.commands import commands
from calib.compensate.commands_file import write_commands
from calib.compensate.matching import POSE, Matching
from calib.compensate.program import Program
from calib.errors import CalibError, FileError, MeasurementError, ModelError
from calib.formats.convert import Wanted, check_options
from calib.formats.origins import write_origins
from calib.formats.ur_conf import read_deltas
from calib.formats.ur_models import ur_model
from calib.formats.ur_yaml import read_yaml, write_yaml
from calib.model.robot import Robot
from calib.model.urdf import Urdf

JOINTS = (
    "shoulder_pan_joint,shoulder_lift_joint,elbow_joint,wrist_1_joint,wrist_2_joint,wrist_3_joint"
)
XYZ = "x [mm],y [mm],z [mm]"
CALIBRATED = Path(__file__).parents[2] / "urdf" / "ur3_calibrated.urdf"


def refused(kind: type[CalibError], text: str):
    """The whole message, as it is printed."""
    return pytest.raises(kind, match=f"^{re.escape(text)}$")


def program(folder: Path, robot: Robot, *lines: str) -> Program:
    path = folder / "p.csv"
    path.write_text("\n".join([*lines, ""]))
    return Program.read(path, robot)


def test_commands_in_a_form_that_there_is_not(ur3, tmp_path):
    wanted = Program(("1",), q=np.zeros((1, 6)))
    made = commands(Robot.load(CALIBRATED, "base", "tool0"), wanted, nominal=ur3)
    with refused(
        ModelError,
        "An orientation cannot be written as 'euler'; choose one of 'rotation-vector', 'quaternion', "
        "'rpy'.",
    ):
        write_commands(made, tmp_path / "c.csv", orientation="euler")
    with refused(
        ModelError, "Commands cannot be written in 'cm'; choose one of 'deg mm', 'rad m'."
    ):
        write_commands(made, tmp_path / "c.csv", units="cm")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            {"update": Path("c.conf")},
            "--update c.conf is the calibration.conf whose other lines the format 'ur-conf' keeps; the format here is "
            "'urdf'. Leave it out, or add --to ur-conf.",
        ),
        (
            {"hash_from": Path("k.yaml")},
            "--hash-from k.yaml is the file whose hash the format 'ur-yaml' keeps; the format here is 'urdf'. Leave it "
            "out, or add --to ur-yaml.",
        ),
        (
            {"urcontrol": Path("u.conf")},
            "--urcontrol u.conf has the nominal rows that a calibration.conf counts from; neither SOURCE nor "
            "--hash-from is one. Leave it out.",
        ),
    ],
)
def test_options_that_a_conversion_has_no_use_for(options, said):
    with refused(CalibError, said):
        check_options(Wanted(Path("o.urdf"), "urdf", **options), "urdf")


def test_matching_by_what_there_is_not():
    with refused(
        ModelError,
        "Poses cannot be matched by 'tip'; choose one of 'pose', 'position', 'axis', 'weighted'.",
    ):
        Matching("tip", 0.1)
    with refused(ModelError, "The lever is 0.0 m; it must be a length greater than 0."):
        Matching(POSE, 0.0)


def test_programs_that_a_caller_made_wrong():
    with refused(ModelError, "A program has no rows. Give at least one."):
        Program((), q=np.zeros((0, 6)))
    with refused(
        ModelError,
        "The joint values of a program have the shape (3, 6); (N, m) is wanted, with N = 2.",
    ):
        Program(("1", "2"), q=np.zeros((3, 6)))
    with refused(
        ModelError,
        "The poses of a program have the shape (1, 3, 4); (N, 4, 4) is wanted, with N = 1.",
    ):
        Program(("1",), T_wanted=np.zeros((1, 3, 4)))


def test_two_columns_of_one_name_in_other_letters(ur3, tmp_path):
    with refused(
        MeasurementError,
        "p.csv: two columns are called 'roll': 'roll [deg]' and 'ROLL [deg]'. Remove or rename one, "
        'or leave one out: --columns "ROLL [deg]=-".',
    ):
        program(
            tmp_path, ur3, f"{XYZ},roll [deg],ROLL [deg],pitch [deg],yaw [deg]", "1,2,3,4,5,6,7"
        )


def test_joints_of_which_some_have_columns(ur3, tmp_path):
    with refused(
        MeasurementError,
        "p.csv: no column for the joints 'shoulder_lift_joint', 'elbow_joint', 'wrist_1_joint', "
        "'wrist_2_joint', 'wrist_3_joint', while there are some for 'shoulder_pan_joint'. The "
        "columns found: 'shoulder_pan_joint [deg]', 'elbow [deg]'. Close to them: 'elbow'. Another "
        'name is mapped by --columns "name in the table=shoulder_lift_joint [deg]"; a joint that '
        "stands still is given with --hold.",
    ):
        program(tmp_path, ur3, "shoulder_pan_joint [deg],elbow [deg]", "1,2")


def test_an_orientation_given_twice(ur3, tmp_path):
    with refused(
        MeasurementError,
        "p.csv: the orientation is there twice, as a rotation vector (rx, ry, rz) and as a "
        'quaternion (qx, qy, qz, qw). Leave one out: --columns "qx=-" and so on.',
    ):
        program(
            tmp_path, ur3, f"{XYZ},rx [deg],ry [deg],rz [deg],qx,qy,qz,qw", "1,2,3,0,0,0,0,0,0,1"
        )


def test_a_quaternion_with_a_unit(ur3, tmp_path):
    with refused(
        MeasurementError,
        "p.csv, column 'qx [deg]': 'deg' cannot be; a quaternion has no unit. Correct the header to "
        "'qx'; for angles, to 'rx [deg]' (a rotation vector) or 'roll [deg]' and so on.",
    ):
        program(tmp_path, ur3, f"{XYZ},qx [deg],qy,qz,qw", "1,2,3,0,0,0,1")


def test_a_quaternion_that_has_not_length_one(ur3, tmp_path):
    with refused(
        MeasurementError,
        "p.csv, line 2 (row 1), columns qx, qy, qz, qw: the quaternion has the length 1.11803; that "
        "of an orientation is 1. Correct it; some controllers write w first: then map the columns "
        "with --columns.",
    ):
        program(tmp_path, ur3, f"{XYZ},qx,qy,qz,qw", "100,200,300,0,0,0.5,1")


def test_a_joint_name_too_long_for_yaml(ur3, tmp_path):
    name = b"elbow_joint" * 100
    long = Urdf.from_bytes(ur3.urdf.data.replace(b'"elbow_joint"', b'"' + name + b'"'), "long.urdf")
    robot = Robot.from_urdf(long, "base", "tool0")
    path = tmp_path / "o.yaml"
    with refused(
        FileError,
        f"{path}: the origins of 'ur3' are not written: YAML takes no name of more than 1024 characters, and the "
        "joint 'elbow_jointelbow_jointelbow_jo...' has one of 1100. Give it a shorter name in the URDF.",
    ):
        write_origins(robot, path)
    assert not path.exists()


MOUNTING = """[mounting]
delta_theta = [0, 0, 0, 0, 0, 0]
delta_a = [0, 0, 0, 0, 0, 0]
delta_d = [0, 0, 0, 0, 0, 0]
delta_alpha = [0, 0, 0, 0, 0, 0]
"""


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "delta_d =",
            "delta_b =",
            ": [mounting] has no delta_d (did you mean 'delta_b'?); a calibration.conf has 'delta_theta', 'delta_a', "
            "'delta_d', 'delta_alpha' there, six numbers each.",
        ),
        (
            "delta_a = [0, 0, 0, 0, 0, 0]",
            "delta_a = [0, 0, 0, 0, 0]",
            ", line 3: delta_a has 5 values; a Universal Robots arm has six joints, six numbers with commas between "
            "them are wanted.",
        ),
        (
            "delta_a = [0, 0,",
            "delta_a = [0, 425,",
            ", line 3: delta_a of joint 2 is 425, more than 10 m: that is no arm's. Lengths are in metres and angles "
            "in radians.",
        ),
    ],
)
def test_a_calibration_conf_without_six_numbers_of_each(tmp_path, old, new, said):
    path = tmp_path / "c.conf"
    path.write_text(MOUNTING.replace(old, new))
    with refused(FileError, f"{path}{said}"):
        read_deltas(path)


@pytest.mark.parametrize(
    ("new", "said"),
    [
        (
            "y: !inches 0.0",
            "the tag !inches of y of 'shoulder' is not known. Write the value without it.",
        ),
        (
            "y: [0.0]",
            "y of 'shoulder' is 'a list or a table'; a finite number [m] is wanted.",
        ),
        (
            "y: 425.0",
            "y of 'shoulder' is 425, more than 10 m: that is no arm's. Lengths are in metres and angles in radians.",
        ),
    ],
)
def test_a_kinematics_yaml_with_what_is_no_number(tmp_path, new, said):
    path = write_yaml(tmp_path / "k.yaml", ur_model("UR3").nominal.chain(), "calib_1")
    text = path.read_text()
    line = next(i for i, one in enumerate(text.splitlines(), 1) if one.strip().startswith("y: "))
    path.write_text(re.sub(r"\by: \S+", new, text, count=1))
    with refused(FileError, f"{path}, line {line}: {said}"):
        read_yaml(path)
