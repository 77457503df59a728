import hashlib
from pathlib import Path

import numpy as np
import pytest
from openpyxl import Workbook

from calib.data.measurements import Measurements
from calib.data.points_file import NUMERAL, decimal_sign_in, decimal_sign_of, plain, read_points
from calib.errors import MeasurementError
from tests.data.tables import refused as refused_table

XYZ = [[0.1005, -0.2005, 0.3], [0.1105, -0.2005, 0.31]]


def refused(path, *says, **arguments):
    """The text with which a list is refused; it holds each of the words."""
    with pytest.raises(MeasurementError) as caught:
        read_points(path, **arguments)
    text = str(caught.value)
    for word in says:
        assert word in text
    assert "\n" not in text
    return text


# Layouts


@pytest.mark.parametrize(
    ("lines", "names"),
    [
        # SpatialAnalyzer: one name in three parts, or three columns
        (
            (
                "// Units: Millimeters",
                "A::Main::P1  100.5 -200.5 300.0  0.01",
                "A::Main::P2  110.5 -200.5 310.0  0.01",
            ),
            ("A::Main::P1", "A::Main::P2"),
        ),
        (
            (
                "Collection,Group,Point,X [mm],Y [mm],Z [mm],Time",
                "A,Main,1,100.5,-200.5,300.0,12:03",
                "A,Main,2,110.5,-200.5,310.0,12:04",
            ),
            ("A::Main::1", "A::Main::2"),
        ),
        (
            ("# mm", "A,Main,1,100.5,-200.5,300.0", "A,Main,2,110.5,-200.5,310.0,"),
            ("A::Main::1", "A::Main::2"),
        ),
        # Leica: a name and three numbers, in columns of blanks or tabs, with a decimal point or comma
        (("Length unit = mm", "P1 100.5 -200.5 300", "P2 110.5 -200.5 310"), ("P1", "P2")),
        (
            ("! units mm, deg", "P1\t100,5\t-200,5\t300,0", "", "P2\t110,5\t-200,5\t310,0"),
            ("P1", "P2"),
        ),
        (("% Unit: m", "P1 0,1005 -0,2005 0,3", "P2 0,1105 -0,2005 0,31"), ("P1", "P2")),
        (("# Units in cm", "1  10.05 -20.05 30", "2  11.05 -20.05 31"), ("1", "2")),
        (
            ("# units: mm", "Ball 1 100.5 -200.5 300", "Ball 2 110.5 -200.5 310"),
            ("Ball 1", "Ball 2"),
        ),
        (
            ("# units: mm", '"Ball 1" 100.5 -200.5 300', '"Ball two" 110.5 -200.5 310'),
            ("Ball 1", "Ball two"),
        ),
        # PolyWorks: with a direction behind, with a header in another order, without names
        (
            (
                "name;x (mm);y (mm);z (mm);i;j;k",
                "P1;100.5;-200.5;300;0;0;1",
                "P2;110.5;-200.5;310;0;0;1",
            ),
            ("P1", "P2"),
        ),
        (
            ("z [mm],y [mm],x [mm],label", "300,-200.5,100.5,P1", "310,-200.5,110.5,P2"),
            ("P1", "P2"),
        ),
        (("# Unit: um", "-----", "100500 -200500 300000", "110500 -200500 310000"), ()),
        (("# Unit: mm", "100.5 -200.5 300 0 0 1", "110.5 -200.5 310 0 0 1"), ()),
        (
            ("Point Name X Y Z", "units: mm", "P1 100.5 -200.5 300", "P2 110.5 -200.5 310"),
            ("P1", "P2"),
        ),
        (("name x y z", "units: mm", "7 100.5 -200.5 300", "8 110.5 -200.5 310"), ("7", "8")),
        # Labels between the numbers
        (
            ("Units: mm", "P1 X 100.5 Y -200.5 Z 300", "P2 x: 110.5, y=-200.5 ,Z 310 mm, a = 1"),
            ("P1", "P2"),
        ),
        (("# mm", "P1:,X,100.5,Y,-200.5,Z,300", "P2;X=110.5;Y=-200.5;Z=310"), ("P1", "P2")),
        (("# mm", "1 (X 100.5, Y -200.5, Z 300)", "2 {X 110.5,Y -200.5,Z 310}"), ("1", "2")),
        (("# mm", "X 100,5 Y -200,5 Z 300", "X 110,5 Y -200,5 Z 310"), ()),
        (("# mm", "P1: 100.5 -200.5 300", "P2: 110.5 -200.5 310"), ("P1", "P2")),
        (("station;x;y;z", "# units: mm", "A;100.5;-200.5;300", "B;110.5;-200.5;310"), ("A", "B")),
    ],
)
def test_lists_as_programs_write_them(listed, lines, names):
    points = read_points(listed(*lines))
    assert points.names == names
    np.testing.assert_allclose(points.points, XYZ, rtol=1e-14)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_encodings_of_windows(listed, encoding):
    points = read_points(listed("# Gerät; units: µm", "Pé 500000 0 1", encoding=encoding))
    assert points.names == ("Pé",)
    np.testing.assert_allclose(points.points, [[0.5, 0, 1e-6]], rtol=1e-14)


