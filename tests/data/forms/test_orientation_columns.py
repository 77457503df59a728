"""Orientations by their columns: the convention that they are read in, and what is refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.forms.column_options import ColumnOptions
from calib.data.measurements import Measurements
from calib.errors import MeasurementError
from tests.data.tables import refused

DEG = 180 / np.pi
FEW = Rotation.from_euler("ZYX", [[20, -30, 40], [170, 80, -100]], degrees=True)


@pytest.mark.parametrize(
    ("columns", "numbers", "orientation", "read_as"),
    [
        ("Roll [deg],PITCH [deg],yaw [deg]", FEW.as_euler("xyz", degrees=True), None, "rpy"),
        ("A [deg],B [deg],C [deg]", FEW.as_euler("ZYX", degrees=True), None, "kuka"),
        ("W [deg],P [deg],R [rad]", FEW.as_euler("xyz") * [DEG, DEG, 1], None, "fanuc"),
        ("q1,Q2,q3,q4", FEW.as_quat()[:, [3, 0, 1, 2]], None, "abb"),
        ("RX [deg],RY [deg],RZ [deg]", FEW.as_euler("XYZ", degrees=True), "staubli", "staubli"),
        ("Rx [deg],Ry [deg],Rz [deg]", FEW.as_euler("xyz", degrees=True), "yaskawa", "yaskawa"),
        ("rx [deg],ry [deg],rz [deg]", FEW.as_rotvec(degrees=True), None, "rotation-vector"),
        (
            "r11,r12,r13,r21,r22,r23,R31,R32,R33",
            FEW.as_matrix().reshape(-1, 9),
            None,
            "matrix",
        ),
    ],
)
def test_conventions_are_named_by_columns_or_by_an_option(
    table, columns, numbers, orientation, read_as
):
    rows = [f"1,{','.join(map(repr, row.tolist()))},100,200,300" for row in numbers]
    path = table(f"joint [deg],{columns},x [mm],y [mm],z [mm]", *rows)
    m = Measurements.read(path, columns=ColumnOptions(orientation=orientation))
    assert (m.joint_names, m.kinds, m.orientation) == (("joint",), ("pose", "pose"), read_as)
    np.testing.assert_allclose(m.rotations, FEW.as_matrix(), atol=1e-14)
    written = path.with_name("written.csv")
    m.write(written)
    again = Measurements.read(written)
    assert again.orientation == "quaternion"
    np.testing.assert_allclose(again.rotations, FEW.as_matrix(), atol=1e-14)


@pytest.mark.parametrize(
    ("columns", "numbers", "orientation", "says"),
    [
        ("q1,q2,q3,q4", "1,0,0,0.1", None, ["line 2 (row 1)", "'q1'", "length 1.00499"]),
        ("A,B [deg],C [deg]", "1,2,3", None, ["column 'A'", "'A [deg]'"]),
        (
            "r11,r12,r13,r21,r22,r23,r31,r32,r33",
            "1,0,0,0,1,0,0,0,-1",
            None,
            ["line 2 (row 1)", "'r11'", "-1"],
        ),
        (
            "r11,r12,r13,r21,r22,r23,r31,r32,r33",
            "1,0,0.01,0,1,0,0,0,1",
            None,
            ["line 2 (row 1)", "'r11'"],
        ),
        ("A [deg],B [deg],C [deg]", "1,2,3", "fanuc", ["--orientation fanuc", "W, P, R"]),
        ("rx [deg],ry [deg],rz [deg]", "179,80,-100", None, ["--orientation staubli", "yaskawa"]),
        (
            "A [deg],B [deg],C [deg],qx,qy,qz,qw",
            "1,2,3,0,0,0,1",
            None,
            ["--orientation quaternion", '--columns "A=-"'],
        ),
    ],
)
def test_orientations_of_a_convention_that_are_refused(table, columns, numbers, orientation, says):
    path = table(f"joint [deg],{columns},x [mm],y [mm],z [mm]", f"1,{numbers},100,200,300")
    refused(path, says, columns=ColumnOptions(orientation=orientation))


def test_one_of_two_orientations_is_chosen(table):
    header = "joint [deg],A [deg],B [deg],C [deg],qx,qy,qz,qw,x [mm],y [mm],z [mm]"
    path = table(header, "1,90,0,0,0,0,0,1,100,200,300")
    m = Measurements.read(path, columns=ColumnOptions(orientation="kuka"))
    np.testing.assert_allclose(m.rotations[0, :, 0], [0, 1, 0], atol=1e-15)
    m = Measurements.read(path, columns=ColumnOptions(orientation="quaternion"))
    np.testing.assert_array_equal(m.rotations[0], np.eye(3))


def test_a_rotation_vector_beyond_half_a_turn_is_read_if_it_is_called_so(table):
    path = table("j [deg],rx [deg],ry [deg],rz [deg],x [mm],y [mm],z [mm]", "1,200,0,0,100,0,0")
    m = Measurements.read(path, columns=ColumnOptions(orientation="rotation-vector"))
    np.testing.assert_allclose(m.rotations[0, 1, 1], np.cos(np.radians(200)), rtol=1e-15)


def test_joints_may_have_the_names_of_orientations(table):
    path = table("A [deg],B [deg],C [deg],x [mm],y [mm],z [mm]", "1,2,3,100,200,300")
    m = Measurements.read(path, ["A", "B", "C"])
    assert (m.kinds, m.orientation) == (("point",), "")
    path = table("q1 [deg],q2 [deg],q3 [deg],q4 [deg],x [mm],y [mm],z [mm]", "1,2,3,4,100,2,3")
    assert Measurements.read(path).joint_names == ("q1", "q2", "q3", "q4")


def test_a_plan_s_empty_quaternion_is_none_beside_other_angles(table):
    header = "j [deg],x [mm],y [mm],z [mm],qx,qy,qz,qw,A [deg],B [deg],C [deg]"
    m = Measurements.read(table(header, "1,100,200,300,,,,,90,0,0", "2,,,,,,,,,,"))
    assert (m.orientation, m.rows, m.unmeasured) == ("kuka", (1,), (2,))


def test_a_brand_s_letters_are_read_in_any_case_if_it_is_given(table):
    capitals = Measurements.read(
        table("J1,X,Y,Z,W,P,R", "10,400,200,300,10,20,30"),
        ["J1"],
        columns=ColumnOptions(brand="fanuc"),
    )
    small = Measurements.read(
        table("J1,x,y,z,w,p,r", "10,400,200,300,10,20,30"),
        ["J1"],
        columns=ColumnOptions(brand="fanuc"),
    )
    np.testing.assert_array_equal(small.rotations, capitals.rotations)
    assert small.orientation == "fanuc"


def test_a_brand_s_angles_without_unit_are_refused_with_the_option_to_type(table):
    path = table("J1 [deg],x [mm],y [mm],z [mm],W,P,R", "10,1,2,3,10,20,30")
    with pytest.raises(MeasurementError, match="--columns fanuc"):
        Measurements.read(path, ["J1"])
