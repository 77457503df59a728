"""Commands as a table: what is written, how exactly, and what is left empty."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from calib.compensate.commands import Commands, commands
from calib.compensate.commands_file import write_commands
from calib.compensate.program import Program, read_program
from calib.errors import ModelError
from calib.model.robot import Robot

JOINTS = [
    "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
]  # fmt: skip


@pytest.fixture(scope="module")
def true() -> Robot:
    """The paper's UR3 as it was found to be."""
    path = Path(__file__).parents[2] / "urdf" / "ur3_calibrated.urdf"
    return Robot.load(path, "base", "tool0")


@pytest.fixture(scope="module")
def made(ur3: Robot, true: Robot) -> Commands:
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
    found = commands(true, program, nominal=ur3)
    assert found.reached.tolist() == [True, True, True, False]
    return found


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_what_stands_in_the_table(made: Commands, tmp_path: Path):
    table = rows(write_commands(made, tmp_path / "c.csv"))
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
        assert np.abs(np.radians(joints) - made.q[i]).max() < 1e-11
        assert np.abs(np.radians(changes) - made.joint_corrections[i]).max() < 1e-11
        moved = [
            float(row["correction position [mm]"]) / 1e3,
            np.radians(float(row["correction angle [deg]"])),
        ]
        assert np.abs(moved - made.pose_corrections[i]).max() < 1e-9
    assert table[0]["status"] == "ok"


def test_a_row_without_a_command_is_empty_but_for_what_goes_along_and_the_reason(
    made: Commands, tmp_path: Path
):
    last = rows(write_commands(made, tmp_path / "c.csv"))[-1]
    assert last.pop("name") == "d, far"
    assert last.pop("speed [mm/s]") == "4"
    assert last.pop("status") == f"no command: {made.reasons[3]}"
    assert set(last.values()) == {""}


@pytest.mark.parametrize("form", ["rotation-vector", "quaternion", "rpy"])
def test_every_form_of_an_orientation_is_read_back(
    made: Commands, tmp_path: Path, ur3: Robot, form: str
):
    path = write_commands(made, tmp_path / "c.csv", orientation=form)
    kept = rows(path)[:3]
    with path.open(
        "w", encoding="utf-8", newline=""
    ) as file:  # the reader wants a pose in each row
        writer = csv.DictWriter(file, list(kept[0]))
        writer.writeheader()
        writer.writerows(kept)
    program = read_program(path, ur3, given="poses")
    assert program.T_wanted is not None
    assert program.q is not None
    assert np.abs(program.T_wanted - made.T_send[:3]).max() < 1e-9
    assert np.abs(program.q - made.q[:3]).max() < 1e-11
    # What is sent is where the nominal robot is at the joint values of the same row.
    assert np.abs(ur3.poses(program.q) - program.T_wanted).max() < 1e-9
    assert program.kept == tuple((label, cells[:3]) for label, cells in made.program.kept)


@pytest.mark.parametrize("form", ["rotation-vector", "quaternion", "rpy"])
def test_radians_and_metres(made: Commands, tmp_path: Path, ur3: Robot, form: str):
    plain = rows(write_commands(made, tmp_path / "deg.csv", orientation=form))
    path = write_commands(made, tmp_path / "rad.csv", orientation=form, units="rad m")
    table = rows(path)
    assert not any("deg]" in name or "mm]" in name for name in list(table[0])[2:])
    assert len(table[0]) == len(plain[0])
    for name in (f"{JOINTS[1]} [rad]", f"correction {JOINTS[1]} [rad]", "correction angle [rad]"):
        degrees = plain[0][name.replace("rad]", "deg]")]
        assert float(table[0][name]) == pytest.approx(np.radians(float(degrees)), abs=1e-11)
    for name in ("x [m]", "correction position [m]"):
        millimetres = plain[0][name.replace("m]", "mm]")]
        assert float(table[0][name]) == pytest.approx(1e-3 * float(millimetres), abs=1e-9)
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:4]), encoding="utf-8")
    program = read_program(path, ur3, given="poses")
    assert program.T_wanted is not None
    assert program.q is not None
    assert np.abs(program.T_wanted - made.T_send[:3]).max() < 1e-9
    assert np.abs(program.q - made.q[:3]).max() < 1e-11


@settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    turn=st.sampled_from([0.0, 1e-9, 1.0, np.pi - 1e-9, np.pi]),
    pitch=st.sampled_from([0.0, np.pi / 2, np.pi / 2 - 1e-7, -np.pi / 2]),
    yaw=st.floats(-4.0, 4.0),
)
def test_rotations_by_half_a_turn_and_at_the_pole_are_read_back(
    made: Commands, tmp_path: Path, ur3: Robot, turn: float, pitch: float, yaw: float
):
    R = (
        Rotation.from_euler("ZYX", [yaw, pitch, 0.0]) * Rotation.from_rotvec([turn, 0.0, 0.0])
    ).as_matrix()
    T = made.T_send.copy()
    T[:, :3, :3] = R
    for form in ("rotation-vector", "quaternion", "rpy"):
        path = write_commands(
            replace(made, T_send=T, reasons=("",) * 4),
            tmp_path / "c.csv",
            send="poses",
            orientation=form,
            overwrite=True,
        )
        lines = path.read_text(encoding="utf-8").splitlines()
        path.write_text("\n".join(lines[:4]), encoding="utf-8")
        program = read_program(path, ur3, given="poses")
        assert program.T_wanted is not None
        assert np.abs(program.T_wanted[:, :3, :3] - R).max() < 1e-10


@pytest.mark.parametrize(
    ("send", "there", "missing"),
    [
        ("joints", {"elbow_joint [deg]", "correction elbow_joint [deg]"}, {"x [mm]", "rx [rad]"}),
        ("poses", {"x [mm]", "rz [rad]"}, {"elbow_joint [deg]", "correction elbow_joint [deg]"}),
    ],
)
def test_joint_values_or_poses_alone(
    made: Commands, tmp_path: Path, send: str, there: set[str], missing: set[str]
):
    header = set(rows(write_commands(made, tmp_path / "c.csv", send=send))[0])
    assert header >= there | {"name", "correction position [mm]", "status"}
    assert not header & missing


def test_warnings_stand_in_the_last_column(ur3: Robot, true: Robot, tmp_path: Path):
    program = Program.of_joints(np.radians([10, -80, 70, -60, -90, 5]))
    found = commands(true, program, nominal=ur3, limit=(1e-4, 1e-4))
    status = rows(write_commands(found, tmp_path / "c.csv"))[0]["status"]
    assert status == "warning: " + "; ".join(found.warnings[0])
    assert "the pose moves by" in status
    assert "the pose turns by" in status


def test_a_robot_that_is_right_has_corrections_of_zero_without_a_sign(ur3: Robot, tmp_path: Path):
    program = Program.of_joints(np.radians([[10, -80, 70, -60, -90, 5]]))
    row = rows(write_commands(commands(ur3, program, nominal=ur3), tmp_path / "c.csv"))[0]
    assert {row[f"correction {name} [deg]"] for name in JOINTS} == {"0.000000000"}
    assert row["correction position [mm]"] == "0.000000"


@pytest.mark.parametrize(
    "wrong",
    [{"send": "all"}, {"orientation": "euler"}, {"units": "inch"}],
)
def test_what_cannot_be_asked_for(made: Commands, tmp_path: Path, wrong: dict[str, str]):
    ((what, given),) = wrong.items()
    with pytest.raises(ModelError, match=f"{what} '{given}'; choose one of "):
        write_commands(made, tmp_path / "c.csv", **wrong)
    assert not (tmp_path / "c.csv").exists()
