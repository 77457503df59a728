"""Which column of a table is what, and of what kinds its rows are."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.measurements import Measurements
from tests.data.tables import assert_same, refused

TURNED = Rotation.from_rotvec([[0.1, -0.2, 0.3], [3.0, 0.2, -0.4]])
POSE = "a [deg],x [mm],y [mm],z [mm],"


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
    np.testing.assert_allclose(m.sigma["m"], [5e-5, 6e-5], rtol=1e-15)
    assert m.rows == (1, 2)
    assert m.sets == ("estimate", "estimate")
    assert m.ignored == ("qx", "rx [rad]", "force [N]", "note")


def test_prismatic_joints(table):
    path = table("rail [mm],a [deg],x [mm],y [mm],z [mm]", "1500,20,300,400,500")
    types = {"rail": "prismatic", "a": "continuous"}
    for arguments in ((["rail", "a"], types), (["rail", "a"],), (None, types)):
        m = Measurements.read(path, *arguments)
        np.testing.assert_allclose(m.joints, [[1.5, np.deg2rad(20)]], rtol=1e-15)
        assert m.prismatic == ("rail",)
    assert Measurements.read(path).ignored == ("rail [mm]",)


def test_missing_joints_are_named_with_what_is_close(table):
    path = table("Elbow [deg],sholder_pan_joint [deg],x [mm],y [mm],z [mm]", "1,2,3,4,5")
    text = refused(
        path, joint_names=["shoulder_pan_joint", "elbow", "tool"], says="data.csv, line 1: "
    )
    assert "'shoulder_pan_joint' (did you mean 'sholder_pan_joint'?)" in text
    assert "'elbow' (did you mean 'Elbow'?), 'tool'." in text
    assert "The columns found: 'Elbow [deg]', " in text
    assert '--columns "name in the table=shoulder_pan_joint [deg]"' in text


def test_torques(table):
    header = (
        "a [deg],b [deg],rail [mm],rail.torque [N],a.torque [N m],b.torque,x [mm],y [mm],z [mm]"
    )
    path = table(header, "1,2,3,4,-5,,100,200,300", "1,2,3,6,7,,100,200,300")
    names = ["rail", "a"]
    m = Measurements.read(path, names)
    np.testing.assert_array_equal(m.torques, [[4, -5], [6, 7]])
    assert m.ignored == ("b [deg]", "b.torque")
    text = refused(path, ["column 'b.torque' (revolute joint 'b')", "no unit", "'b.torque [Nm]'"])
    assert "'Nm'." in text
    with_unit = {"b.torque": "b.torque [Nm]"}
    refused(path, "column 'b.torque': the cell is empty", joint_names=["b"], columns=with_unit)
    assert m.select(np.array([False, True])).torques.tolist() == [[6, 7]]


# Kinds


@pytest.mark.parametrize(
    ("columns", "values"),
    [
        ("qx,qy,qz,qw", TURNED.as_quat()),
        ("qx,qy,qz,qw", -TURNED.as_quat()),
        ("qx [-],QY,qz [1],qw []", TURNED.as_quat() * 1.0009),
        ("rx [rad],ry [rad],rz [rad]", TURNED.as_rotvec()),
        ("rx [deg],ry [mrad],rz [rad]", TURNED.as_rotvec() * [180 / np.pi, 1000, 1]),
    ],
)
def test_a_complete_orientation_makes_poses(table, columns, values):
    rows = [f"1,{','.join(map(repr, row.tolist()))},100,200,300,0.05" for row in values]
    path = table(f"a [deg],{columns},x [mm],y [mm],z [mm],sigma_angle [deg]", *rows)
    m = Measurements.read(path)
    assert m.kinds == ("pose", "pose")
    np.testing.assert_allclose(m.rotations, TURNED.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(m.points, [[0.1, 0.2, 0.3]] * 2)
    np.testing.assert_allclose(m.sigma["rad"], np.deg2rad([0.05, 0.05]))
    assert m.ignored == ()
    points = Measurements.read(path, kind="point")
    assert points.kinds == ("point", "point")
    assert points.rotations is None
    assert "rad" not in points.sigma
    assert len(points.ignored) == columns.count(",") + 2
    as_poses = Measurements.read(path, kind="pose")
    assert_same(as_poses, m, atol=1e-15)


@pytest.mark.parametrize(
    ("header", "row", "says"),
    [
        ("qx,qy,qz,qw", "0,0,0,0.9", ["line 2 (row 1)", "length 0.9", "is 1"]),
        ("qx,qy,qz,qw [rad]", "0,0,0,1", ["column 'qw [rad]'", "'rad' cannot be"]),
        ("rx,ry,rz,b", "0,0,1,1", ["column 'rx' (a rotation vector", "no unit", "'rx [rad]'"]),
        ("rx [mm],ry [rad],rz [rad],b", "0,0,1,1", ["'mm' is not a unit of angle"]),
        ("rx [rad],ry [rad],rz [rad],b", "0,0,90,1", ["'rx [rad]'", "look like degrees"]),
        (
            "qx,qy,qz,qw,rx [rad],ry [rad],rz [rad]",
            "0,0,0,1,0,0,0",
            ["need one orientation", '--columns "rx=-"'],
        ),
        ("qx,qy,qz,qw,sigma_angle [rad]", "0,0,0,1,0.0", ["row 1: 'sigma_angle' is 0;"]),
    ],
)
def test_orientations_that_are_refused(table, header, row, says):
    refused(table(POSE + header, "1,100,200,300," + row), says)


def test_distances(table):
    path = table("a [deg],distance [mm],group,sigma [um]", "1,500,A,10", "2,510.5,B,10")
    m = Measurements.read(path)
    assert m.kinds == ("distance", "distance")
    np.testing.assert_allclose(m.distances, [0.5, 0.5105])
    assert np.isnan(m.points).all()
    assert m.groups == ("A", "B")
    assert Measurements.read(path, kind="distance").kinds == m.kinds


def test_fixed_points_in_groups_of_several_columns(table):
    lines = ("left,0,1", "left,1,2", "right,0,3", "left,0,4", "left,1,5", "right,0,6")
    path = table("place,socket,a [deg]", *lines)
    columns = {"socket": "group", "place": "group"}
    m = Measurements.read(path, kind="fixed", columns=columns)
    assert m.groups == ("left/0", "left/1", "right/0", "left/0", "left/1", "right/0")
    assert m.kinds == ("fixed",) * 6
    assert np.isnan(m.points).all()
    assert m.ignored == ()
    one = Measurements.read(path, kind="fixed")
    assert one.groups == ("",) * 6
    assert one.ignored == ("place", "socket")
    mixed = Measurements.read(
        table("Group,socket,a [deg]", *lines), kind="fixed", columns={"socket": "group"}
    )
    assert mixed.groups == m.groups


def test_what_is_missing_is_asked_for(table):
    path = table("a [deg],place", "1,left")
    refused(path, ["need a column 'x [mm]'", "--kind fixed", '"name in the table=x [mm]"'])
    refused(path, "need a column 'distance [mm]'", kind="distance")
    refused(path, "There is no kind of measurement 'socket'; there are 'point', ", kind="socket")
    path = table("a [deg],distance [mm]", "1,500")
    refused(path, ["need a column 'pair'", "'distance [mm]'"], kind="pair")


def test_rows_of_several_kinds(table):
    header = (
        "kind,a [deg],x [mm],y [mm],z [mm],qx,qy,qz,qw,distance [mm],pair,group,sigma_angle [deg]"
    )
    path = table(
        header,
        "point,1,100,200,300,,,,,,,,",
        "pose,2,100,200,300,0,0,0,-1,,,,0.1",
        "distance,3,,,,,,,,500,,A,",
        "pair,4,,,,,,,,,p,,",
        "pair,5,,,,,,,,600,p,,",
        "fixed,6,not,read,,,,,,,,B,",
        "fixed,7,,,,,,,,,not read,B,",
    )
    m = Measurements.read(path)
    assert m.kinds == ("point", "pose", "distance", "pair", "pair", "fixed", "fixed")
    assert m.pairs == ("", "", "", "p", "p", "", "")
    np.testing.assert_allclose(m.points[:2], [[0.1, 0.2, 0.3]] * 2)
    assert np.isnan(m.points[2:]).all()
    np.testing.assert_array_equal(m.rotations[1], np.eye(3))
    assert np.isnan(m.rotations[[0, *range(2, 7)]]).all()
    np.testing.assert_allclose(m.distances, [np.nan, np.nan, 0.5, 0.6, 0.6, np.nan, np.nan])
    np.testing.assert_allclose(m.sigma["rad"][1], np.deg2rad(0.1))
    np.testing.assert_array_equal(
        m.of_kind("fixed", "pose"), [False, True, *[False] * 3, True, True]
    )
    every = Measurements.read(path, kind="fixed", columns={"group": "-"})
    assert every.kinds == ("fixed",) * 7
    assert "kind" in every.ignored


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        (("kind,a [deg]", "ball,1"), ["line 2 (row 1), column 'kind'", "'ball'", '"kind=-"']),
        (("Kind,a [deg]", ",1"), ["There is no kind of measurement ''", '"Kind=-"']),
        (("kind,a [deg]", "fixed,1", "point,2"), "need a column 'x [mm]'"),
        (("kind,a [deg]",), "need a column 'x [mm]'"),
        (
            ("kind,a [deg],x [mm],y [mm],z [mm]", "fixed,1,,,", "point,2,1,,3"),
            "line 3 (row 2), column 'y [mm]': the cell is empty",
        ),
    ],
)
def test_kinds_that_are_refused(table, lines, says):
    refused(table(*lines), says)


@pytest.mark.parametrize(("kind", "ignored"), [("point", ()), ("pose", ("kind",))])
def test_a_column_of_kinds_is_told_where_the_kind_given_is_another(tmp_path, kind, ignored):
    path = tmp_path / "poses.csv"
    path.write_text("a [deg],x [mm],y [mm],z [mm],qx,qy,qz,qw,kind\n1,2,3,4,0,0,0,1,point\n")
    found = Measurements.read(path, joint_names=("a",), kind=kind).ignored
    assert tuple(name for name in found if name == "kind") == ignored
