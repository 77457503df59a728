"""Programs as tables: what is read and what is refused; and commands, whose every number is read back as it was."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

from calib.data.forms.column_options import ColumnOptions
from calib.data.forms.orientations import CONVENTIONS
from calib.errors import MeasurementError
from calib.example import paper_measurements, paper_urdf
from calib.robot.robot import Robot
from calib.verbs.compensate.commands import Commands
from calib.verbs.compensate.compensate import compensate
from calib.verbs.compensate.program_table import read_program, write_commands
from calib.verbs.compensate.robot_program import Program
from tests.places import ROOT

NAMES = [
    "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint",
]  # fmt: skip
IN_DEG = ",".join(f"{name} [deg]" for name in NAMES)
VALUES = "10,-80,70,-60,-90,5"
XYZ = "x [mm],y [mm],z [mm]"


@pytest.fixture
def read(tmp_path: Path, ur3: Robot):
    """Write lines as a table and read them as a program of the UR3."""

    def reader(*lines: str, robot: Robot = ur3, **options: object) -> Program:
        path = tmp_path / "program.csv"
        path.write_text("\n".join([*lines, ""]), encoding="utf-8")
        return read_program(path, robot, **options)  # type: ignore[arg-type]

    return reader


def test_joint_values_with_columns_that_go_along(read):
    program = read(
        f"step,speed [mm/s],{IN_DEG},remark",
        f'A1,250,{VALUES},"left, then up"',
        f"A2,100,{VALUES},",
    )
    assert program.T_wanted is None
    assert program.q is not None
    assert program.q == pytest.approx(np.radians([[10, -80, 70, -60, -90, 5]] * 2))
    assert program.kept == (
        ("step", ("A1", "A2")),
        ("speed [mm/s]", ("250", "100")),
        ("remark", ("left, then up", "")),
    )
    assert program.labels == ("row 1", "row 2")


def test_columns_in_any_order_and_unit_and_another_name(read):
    header = ",".join([f"{NAMES[5]} [rad]", "J1", *(f"{n} [deg]" for n in NAMES[1:5])])
    program = read(header, "0.5,20,-80,70,-60,-90", columns={"J1": "shoulder_pan_joint [deg]"})
    wanted = [*np.radians([20, -80, 70, -60, -90]), 0.5]
    assert program.q == pytest.approx(np.array([wanted]))


def test_the_paper_s_table_is_points_with_joint_values_to_start_at(ur3: Robot):
    program = read_program(paper_measurements(), ur3)
    assert program.q is not None
    assert program.T_wanted is not None
    assert not program.oriented
    assert len(program) == 35
    assert program.T_wanted[0, :3, 3] == pytest.approx([-0.14902, -0.2075, 0.7426])
    assert [label for label, _ in program.kept] == ["row", "set"]


angles = st.floats(-3.1, 3.1, allow_nan=False)


@settings(max_examples=20, deadline=None)
@given(roll=angles, pitch=st.floats(-1.57, 1.57), yaw=angles)
def test_the_three_forms_of_an_orientation_are_one(tmp_path_factory, roll, pitch, yaw):
    robot = Robot.load(paper_urdf(), "base", "tool0")
    Rx, Ry, Rz = (Rotation.from_euler(a, v) for a, v in zip("xyz", (roll, pitch, yaw), strict=True))
    R = Rz * Ry * Rx
    path = tmp_path_factory.mktemp("forms") / "program.csv"
    q, v = R.as_quat(), R.as_rotvec()
    for header, numbers in (
        ("qx,qy,qz,qw", q),
        ("qx [-],qy [1],qz [],QW", -q),
        ("rx [rad],ry [rad],rz [rad]", v),
        ("rx [mrad],ry [mrad],rz [mrad]", 1e3 * v),
        ("Roll [deg],PITCH [deg],yaw [deg]", np.degrees([roll, pitch, yaw])),
    ):
        cells = ",".join(repr(float(number)) for number in numbers)
        path.write_text(f"x [m],y [m],z [m],{header}\n0.3,0.2,0.1,{cells}\n", encoding="utf-8")
        program = read_program(path, robot)
        assert program.oriented
        assert program.T_wanted is not None
        assert program.q is None
        form = {"q": "quaternion", "R": "rpy"}.get(header[0], "rotation-vector")
        assert program.form == form
        assert np.abs(program.T_wanted[0, :3, :3] - R.as_matrix()).max() < 1e-14
        assert program.T_wanted[0, :3, 3] == pytest.approx([0.3, 0.2, 0.1])


def test_a_plan_s_columns_to_fill_in_are_no_poses(read):
    program = read(f"row,{IN_DEG},{XYZ},qx,qy,qz,qw", f"7,{VALUES},,,,,,,")
    assert program.T_wanted is None
    assert program.labels == ("row 7",)
    assert [label for label, _ in program.kept] == ["row"]


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ([f"{IN_DEG},correction position [mm],status", f"{VALUES},0.5,ok"], "corrected already"),
        ([f"{XYZ},rx [rad],ry [rad],rz [rad],qx,qy,qz,qw", "300,200,100,0,0,0,0,0,0,1"], "is there twice"),
        ([f"{XYZ},rx,ry,rz", "1,2,3,0,0,0"], "column 'rx' (a rotation vector): the column has no unit"),
        ([f"{XYZ},qx,qy,qz,qw", "300,200,100,0,0,0,1", "300,200,100,0,0,0,0.9"], "line 3 (row 2), column 'qx'"),
        ([f"{XYZ},note", "300,200,100,", ",,,a"], "row 2: there is no position"),
        ([IN_DEG.replace("elbow_joint", "elbow_jont"), VALUES], "'elbow_joint' missing beside"),
    ],
)  # fmt: skip
def test_tables_that_are_refused(read, lines: list[str], said: str):
    with pytest.raises(MeasurementError) as caught:
        read(*lines)
    assert str(caught.value).startswith("program.csv")
    assert said in str(caught.value)


ONE = """<robot name="slider">
  <link name="base"/><link name="tip"/>
  <joint name="lift" type="prismatic"><parent link="base"/><child link="tip"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>"""


def test_a_joint_that_slides_is_in_a_length(read, tmp_path: Path):
    path = tmp_path / "one.urdf"
    path.write_text(ONE, encoding="utf-8")
    lift = Robot.load(path)
    assert read("lift [mm]", "300", robot=lift).q == pytest.approx(np.array([[0.3]]))
    with pytest.raises(MeasurementError, match="'deg' is not a unit of length"):
        read("lift [deg]", "300", robot=lift)


def test_a_brand_s_program(read):
    header = "step,A1,A2,A3,A4,A5,A6,X,Y,Z,A,B,C"
    line = "a,10,-80,70,-60,-90,5,300,200,100,20,-30,40"
    program = read(header, line, columns=ColumnOptions(brand="kuka"))
    assert program.q == pytest.approx(np.radians([[10, -80, 70, -60, -90, 5]]))
    R = Rotation.from_euler("ZYX", [20, -30, 40], degrees=True).as_matrix()
    assert program.T_wanted is not None
    assert program.T_wanted[0, :3, :3] == pytest.approx(R, abs=1e-15)
    assert program.T_wanted[0, :3, 3] == pytest.approx([0.3, 0.2, 0.1])
    assert (program.form, program.kept) == ("kuka", (("step", ("a",)),))
    with pytest.raises(MeasurementError, match=r"program.csv.*--columns kuka"):
        read(header, line)


def test_an_option_names_the_convention_where_the_columns_fit_it(read):
    angles = f"{XYZ},Rx [deg],Ry [deg],Rz [deg]", "300,200,100,40,-30,20"
    for orientation, sequence in (("staubli", "XYZ"), ("yaskawa", "xyz")):
        R = Rotation.from_euler(sequence, [40, -30, 20], degrees=True).as_matrix()
        program = read(*angles, columns=ColumnOptions(orientation=orientation))
        assert program.T_wanted is not None
        assert program.T_wanted[0, :3, :3] == pytest.approx(R, abs=1e-15)
        assert program.form == orientation
    program = read(*angles, columns=ColumnOptions(orientation="abb"))
    assert program.form == "rotation-vector"


def test_one_letter_is_no_part_of_an_orientation(read):
    program = read(f"A,P,R,{XYZ}", "part 1,1,7,300,200,100")
    assert [label for label, _ in program.kept] == ["A", "P", "R"]
    assert not program.oriented
    with pytest.raises(MeasurementError, match="'C' missing beside 'A', 'B'"):
        read(f"{XYZ},A [deg],B [deg]", "300,200,100,1,2")


def test_one_unit_for_all_joints(read):
    program = read(",".join(NAMES), VALUES, columns=ColumnOptions(joint_unit="deg"))
    assert program.q == pytest.approx(np.radians([[10, -80, 70, -60, -90, 5]]))
    with pytest.raises(MeasurementError, match="--joint-unit deg"):
        read(",".join(NAMES), VALUES)


def test_a_plan_s_empty_quaternion_goes_not_along(read):
    program = read(f"{XYZ},qx,qy,qz,qw,A [deg],B [deg],C [deg]", "300,200,100,,,,,20,-30,40")
    assert (program.form, program.kept) == ("kuka", ())


# Commands


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


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_what_stands_in_the_table(four: Commands, tmp_path: Path):
    table = rows_of(write_commands(four, tmp_path / "c.csv"))
    corrections = [f"correction {name} [deg]" for name in NAMES]
    assert list(table[0]) == [
        "name", "speed [mm/s]", *(f"{name} [deg]" for name in NAMES), "x [mm]", "y [mm]", "z [mm]",
        "rx [rad]", "ry [rad]", "rz [rad]", *corrections, "correction position [mm]", "correction angle [deg]",
        "status",
    ]  # fmt: skip
    assert [row["name"] for row in table] == ["a", "b", 'the "third"', "d, far"]
    assert [row["speed [mm/s]"] for row in table] == ["1", "2", "", "4"]
    for i, row in enumerate(table[:3]):
        joints = [float(row[f"{name} [deg]"]) for name in NAMES]
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
    table = rows_of(
        write_commands(replace(four, T_send=T_send), tmp_path / "c.csv", orientation=form)
    )
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
    assert list(rows_of(path)[0])[11 : 11 + len(columns)] == columns


def test_zeros_have_no_sign_and_warnings_are_named(ur3: Robot, tmp_path: Path):
    near = np.radians([[10, -80, 70, -60, 0.2, 5]])
    row = rows_of(
        write_commands(compensate(ur3, Program.of_joints(near), nominal=ur3), tmp_path / "c.csv")
    )[0]
    assert {row[f"correction {name} [deg]"] for name in NAMES} == {"0.000000000"}
    assert row["status"] == "warning: near singularity"
