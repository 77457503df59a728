"""Ten tracker lists and ten tables as users bring them, one quirk each: read right, or refused with what to type."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from openpyxl import Workbook
from scipy.spatial.transform import Rotation

from calib.data.forms.column_options import ColumnOptions
from calib.data.measurements import Measurements
from tests.data.tables import refused

#: Measured points [m], by name, and the joint values [deg] of the rows, in another order.
POINTS = {"P1": (1.9924945, -0.3005, 1.25), "P2": (0.8025, 0.1, -0.0301255)}
JOINTS = ("point,j1 [deg],j2 [deg]", "P2,10,20", "P1,30,-40")

LISTS = {
    "names behind a slash": (
        "Units: mm",
        "KR6/P1 1992.4945 -300.5 1250",
        "KR6/P2 802.5 100 -30.1255",
    ),
    "names behind a station": (
        "# mm",
        "Station1_P1;1992.4945;-300.5;1250",
        "Station1_P2;802.5;100;-30.1255",
    ),
    "commas between thousands": (
        "Units: mm",
        "P1 1,992.4945 -300.5 1,250",
        "P2 802.5 100 -30.1255",
    ),
    "points between thousands": (
        "Units: mm",
        "P1\t1.992,4945\t-300,5\t1.250",
        "P2\t802,5\t100\t-30,1255",
    ),
    "quoted numbers between commas": (
        "name,x [mm],y [mm],z [mm]",
        'P1,"1,992.4945",-300.5,"1,250"',
        "P2,802.5,100,-30.1255",
    ),
    "quoted decimal commas between commas": (
        "name,x [mm],y [mm],z [mm]",
        '"P1","1992,4945","-300,5","1250"',
        '"P2","802,5","100","-30,1255"',
    ),
    "labels between the numbers": (
        "Units: mm",
        "P1 X 1992.4945 Y -300.5 Z 1250",
        "P2: X=802.5, Y=100, Z=-30.1255, D=2",
    ),
    "points of a KUKA program": (
        "; Units: mm",
        "DECL E6POS P1={X 1992.4945,Y -300.5,Z 1250.0,A 0.0,B 0.0,C 0.0}",
        "DECL E6POS P2={X 802.5,Y 100.0,Z -30.1255,A 0.0,B 0.0,C 0.0}",
    ),
    "Excel's line with the separator": (
        "sep=;",
        "name;x [mm];y [mm];z [mm]",
        "P1;1992,4945;-300,5;1250",
        "P2;802,5;100;-30,1255",
    ),
}


def check(measurements):
    np.testing.assert_allclose(np.degrees(measurements.joints), [[10, 20], [30, -40]], rtol=1e-14)
    np.testing.assert_allclose(measurements.points, [POINTS["P2"], POINTS["P1"]], rtol=1e-14)


@pytest.mark.parametrize("quirk", LISTS)
def test_lists_that_are_read(table, listed, quirk):
    check(Measurements.read(table(*JOINTS), ["j1", "j2"], points=listed(*LISTS[quirk])))


def test_a_list_in_a_sheet(table, tmp_path: Path):
    book = Workbook()
    rows = book.create_sheet("Tracker")
    rows.append(["Point ID", "X [mm]", "Y [mm]", "Z [mm]"])
    for name, point in POINTS.items():
        rows.append([f"Run 1::{name}", *(1e3 * value for value in point)])
    book.save(tmp_path / "tracker.xlsx")
    points = f"{tmp_path / 'tracker.xlsx'}#Tracker"
    check(Measurements.read(table(*JOINTS), ["j1", "j2"], points=points))


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        # Either 1.992 m or 1992 m: no other number tells.
        (("Units: m", "P1 1,992 -3,005 1,250", "P2 1,802 1,000 -3,012"), "'# Decimal: comma'"),
        (("S1_P1 1992.4 -300.5 1250", "S1_P2 802.5 100 -30.1"), "--points-unit mm"),
        (("Units: mm", "A/P1 1.5 2 3", "B/P1 1.5 2 4", "A/P2 5.5 6 7"), "'A/P1', 'B/P1'"),
    ],
)
def test_lists_that_are_refused(table, listed, lines, says):
    path = listed(*lines)
    refused(table(*JOINTS), ["tracker.txt", says], joint_names=["j1", "j2"], points=path)


# Tables

TURN = Rotation.from_euler("ZYX", [20, -30, 40], degrees=True)
XYZ = "1992.4945,-300.5,1250"


def degrees(sequence):
    return ",".join(map(repr, TURN.as_euler(sequence, degrees=True).tolist()))


TABLES = {
    "KUKA's columns": ("A1,A2,X,Y,Z,A,B,C", f"10,-20,{XYZ},{degrees('ZYX')}", {"brand": "kuka"}),
    "FANUC's columns": ("J1,J2,X,Y,Z,W,P,R", f"10,-20,{XYZ},{degrees('xyz')}", {"brand": "fanuc"}),
    "Stäubli's columns": (
        "J1,J2,X,Y,Z,RX,RY,RZ",
        f"10,-20,{XYZ},{degrees('XYZ')}",
        {"brand": "staubli"},
    ),
    "Yaskawa's columns": (
        "S,L,X,Y,Z,Rx,Ry,Rz",
        f"10,-20,{XYZ},{degrees('xyz')}",
        {"brand": "yaskawa"},
    ),
    "ABB's columns": (
        "rax_1;rax_2;x;y;z;q1;q2;q3;q4",
        "10;-20;1992,4945;-300,5;1250;"
        + ";".join(
            repr(number).replace(".", ",") for number in TURN.as_quat()[[3, 0, 1, 2]].tolist()
        ),
        {"brand": "abb"},
    ),
    "joints without a unit": (
        "j1,j2,x [mm],y [mm],z [mm],yaw [deg],pitch [deg],roll [deg]",
        f"10,-20,{XYZ},{degrees('ZYX')}",
        {"joint_unit": "deg"},
    ),
    "a matrix": (
        "j1 [deg],j2 [deg],x [mm],y [mm],z [mm],r11,r12,r13,r21,r22,r23,r31,r32,r33",
        f"10,-20,{XYZ}," + ",".join(map(repr, TURN.as_matrix().ravel().tolist())),
        {},
    ),
}


@pytest.mark.parametrize("quirk", TABLES)
def test_tables_that_are_read(table, quirk):
    header, row, options = TABLES[quirk]
    m = Measurements.read(table(header, row), ["j1", "j2"], columns=ColumnOptions(**options))
    np.testing.assert_allclose(np.degrees(m.joints), [[10, -20]], rtol=1e-14)
    np.testing.assert_allclose(m.points, [POINTS["P1"]], rtol=1e-14)
    np.testing.assert_allclose(m.rotations, [TURN.as_matrix()], atol=1e-14)


@pytest.mark.parametrize(
    ("header", "row", "says"),
    [
        ("A1,A2,A3,A4,A5,A6,X,Y,Z", f"1,2,3,4,5,6,{XYZ}", "--columns kuka"),
        ("J1 [deg],J2 [deg],J3 [deg],J4 [deg],x [mm]", "1,2,3,4,5", "--columns fanuc"),
        ("j1,j2,x [mm],y [mm],z [mm]", f"1,2,{XYZ}", "--joint-unit deg"),
        (
            "j1 [deg],j2 [deg],x [mm],y [mm],z [mm],Rx [deg],Ry [deg],Rz [deg]",
            f"1,2,{XYZ},170,80,-100",
            "--orientation staubli",
        ),
        ("sep=;\nj1 [deg];j2 [deg];x;y;z", "1;2;3;4;5", '--columns "x=x [mm]"'),
    ],
)
def test_tables_that_are_refused(table, header, row, says):
    refused(table(header, row), ["data.csv", says], joint_names=["j1", "j2"])
