import csv
import hashlib
import itertools
from dataclasses import FrozenInstanceError, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import strategies as st

import calib
from calib.data.measurements import Measurements
from calib.errors import MeasurementError

UR3 = Path(calib.__file__).parent / "example" / "ur3_leica.csv"
UR3_JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
HEADER = "row,set,a [deg],b [deg],x [mm],y [mm],z [mm]"
ROWS = ("1,estimate,10,20,300,400,500", "2,validate,-30,420.75,301.5,-400,500")


def refused(path, *, says, **arguments):
    """The text with which a table is refused; it holds each of the words."""
    with pytest.raises(MeasurementError) as caught:
        Measurements.read(path, **arguments)
    text = str(caught.value)
    for word in [says] if isinstance(says, str) else says:
        assert word in text
    assert "\n" not in text
    return text


def assert_same(one, other, rtol=1e-15):
    for name in ("joints", "points"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=rtol, atol=0)
    assert (one.sigma is None) == (other.sigma is None)
    if one.sigma is not None:
        np.testing.assert_allclose(one.sigma, other.sigma, rtol=rtol, atol=0)
    for name in ("joint_names", "sets", "targets", "groups", "rows", "prismatic"):
        assert getattr(one, name) == getattr(other, name)


# The paper's table


def test_the_papers_table():
    m = Measurements.read(UR3, UR3_JOINTS, dict.fromkeys(UR3_JOINTS, "revolute"))
    with UR3.open() as file:
        printed = list(csv.reader(file))[1:]
    numbers = np.array([[float(cell) for cell in line[2:]] for line in printed])
    assert len(m) == 35
    assert m.joint_names == UR3_JOINTS
    np.testing.assert_allclose(m.joints, np.deg2rad(numbers[:, :6]), rtol=1e-15)
    np.testing.assert_allclose(m.points, numbers[:, 6:] / 1000.0, rtol=1e-15)
    assert m.joints[9, 5] == pytest.approx(np.deg2rad(420.75), rel=1e-15)
    assert m.sets == ("estimate",) * 30 + ("validate",) * 5
    assert m.rows == tuple(range(1, 36))
    assert m.sigma is None
    assert (m.targets, m.groups) == (("target",) * 35, ("",) * 35)
    assert m.source == "ur3_leica.csv"
    assert m.sha256 == hashlib.sha256(UR3.read_bytes()).hexdigest()
    assert m.ignored == ()
    assert_same(Measurements.read(UR3), m, rtol=0)


def examples():
    """The tables and lists that docs/data-format.md shows, in its order."""
    page = Path(__file__).parents[2] / "docs" / "data-format.md"
    return [block.strip() for block in page.read_text(encoding="utf-8").split("```")[1::2]]


def test_the_example_in_the_documentation(table):
    m = Measurements.read(table(examples()[0]), UR3_JOINTS[:3])
    np.testing.assert_array_equal(m.points, Measurements.read(UR3).points[[0, 1, 30]])
    assert m.sets == ("estimate", "estimate", "validate")


def test_the_examples_of_other_kinds(table):
    poses, lengths, sockets = examples()[1:4]
    m = Measurements.read(table(poses))
    assert set(m.kinds) == {"pose"}
    np.testing.assert_allclose(m.sigma_angle, np.deg2rad([0.1, 0.1]))
    m = Measurements.read(table(lengths))
    assert m.kinds == ("distance", "distance", "pair", "pair")
    np.testing.assert_allclose(m.distances[2:], [0.750002] * 2)
    columns = {"placement": "group", "socket": "group"}
    m = Measurements.read(table(sockets), kind="fixed", columns=columns)
    assert m.groups == ("left/A", "left/A", "left/B", "left/B")


def test_the_example_of_a_list_of_points(table, tmp_path):
    listed, joints = examples()[4:]
    (tmp_path / "tracker.txt").write_text(listed)
    m = Measurements.read(table(joints), UR3_JOINTS[:3], points=tmp_path / "tracker.txt")
    paper = Measurements.read(UR3)
    np.testing.assert_array_equal(m.points, paper.points[[1, 0]])
    np.testing.assert_array_equal(m.joints, paper.joints[[1, 0], :3])


# The value


