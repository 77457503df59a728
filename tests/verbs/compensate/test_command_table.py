"""The table of commands: every number is read back as it was; rows without a command are empty."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.forms.column_options import ColumnOptions
from calib.data.forms.orientations import CONVENTIONS
from calib.robot.robot import Robot
from calib.verbs.compensate.command_table import write_commands
from calib.verbs.compensate.commands import Commands, compensate
from calib.verbs.compensate.program import Program
from calib.verbs.compensate.program_file import read_program
from tests.places import ROOT

JOINTS = [
    "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
]  # fmt: skip


@pytest.fixture(scope="module")
def true() -> Robot:
    """The paper's UR3 as it was found to be."""
    path = ROOT / "urdf" / "ur3_calibrated.urdf"
    return Robot.load(path, "base", "tool0")


@pytest.fixture(scope="module")
def four(ur3: Robot, true: Robot) -> Commands:
    """Of four rows: two plain, one with a pitch of 90 degrees, one out of reach."""
    q = np.radians(
        [[10, -80, 70, -60, -90, 5], [-20, -60, 80, -100, 60, 350], [0, -90, 90, 0, 90, 0]]
    )
    T = ur3.poses(q)
    T[2, :3, :3] = Rotation.from_euler("xyz", [0.3, np.pi / 2, 0.0]).as_matrix()
    poses = np.concatenate([T, T[:1]])
    poses[3, :3, 3] = [1.0, 1.0, 1.0]
    program = Program(
        labels=tuple(f"row {k}" for k in "abcd"),
        q=np.vstack([q, q[:1]]),
        T_wanted=poses,
        kept=(("name", ("a", "b", 'the "third"', "d, far")), ("speed [mm/s]", ("1", "2", "", "4"))),
    )
    found = compensate(true, program, nominal=ur3)
    assert found.reached.tolist() == [True, True, True, False]
    return found


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_what_stands_in_the_table(four: Commands, tmp_path: Path):
    table = rows(write_commands(four, tmp_path / "c.csv"))
    corrections = [f"correction {name} [deg]" for name in JOINTS]
    assert list(table[0]) == [
        "name", "speed [mm/s]", *(f"{name} [deg]" for name in JOINTS), "x [mm]", "y [mm]", "z [mm]",
        "rx [rad]", "ry [rad]", "rz [rad]", *corrections, "correction position [mm]", "correction angle [deg]",
        "status",
    ]  # fmt: skip
    assert [row["name"] for row in table] == ["a", "b", 'the "third"', "d, far"]
    assert [row["speed [mm/s]"] for row in table] == ["1", "2", "", "4"]
    for i, row in enumerate(table[:3]):
        joints = [float(row[f"{name} [deg]"]) for name in JOINTS]
        changes = [float(row[name]) for name in corrections]
        assert np.abs(np.radians(joints) - four.q[i]).max() < 1e-11
        assert np.abs(np.radians(changes) - four.joint_corrections[i]).max() < 1e-11
        moved = [
            float(row["correction position [mm]"]) / 1e3,
            np.radians(float(row["correction angle [deg]"])),
        ]
        assert np.abs(moved - four.pose_corrections[i]).max() < 1e-9
    assert table[0]["status"] == "ok"
    last = table[-1]
    assert (last.pop("name"), last.pop("speed [mm/s]")) == ("d, far", "4")
    assert last.pop("status") == "no command: unreachable"
    assert set(last.values()) == {""}


@pytest.mark.parametrize("form", CONVENTIONS)
def test_every_form_of_an_orientation_is_read_back(
    four: Commands, tmp_path: Path, ur3: Robot, form: str
):
    # Half turns, and a pitch of a right angle.
    R = Rotation.from_euler(
        "ZYX", [[0.3, np.pi / 2, 1e-9], [2.0, 0.0, np.pi], [1.0, -np.pi / 2, 0.0]]
    )
    T_send = four.T_send.copy()
    T_send[:3, :3, :3] = R.as_matrix()
    table = rows(write_commands(replace(four, T_send=T_send), tmp_path / "c.csv", orientation=form))
    path = tmp_path / "read.csv"
    with path.open("w", encoding="utf-8", newline="") as file:
        names = [name for name in table[0] if not name.startswith("correction")]
        writer = csv.DictWriter(file, names, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(table[:3])
    program = read_program(path, ur3, columns=ColumnOptions(orientation=form))
    assert program.form == form
    assert np.abs(program.T_wanted - T_send[:3]).max() < 1e-9
    assert np.abs(program.q - four.q[:3]).max() < 1e-11
    assert program.kept == tuple((label, cells[:3]) for label, cells in four.program.kept)


@pytest.mark.parametrize(
    ("form", "orientation", "columns"),
    [
        ("kuka", None, ["A [deg]", "B [deg]", "C [deg]"]),
        ("staubli", None, ["rx [deg]", "ry [deg]", "rz [deg]"]),
        ("abb", None, ["q1", "q2", "q3", "q4"]),
        ("kuka", "fanuc", ["W [deg]", "P [deg]", "R [deg]"]),
        ("", None, ["rx [rad]", "ry [rad]", "rz [rad]"]),
    ],
)
def test_orientations_are_written_as_they_came_unless_another_convention_is_named(
    four: Commands, tmp_path: Path, form: str, orientation: str | None, columns: list[str]
):
    commands = replace(four, program=replace(four.program, form=form))
    path = write_commands(commands, tmp_path / "c.csv", orientation=orientation)
    assert list(rows(path)[0])[11 : 11 + len(columns)] == columns


def test_zeros_have_no_sign_and_warnings_are_named(ur3: Robot, tmp_path: Path):
    near = np.radians([[10, -80, 70, -60, 0.2, 5]])
    row = rows(
        write_commands(compensate(ur3, Program.of_joints(near), nominal=ur3), tmp_path / "c.csv")
    )[0]
    assert {row[f"correction {name} [deg]"] for name in JOINTS} == {"0.000000000"}
    assert row["status"] == "warning: near singularity"
