"""One robot of a fleet: its files are read when its turn has come; its name is that of a folder."""

from __future__ import annotations

import pytest

from calib.errors import CalibError
from calib.robot.urdf import read_urdf
from calib.verbs.fleet.fleet_robot import FleetRobot, check_names
from tests.verbs.fleet.arms import CELL, arm, arms


def test_a_robot_of_files_is_read_by_load(tmp_path, ur3):
    (robot,) = arms(tmp_path, ur3, [0])
    sources = []

    def read(source: str):
        sources.append(source)
        return read_urdf(source)

    nominal, measurements, cell = robot.load(read)
    assert robot.name == "arm-0"
    assert sources == [str(tmp_path / "robot.urdf")]
    assert (nominal.base, nominal.tip) == ("base", "tool0")
    assert measurements.source == "arm-0.csv"
    assert measurements.joint_names == nominal.joint_names
    assert len(measurements) == 12
    assert cell is CELL


def test_files_are_not_read_before(tmp_path):
    robot = arm(tmp_path, "gone")
    with pytest.raises(CalibError, match=r"gone\.csv"):
        robot.load(read_urdf)


def test_columns_are_renamed(tmp_path, ur3):
    arms(tmp_path, ur3, [0])
    table = tmp_path / "arm-0.csv"
    joint = ur3.joint_names[0]
    table.write_text(table.read_text().replace(joint, "J1"))
    robot = FleetRobot.of_files(
        "arm-0", tmp_path / "robot.urdf", table, CELL, columns={"J1": joint}
    )
    nominal, measurements, _ = robot.load(read_urdf)
    assert measurements.joint_names == nominal.joint_names == ur3.joint_names


@pytest.mark.parametrize(
    "names",
    [("a", "a"), ("Arm 1", "arm 1"), ("straße", "STRASSE")],
)
def test_a_name_twice_is_refused_with_its_place(names):
    places = [(name, f"line {k}") for k, name in enumerate(names, 2)]
    with pytest.raises(CalibError, match=r"line 3: .* is no other robot's"):
        check_names(places)


@pytest.mark.parametrize("name", ["a", "SN-001", "7", "Ünit 3", "a.b+c_d", "x" * 100])
def test_names_that_are_folders_are_allowed(name):
    check_names([(name, "Robot 1")])


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", ".hidden", "x.", "x" * 101, "~"])
def test_names_that_are_no_folders_are_refused(name):
    with pytest.raises(CalibError, match=r"Robot 1: .* cannot be the name"):
        check_names([(name, "Robot 1")])