def test_arrays_are_read_only_copies():
    joints = np.zeros((2, 1))
    m = Measurements(("a",), joints, [[1, 2, 3], [4, 5, 6]], sigma=[0.1, 0.2])
    joints[0, 0] = 1.0
    assert m.joints[0, 0] == 0.0
    for array in (m.joints, m.points, m.sigma, m.estimation, m.validation, m.joints_for(["a"])):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    with pytest.raises(FrozenInstanceError):
        m.source = "other"


def test_select_keeps_row_numbers_and_the_rest():
    m = replace(Measurements.read(UR3), sigma=np.linspace(1e-4, 2e-4, 35))
    held_back = m.select(m.validation)
    assert len(held_back) == 5
    assert held_back.rows == (31, 32, 33, 34, 35)
    assert held_back.sets == ("validate",) * 5
    np.testing.assert_array_equal(held_back.points, m.points[30:])
    np.testing.assert_array_equal(held_back.joints, m.joints[30:])
    np.testing.assert_array_equal(held_back.sigma, m.sigma[30:])
    assert held_back.sha256 == m.sha256
    assert len(held_back.select(held_back.estimation)) == 0


def test_joints_for_another_order():
    m = Measurements.read(UR3)
    np.testing.assert_array_equal(
        m.joints_for(["wrist_3_joint", "elbow_joint"]), m.joints[:, [5, 2]]
    )
    assert m.joints_for([]).shape == (35, 0)
    with pytest.raises(MeasurementError) as caught:
        m.joints_for(["elbow_joint", "wrist_4_joint"])
    assert "'wrist_4_joint'" in str(caught.value)
    assert "'wrist_3_joint'" in str(caught.value)


# Reading


def test_optional_columns_and_ignored_ones(table):
    path = table(
        "a [deg],target,group,sigma [um],x [mm],y [mm],z [mm],qx,rx [rad],force [N],note,",
        "10,ball,north,50,300,400,500,0,0.1,3,warm,",
        "20,cube,,60,300,400,600,0,0.1,,,",
    )
    m = Measurements.read(path)
    assert m.joint_names == ("a",)
    assert m.targets == ("ball", "cube")
    assert m.groups == ("north", "")
    np.testing.assert_allclose(m.sigma, [5e-5, 6e-5], rtol=1e-15)
    assert m.rows == (1, 2)
    assert m.sets == ("estimate", "estimate")
    assert m.ignored == ("qx", "rx [rad]", "force [N]", "note")


def test_columns_are_renamed_and_given_units(table):
    path = table("J1,J2 [deg],East [mm],y [mm],z [mm]", "10,20,300,400,500")
    columns = {"J1": "a [deg]", "J2": "b", "East": "x"}
    m = Measurements.read(path, ["a", "b"], columns=columns)
    np.testing.assert_allclose(m.joints, np.deg2rad([[10, 20]]), rtol=1e-15)
    assert m.points[0, 0] == pytest.approx(0.3)
    with_unit_in_key = {"J1": "a [deg]", "J2 [deg]": "b [deg]", "East": "x"}
    assert_same(Measurements.read(path, ["a", "b"], columns=with_unit_in_key), m, rtol=0)


def test_prismatic_joints(table):
    path = table("rail [mm],a [deg],x [mm],y [mm],z [mm]", "1500,20,300,400,500")
    types = {"rail": "prismatic", "a": "continuous"}
    for arguments in ((["rail", "a"], types), (["rail", "a"],), (None, types)):
        m = Measurements.read(path, *arguments)
        np.testing.assert_allclose(m.joints, [[1.5, np.deg2rad(20)]], rtol=1e-15)
        assert m.prismatic == ("rail",)
    assert Measurements.read(path).ignored == ("rail [mm]",)


# Writing


names = st.text(alphabet="abJ_ 0[].,;'\"#é", min_size=1, max_size=8).filter(
    lambda text: text == text.strip()
)
values = st.floats(-3, 3).filter(lambda value: value == 0 or abs(value) > 1e-300)


# Refusals: the file


