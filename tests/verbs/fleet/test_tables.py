"""calib.fleet: robots, tables and cells as users have them."""

from __future__ import annotations

from pathlib import Path

import pytest

import calib
from calib.errors import ArgumentError, CalibError, ModelError
from calib.robot.robot import Robot
from calib.verbs.fleet.fleet import Fleet
from calib.verbs.fleet.record import DONE, FAILED
from tests.verbs.fleet.arms import CELL, arms, files

NAMES = ("arm-0", "arm-1")
QUICK = {"validate": False, "reports": False}


@pytest.fixture(scope="module")
def shop(tmp_path_factory, ur3: Robot) -> Path:
    folder = tmp_path_factory.mktemp("fleet")
    arms(folder, ur3, range(2))
    return folder


@pytest.fixture(scope="module")
def tables(shop: Path) -> dict[str, Path]:
    return {name: shop / f"{name}.csv" for name in NAMES}


@pytest.fixture(scope="module")
def fleet(shop: Path, tables) -> Fleet:
    return calib.fleet(shop / "robot.urdf", tables, shop / "results", cell=CELL, **QUICK)


def test_one_robot_for_all_tables(shop: Path, fleet: Fleet):
    assert [(row.name, row.status) for row in fleet.rows] == [(name, DONE) for name in NAMES]
    assert all((shop / "results" / name / "corrected.urdf").exists() for name in NAMES)


@pytest.mark.parametrize("form", ["robot", "sequence", "mapping"])
@pytest.mark.usefixtures("fleet")
def test_values_and_one_robot_for_each_table_make_the_same_fleet(shop, tables, tmp_path, form):
    path = str(shop / "robot.urdf")
    robot = Robot.load(path, "base", "tool0")
    robots = {"robot": robot, "sequence": [path, robot], "mapping": {"arm-1": path, "arm-0": robot}}
    read = {
        name: calib.Measurements.read(table, robot.joint_names) for name, table in tables.items()
    }
    cells = dict.fromkeys(NAMES, CELL)
    calib.fleet(robots[form], read, tmp_path, cell=cells, **QUICK)
    made, expected = files(tmp_path), files(shop / "results")
    assert made["arm-0/corrected.urdf"] == expected["arm-0/corrected.urdf"]
    assert made["arm-1/corrected.urdf"] == expected["arm-1/corrected.urdf"]


@pytest.mark.usefixtures("fleet")
def test_a_second_run_keeps_what_is_finished(shop: Path, tables):
    again = calib.fleet(shop / "robot.urdf", tables, shop / "results", cell=CELL, **QUICK)
    assert again.kept == 2


def test_a_robot_that_cannot_be_read_fails_alone(shop: Path, tables, tmp_path: Path):
    robots = {"arm-0": "no such robot", "arm-1": shop / "robot.urdf"}
    made = calib.fleet(robots, tables, tmp_path, cell=CELL, **QUICK)
    assert [row.status for row in made.rows] == [FAILED, DONE]


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"robots": 3}, ArgumentError, "'robots'"),
        ({"robots": [3, 4]}, ArgumentError, "robots"),
        ({"solver": "nix"}, ModelError, "'nix'"),
        ({"robots": ["ur3"]}, CalibError, r"robots \(1\) and of tables \(2\)"),
        ({"robots": {"arm-0": "ur3"}}, CalibError, "lacks 'arm-1'"),
        ({"robots": {"arm-0": "ur3", "arm-1": "ur3", "x": "ur3"}}, CalibError, "has 'x'"),
        ({"tables": ["a.csv"]}, ArgumentError, "'tables'"),
        ({"tables": {"a": 3}}, ArgumentError, "tables"),
        ({"folder": 3}, ArgumentError, "'folder'"),
        ({"cell": 3}, ArgumentError, "'cell'"),
        ({"cell": {"arm-0": CELL}}, CalibError, "lacks 'arm-1'"),
        ({"report": True}, ArgumentError, "did you mean 'reports'"),
        ({"reports": "no"}, ArgumentError, "'reports'"),
    ],
)
def test_wrong_arguments_are_named(tables, tmp_path: Path, changes, error, words):
    given = {"robots": "ur3", "tables": tables, "folder": tmp_path / "new", **changes}
    with pytest.raises(error, match=words):
        calib.fleet(**given)
    assert not (tmp_path / "new").exists()


def test_a_fleet_in_one_line(fleet: Fleet):
    assert repr(fleet) == "Fleet(2 robots, 0 failed, 0 withheld, 0 outliers, 0 kept)"
