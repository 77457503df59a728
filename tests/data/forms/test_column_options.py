"""What is said of a table's columns besides their headers."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.forms.column_options import (
    BRANDS,
    LEROBOT,
    ColumnOptions,
    brands_like,
    column_options,
)
from calib.data.forms.orientations import CONVENTIONS
from calib.data.measurements import Measurements
from calib.errors import CalibError, MeasurementError
from tests.data.tables import refused

JOINTS = ["one", "two", "three", "four", "five", "six"]
ANGLES = [10.0, -20.0, 30.0, -40.0, 50.0, -60.0]
TURN = Rotation.from_euler("ZYX", [20, -30, 40], degrees=True)

#: Header of a brand's table without a unit, and the orientation `TURN` in its convention.
HEADERS = {
    "kuka": ("A1,A2,A3,A4,A5,A6,X,Y,Z,A,B,C", [20, -30, 40]),
    "fanuc": ("J1,J2,J3,J4,J5,J6,X,Y,Z,W,P,R", [40, -30, 20]),
    "abb": ("rax_1,rax_2,rax_3,rax_4,rax_5,rax_6,x,y,z,q1,q2,q3,q4", TURN.as_quat()[[3, 0, 1, 2]]),
    "staubli": ("J1,J2,J3,J4,J5,J6,X,Y,Z,RX,RY,RZ", TURN.as_euler("XYZ", degrees=True)),
    "yaskawa": ("S,L,U,R,B,T,X,Y,Z,Rx,Ry,Rz", [40, -30, 20]),
}


def row(orientation):
    return ",".join(map(repr, [*ANGLES, 500.0, -200.5, 300.0, *map(float, orientation)]))


def test_every_brand_is_tried_and_has_a_convention():
    assert HEADERS.keys() == BRANDS.keys() - {LEROBOT}  # see test_servo_columns.py
    assert HEADERS.keys() <= CONVENTIONS.keys()
    assert BRANDS[LEROBOT].convention is None


@pytest.mark.parametrize("name", HEADERS)
def test_a_brand_s_columns_are_the_robot_s_in_its_order(table, name):
    header, orientation = HEADERS[name]
    path = table(header, row(orientation))
    m = Measurements.read(path, JOINTS, columns=ColumnOptions(brand=name))
    assert m.joint_names == tuple(JOINTS)
    np.testing.assert_allclose(m.joints, np.radians([ANGLES]), rtol=1e-15)
    np.testing.assert_allclose(m.points, [[0.5, -0.2005, 0.3]], rtol=1e-15)
    np.testing.assert_allclose(m.rotations, [TURN.as_matrix()], atol=1e-15)
    assert (m.kinds, m.orientation, m.ignored) == (("pose",), name, ())
    says = ["'one'", f"--columns {name}"]
    refused(path, says, joint_names=JOINTS)


def test_units_of_the_header_win_and_further_columns_are_mapped(table):
    path = table("A1 [rad],A2,E1 [mm],T,X [m],Y [m],Z [m]", "0.1,20,1500,25,0.5,0.1,0.2")
    names = ["rail", "one", "two"]
    options = ColumnOptions({"E1": "rail"}, brand="kuka")
    m = Measurements.read(path, names, {"rail": "prismatic"}, options)
    np.testing.assert_allclose(m.joints, [[1.5, 0.1, np.radians(20)]], rtol=1e-15)
    assert m.points[0, 0] == 0.5
    assert m.ignored == ("T",)
    says = ["2 axes of KUKA", "external axes 'E1'", '--columns "E1=rail"', "--tip", "--hold"]
    refused(path, says, joint_names=names, columns=ColumnOptions(brand="kuka"))
    says = ['--columns "A2=-"', "'A1', 'A2'"]
    refused(path, says, joint_names=["one"], columns=ColumnOptions(brand="kuka"))
    one = Measurements.read(path, ["one"], columns=ColumnOptions({"A2": "-"}, brand="kuka"))
    assert one.joints.tolist() == [[0.1]]


def test_the_seventh_axis_of_yaskawa_is_the_third_of_the_arm(table):
    path = table("S,L,U,R,B,T,E,X,Y,Z", "1,2,4,5,6,7,3,500,1,2")
    m = Measurements.read(path, [*"abcdefg"], columns=ColumnOptions(brand="yaskawa"))
    np.testing.assert_allclose(np.degrees(m.joints), [[1, 2, 3, 4, 5, 6, 7]])


def test_without_a_robot_axes_keep_their_names(table):
    header, orientation = HEADERS["kuka"]
    m = Measurements.read(table(header, row(orientation)), columns=ColumnOptions(brand="kuka"))
    assert m.joint_names == ("A1", "A2", "A3", "A4", "A5", "A6")
    np.testing.assert_allclose(m.joints, np.radians([ANGLES]), rtol=1e-15)


@pytest.mark.parametrize(
    ("names", "brands"),
    [
        ("A1 A2 A3 A4 A5 A6", "kuka"),
        ("a1 a2 a3 a4", "kuka"),
        ("J1 J2 J3 J4 J5 J6 x y z", "fanuc abb staubli"),
        ("J1 J2 J3 J4 J5 J6 W P R", "fanuc"),
        ("J1 J2 J3 J4 J5 J6 q1 q2 q3 q4", "abb"),
        ("J1 J2 J3 J4 J5 J6 rx ry rz", "staubli"),
        ("S L U R B T", "yaskawa"),
        ("s l u r b t", ""),
        ("A1 A2 A3", ""),
        ("J2 J3 J4 J5", ""),
        ("joint_1 joint_2 x y z", ""),
    ],
)
def test_tables_that_look_like_a_brand_s(names, brands):
    assert [brand.name for brand in brands_like(names.split())] == brands.split()


def test_a_table_of_another_brand_is_refused_with_its_own(table):
    header, orientation = HEADERS["fanuc"]
    path = table(header, row(orientation))
    refused(
        path, ["'one'", "--columns fanuc"], joint_names=JOINTS, columns=ColumnOptions(brand="kuka")
    )


def test_a_brand_s_table_in_another_convention(table):
    options = ColumnOptions(brand="fanuc", orientation="kuka")
    path = table("J1,J2,X,Y,Z,A [deg],B [deg],C [deg]", "1,2,500,0,0,20,-30,40")
    m = Measurements.read(path, ["one", "two"], columns=options)
    np.testing.assert_allclose(m.rotations, [TURN.as_matrix()], atol=1e-15)
    assert m.orientation == "kuka"


def test_a_robot_whose_joints_are_called_as_the_brand_s_axes(table):
    names = ["A1", "A2", "A3", "A4", "A5", "A6"]
    header, orientation = HEADERS["kuka"]
    path = table(header, row(orientation))
    refused(path, ["column 'A1'", "--columns kuka or --joint-unit deg"], joint_names=names)
    m = Measurements.read(path, names, columns=ColumnOptions(brand="kuka"))
    np.testing.assert_allclose(m.joints, np.radians([ANGLES]), rtol=1e-15)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"brand": "cuka"}, "'cuka'.*--columns.*'kuka'"),
        ({"orientation": "abc"}, "'abc'.*--orientation.*'abb'"),
        ({"joint_unit": "grad"}, "--joint-unit.*'grad'.*'deg'.*'mm'"),
        ({"joint_unit": "deg rad"}, "--joint-unit.*'deg rad'"),
        ({"joint_unit": "N"}, "--joint-unit.*'N'"),
    ],
)
def test_words_that_are_refused(given, says):
    with pytest.raises(MeasurementError, match=says):
        ColumnOptions(**given)


def test_arguments_of_another_type_are_refused():
    for given in ({"names": ["a"]}, {"brand": 3}, {"joint_unit": ["deg"]}):
        with pytest.raises(CalibError):
            ColumnOptions(**given)


def test_a_mapping_is_all_that_is_said():
    assert column_options({"J1": "a"}) == ColumnOptions({"J1": "a"})
    assert column_options(None) == ColumnOptions()


def test_one_unit_for_all_joints_that_name_none(table):
    path = table("a,b [mrad],rail,x [mm],y [mm],z [mm]", "10,20,1500,300,400,500")
    types = {"a": "revolute", "b": "revolute", "rail": "prismatic"}
    for unit in ("deg mm", "mm deg"):
        m = Measurements.read(path, [*types], types, ColumnOptions(joint_unit=unit))
        np.testing.assert_allclose(m.joints, [[np.radians(10), 0.02, 1.5]], rtol=1e-15)
    only_angle = ColumnOptions(joint_unit="deg")
    says = ["column 'rail'", "--joint-unit mm"]
    refused(path, says, joint_names=[*types], joint_types=types, columns=only_angle)
    refused(path, ["column 'a'", "--joint-unit deg"], joint_names=[*types], joint_types=types)