def test_files_that_are_no_tables(tmp_path, table):
    refused(tmp_path / "none.csv", says=["none.csv", "does not exist"])
    refused(tmp_path, says="is a folder")
    refused(table(""), says="the file is empty")
    refused(table("# only a remark", "", ",,"), says="the file is empty")
    refused(table(HEADER, ",,,,,,"), says=["data.csv", "no row below it"])
    refused(table(HEADER, *ROWS, encoding="utf-16-le"), says="not a text file")
    refused(table(HEADER, *ROWS, encoding="utf-32"), says="not a text file")
    refused(table(*ROWS[:1], *ROWS), says="no column of joint angles")
    refused(table("1,2,3", "4,5,6"), says="the first line holds numbers")
    refused(table(HEADER, '1,estimate,"10,20'), says=["data.csv", "double quotes"])
    refused(table("a" * 200_000), says=["data.csv", "field larger"])


# Refusals: the header


@pytest.mark.parametrize(
    ("header", "joint_names", "says"),
    [
        ("a,b [deg],x [mm],y [mm],z [mm]", "ab", ["column 'a'", "no unit", "'a [deg]'", "mrad"]),
        ("a [deg],b [deg],x,y [mm],z [mm]", "ab", ["column 'x'", "no unit", "'x [mm]'"]),
        ("a [deg],b [deg],x [mm],y [mm],z (mm)", "ab", ["need a column 'z [mm]'", "'z (mm)'"]),
        ("a [deg],b [grad],x [mm],y [mm],z [mm]", "ab", ["'b [grad]'", "'grad' is not a unit"]),
        ("a [deg],b [deg],x [deg],y [mm],z [mm]", "ab", ["'x [deg]'", "not a unit of length"]),
        ("a [deg],a [rad],x [mm],y [mm],z [mm]", "a", ["two columns", "'a'", "number 2"]),
        ("a [deg],x [mm],X [m],y [mm],z [mm]", "a", ["two columns", "'x [mm]'", "'X [m]'"]),
        ("a,x [mm],y [mm],z [mm],q", None, ["no column of joint angles", "'a'"]),
        ("a [deg],b [deg],c,d,e", None, ["need a column 'x [mm]'", "'a [deg]'", "--columns"]),
    ],
)
def test_headers_that_are_refused(table, header, joint_names, says):
    refused(table(header, "1,2,3,4,5"), joint_names=joint_names, says=["data.csv", *says])


def test_missing_joints_are_named_with_what_is_close(table):
    path = table("Elbow [deg],sholder_pan_joint [deg],x [mm],y [mm],z [mm]", "1,2,3,4,5")
    text = refused(path, joint_names=["shoulder_pan_joint", "elbow", "tool"], says="data.csv: ")
    assert "'shoulder_pan_joint' (did you mean 'sholder_pan_joint'?)" in text
    assert "'elbow' (did you mean 'Elbow'?), 'tool'." in text
    assert "The columns found: 'Elbow [deg]', " in text
    assert '--columns "name in the table=shoulder_pan_joint [deg]"' in text


# Refusals: the cells


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ("7,estimate,1,2,3,4", ["has 6 cells, the header has 7"]),
        ("7,estimate,1,2,3,4,5,6", ["has 8 cells, the header has 7", "decimal comma"]),
        ("7,estimate,1,,3,4,5", ["column 'b [deg]'", "the cell is empty"]),
        ("7,estimate,1,2,3,nan,5", ["column 'y [mm]'", "'nan' is not a finite number"]),
        ("7,estimate,1,2,3,4,5 mm", ["column 'z [mm]'", "'5 mm' is not a finite number"]),
        ("7,estimate,1,2,3,4,1_000", ["column 'z [mm]'", "'1_000' is not a finite number"]),
        ('7,estimate,1,2,3,4,"5,5"', ["column 'z [mm]'", "decimal comma", "semicolons"]),
        ("7,estimate,1,2,3e8,4,5", ["column 'x [mm]'", "further from the origin than 100 m"]),
    ],
)
def test_cells_that_are_refused(table, row, says):
    path = table(HEADER, "# remark", ROWS[0], row)
    refused(path, says=["data.csv, line 4 (row ", *says])


def test_without_a_row_column_rows_are_counted(table):
    path = table("", "a [deg],x [mm],y [mm],z [mm]", "1,2,3,4", "", "1,2,3,no")
    refused(path, says="line 5 (row 2), column 'z [mm]'")


def test_points_and_commas_in_one_table(table):
    path = table("a [deg];x [mm];y [mm];z [mm]", "1;200;300;400", "1.5;1,234;300;400")
    refused(path, says=["decimal point in line 3", "decimal comma in line 3"])


