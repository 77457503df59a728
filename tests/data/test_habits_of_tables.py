"""Tables as people and their programs write them: read to the same numbers as the clean table, or the line named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from openpyxl import Workbook

from calib.data.measurements import Measurements
from calib.errors import MeasurementError
from tests.data.tables import assert_same

HEADER = ["set", "joint_1 [deg]", "joint_2 [deg]", "x [mm]", "y [mm]", "z [mm]"]
ROWS = [
    ["estimate", "-14.69", "74.76", "-149.02", "207.5", "742.6"],
    ["estimate", "12.5", "-109.13", "130.43", "-134.57", "600.86"],
    ["validate", "23.88", "89.52", "0.5", "56.38", "620.06"],
]
UNITS = ["", "deg", "deg", "mm", "mm", "mm"]
NAMES = [cell.split(" [")[0] for cell in HEADER]


def lines(header: list[str] = HEADER, rows: list[list[str]] = ROWS, sign: str = ",") -> list[str]:
    """The lines of a table."""
    return [sign.join(row) for row in (header, *rows)]


def changed(*, row: int = 0, column: int = 3, to: str) -> list[str]:
    """The lines of the table with another cell."""
    rows = [list(cells) for cells in ROWS]
    rows[row][column] = to
    return lines(rows=rows)


def replaced(old: str, new: str) -> list[str]:
    """The lines of the table with another text in the header."""
    first, *rest = lines()
    assert old in first
    return [first.replace(old, new), *rest]


def with_minus(minus: str) -> list[str]:
    """The lines of the table with another sign for the minus in its numbers."""
    return lines(rows=[[cell.replace("-", minus) for cell in row] for row in ROWS])


def with_decimal_comma(sign: str) -> list[str]:
    """The lines of the table with decimal commas."""
    return lines(rows=[[cell.replace(".", ",") for cell in row] for row in ROWS], sign=sign)


def framed() -> list[str]:
    """The table as Markdown."""
    table = ["| " + " | ".join(row) + " |" for row in (HEADER, *ROWS)]
    return [table[0], "|---|---:|---:|---:|---:|---:|", *table[1:]]


def aligned() -> list[str]:
    """The table with its columns below one another."""
    return ["".join(f"{cell:>18}" for cell in row) for row in (HEADER, *ROWS)]


def quoted(cells: list[str]) -> str:
    """Cells in quotes."""
    return ",".join(f'"{cell}"' for cell in cells)


TITLES = ["Calibration of arm 3, cell B", "Operator: N. N.,,,,,", "", "2026-05-01"]
READ: dict[str, list[str]] = {
    "degree sign": replaced("[deg]", "[\N{DEGREE SIGN}]"),
    "abbreviated with a point": replaced("[deg]", "[deg.]"),
    "in words": replaced("[deg]", "[degrees]"),
    "round brackets": [lines()[0].replace("[", "(").replace("]", ")"), *lines()[1:]],
    "round brackets, degree sign": replaced("[deg]", "(\N{DEGREE SIGN})"),
    "full-width brackets": replaced("[mm]", "\uff3bmm\uff3d"),
    "no blank before the unit": replaced(" [", "["),
    "blanks in the unit": replaced("[mm]", "[ mm ]"),
    "Cyrillic unit": replaced("[mm]", "[\u043c\u043c]"),
    "Chinese unit": replaced("[mm]", "[\u6beb\u7c73]"),
    "unit of one character": replaced("[mm]", "[\N{SQUARE MM}]"),
    "capital coordinates": replaced("x [mm],y [mm],z [mm]", "X [mm],Y [mm],Z [mm]"),
    "true minus": with_minus("\N{MINUS SIGN}"),
    "en dash as minus": with_minus("\N{EN DASH}"),
    "a title": [TITLES[0], *lines()],
    "a title with a unit": ["Positions [mm]", *lines()],
    "several titles": [*TITLES, *lines()],
    "titles of several cells": ["Robot,UR3,Serial,2016", "Date,2026-05-01", *lines()],
    "a title, no unit but by rows": [TITLES[0], *lines(NAMES)[:1], ",".join(UNITS), *lines()[1:]],
    "a row of units": [",".join(NAMES), ",".join(UNITS), *lines()[1:]],
    "a row of units in brackets": [",".join(NAMES), ",[deg],[deg],(mm),(mm),[mm]", *lines()[1:]],
    "a row of units with a heading": [",".join(NAMES), "unit,deg,deg,mm,mm,mm", *lines()[1:]],
    "bars": lines(sign="|"),
    "bars and blanks": lines(sign=" | "),
    "Markdown": framed(),
    "columns below one another": aligned(),
    "single blanks": lines(sign=" "),
    "tabs": lines(sign="\t"),
    "semicolons and decimal commas": with_decimal_comma(";"),
    "tabs and decimal commas": with_decimal_comma("\t"),
    "bars and decimal commas": with_decimal_comma("|"),
    "blanks and decimal commas": with_decimal_comma("  "),
    "blanks around commas": lines(sign=" , "),
    "separators at the end of rows": [lines()[0], *(line + ",," for line in lines()[1:])],
    "separators at the end of the header": [lines()[0] + ",,", *lines()[1:]],
    "separators at the end of all lines": [line + "," for line in lines()],
    "an empty column": [",".join([*r[:2], "", *r[2:]]) for r in (HEADER, *ROWS)],
    "quotes": [quoted(row) for row in (HEADER, *ROWS)],
    "a header over two lines": [*quoted(HEADER).replace(" [", "\n[").split("\n"), *lines()[1:]],
    "comments": ["# made by a program", lines()[0], "% and another", *lines()[1:], "# the end"],
    "the header in a comment": ["# by numpy.savetxt", "# " + lines()[0], *lines()[1:]],
    "a line for Excel": ["sep=;", *with_decimal_comma(";")],
    "rule below the header": [lines()[0], "-----------", *lines()[1:]],
    "empty lines": ["", *lines()[:2], ",,,,,", '"",""', *lines()[2:], "", ""],
}


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Measurements:
    """The table without any habit."""
    path = tmp_path_factory.mktemp("clean") / "data.csv"
    path.write_text("\n".join(lines()), "utf-8")
    return Measurements.read(path)


def test_the_clean_table(clean):
    np.testing.assert_allclose(clean.points[0], [-0.14902, 0.2075, 0.7426], rtol=1e-15)
    np.testing.assert_allclose(np.degrees(clean.joints[1]), [12.5, -109.13], rtol=1e-15)
    assert clean.sets == ("estimate", "estimate", "validate")


@pytest.mark.parametrize("habit", READ)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_read_to_the_same_numbers(tmp_path: Path, clean, habit: str, encoding: str):
    path = tmp_path / "data.csv"
    path.write_bytes("\r\n".join([*READ[habit], ""]).encode(encoding))
    assert_same(Measurements.read(path), clean, rtol=0)


@pytest.mark.parametrize("encoding", ["cp1252", "cp1251", "cp1250"])
def test_the_degree_sign_in_code_pages_of_windows(tmp_path: Path, clean, encoding: str):
    path = tmp_path / "data.csv"
    path.write_bytes("\r\n".join(READ["degree sign"]).encode(encoding))
    assert_same(Measurements.read(path), clean, rtol=0)


def test_a_micrometre(tmp_path: Path, clean):
    for micro in (
        "\N{MICRO SIGN}m",
        "\N{GREEK SMALL LETTER MU}m",
        "um",
        "micron",
        "\u043c\u043a\u043c",
    ):
        rows = [[*row[:5], str(1000 * float(row[5]))] for row in ROWS]
        path = tmp_path / "data.csv"
        path.write_text("\n".join(lines([*HEADER[:5], f"z [{micro}]"], rows)), "utf-8")
        assert_same(Measurements.read(path), clean, rtol=1e-15)


def test_titles_and_units_in_a_sheet(tmp_path: Path, clean):
    book = Workbook()
    for row in ([TITLES[0]], [], NAMES, UNITS, *ROWS):
        book.active.append(
            [float(cell) if cell[-1:].isdigit() else cell for cell in row] if row in ROWS else row
        )
    book.save(tmp_path / "data.xlsx")
    assert_same(Measurements.read(tmp_path / "data.xlsx"), clean, rtol=0)


@pytest.mark.parametrize(
    "word",
    [
        "NaN",
        "nan",
        "NAN",
        "n/a",
        "N/A",
        "NA",
        "#N/A",
        "#REF!",
        "#DIV/0!",
        "-",
        "--",
        "null",
        "None",
        "",
    ],
)
def test_a_row_without_a_measurement(tmp_path: Path, clean, word: str):
    path = tmp_path / "data.csv"
    path.write_text("\n".join([*lines(), f"estimate,1,2,{word},{word},{word}"]), "utf-8")
    read = Measurements.read(path)
    assert read.unmeasured == (4,)
    assert_same(read, clean, rtol=0)


def test_a_row_that_begins_with_a_word_of_excel_is_no_comment(tmp_path: Path):
    order = [3, 1, 2, 4, 5]
    table = [[row[i] for i in order] for row in (HEADER, *ROWS)]
    table.append(["#N/A", "1", "2", "#N/A", "#N/A"])
    path = tmp_path / "data.csv"
    path.write_text("\n".join(map(",".join, table)), "utf-8")
    assert Measurements.read(path).unmeasured == (4,)
    table[-1] = ["#REF!", "1", "2", "#REF!", "#REF!"]
    path.write_text("\n".join(map(",".join, table)), "utf-8")
    assert Measurements.read(path).unmeasured == (4,)
    path.write_text("\n".join(map(",".join, [*table[:-1], ["#REF!", "1", "2", "3", "4"]])), "utf-8")
    with pytest.raises(
        MeasurementError, match=r"line 5 \(row 4\), column 'x \[mm\]': '#REF!' is an error"
    ):
        Measurements.read(path)


#: What is refused, with what the message names: place, and what is to be done.
REFUSED: dict[str, tuple[list[str], list[str]]] = {
    "no unit": (replaced("x [mm]", "x"), ["line 1, column 'x'", "no unit", "'x [mm]'"]),
    "no unit at a joint": (replaced("joint_2 [deg]", "joint_2"), ["column 'joint_2'", "no unit"]),
    "unknown unit": (replaced("x [mm]", "x [furlong]"), ["line 1, column 'x [furlong]'", "'mm'"]),
    "megametres": (replaced("x [mm]", "x [Mm]"), ["column 'x [Mm]'", "'Mm'", "'mm'"]),
    "gon or degree": (replaced("joint_2 [deg]", "joint_2 [grad]"), ["column 'joint_2 [grad]'", "'deg'"]),
    "unit of another quantity": (replaced("x [mm]", "x [deg]"), ["column 'x [deg]'", "length"]),
    "unit after a slash": (replaced("x [mm]", "x/mm"), ["line 1", "'x/mm'", "'x [mm]'"]),
    "unit after an underscore": (replaced("x [mm]", "x_mm"), ["line 1", "'x_mm'", "'x [mm]'"]),
    "remark after the unit": (replaced("x [mm]", "x [mm] measured"), ["'x [mm] measured'", "'x [mm]'"]),
    "two columns of one name": (replaced("y [mm]", "x [mm]"), ["line 1", "called 'x'", "number 4", "number 5"]),
    "unit after a blank": (replaced("joint_1 [deg]", "joint_1 deg"), ["line 1", "'joint_1 deg'", "'joint_1 [deg]'"]),
    "no header": (lines()[1:], ["line 1", "header should be"]),
    "#REF!": (changed(to="#REF!"), ["line 2 (row 1)", "column 'x [mm]'", "formula"]),
    "#DIV/0!": (changed(to="#DIV/0!"), ["line 2 (row 1)", "column 'x [mm]'", "formula"]),
    "one of three missing": (changed(row=1, to="NaN"), ["line 3 (row 2)", "column 'x [mm]'", "NaN"]),
    "joint missing": (changed(column=1, to="n/a"), ["line 2 (row 1)", "column 'joint_1 [deg]'", "n/a"]),
    "infinite": (changed(to="inf"), ["line 2 (row 1)", "column 'x [mm]'", "'inf'"]),
    "unit in the cell": (changed(to="-149.02 mm"), ["line 2 (row 1)", "column 'x [mm]'", "'-149.02 mm'", "header"]),
    "apostrophe between thousands": (changed(to="1'149.02"), ["line 2 (row 1)", "column 'x [mm]'", "thousands"]),
    "blank between thousands": (changed(to="1 149.02"), ["line 2 (row 1)", "column 'x [mm]'", "thousands"]),
    "comma between thousands": (changed(to='"1,149.02"'), ["line 2 (row 1)", "column 'x [mm]'", "thousands"]),
    "point between thousands": (lines(rows=[[*ROWS[0][:5], "1.742,6"]], sign=";"), ["line 2", "decimal"]),
    "decimal commas between commas": (with_decimal_comma(","), ["line 2 (row 1)", "semicolons"]),
    "decimal comma in quotes": (changed(to='"149,02"'), ["line 2 (row 1)", "column 'x [mm]'", "decimal comma"]),
    "a cell too many": ([*lines()[:2], lines()[2] + ",7"], ["line 3 (row 2)", "7 cells", "6"]),
    "a cell too few": ([*lines()[:2], lines()[2].rpartition(",")[0]], ["line 3 (row 2)", "5 cells", "6"]),
    "an empty cell between blanks": (
        lines(rows=[ROWS[0], ["estimate", "", *ROWS[1][2:]]], sign="  "),
        ["line 3 (row 2)", "5 cells", "nan"],
    ),
    "a quote that does not end": (changed(to='"149.02'), ["line", "double quotes"]),
    "a date": (changed(to="5-Jan"), ["line 2 (row 1)", "column 'x [mm]'", "date"]),
    "a title, and too few cells": (
        [TITLES[0], *lines()[:2], "estimate,1,2,3"],
        ["line 4 (row 2)", "4 cells"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("habit", REFUSED)
def test_refused_with_its_place(tmp_path: Path, habit: str):
    written, says = REFUSED[habit]
    path = tmp_path / "data.csv"
    path.write_text("\n".join([*written, ""]), "utf-8")
    with pytest.raises(MeasurementError) as caught:
        Measurements.read(path, ["joint_1", "joint_2"])
    text = str(caught.value)
    assert "data.csv" in text
    assert [word for word in says if word not in text] == [], text