def test_the_value(listed):
    path = listed("# a", "", "P1 100.5 200 300")
    points = read_points(path, "mm")
    assert (points.lines, points.source) == ((3,), "tracker.txt")
    assert points.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    with pytest.raises(ValueError, match="read-only"):
        points.points[0] = 1


def test_a_point_is_found_by_its_whole_name_or_its_last_part(listed):
    path = listed("A::M::P1 1 2 3", "A::M::P2 1 2 3", "B::M::P2 1 2 3")
    points = read_points(path, "m")
    assert points.of_rows("t.csv", [1, 2], ["P1", "B::M::P2"]) == [0, 2]
    assert points.of_rows("t.csv", [1, 2, 3], None) == [0, 1, 2]
    with pytest.raises(
        MeasurementError, match=r"row 4: .* in lines 2, 3; .* 'A::M::P2', 'B::M::P2'"
    ):
        points.of_rows("t.csv", [4], ["P2"])


# Refusals


def test_labels_tell_a_point_s_number_from_whole_coordinates(listed):
    points = read_points(listed("1 X 100 Y 200 Z 300", "2 X 110 Y 200 Z 300"), "mm")
    assert points.names == ("1", "2")
    np.testing.assert_allclose(points.points[1], [0.11, 0.2, 0.3])


@pytest.mark.parametrize(
    ("lines", "is_refused"),
    [
        (("P1,1,992.49,200.5,300.5", "P2,802.5,200.5,300.5"), True),
        (("P1,1,992.49,200.5,300.5", "P2,1,802.50,200.5,300.5"), True),
        (("P1,-200.5,-1,992,300", "P2,802,200,300"), True),
        (("P1,1.5,992.49,200.5,0.1", "P2,1.25,802.5,200.5,0.2"), False),
        (("P1,100,200,300,1", "P2,100,200,300,2"), False),
        (("name,x,y,z,d", "P1,100,200,300,1", "P2,100,200,300"), False),
        (("P1;1,992.49;200.5;300.5", "P2;802.5;200.5;300.5"), False),
        (("A,1,100.5,200.5,300.5", "A,2,100.5,200.5,300.5"), False),
    ],
)
def test_commas_between_thousands_between_commas_are_refused(listed, lines, is_refused):
    path = listed(*lines)
    if is_refused:
        refused(path, "line 1", "double quotes", '"name,x,y,z"', unit="mm")
    else:
        assert len(read_points(path, "mm").points) == 2


