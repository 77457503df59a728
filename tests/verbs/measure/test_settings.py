"""Settings of a session: written and read they are the same, and what is damaged is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.basics.json_files import json_bytes
from calib.data.cell import Cell
from calib.data.surroundings import Box, Tracker
from calib.errors import FileError
from calib.result.calibration_file import cell_table
from calib.robot.robot import Robot
from calib.verbs.measure.aim import Aim
from calib.verbs.measure.settings import ROBOT, SETTINGS, Settings, cell_of_robot
from calib.verbs.workspace.region_file import region_table
from tests.verbs.measure.sessions import points_cell


@pytest.fixture
def settings(ur3) -> Settings:
    cell = points_cell("placement", targets={"a": [0.1, 0.2, 0.3]}, gravity=[0.0, 0.1, -9.8])
    region = calib.Region.box([0.2, -0.1, 0.1], [0.4, 0.1, 1.0 / 3.0])
    aim = Aim(error=1.0 / 7e3, poses=17, region=region)
    return Settings(ur3, cell_of_robot(cell, ur3), aim, 5, False, (0.1, 1.0 / 3.0, 0, 0, 0, 0))


def test_what_is_written_is_read_to_the_last_bit(settings: Settings, tmp_path: Path):
    settings.write(tmp_path)
    read = Settings.read(tmp_path)
    assert (read.aim.error, read.aim.poses) == (1.0 / 7e3, 17)
    assert read.aim.region is not None
    assert settings.aim.region is not None
    read_region, region = region_table(read.aim.region), region_table(settings.aim.region)
    assert json_bytes(read_region) == json_bytes(region)
    assert (read.seed, read.collisions, read.start) == (5, False, settings.start)
    assert cell_table(read.cell) == cell_table(settings.cell)
    assert read.robot.joint_names == settings.robot.joint_names
    assert (read.robot.base, read.robot.tip) == ("base", "tool0")
    q = np.linspace(-1.0, 1.0, 12).reshape(2, 6)
    assert (read.robot.poses(q) == settings.robot.poses(q)).all()
    assert (tmp_path / ROBOT).read_bytes() == settings.robot.urdf.data


def test_a_cell_with_surroundings_is_kept(settings: Settings, tmp_path: Path):
    cell = replace(
        settings.cell,
        tracker=Tracker(position=np.array([2.0, 0.0, 1.0])),
        boxes=(Box("table", np.array([0.5, 0.7, 0.2]), np.eye(4)),),
        ranges={settings.robot.joint_names[0]: (-1.0, 1.0)},
    )
    replace(settings, cell=cell).write(tmp_path)
    assert cell_table(Settings.read(tmp_path).cell) == cell_table(cell)


def test_the_file_that_was_named_is_read_again_while_it_is_the_same(settings, tmp_path: Path):
    named = tmp_path / "named.urdf"
    named.write_bytes(settings.robot.urdf.data)
    folder = tmp_path / "s"
    folder.mkdir()
    replace(settings, source=str(named)).write(folder)
    assert Settings.read(folder).robot.urdf.path == named
    named.write_bytes(settings.robot.urdf.data + b"<!-- changed -->")
    assert Settings.read(folder).robot.urdf.path == folder / ROBOT
    named.unlink()
    assert Settings.read(folder).robot.urdf.path == folder / ROBOT


def test_a_session_is_not_written_over(settings: Settings, tmp_path: Path):
    settings.write(tmp_path)
    before = (tmp_path / SETTINGS).read_bytes()
    with pytest.raises(FileError):
        settings.write(tmp_path)
    assert (tmp_path / SETTINGS).read_bytes() == before


@pytest.mark.parametrize("key", ["cell", "aim", "seed", "start", "robot", "collisions"])
def test_a_file_that_lacks_an_entry_is_refused(settings: Settings, tmp_path: Path, key: str):
    settings.write(tmp_path)
    table = json.loads((tmp_path / SETTINGS).read_text())
    del table[key]
    (tmp_path / SETTINGS).write_text(json.dumps(table))
    with pytest.raises(FileError, match=key):
        Settings.read(tmp_path)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"schema": "session 99"}'])
def test_other_files_are_refused(tmp_path: Path, text: str):
    (tmp_path / SETTINGS).write_text(text)
    with pytest.raises(FileError):
        Settings.read(tmp_path)


def test_a_folder_without_a_session_is_refused(tmp_path: Path):
    with pytest.raises(FileError):
        Settings.read(tmp_path)


def test_the_cell_has_the_links_of_the_robot(ur3: Robot):
    cell = cell_of_robot(Cell(), ur3)
    assert (cell.base, cell.tip) == ("base", "tool0")
