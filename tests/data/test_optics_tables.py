"""Tables of cameras and boards of a cell file, as values; test_cell_file has them as files."""

from __future__ import annotations

from pathlib import Path

import pytest

from calib.data.optics_tables import boards_of_tables, cameras_of_tables
from calib.errors import CalibError, FileError

PATH = Path("folder") / "cell.toml"
CAMERA = {"width": 640, "height": 480}
BOARD = {"pattern": "chessboard", "columns": 9, "rows": 7, "square_mm": 20.0}


def test_the_table_without_a_name_has_the_empty_one():
    cameras = cameras_of_tables(CAMERA, {"left": CAMERA, "right": {**CAMERA, "name": "eye"}}, PATH)
    assert {key: camera.name for key, camera in cameras.items()} == {
        "": "camera",
        "left": "left",
        "right": "eye",
    }
    boards = boards_of_tables(None, {"gripper": BOARD}, PATH)
    assert {key: board.name for key, board in boards.items()} == {"gripper": "gripper"}
    assert (cameras_of_tables(None, {}, PATH), boards_of_tables(None, {}, PATH)) == ({}, {})


def test_names_of_files_begin_at_the_cell_file():
    with pytest.raises(FileError, match=r"folder/cell.toml: .*folder/left.yaml"):
        cameras_of_tables(None, {"left": {"file": "left.yaml"}}, PATH)
    with pytest.raises(FileError, match=r"folder/cell.toml: .*folder/board.toml"):
        boards_of_tables({"file": "board.toml"}, {}, PATH)


def test_headings_begin_messages():
    with pytest.raises(CalibError, match=r"^\[cameras.left\]: "):
        cameras_of_tables(None, {"left": {"width": 640}}, PATH)
    with pytest.raises(CalibError, match=r"^\[board\]: "):
        boards_of_tables({"rows": 7}, {}, PATH)