def test_units_that_are_missing_or_contradict(listed):
    bare = listed("P1 100 200 300")
    refused(bare, "and none is named", "'# Units: mm'", "(--points-unit mm)", "'um'")
    refused(bare, "and 'deg' is named", unit="deg")
    path = listed("# units: mm", "P1 100 200 300")
    assert read_points(path, "mm").names == ("P1",)
    refused(path, "and 'mm', 'm' is named", unit="m")
    refused(listed("# units: feet", "P1 1 2 3"), "and 'ft' is named")


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        ((), "no line of it holds three numbers"),
        (("P1 1.5 2 3", "P2 - - -"), "line 2: 'P2 - - -' has no three numbers"),
        (("x,y,z", "1.5,2,3", "1.5,,3"), "line 3: '1.5  3'"),
        (("P1;1,5;2;3", "P2;1.5;2;3"), "decimal point in line 2 and a decimal comma in line 1"),
        (("1 100 200 300", "2 100 200 301"), "line 1: all are whole numbers"),
        (("P1\0 1 2 3",), "not a text file"),
        (("a" * 200_000,), "no line of it holds three numbers"),
    ],
)
def test_lists_that_are_refused(listed, lines, says):
    refused(listed(*lines), "tracker.txt", says, unit="m")


# With a table of joint values


TRACKER = ("# Units: mm", "A::M::P1 100.5 -200.5 300", "A::M::P2 110.5 -200.5 310")


def test_points_are_matched_by_name(listed, table):
    joints = table("a [deg],Point,set", "1,P2,estimate", "2,A::M::P1,validate")
    path = listed(*TRACKER, "A::M::REF 0 0 0")
    m = Measurements.read(joints, ["a"], points=path)
    np.testing.assert_allclose(m.points, XYZ[::-1], rtol=1e-14)
    assert m.kinds == ("point", "point")
    assert m.sets == ("estimate", "validate")
    assert m.source == "data.csv + tracker.txt"
    hashes = [hashlib.sha256(Path(p).read_bytes()).hexdigest() for p in (joints, path)]
    assert m.sha256 == " + ".join(hashes)


def test_points_are_matched_in_order(listed, table):
    m = Measurements.read(table("a [deg]", "1", "2"), points=listed(*TRACKER))
    np.testing.assert_allclose(m.points, XYZ, rtol=1e-14)
    bare = listed(*TRACKER[1:])
    again = Measurements.read(table("a [deg]", "1", "2"), points=bare, points_unit="mm")
    np.testing.assert_array_equal(again.points, m.points)


@pytest.mark.parametrize(
    ("lines", "arguments", "says"),
    [
        (("a [deg]", "1"), {}, "has 2 points and data.csv 1 rows"),
        (
            ("a [deg],point", "1,P1", "2,P22"),
            {},
            "row 2: in tracker.txt there is no point 'P22' (did you mean 'P2'",
        ),
        (("a [deg],point", "1,P1", "2,Q"), {}, "it has 'A::M::P1', 'A::M::P2'."),
        (
            ("a [deg],point", "1,P1", "2,A::M::P1"),
            {},
            "row 2: in tracker.txt row 1 names the point 'A::M::P1' too",
        ),
        (("a [deg],point", "1,", "2,"), {}, "nothing is measured yet in its 2 rows"),
        (("a [deg],group", "1,P1", "2,"), {"kind": "fixed"}, "here they are 'fixed'"),
        (("a [deg],kind", "1,point", "2,pose"), {}, "here they are 'point', 'pose'"),
    ],
)
def test_tables_that_do_not_match(listed, table, lines, arguments, says):
    with pytest.raises(MeasurementError) as caught:
        Measurements.read(table(*lines), points=listed(*TRACKER), **arguments)
    assert says in str(caught.value)


# Lists as users bring them, one quirk each

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


def check_points(measurements):
    np.testing.assert_allclose(np.degrees(measurements.joints), [[10, 20], [30, -40]], rtol=1e-14)
    np.testing.assert_allclose(measurements.points, [POINTS["P2"], POINTS["P1"]], rtol=1e-14)


@pytest.mark.parametrize("quirk", LISTS)
def test_lists_that_are_read(table, listed, quirk):
    check_points(Measurements.read(table(*JOINTS), ["j1", "j2"], points=listed(*LISTS[quirk])))


