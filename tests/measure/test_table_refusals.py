"""What readers of tables and lists of points refuse, in full: what was given, where, what is allowed, the fix."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from calib.errors import CalibError, MeasurementError
from calib.measure.measurements import Measurements
from calib.measure.noise import parse_noise
from calib.measure.quantities import parse_joint_value
from calib.measure.sweeps import read_sweeps

POSE = "a [deg],x [mm],y [mm],z [mm],qx,qy,qz,qw"


def refused(kind: type[CalibError], text: str):
    """The whole message, as it is printed."""
    return pytest.raises(kind, match=f"^{re.escape(text)}$")


def written(folder: Path, *lines: str, name: str = "t.csv") -> Path:
    path = folder / name
    path.write_text("\n".join([*lines, ""]))
    return path


def rows(**changes):
    """Three rows of a robot with one joint."""
    values = {"joint_names": ("a",), "joints": np.zeros((3, 1)), "points": np.ones((3, 3))}
    return Measurements(**{**values, "source": "own", **changes})


def test_two_columns_of_one_name(tmp_path):
    path = written(tmp_path, "a [deg],x [mm],y [mm],z [mm],x [m]", "1,2,3,4,5")
    with refused(
        MeasurementError,
        "t.csv: two columns are called 'x': number 2 ('x [mm]') and number 5 ('x [m]'). Remove or "
        'rename one, or leave one out: --columns "x [m]=-".',
    ):
        Measurements.read(path)


def test_a_column_mapped_to_an_unknown_unit(tmp_path):
    path = written(tmp_path, "a [deg],x,y [mm],z [mm]", "1,2,3,4")
    with refused(
        MeasurementError,
        "t.csv: --columns maps 'x' to 'x [inch]': 'inch' is not a unit that calib knows: a length is "
        "in 'm', 'mm', 'um', 'cm', 'in', an angle in 'rad', 'deg', 'mrad', a torque in 'Nm', a force "
        "in 'N'",
    ):
        Measurements.read(path, columns={"x": "x [inch]"})


def test_a_column_in_a_unit_of_another_quantity(tmp_path):
    path = written(tmp_path, "a [deg],x [deg],y [mm],z [mm]", "1,2,3,4")
    with refused(
        MeasurementError,
        "t.csv, column 'x [deg]': 'deg' is not a unit of length. Correct the header to 'x [mm]'; "
        "allowed are 'm', 'mm', 'um', 'cm', 'in'.",
    ):
        Measurements.read(path)


def test_a_column_without_a_unit(tmp_path):
    path = written(tmp_path, "a [deg],x,y [mm],z [mm]", "1,2,3,4")
    with refused(
        MeasurementError,
        "t.csv, column 'x': the column has no unit. Write the unit into the header, 'x [mm]', or "
        "give it with --columns \"x=x [mm]\"; allowed are 'm', 'mm', 'um', 'cm', 'in'.",
    ):
        Measurements.read(path)


def test_an_orientation_given_twice(tmp_path):
    path = written(tmp_path, f"{POSE},rx [deg],ry [deg],rz [deg]", "1,2,3,4,0,0,0,1,0,0,0")
    with refused(
        MeasurementError,
        "t.csv: the orientation is there twice, as 'qx', 'qy', 'qz', 'qw' and as 'rx', 'ry', 'rz'. "
        'Leave one out: --columns "rx=-" or --columns "qx=-".',
    ):
        Measurements.read(path, kind="pose")


def test_a_quaternion_with_a_unit(tmp_path):
    path = written(tmp_path, POSE.replace("qy", "qy [deg]"), "1,2,3,4,0,0,0,1")
    with refused(
        MeasurementError,
        "t.csv, column 'qy [deg]': 'deg' cannot be; a quaternion has no unit. Correct the header to "
        "'qy'; for angles, to 'rx [deg]' and so on.",
    ):
        Measurements.read(path, kind="pose")


def test_a_quaternion_that_has_not_length_one(tmp_path):
    path = written(tmp_path, POSE, "1,2,3,4,0,0,0,1", "1,2,3,4,0,0,0.5,1")
    with refused(
        MeasurementError,
        "t.csv, line 3 (row 2), columns qx, qy, qz, qw: the quaternion has the length 1.11803; that "
        "of an orientation is 1. Correct it, or leave the orientation out with --kind point.",
    ):
        Measurements.read(path)


def test_joints_without_columns(tmp_path):
    path = written(tmp_path, "elbow [deg],x [mm],y [mm],z [mm]", "1,2,3,4")
    with refused(
        MeasurementError,
        "t.csv: no column for the joints 'elbow_joint'. The columns found: 'elbow [deg]', 'x [mm]', "
        "'y [mm]', 'z [mm]'. Close to 'elbow_joint': 'elbow'. The header of such a column is "
        "'elbow_joint [deg]'; another name is mapped by --columns \"name in the table=elbow_joint "
        '[deg]".',
    ):
        Measurements.read(path, ("elbow_joint",))


def test_set_ups_that_would_be_joined_to_one_name(tmp_path):
    head = "a [deg],x [mm],y [mm],z [mm],day,place"
    path = written(tmp_path, head, "1,2,3,4,1/2,3", "1,2,3,4,1,2/3")
    with refused(
        MeasurementError,
        "t.csv, line 3 (row 2): the words '1', '2/3' make the same group '1/2/3' as '1/2', '3'. "
        "Write words without '/' in these columns.",
    ):
        Measurements.read(path, columns={"day": "group", "place": "group"})


def test_files_that_are_no_text(tmp_path):
    path = tmp_path / "t.csv"
    path.write_bytes(b"a [deg],x [mm],y [mm],z [mm]\n1,2,\0,4\n")
    with refused(
        MeasurementError, "t.csv: this is not a text file. Save the table as CSV (UTF-8)."
    ):
        Measurements.read(path)
    path.write_bytes(b"P1 1 2 3\nP2 1 \0 3\n")
    with refused(
        MeasurementError, "t.csv: this is not a text file. Export the points as text (ASCII)."
    ):
        read_sweeps(points=path)


def test_quotes_that_do_not_close(tmp_path):
    path = written(tmp_path, 'a [deg],"x [mm],y [mm],z [mm]', "1,2,3,4")
    with refused(
        MeasurementError,
        't.csv: not a CSV table (unexpected end of data). Check the double quotes (") in its header.',
    ):
        Measurements.read(path)
    path = written(tmp_path, "a [deg],x [mm],y [mm],z [mm]", '1,"2,3,4')
    with refused(
        MeasurementError,
        't.csv, line 2: not a CSV table (unexpected end of data). Check the double quotes (") there '
        "and above.",
    ):
        Measurements.read(path)


def test_points_without_names_beside_a_table_with_names(tmp_path):
    table = written(tmp_path, "point,sweep", "P1,plane")
    points = written(tmp_path, "# Units: mm", "100 200 300", name="p.txt")
    with refused(
        MeasurementError,
        "p.txt: the points have no names, and t.csv has a column 'point' to match them by. Add names "
        'to the points, or leave the column out: --columns "point=-".',
    ):
        read_sweeps(table, points=points)
    with refused(
        MeasurementError,
        "p.txt: the points have no names, which would say what sweep they are of. Name them "
        "'plane_1', 'joint1_01' and so on, or give a table with a column 'sweep'.",
    ):
        read_sweeps(points=points)


def test_points_in_a_unit_that_is_no_length(tmp_path):
    points = written(tmp_path, "plane_1 1 2 3", name="p.txt")
    with refused(
        MeasurementError,
        "p.txt: 'deg' is not a unit of length; allowed are 'm', 'mm', 'um', 'cm', 'in'",
    ):
        read_sweeps(points=points, points_unit="deg")


def test_a_point_whose_name_is_no_sweep(tmp_path):
    points = written(
        tmp_path, "# Units: mm", "plane_1 100 200 300", "ring_1 100 200 300", name="p.txt"
    )
    with refused(
        MeasurementError,
        "p.txt, line 3: the point 'ring_1': 'ring' is not a sweep; allowed are 'plane', a joint's "
        "number, 'joint 1'. Joints go by their names where --robot or columns of joint values tell "
        'them. Correct it, or map it: --sweep "ring=joint 1".',
    ):
        read_sweeps(points=points)


@pytest.mark.parametrize("cell", ["", "two"])
def test_a_cell_of_a_sweep_that_is_no_number(tmp_path, cell):
    path = written(tmp_path, "sweep,x [mm],y [mm],z [mm]", f"plane,1,{cell},3")
    said = "the cell is empty" if not cell else "'two' is not a finite number"
    with refused(
        MeasurementError,
        f"t.csv, line 2 (row 1), column 'y [mm]': {said}. Correct it, or remove the row.",
    ):
        read_sweeps(path)


def test_rows_that_a_program_made_wrong():
    with refused(
        MeasurementError,
        "own, row 2: target ' t' and group '' are names on one line, without blanks around them; "
        "only the group may be empty",
    ):
        rows(targets=("t", " t", "t"))
    with refused(
        MeasurementError,
        "own, row 2: the kind 'points' is none of 'point', 'pose', 'distance', 'pair', 'fixed', "
        "'plane'",
    ):
        rows(kinds=("point", "points", "point"))
    with refused(
        MeasurementError,
        "own, row 2: the pair '' is a word on one line, without blanks around it, that two rows of "
        "the kind 'pair' share",
    ):
        rows(kinds=("point", "pair", "pair"), pairs=("", "", ""), distances=np.ones(3))
    with refused(MeasurementError, "own: the row number 2 is there twice; row numbers are unique"):
        rows(rows=(1, 2, 2))
    with refused(
        MeasurementError, "own, row 3: 'sigma' holds nan; every value is positive and finite"
    ):
        rows(sigma=[1e-4, 1e-4, np.nan])
    with refused(
        MeasurementError,
        "own, row 2: 'sigma' is 1e+07 m; no instrument has one below 1e-15 or above 1e+06 m. Correct "
        "it, or leave the column out: the noise is found from the data.",
    ):
        rows(sigma=[1e-4, 1e7, 1e-4])


def test_a_noise_without_a_number():
    with refused(
        CalibError,
        '--noise was given as "1.2.3 mm", where a number cannot be read; write it such as "0.05 mm" '
        'or "15 um + 6 um/m".',
    ):
        parse_noise("1.2.3 mm", "--noise")


def test_a_joint_value_without_a_number():
    with refused(
        CalibError,
        "[held] 'elbow': 'half a turn' is no number with a unit, such as \"0.5 mm\". Write \"30 deg\" or "
        '"0.3 m".',
    ):
        parse_joint_value("half a turn", "[held] 'elbow'")


def test_a_standard_deviation_of_zero(tmp_path):
    path = written(tmp_path, "a [deg],x [mm],y [mm],z [mm],sigma [mm]", "1,100,200,300,0")
    with refused(
        MeasurementError,
        "t.csv, line 2 (row 1), column 'sigma [mm]': sigma is '0'; a standard deviation is greater "
        "than zero. Correct it, or leave the column out: the noise is found from the data.",
    ):
        Measurements.read(path)


@pytest.mark.parametrize("cell", [1_000_000 * "1", '"' + 1_000_000 * "1" + '"'])
def test_a_cell_that_is_longer_than_any(tmp_path, cell):
    path = written(tmp_path, "a [deg],x [mm],y [mm],z [mm]", "1,2,3,4", f"1,2,3,{cell}", "1,2,3,4")
    with refused(
        MeasurementError,
        "t.csv, line 3: a cell is longer than 131,072 characters, and no measurement is. Delete it; if it runs over "
        'several lines, a double quote (") there does not close.',
    ):
        Measurements.read(path)
    path = written(tmp_path, f"a [deg],{cell}", "1,2")
    with refused(
        MeasurementError,
        "t.csv: a cell of the header is longer than 131,072 characters, and no column's name is. Check that it is the "
        "right file.",
    ):
        Measurements.read(path)
