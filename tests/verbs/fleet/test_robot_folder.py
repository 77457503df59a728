"""A robot's folder: finished or not, and never another's files."""

from __future__ import annotations

import json

import pytest

from calib.errors import CalibError
from calib.verbs.fleet.fleet_row import DONE, FleetRow
from calib.verbs.fleet.robot_folder import MADE, URDF, RobotFolder
from tests.verbs.fleet.arms import files

ROW = FleetRow("arm-0", DONE, sigma={"m": 1e-4})
CONTENT = {URDF: b"<robot/>", "result.json": b"{}"}


@pytest.fixture
def folder(tmp_path) -> RobotFolder:
    """A finished folder with the fingerprint ``"f"``."""
    folder = RobotFolder(tmp_path / "arm-0")
    folder.write("f", ROW, CONTENT)
    return folder


def test_a_finished_folder_has_its_files_and_row(folder):
    there = files(folder.path)
    assert {name: there[name] for name in CONTENT} == CONTENT
    assert set(there) == {*CONTENT, MADE}
    assert repr(folder.finished_row("f")) == repr(ROW)


def test_other_inputs_are_not_finished(folder):
    assert folder.finished_row("g") is None
    assert RobotFolder(folder.path / "gone").finished_row("f") is None


def test_a_folder_without_one_of_its_files_is_not_finished(folder):
    (folder.path / "result.json").unlink()
    assert folder.finished_row("f") is None


@pytest.mark.parametrize(
    "change",
    [{"schema": "fleet robot 0"}, {"row": {}}, {"row": None}, {"files": 3}, {"fingerprint": ""}],
)
def test_a_changed_or_unfinished_list_is_not_finished(folder, change):
    made = folder.path / MADE
    made.write_text(json.dumps(json.loads(made.read_text()) | change))
    assert folder.finished_row("f") is None


def test_files_of_an_earlier_result_are_removed_and_no_others(folder):
    (folder.path / "notes.txt").write_text("somebody's own")
    folder.write("g", ROW, {"result.json": b"[]"})
    there = files(folder.path)
    assert set(there) == {"result.json", "notes.txt", MADE}
    assert there["result.json"] == b"[]"
    assert folder.finished_row("g") is not None
    assert folder.finished_row("f") is None


def test_names_of_other_folders_are_not_removed(folder, tmp_path):
    other = tmp_path / "precious.txt"
    other.write_text("keep me")
    made = folder.path / MADE
    table = json.loads(made.read_text())
    table["files"] += ["../precious.txt", str(other), MADE, 3]
    made.write_text(json.dumps(table))
    folder.write("g", ROW, {"result.json": b"[]"})
    assert other.read_text() == "keep me"
    assert set(files(folder.path)) == {"result.json", MADE}


@pytest.mark.parametrize("name", [URDF, "result.json"])
def test_a_file_that_no_fleet_has_written_is_not_replaced(tmp_path, name):
    (tmp_path / name).write_text("somebody's")
    with pytest.raises(CalibError, match=rf"{name} exists already"):
        RobotFolder(tmp_path).write("f", ROW, {"result.json": b"{}"})
    assert files(tmp_path) == {name: b"somebody's"}