def test_a_list_in_a_sheet(table, tmp_path: Path):
    book = Workbook()
    rows = book.create_sheet("Tracker")
    rows.append(["Point ID", "X [mm]", "Y [mm]", "Z [mm]"])
    for name, point in POINTS.items():
        rows.append([f"Run 1::{name}", *(1e3 * value for value in point)])
    book.save(tmp_path / "tracker.xlsx")
    points = f"{tmp_path / 'tracker.xlsx'}#Tracker"
    check_points(Measurements.read(table(*JOINTS), ["j1", "j2"], points=points))


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        # Either 1.992 m or 1992 m: no other number tells.
        (("Units: m", "P1 1,992 -3,005 1,250", "P2 1,802 1,000 -3,012"), "'# Decimal: comma'"),
        (("S1_P1 1992.4 -300.5 1250", "S1_P2 802.5 100 -30.1"), "--points-unit mm"),
        (("Units: mm", "A/P1 1.5 2 3", "B/P1 1.5 2 4", "A/P2 5.5 6 7"), "'A/P1', 'B/P1'"),
    ],
)
def test_lists_of_a_table_that_are_refused(table, listed, lines, says):
    path = listed(*lines)
    refused_table(table(*JOINTS), ["tracker.txt", says], joint_names=["j1", "j2"], points=path)


def sign(*texts, stated=None):
    return decimal_sign_of(list(enumerate(texts, 1)), "t.txt", stated)


@pytest.mark.parametrize(
    ("texts", "decimal", "numbers"),
    [
        (("1,992.4945", "-300.5", "12"), ".", ["1992.4945", "-300.5", "12"]),
        (("1.992,4945", "-300,5", "12"), ",", ["1992.4945", "-300.5", "12"]),
        (("1,992", "300.25", "+2,000,000.5"), ".", ["1992", "300.25", "+2000000.5"]),
        (("1.992", "300,25"), ",", ["1992", "300.25"]),
        (("1,234,567", "1,992"), ".", ["1234567", "1992"]),
        (("1.992", "300.125"), ".", ["1.992", "300.125"]),
        (("0,992", "1,992"), ",", ["0.992", "1.992"]),
        (("1992,494", "1,992"), ",", ["1992.494", "1.992"]),
        (("1'992.4945", "1\N{NARROW NO-BREAK SPACE}000.5"), ".", ["1992.4945", "1000.5"]),
        (("1,5e3", ",5", "5,"), ",", ["1.5e3", ".5", "5."]),
        (("x", "", "1.5"), ".", ["x", "", "1.5"]),
    ],
)
def test_all_numbers_tell_which_sign_is_decimal(texts, decimal, numbers):
    assert sign(*texts) == decimal
    assert [plain(text, decimal) for text in texts] == numbers


def test_a_comma_that_may_be_either_needs_a_remark():
    with pytest.raises(MeasurementError, match=r"t.txt, line 2.*'# Decimal: comma'"):
        sign("12", "1,992", "-300,125")
    assert sign("1,992", stated=",") == ","
    assert sign("1,992", stated=".") == "."
    for remark, decimal in (
        ("Decimal: comma", ","),
        ("decimal separator = .", "."),
        ("Decimal point", "."),
        ("decimals: 3", None),
        ("Units: mm", None),
    ):
        assert decimal_sign_in(["x", remark]) == decimal


@pytest.mark.parametrize(
    ("texts", "stated", "says"),
    [
        (("1.5", "1,5"), None, "decimal point in line 1 and a decimal comma in line 2"),
        (("1,992.5", "1.992,5"), None, "decimal point in line 1"),
        (("1,5", "1,234,567"), None, "line 1 and between thousands in line 2"),
        (("1,234,567", "1.234.567"), None, "line 2 and commas in line 1"),
        (("12", "1,5"), ".", "decimal comma in line 2"),
    ],
)
def test_contradictions_are_refused(texts, stated, says):
    with pytest.raises(MeasurementError, match=says):
        sign(*texts, stated=stated)


def test_what_is_no_number():
    for text in ("1,99,2", "12,34.5", "1,992,4945", "5'", "5'11", "1 992", "", ".", "1.2.3", "nan"):
        assert not NUMERAL.fullmatch(text)
