"""Columns by name and unit: what maps to what, and headers that are refused."""

import numpy as np
import pytest

from calib.basics.tables import Column, Table
from calib.data.columns import column_names, name_columns, reserved, with_unit
from calib.data.forms.column_options import ColumnOptions
from calib.data.measurements import Measurements
from calib.errors import MeasurementError
from tests.data.tables import assert_same, refused


@pytest.fixture
def named(table):
    """Names the columns of a header by calib's names, as positions, and the groups."""

    def name(header, columns, joint_names=()):
        value = Table.read(table(header, "1," * header.count(",") + "1"))
        found, groups = name_columns(value, joint_names, columns)
        return {key: c.index for key, c in found.items()}, [c.index for c in groups]

    return name


def test_the_tables_names_map_to_calibs(named):
    assert named("J1 [deg],J2,note", {"J1": "a", "J2": "b [deg]"})[0] == {"a": 0, "b": 1, "note": 2}
    assert named("J1 [deg],J2", {"J1": "J2", "J2": "J1"})[0] == {"J2": 0, "J1": 1}
    assert named("J1 [deg],J2", {"J1 [deg]": "a", "J2": "-"})[0] == {"a": 0}
    with pytest.raises(
        MeasurementError, match="there is no column 'K', which --columns maps to 'a'"
    ):
        named("J1,J2", {"K": "a"})
    with pytest.raises(MeasurementError, match=r"'J1 \[deg\]': --columns gives it another unit"):
        named("J1 [deg]", {"J1": "a [rad]"})


def test_names_of_calib_are_read_in_any_case_unless_a_joint_has_them(named):
    assert named("X [mm],Status,Ax", {})[0] == {"x": 0, "status": 1, "Ax": 2}
    assert named("X [mm]", {}, ["X"])[0] == {"X": 0}
    assert "x" in reserved()


def test_groups_are_joined_only_if_they_are_mapped(named):
    columns = {"place": "group", "socket": "group"}
    assert named("place,socket,n", columns) == ({"group": 0, "n": 2}, [0, 1])
    assert named("group,socket", {"socket": "group"}) == ({"group": 0}, [0, 1])
    with pytest.raises(MeasurementError, match="two columns are called 'group': number 1"):
        named("group,Group", {})


def test_a_unit_is_that_of_the_quantity():
    value = Table("t.csv", "", ",", ("a",), (), ())
    length, plain = Column(0, "a [mm]", "x", "mm"), Column(0, "a", "x", None)
    assert with_unit(value, length, "length") is length
    assert with_unit(value, plain, None) is plain
    for column, quantity, says in (
        (
            length,
            "angle",
            "column 'a .mm.' .it.: 'mm' is not a unit of angle.*'a .rad.'.*a=x .rad.",
        ),
        (plain, "length", "the column has no unit. Write the header 'a .rad.'"),
        (length, None, "'mm' cannot be; there is no unit here"),
    ):
        with pytest.raises(MeasurementError, match=says):
            with_unit(value, column, quantity, "it", "rad")


def test_columns_are_renamed_and_given_units(table):
    path = table("J1,J2 [deg],East [mm],y [mm],z [mm]", "10,20,300,400,500")
    columns = {"J1": "a [deg]", "J2": "b", "East": "x"}
    m = Measurements.read(path, ["a", "b"], columns=columns)
    np.testing.assert_allclose(m.joints, np.deg2rad([[10, 20]]), rtol=1e-15)
    assert m.points[0, 0] == pytest.approx(0.3)
    with_unit_in_key = {"J1": "a [deg]", "J2 [deg]": "b [deg]", "East": "x"}
    assert_same(Measurements.read(path, ["a", "b"], columns=with_unit_in_key), m, rtol=0)


@pytest.mark.parametrize(
    ("header", "joint_names", "says"),
    [
        ("a,b [deg],x [mm],y [mm],z [mm]", "ab", ["column 'a'", "no unit", "'a [deg]'", "mrad"]),
        ("a [deg],b [deg],x,y [mm],z [mm]", "ab", ["column 'x'", "no unit", "'x [mm]'"]),
        ("a [deg],b [deg],x [mm],y [mm],z/mm", "ab", ["need a column 'z [mm]'", "'z/mm'"]),
        ("a [deg],b [grad],x [mm],y [mm],z [mm]", "ab", ["'b [grad]'", "'grad' is not a unit"]),
        ("a [deg],b [deg],x [deg],y [mm],z [mm]", "ab", ["'x [deg]'", "not a unit of length"]),
        ("a [deg],a [rad],x [mm],y [mm],z [mm]", "a", ["two columns", "'a'", "number 2"]),
        ("a [deg],x [mm],X [m],y [mm],z [mm]", "a", ["two columns", "'x [mm]'", "'X [m]'"]),
        ("a,x [mm],y [mm],z [mm],q", None, ["no column of joint angles", "'a'"]),
        ("a [deg],b [deg],c,d,e", None, ["need a column 'x [mm]'", "'a [deg]'", "--columns"]),
    ],
)
def test_headers_that_are_refused(table, header, joint_names, says):
    refused(
        table(header, "1,2,3,4,5"),
        joint_names=joint_names and [*joint_names],
        says=["data.csv", *says],
    )


def test_the_names_of_a_table(tmp_path):
    path = tmp_path / "data.csv"
    path.write_text("a [deg];b [m]\n1;2\n")
    table = Table.read(path)
    assert column_names(table) == {"a", "b"}
    assert column_names(table, {"a": "elbow [deg]"}) == {"a", "b", "elbow"}
    assert column_names(table, ColumnOptions(brand="kuka")) is None
