from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import pytest

from calib.camera.camera_file import read_camera
from calib.example import dh_rows
from calib.robot.urdf import Urdf
from tests.verbs.convert.camera_arms import calibration, image_calibration
from tests.verbs.convert.forms import write_forms


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A folder with one robot in every form, to write into."""
    return write_forms(tmp_path_factory.mktemp("convert"))


def said(text: str) -> str:
    return " ".join(text.split())


def test_the_examples_of_the_command_line(examples):
    done = examples.starting("calib convert calibration.conf")
    assert done.lines[0].startswith("Read: calibration.conf, ur-conf, UR3, calib_44555739735307312")
    assert "'tool0' lies 1.7" in " ".join(done.out.split())
    assert done.lines[-2:] == [
        "  ros2 launch ur_robot_driver ur_control.launch.py ur_type:=ur3 robot_ip:=ADDRESS \\",
        '    kinematics_params_file:="$PWD"/kinematics.yaml',
    ]
    done = examples.starting("calib convert result.json --to modified-dh")
    assert "Written: rows.csv, DH rows, modified (Craig's) convention." in said(done.out)
    assert "Nearly parallel axes: 'shoulder_lift_joint' and 'elbow_joint'" in said(done.out)
    lines = (examples.folder / "rows.csv").read_text().splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    assert [row["table"] for row in rows] == ["before"] * 8 + ["after"] * 8 + ["change"] * 8


def test_what_is_printed(call, folder, tmp_path):
    words = ("--tip", "panda_link8", "--to", "dh", "-o", tmp_path / "panda.json")
    done = call(folder, "convert", "panda", *words)
    assert "nominal robot is not known; --robot" in done.out
    assert json.loads((tmp_path / "panda.json").read_text())["before"] is None
    done = call(folder, "convert", "robot.urdf", "--tip", "tool0", "-o", tmp_path / "copy.urdf")
    assert "Read as a nominal robot: there is no calibration to compare it with." in done.out
    assert (tmp_path / "copy.urdf").read_bytes() == (folder / "robot.urdf").read_bytes()
    words = ("--tip", "tool0", "--hold", "elbow_joint=30 deg", "--to", "dh", "-o")
    assert call(folder, "convert", "robot.urdf", *words, tmp_path / "h.csv").code == 0
    assert ",held at 30 deg," in (tmp_path / "h.csv").read_text()


def test_zeros_are_written_with_the_servo_s_own_file(call, folder, tmp_path):
    names = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    own = {f"{name}_joint": {"homing_offset": 100} for name in names}
    (tmp_path / "own.json").write_text(json.dumps(own))
    words = ("--to", "lerobot", "--update", tmp_path / "own.json", "--ticks", "8192", "-o")
    done = call(folder, "convert", "result.json", *words, tmp_path / "new.json")
    assert done.code == 0
    assert "Rms error of validation rows" in done.out
    new = json.loads((tmp_path / "new.json").read_text())
    assert new["shoulder_pan_joint"]["homing_offset"] == 92  # 0.345 deg of 0.044 deg a tick
    assert new["wrist_3_joint"]["homing_offset"] == 100
    done = call(folder, "convert", "robot.urdf", "--to", "zeros", "-o", tmp_path / "z.csv")
    assert (done.code, "calib calibrate" in done.err) == (1, True)


def test_a_robot_of_rows_from_its_file_to_corrected_rows(call, tmp_path):
    """The way of an owner of an arm without a URDF: a table of rows is the robot everywhere."""
    shutil.copy(dh_rows("fanuc_lrmate200id"), tmp_path / "rows.csv")
    done = call(tmp_path, "convert", "rows.csv", "--to", "urdf", "-o", "robot.urdf")
    assert done.code == 0
    assert "6 DH rows, standard convention" in said(done.out)
    assert "[coupling] J3 = { J2 = 1 }, or the rows in a comment" in said(done.out)
    words = ("rows.csv", "--count", "30", "--validation", "5", "-o", "data.csv")
    assert call(tmp_path, "simulate", *words).code == 0
    words = ("rows.csv", "data.csv", "--model", "zeros", "--json", "result.json", "-o", "c.urdf")
    assert call(tmp_path, "calibrate", *words, "--accept").code == 0
    words = ("result.json", "--to", "dh", "-o", "corrected.csv", "--accept")
    done = call(tmp_path, "convert", *words)
    assert "The convention of the rows is standard" in said(done.out)
    lines = (tmp_path / "corrected.csv").read_text().splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    assert {row["value added"] for row in rows if row["joint"] == "J3"} == {"J3 + J2"}
    assert call(tmp_path, "inspect", "corrected.csv").code == 0
    done = call(tmp_path, "calibrate", "data.csv", "rows.csv")
    assert done.code == 1
    assert "ROBOT comes first" in said(done.err)


def test_a_camera_is_handed_over(call, tmp_path):
    calibration().write_json(tmp_path / "result.json")
    words = ("--to", "camera-mount", "--camera-frame", "color_optical", "-o", "arm.urdf")
    done = call(tmp_path, "convert", "result.json", *words)
    assert (done.code, "'camera_mount_joint', 'camera_body_joint'" in said(done.err)) == (1, True)
    move = ("--move", "camera_mount_joint", "--camera", "color", "--new-board-frame", "plate")
    done = call(tmp_path, "convert", "result.json", *words, *move, "--board", "board")
    assert done.code == 0
    assert "the origin of 'camera_mount_joint' was changed" in said(done.out)
    assert "the URDF with the calibrated mount of the camera." in said(done.out)
    arm = Urdf.read(tmp_path / "arm.urdf")
    assert arm.links[-1] == "plate"
    words = ("--new-camera-frame", "cam", "-o", "camera.launch.py", "--quiet")
    assert call(tmp_path, "convert", "result.json", *words).code == 0
    assert "'--child-frame-id', 'cam'" in (tmp_path / "camera.launch.py").read_text()


def test_intrinsics_are_handed_over(call, tmp_path):
    image_calibration().write_json(tmp_path / "result.json")
    done = call(tmp_path, "convert", "result.json", "--to", "camera-info", "-o", "info.yaml")
    assert (done.code, "1280 x 720 px, pinhole" in said(done.out)) == (0, True)
    read = read_camera(tmp_path / "info.yaml")
    written = image_calibration().optics.cameras["color"]
    assert read.values is not None
    assert written.values is not None
    assert read.values.tolist() == written.values.tolist()
    words = ("--to", "dh", "--camera", "color", "-o", "rows.csv")
    done = call(tmp_path, "convert", "result.json", *words)
    assert (done.code, "'dh' has neither" in said(done.err)) == (1, True)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("result.json", "-o", "o.json"), "'.json' does not say which format is wanted"),
        (("result.json", "-o", "result.json", "--to", "dh", "--force"), "is also an input"),
    ],
)
def test_what_is_refused(call, folder, words, said):
    before = sorted(folder.iterdir())
    done = call(folder, "convert", *words)
    assert (done.code, done.out) == (1, "")
    assert said in done.err
    assert sorted(folder.iterdir()) == before
