"""Tables as programs write them, read to the same bits, and files that are no tables."""

import functools
import itertools

import numpy as np
import pytest

from calib.basics.tables import Column, Table
from calib.data.measurements import Measurements
from calib.errors import MeasurementError
from tests.data.tables import HEADER, ROWS, assert_same, refused, write_lines

FORM = [
    "joint_1 [deg],joint_2 [deg],x [mm],y [mm],z [mm]",
    "1.5,-20,300.25,0,50",
    "2,30.125,-301,5,60.5",
]


@pytest.fixture
def table(tmp_path):
    """Writes a table's lines to a file and gives its path."""
    return functools.partial(write_lines, tmp_path)


def test_the_value(table):
    path = table("# remark", "a [deg];b [m]", "1,5;x", "", "2;")
    value = Table.read(path)
    assert (value.source, value.separator, value.header) == ("data.csv", ";", ("a [deg]", "b [m]"))
    assert value.lines == (3, 5)
    assert value.cells == (["1,5", "x"], ["2", ""])
    first, second = Column(0, "a [deg]", "a", "deg"), Column(1, "b [m]", "b", "m")
    assert value.column(second) == ["x", ""]
    np.testing.assert_array_equal(value.numbers([first, second]), [[1.5, np.inf], [2, np.nan]])
    assert first.to_si == np.pi / 180
    assert Column(0, "qx", "qx", None).to_si == Column(0, "n [furlong]", "n", "furlong").to_si == 1
    with pytest.raises(
        MeasurementError, match=r"data.csv, line 5 \(row 2\), column 'a \[deg\]': no"
    ):
        value.fail(1, first, "no")
    with pytest.raises(MeasurementError, match=r"line 3 \(row x\)"):
        value.fail(0, first, "no", second)


def bytes_of(lines, sign=",", end="\n", encoding="utf-8"):
    text = end.join(lines) + end
    if sign == ";":
        return text.replace(",", ";").replace(".", ",").encode(encoding)
    return text.replace(",", sign).encode(encoding)


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


def test_points_and_commas_in_one_table(table):
    path = table("a [deg];x [mm];y [mm];z [mm]", "1;200;300;400", "1.5;1,234;300;400")
    refused(path, says=["decimal point in line 3", "decimal comma in line 3"])


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
    refused(table(FORM[0], FORM[1] + ",7"), says=["line 2", "the row has 6 cells"])
    header = "J\xf6int [deg],x [mm],y [mm],z [mm]"  # as Excel writes "CSV" on Windows
    ansi = Measurements.read(table(header, "1,200,300,400", encoding="cp1252"))
    assert ansi.joint_names == ("J\xf6int",)
    assert len(refused(table(FORM[0], "a" * 100_000 + ",1,2,3,4"), says=["line 2 (row 1)"])) < 4000


# Excel's first line


@pytest.mark.parametrize("line", ["sep=;", '"sep=;"', "SEP=;", "sep=;;;"])
def test_a_line_that_names_the_separator_is_no_header(table, line: str):
    m = Measurements.read(table(line, HEADER.replace(",", ";"), "7;estimate;1;2;100,5;200;300"))
    assert m.rows == (7,)
    assert m.points[0, 0] == pytest.approx(0.1005)


def test_the_line_is_counted_and_a_separator_that_does_not_occur_is_not_believed(table):
    m = Measurements.read(table("sep=;", HEADER, *ROWS))
    assert m.rows == (1, 2)
    refused(table("sep=,", HEADER, "1,estimate,x,2,3,4,5"), "line 3 (row 1), column 'a [deg]'")
