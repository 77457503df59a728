from __future__ import annotations

from dataclasses import replace

import pytest

from calib.errors import MeasurementError
from calib.verbs.measure.devices.reading import Context
from calib.verbs.measure.devices.rows import GrowingText, bare_row, row_below, rows_of
from tests.verbs.measure.devices.contexts import BARE, UR, XYZ


def xyz(cells) -> list[float]:
    """The three coordinates of a row [m]."""
    if "x [m]" in cells:
        return [cells[f"{axis} [m]"] for axis in "xyz"]
    return [cells[header] / 1e3 for header in XYZ]


@pytest.mark.parametrize(
    "text",
    [
        "x [mm],y [mm],z [mm]\n100.5,-200.25,3e2\n",
        "x [mm];y [mm];z [mm]\n100,5;-200,25;300,0\n",
        "Measured today\nx\ty\tz\nmm\tmm\tmm\n100,5\t-200,25\t300\n",
        "# x [mm] y [mm] z [mm]\n100.5 -200.25 300\n",
        "Units: mm\nP1 100.5 -200.25 300\n",
        "# Units: mm\nP1; 100,5; -200,25; 300,0\n",
        "Units: mm\nP1 X=100.5, Y=-200.25, Z=300.0\n",
    ],
)
def test_tables_and_lists_are_read_as_elsewhere(text: str):
    (row,) = rows_of(text, "a.txt", UR)
    assert xyz(row.cells) == pytest.approx([0.1005, -0.20025, 0.3], abs=1e-15)
    assert row.line == text.count("\n")


def test_points_named_as_targets_say_their_targets():
    context = replace(UR, targets=("T1", "T2"), points_unit="mm")
    rows = rows_of("T1 1 2 3.5\nT2 4 5 6.5\nP7 7 8 9.5\n", "a.txt", context)
    assert [{k: v for k, v in row.cells.items() if "[" not in k} for row in rows] == [
        {"target": "T1"},
        {"target": "T2"},
        {"point": "P7"},
    ]


def test_commas_that_could_be_either_are_decimal_in_a_cell():
    (row,) = rows_of("# Units: mm\nP1 512,250 -30,500 800,125\n", "a.txt", UR)
    assert xyz(row.cells) == pytest.approx([0.51225, -0.0305, 0.800125])
    with pytest.raises(MeasurementError, match="may be decimal or stand between thousands"):
        rows_of("# Units: um\nP1 512,250 -30,500 800,125\n", "a.txt", UR)  # half a metre, or 0.5 mm


@pytest.mark.parametrize(
    "line",
    ["1.5 -2.25 3", "1,5 -2,25 3", "1,5; -2,25; 3;", "1.5,-2.25,3", "1,5\t-2,25\t3", "1.5|-2.25|3"],
)
def test_bare_numbers_in_the_order_of_the_columns(line: str):
    row = bare_row(line, 7, "stdin", XYZ)
    assert row.cells == {"x [mm]": 1.5, "y [mm]": -2.25, "z [mm]": 3.0}
    assert row.line == 7


def test_bare_lines_may_have_words():
    row = bare_row("T1;100,5;0,7071", 1, "stdin", ("target", "x [mm]", "qw"))
    assert row.cells == {"target": "T1", "x [mm]": 100.5, "qw": "0,7071"}


@pytest.mark.parametrize(
    "line", ["1 2", "1 2 3 4", "1 2 x", "beam broken", "1.000,5 2,5 3,5", "nan nan nan", "inf 1 2"]
)
def test_a_malformed_bare_line_is_refused_with_its_text_and_number(line: str):
    with pytest.raises(MeasurementError) as raised:
        bare_row(line, 7, "stdin", XYZ)
    assert f"stdin, line 7: '{line}'" in str(raised.value)


def test_a_line_below_a_header():
    header = "target;x [mm];temperature [degC]"
    row = row_below(header, "7;1,5;21,5", 3, "tcp")
    assert row.cells == {"target": "7", "x [mm]": 1.5, "temperature [degC]": 21.5}
    for line in ("7;1,5", "7;1,5;21,5;4", "7;warm;cold", '7;"1,5;2'):
        with pytest.raises(MeasurementError, match="tcp, line 3: '7;"):
            row_below(header, line, 3, "tcp")


def new_rows(growing: GrowingText, text: str) -> list[float]:
    """First coordinates [mm] of what is new."""
    rows, faults = growing.update(text)
    assert not faults
    return [round(1e3 * xyz(row.cells)[0], 9) for row in rows]


HEADER = "x [mm],y [mm],z [mm]\n"


def test_what_is_new_in_a_text_that_grows_and_is_written_anew():
    growing = GrowingText("a.csv", UR)
    assert new_rows(growing, "") == []
    assert new_rows(growing, HEADER) == []
    assert new_rows(growing, HEADER + "1,0,0\n2,0,0\n") == [1.0, 2.0]
    assert new_rows(growing, HEADER + "1,0,0\n2,0,0\n3,0,0\n") == [3.0]
    assert new_rows(growing, "") == []  # a program truncates it before it writes all again
    assert new_rows(growing, HEADER + "1,0,0\n2,0,0\n3,0,0\n4,0,0\n") == [4.0]
    assert new_rows(growing, HEADER + "1,0,0\n3,0,0\n5,0,0\n") == [5.0]  # without a bad point
    assert new_rows(growing, HEADER + "6,0,0\n") == [6.0]  # only the last point
    assert new_rows(growing, HEADER + "6,0,0\n6,0,0\n") == [6.0]  # the same twice


def test_what_is_new_in_a_list_and_among_bare_numbers():
    growing = GrowingText("a.txt", UR)
    assert new_rows(growing, "Job of today\n") == []
    assert new_rows(growing, "Job of today\nUnits: mm\nP1 101,5 0,0 0,0\n") == [101.5]
    assert new_rows(growing, "Job of today\nUnits: mm\nP1 101,5 0,0 0,0\nP2 102,5 0,0 0,0\n") == [
        102.5
    ]
    growing = GrowingText("a.txt", BARE)
    assert new_rows(growing, "1 0 0\n\n# remark\n2 0 0\n") == [1.0, 2.0]


@pytest.mark.parametrize(
    ("context", "head", "bad"),
    [
        (UR, HEADER, "2,0\n"),
        (UR, HEADER, "beam broken\n"),
        (UR, HEADER, "2,0,far\n"),
        (UR, "Units: mm\n", "102,5 0,0\n"),
        (BARE, "", "beam broken\n"),
    ],
)
@pytest.mark.parametrize("at_once", [False, True])
def test_a_malformed_line_is_said_once_and_reading_goes_on(
    context: Context, head: str, bad: str, at_once: bool
):
    rows = ["1,0,0\n", "3,0,0\n"] if head == HEADER else ["101,5 0,0 0,0\n", "103,5 0,0 0,0\n"]
    growing = GrowingText("a.txt", context)
    found, said = [], []
    texts = [head, head + rows[0], head + rows[0] + bad, head + rows[0] + bad + rows[1]]
    for text in texts[-1:] if at_once else texts:
        new, faults = growing.update(text)
        found += new
        said += faults
    for _ in range(2):
        assert growing.update(texts[-1]) == ([], [])
    assert len(found) == 2
    (fault,) = said
    assert f"line {texts[2].count(chr(10))}" in str(fault)


def test_a_malformed_first_row_of_a_table_is_said():
    growing = GrowingText("a.csv", UR)
    rows, faults = growing.update(HEADER + "beam broken\n1,0,0\n")
    assert (len(rows), len(faults)) == (1, 1)
    assert "line 2" in str(faults[0])
