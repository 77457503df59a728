"""Folders: what their files are, what belongs together, and that the commands that are typed work."""

from __future__ import annotations

import json
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import calib
from calib.example import paper_measurements
from calib.verbs.inspect.folder import What, look_into
from calib.verbs.inspect.folder_text import folder_text
from tests.cli_fixtures import fill

#: Files of a folder as a user has it, and what they are; those that are not there are nothing to calib.
BEGINNING = {
    "calibration.conf": What.FACTORY,
    "cell.toml": What.CELL,
    "data.csv": What.TABLE,
    "joints.csv": What.TABLE,
    "manifest.csv": What.MANIFEST,
    "robot.urdf": What.ROBOT,
    "sweeps.csv": What.SWEEPS,
    "tracker.txt": What.POINTS,
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The files that a user begins with, under a name with a blank."""
    path = tmp_path / "cell 3"
    path.mkdir()
    return fill(path)


def found(folder: Path) -> dict[str, What]:
    """What the files of a folder are, by their names."""
    entries = look_into(folder).entries
    return {str(entry.path.relative_to(folder)): entry.what for entry in entries}


def test_what_the_files_are(folder: Path):
    assert found(folder) == BEGINNING
    (folder / "notes.txt").write_text("Measured on Monday, after the crash.\n")
    (folder / "broken.urdf").write_text("<robot name='r'><link name='a'/>")
    (folder / "other.json").write_text('{"a": 1}')
    (folder / "plan.json").write_text('{"schema": "plan 2"}')
    (folder / "page.html").write_text("<html></html>")
    (folder / "rows.csv").write_text("joint,theta [deg],d [mm],a [mm],alpha [deg]\na,0,100,0,90\n")
    (folder / ".hidden").mkdir()
    (folder / ".hidden" / "data.csv").write_text("a\n1\n")
    pictures = folder / "images"
    pictures.mkdir()
    for name in ("1.png", "2.png"):
        Image.fromarray(np.zeros((4, 4), dtype=np.uint8)).save(pictures / name)
    (folder / "board.toml").write_text(
        'pattern = "chessboard"\ncolumns = 9\nrows = 7\nsquare_mm = 25.0\n'
    )
    assert found(folder) == BEGINNING | {
        "broken.urdf": What.FAULTY,
        "plan.json": What.OUTPUT,
        "page.html": What.PAGE,
        "rows.csv": What.ROBOT,
        "images": What.PICTURES,
        "board.toml": What.BOARD,
    }


def test_what_belongs_together(folder: Path):
    inside = look_into(folder)
    names = [(fit.robot.path.name, fit.table.path.name, fit.rows) for fit in inside.fits]
    assert names == [("robot.urdf", "data.csv", 35), ("robot.urdf", "joints.csv", 35)]
    first, second = inside.fits
    assert first.points is None
    assert second.points is not None
    assert second.points.path.name == "tracker.txt"
    assert {fit.cell.path.name for fit in inside.fits if fit.cell is not None} == {"cell.toml"}
    assert inside.misfits == ()
    # A table of another robot, and one whose units are missing.
    (folder / "other.csv").write_text("panda_joint1 [deg],x [mm],y [mm],z [mm]\n1,2,3,4\n")
    lines = (folder / "data.csv").read_text("utf-8")
    (folder / "bare.csv").write_text(lines.replace(" [mm]", ""))
    misfits = {entry.path.name: why for entry, why in look_into(folder).misfits}
    assert set(misfits) == {"other.csv", "bare.csv"}
    assert "'x [mm]'" in misfits["bare.csv"]
    assert "shoulder_pan_joint" in misfits["other.csv"]
    text = folder_text(look_into(folder))
    assert "bare.csv fits no robot here." in text


def test_recordings_programs_and_several_results_have_their_commands(tmp_path: Path):
    folder = fill(tmp_path)
    for name in ("data.csv", "joints.csv", "tracker.txt", "manifest.csv", "sweeps.csv"):
        (folder / name).unlink()
    (folder / "run.mcap").write_bytes(b"")
    (folder / "prog.src").write_text("DEF prog()\nEND\n")
    assert found(folder)["run.mcap"] is What.RECORDING
    assert found(folder)["prog.src"] is What.PROGRAM
    assert f"calib bag {folder / 'run.mcap'}" in look_into(folder).commands
    robot = calib.Robot.load(folder / "robot.urdf", "base", "tool0")
    result = calib.calibrate(robot, paper_measurements(), cell=calib.Cell(model="zeros"))
    for name in ("a.json", "b.json"):
        result.write_json(folder / name)
    verbs = [shlex.split(command)[1] for command in look_into(folder).commands]
    assert {"compensate", "history"} <= set(verbs)
    assert verbs[-1] == "history"


def test_joint_values_of_pictures_and_factory_files(call, tmp_path: Path):
    folder = fill(tmp_path)
    for name in (
        "data.csv",
        "joints.csv",
        "tracker.txt",
        "manifest.csv",
        "sweeps.csv",
        "cell.toml",
    ):
        (folder / name).unlink()
    robot = calib.Robot.load(folder / "robot.urdf", "base", "tool0")
    header = ",".join(f"{name} [deg]" for name in robot.joint_names)
    (folder / "joints.csv").write_text(f"image,{header}\n1.png,1,2,3,4,5,6\n")
    (folder / "corners.csv").write_text(f"image,u [px],v [px],{header}\n1.png,1,2,1,2,3,4,5,6\n")
    Image.fromarray(np.zeros((4, 4), dtype=np.uint8)).save(folder / "1.png")
    (folder / "board.toml").write_text(
        'pattern = "chessboard"\ncolumns = 9\nrows = 7\nsquare_mm = 25.0\n'
    )
    (folder / "calibration.conf").write_text("[mounting]\ndelta_theta = [0, 0, 0, 0, 0, 0]\n")
    inside = look_into(folder)
    assert [entry.path.name for entry, _ in inside.misfits] == ["corners.csv"]
    detect = [shlex.split(line) for line in inside.commands if " detect " in line]
    assert [Path(words[words.index("--joints") + 1]).name for words in detect] == ["joints.csv"]
    assert found(folder)["calibration.conf"] is What.FACTORY
    done = call(tmp_path, "inspect", str(folder), "--columns", "kuka")
    assert done.code == 1
    assert "calib inspect" in done.err


def run_all(call, folder: Path) -> list[str]:
    """Paste each command, as it is typed, in the folder above; their verbs."""
    verbs = []
    for command in look_into(folder).commands:
        program, *words = shlex.split(command)
        assert program == "calib"
        done = call(folder.parent, *words)
        assert done.code == 0, (command, done.err)
        verbs.append(words[0])
    return verbs


@pytest.mark.slow
def test_the_commands_work_one_after_the_other(call, folder: Path):
    for name in ("manifest.csv", "joints.csv", "tracker.txt"):
        (folder / name).unlink()
    first = [shlex.split(command)[1] for command in look_into(folder).commands]
    assert first == ["calibrate", "base-frame"]
    assert run_all(call, folder) == first
    assert "corrected.urdf" in found(folder)
    (folder / "sweeps.csv").unlink()
    (folder / "frame.toml").unlink(missing_ok=True)

    inside = look_into(folder)
    ((result, parts),) = inside.of_result
    assert result.path.name == "result.json"
    assert sorted(part.path.name for part in parts) == ["corrected.urdf", "data.csv", "robot.urdf"]
    assert "corrected by result.json" in folder_text(inside)
    assert [shlex.split(command)[1] for command in inside.commands] == ["view"]
    # Rows that were measured afterwards.
    header, *rows = (folder / "data.csv").read_text("utf-8").splitlines()
    (folder / "fresh.csv").write_text("\n".join([header, *rows[3:]]))
    assert run_all(call, folder) == ["evaluate", "view"]


@pytest.mark.slow
def test_without_a_table_the_robot_is_inspected_and_poses_are_planned(call, tmp_path: Path):
    shutil.copy(fill(tmp_path) / "robot.urdf", tmp_path.parent / "robot.urdf")
    alone = tmp_path / "alone"
    alone.mkdir()
    shutil.copy(tmp_path / "robot.urdf", alone)
    commands = [shlex.split(command) for command in look_into(alone).commands]
    assert [words[1] for words in commands] == ["inspect", "plan"]
    done = call(
        tmp_path, *commands[1][1:], "--candidates", "500", "--count", "30", "--no-collisions"
    )
    assert (done.code, (alone / "plan.csv").is_file()) == (0, True)
    # Files that exist are not written again.
    assert "plan-2.csv" in look_into(alone).commands[-1] or found(alone)["plan.csv"] is What.TABLE


def test_an_empty_folder_and_a_table_alone(call, tmp_path: Path):
    assert look_into(tmp_path).commands == ("calib demo",)
    (tmp_path / "data.csv").write_text("a [deg],x [mm],y [mm],z [mm]\n1,2,3,4\n")
    done = call(tmp_path, "inspect", ".")
    assert (done.code, done.err) == (0, "")
    assert "no robot" in done.out
    done = call(tmp_path, "inspect", ".", "data.csv")
    assert (done.code, done.out) == (1, "")
    assert "'.' is a folder" in done.err


def test_outputs_have_names_that_are_free(folder: Path):
    (folder / "corrected.urdf").write_bytes((folder / "robot.urdf").read_bytes())
    (folder / "result.json").write_text(json.dumps({"a": 1}))
    command = look_into(folder).commands[0]
    assert "corrected-2.urdf" in command
    assert "result-2.json" in command


def test_pictures_do_not_keep_other_files_from_being_looked_at(folder: Path):
    pictures = folder / "a"
    pictures.mkdir()
    for number in range(350):
        (pictures / f"{number}.png").write_bytes(b"")
    looked = look_into(folder)
    assert looked.left_out == 0
    assert found(folder) == {**BEGINNING, "a": What.PICTURES}
