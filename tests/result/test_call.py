"""What a calibration was told, and its cell in result files."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.basics.json_files import json_bytes
from calib.boards.board_file import read_board
from calib.camera.camera_file import read_camera
from calib.data.cell import Cell, FurtherRobot, GroupDistance, Priors, Tracker
from calib.example import franka_file
from calib.result.calibration_file import call_table, read_cell
from calib.result.call import Call, file_hashes, split_name
from calib.robot.gravity import Payload
from tests.places import ROOT

CELLS = {
    "plain": Cell(),
    "frames": Cell(
        base="base",
        tips={"left": "tool_l", "right": "tool_r"},
        frames={"a": np.diag([-1.0, -1.0, 1.0, 1.0])},
        estimate_frame=True,
        frame_directions=("x", "rz"),
        robots={"right": FurtherRobot("ur5")},
    ),
    "model": Cell(
        model="dh+compliance",
        ties={"d3": ("d2", -0.1)},
        bounds={"a2": (-1e-3, 0.1 + 0.2)},
        priors=Priors("given", length=1.1e-3, compliance=2e-6),
        parameter_priors={"a3": 1 / 3},
        payload=Payload(5.0, np.array([0.0, 0.01, 0.06])),
        gravity=np.array([0.0, 9.81, 0.0]),
        held={"lift": 0.3},
        coupling={"j3": {"j2": 1.0}},
    ),
    "surroundings": Cell(
        sigma={"m": 1e-4 / 3, "rad": 1e-4},
        distances=(GroupDistance("a", "b", 0.05, 1e-5),),
        tracker=Tracker(np.array([2.5, 0.0, 0.5])),
        target=np.array([0.1, 0.2, 0.3]) / 3,
        estimate_target=False,
    ),
    "camera": Cell(
        cameras={"": read_camera(franka_file("camera.toml"))},
        boards={"": read_board(franka_file("board.toml"))},
    ),
}


def in_file(cell: Cell) -> Any:
    """The cell of a call as a result file has it."""
    return json.loads(json_bytes(call_table(Call(cell=cell))))["cell"]


def bits(value: Any) -> Any:
    """A value with its numbers as text to the last bit, whatever holds it: an independent look at a cell."""
    if isinstance(value, np.ndarray):
        return [entry.hex() for entry in value.astype(float).ravel().tolist()]
    if isinstance(value, float):
        return value.hex()
    if hasattr(value, "items"):
        return {name: bits(entry) for name, entry in value.items()}
    if isinstance(value, tuple):
        return [bits(entry) for entry in value]
    names = getattr(type(value), "__dataclass_fields__", None)
    return value if names is None else {name: bits(getattr(value, name)) for name in names}


@pytest.mark.parametrize("name", CELLS)
def test_a_cell_is_read_back_to_the_last_bit(name: str):
    table = in_file(CELLS[name])
    assert bits(read_cell(table)) == bits(CELLS[name])


def test_what_a_cell_does_not_say_is_not_in_the_file():
    assert in_file(CELLS["plain"]) == {}
    assert in_file(Cell(model="dh")) == {"model": "dh"}


def test_hashes_are_those_of_the_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data.csv").write_bytes(b"q\r\n1\r\n")
    (tmp_path / "arm.xacro").write_bytes(b"<robot/>")
    found = file_hashes(["./data.csv", None, "ur3", "arm.xacro prefix:=left_", "4096@2048"])
    assert found == {
        "./data.csv": hashlib.sha256(b"q\r\n1\r\n").hexdigest(),
        "arm.xacro prefix:=left_": hashlib.sha256(b"<robot/>").hexdigest(),
    }


@pytest.mark.parametrize(
    ("name", "path", "rest"),
    [
        ("./cells//data.csv", "cells/data.csv", ""),
        ("data.xlsx#Sheet 1", "data.xlsx", "#Sheet 1"),
        ("cells/arm.urdf.xacro a:=b", "cells/arm.urdf.xacro", " a:=b"),
        ("ur3", "ur3", ""),
    ],
)
def test_the_path_in_a_name(name: str, path: str, rest: str):
    assert split_name(name) == (Path(path), rest)


def test_the_page_names_every_field_of_a_call():
    page = (ROOT / "docs" / "result-json.md").read_text(encoding="utf-8")
    listed = "\n".join(line for line in page.splitlines() if line.startswith("| `call."))
    for name in call_table(Call(cell=Cell())):
        assert name in listed
