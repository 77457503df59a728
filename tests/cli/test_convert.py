from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from calib.robot.robot import Robot
from tests.formats.forms import write_forms

URDFS = Path(__file__).parents[2] / "urdf"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A folder with one robot in every form, to write into."""
    return write_forms(tmp_path_factory.mktemp("convert"))


def said(text: str) -> str:
    return " ".join(text.split())


# The document's examples


def test_a_kinematics_yaml_of_a_calibration_conf(examples):
    done = examples.starting("calib convert calibration.conf")
    assert done.lines[0] == (
        "Read: calibration.conf, calibration of a UR3, calib_4455573973530731233."
    )
    assert "'tool0' lies 1.7" in done.out
    assert done.lines[-2:] == [
        "  ros2 launch ur_robot_driver ur_control.launch.py ur_type:=ur3 robot_ip:=ADDRESS \\",
        '    kinematics_params_file:="$PWD"/kinematics.yaml',
    ]


def test_rows_as_a_table(examples):
    done = examples.starting("calib convert result.json --to modified-dh")
    assert "Written: rows.csv, DH rows, modified (Craig's) convention." in said(done.out)
    assert "Axes that are nearly parallel: 'shoulder_lift_joint' and 'elbow_joint'" in said(
        done.out
    )
    lines = (examples.folder / "rows.csv").read_text().splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    assert [row["table"] for row in rows] == ["before"] * 8 + ["after"] * 8 + ["change"] * 8
    assert rows[1]["joint"] == "shoulder_pan_joint"


# Other conversions


def test_a_bare_arm_is_called_one(call, folder, tmp_path):
    words = ("calibration.conf", "--ur-model", "UR3", "-o", tmp_path / "bare.urdf")
    done = call(folder, "convert", *words)
    assert "It is a bare arm, without meshes and masses" in said(done.out)
    assert "ominal" not in (tmp_path / "bare.urdf").read_text()


def test_a_urdf_of_a_result_is_the_corrected_robot(call, folder):
    done = call(folder, "convert", "result.json", "-o", "again.urdf")
    assert (done.code, done.err) == (0, "")
    assert done.lines[0] == "Read: result.json, result of 'calib fit' for 'ur3', 'base' to 'tool0'."
    assert "Only origins of joints differ from the nominal URDF" in said(done.out)
    q = np.random.default_rng(1).uniform(-2, 2, (5, 6))
    again, corrected = (
        Robot.load(folder / name, "base", "tool0") for name in ("again.urdf", "corrected.urdf")
    )
    np.testing.assert_allclose(again.poses(q), corrected.poses(q), rtol=0, atol=1e-12)
    other = call(folder, "convert", "result.json", "--robot", "corrected.urdf", "-o", "same.urdf")
    assert other.code == 0
    assert (folder / "same.urdf").read_bytes() == (folder / "corrected.urdf").read_bytes()


def test_origins_and_back(call, folder):
    to = call(folder, "convert", "result.json", "--to", "origins", "-o", "new.yaml")
    assert "A xacro takes them with xacro.load_yaml" in said(to.out)
    words = ("--robot", "robot.urdf", "--base", "base", "--tip", "tool0", "-o", "back.urdf")
    back = call(folder, "convert", "new.yaml", *words)
    assert back.lines[0] == "Read: new.yaml, origins of 7 joints, 'base' to 'tool0' of 'ur3'."
    q = np.random.default_rng(1).uniform(-2, 2, (5, 6))
    wanted = Robot.load(folder / "corrected.urdf", "base", "tool0").poses(q)
    found = Robot.load(folder / "back.urdf", "base", "tool0").poses(q)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12)


def test_robots_of_which_no_nominal_one_is_known(call, folder):
    done = call(
        folder, "convert", "panda", "--tip", "panda_link8", "--to", "dh", "-o", "panda.json"
    )
    assert "How far it is from its nominal robot is not known; --robot names that." in done.out
    assert json.loads((folder / "panda.json").read_text())["before"] is None
    done = call(folder, "convert", "robot.urdf", "--to", "dh", "-o", "nominal.md")
    assert "This is a nominal robot: there is no calibration in it." in done.out
    done = call(folder, "convert", "robot.urdf", "-o", "copy.urdf")
    assert "It is the robot as it was read." in done.out
    assert (folder / "copy.urdf").read_bytes() == (folder / "robot.urdf").read_bytes()


def test_an_arm_without_a_name_has_no_type_to_launch(call, folder, tmp_path):
    urcontrol = tmp_path / "u.conf"
    urcontrol.write_text(
        "[DH]\na = [0, -0.24365, -0.22, 0, 0, 0]\nd = [0.1519, 0, 0, 0.11235, 0.08535, 0.0819]\n"
        "alpha = [1.570796327, 0, 0, 1.570796327, -1.570796327, 0]\n"
    )
    words = ("calibration.conf", "--urcontrol", urcontrol, "-o", tmp_path / "k.yaml")
    done = call(folder, "convert", *words)
    assert (done.code, done.err) == (0, "")
    assert done.lines[0].startswith("Read: calibration.conf, calibration of an arm of u.conf, cal")
    assert " ur_type:=TYPE robot_ip:=ADDRESS " in done.out


def test_another_robot_as_the_nominal_one_is_doubted(call, folder, tmp_path):
    chain = ("--base", "base", "--tip", "tool0", "--to", "dh", "-o")
    done = call(folder, "convert", "corrected.urdf", "--robot", "ur5", *chain, tmp_path / "o.csv")
    assert "check that both are one robot, between the same links." in said(done.out)
    done = call(folder, "convert", "corrected.urdf", "--robot", "ur3", *chain, tmp_path / "p.csv")
    assert "check" not in done.out


def test_a_held_joint(call, folder, tmp_path):
    words = (
        "--tip",
        "tool0",
        "--hold",
        "elbow_joint=30 deg",
        "--to",
        "dh",
        "-o",
        tmp_path / "h.csv",
    )
    assert call(folder, "convert", "robot.urdf", *words).code == 0
    assert ",held at 30 deg," in (tmp_path / "h.csv").read_text()


def test_quiet_says_nothing_and_force_overwrites(call, folder):
    words = ("convert", "result.json", "-o", "quiet.urdf", "--quiet")
    assert call(folder, *words).out == ""
    again = call(folder, *words)
    assert (again.code, again.out) == (1, "")
    assert "quiet.urdf exists already; add --force" in again.err
    assert call(folder, *words, "--force").code == 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("no.json", "-o", "o.urdf"), "calibration result 'no.json' does not exist"),
        (("result.json", "-o", "o.json"), "'.json' does not say which format is wanted"),
        (("result.json", "-o", "result.json", "--to", "dh", "--force"), "is also an input"),
        (
            ("result.json", "-o", "o.urdf", "--hash-from", "kinematics.yaml"),
            "--hash-from kinematics.yaml has no use",
        ),
        (("panda", "-o", "o.conf"), "'ur-conf' is for arms of Universal Robots"),
    ],
)
def test_what_is_refused(call, folder, words, said):
    before = sorted(folder.iterdir())
    done = call(folder, "convert", *words)
    assert (done.code, done.out) == (1, "")
    assert done.err.startswith("calib: ")
    assert said in done.err
    assert len(done.err.splitlines()) == 1
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize(
    "words", [(), ("result.json",), ("result.json", "-o", "o.urdf", "--to", "excel")]
)
def test_wrong_calls(call, folder, words):
    assert call(folder, "convert", *words).code == 2