def test_a_table_without_a_row_to_estimate_from(table):
    path = table(HEADER, ROWS[1])
    refused(path, says=["column 'set'", "no measured row is 'estimate'", "all 1"])


# Refusals: the wrong unit


@pytest.mark.parametrize(
    ("unit", "point", "says"),
    [
        ("m", "-149.02,-207.5,742.6", ["'z [m]'", "742.6 was read as 742.6 m", "in mm"]),
        ("mm", "-149020,-207500,742600", ["742600 was read as 742.6 m", "in um"]),
        ("mm", "-0.149,-0.2075,0.7426", ["0.7426 was read as 0.0007426 m", "in m"]),
        ("um", "-149.02,-207.5,742.6", ["742.6 was read as 0.0007426 m", "in mm"]),
        ("m", "1e9,0,0", ["column 'x [m]'", "Correct the value"]),
        ("mm", "0,0,0", ["none is further from the origin than 5 mm", "Correct the value"]),
    ],
)
def test_points_in_the_wrong_unit(table, unit, point, says):
    path = table(f"a [deg],x [{unit}],y [{unit}],z [{unit}]", f"1,{point}")
    refused(path, says=["line 2 (row 1), column '", *says])


def test_degrees_read_as_radians(table):
    header = "a [rad],b [rad],x [mm],y [mm],z [mm]"
    path = table(header, "1,-74.76,10,20,300", "1,6.1,10,20,300", "1,-72,10,20,300")
    refused(path, says=["column 'b [rad]'", "look like degrees", "'b [deg]'"])


# What programs of this world write


FORM = [
    "joint_1 [deg],joint_2 [deg],x [mm],y [mm],z [mm]",
    "1.5,-20,300.25,0,50",
    "2,30.125,-301,5,60.5",
]


def bytes_of(lines, sign=",", end="\n", encoding="utf-8"):
    text = end.join(lines) + end
    if sign == ";":
        return text.replace(",", ";").replace(".", ",").encode(encoding)
    return text.replace(",", sign).encode(encoding)


@pytest.mark.parametrize("sign", [",", ";", "\t"])
@pytest.mark.parametrize("more", ["", "blank", "comment", "last", "quotes", "trailing", "spaces"])
def test_every_form_is_read_to_the_same_bits(tmp_path, sign, more):
    path = tmp_path / "data.csv"
    path.write_bytes(bytes_of(FORM))
    plain = Measurements.read(path)
    lines = list(FORM)
    if more == "blank":
        lines = ["", lines[0], "", ",,,,", lines[1], " ", lines[2], ""]
    elif more == "comment":
        lines = ["# by a program", lines[0], "  # more", lines[1], '"# quoted, too"', lines[2]]
    elif more == "quotes":
        lines = [",".join(f'"{cell}"' for cell in line.split(",")) for line in lines]
    elif more == "trailing":
        lines = [line + "," for line in lines]
    elif more == "spaces":
        lines = [line.replace(",", " , ") + "  " for line in lines]
    for end, encoding in itertools.product(["\n", "\r\n", "\r"], ["utf-8", "utf-8-sig", "utf-16"]):
        data = bytes_of(lines, sign, end, encoding)
        path.write_bytes(data[:-1] if more == "last" and data.endswith(b"\n") else data)
        assert_same(Measurements.read(path), plain, rtol=0)


def test_forms_that_are_refused(tmp_path, table):
    path = tmp_path / "data.csv"
    path.write_bytes(bytes_of([FORM[0], FORM[1].replace(".", ",")]))
    refused(path, says=["line 2 (row 1)", "the row has 7 cells, the header has 5", "decimal comma"])
    path.write_bytes(bytes_of([FORM[0], '"1,5",-20,300,0,50']))
    refused(path, says=["line 2 (row 1), column 'joint_1 [deg]'", "'1,5' has a decimal comma"])
    refused(table(FORM[0], FORM[1] + ","), says=["line 2", "the row has 6 cells"])
    header = "J\xf6int [deg],x [mm],y [mm],z [mm]"  # as Excel writes "CSV" on Windows
    ansi = Measurements.read(table(header, "1,200,300,400", encoding="cp1252"))
    assert ansi.joint_names == ("J\xf6int",)
    assert len(refused(table(FORM[0], "a" * 100_000 + ",1,2,3,4"), says=["line 2 (row 1)"])) < 4000
