"""Tables: columns are aligned, long names get room, no line is longer than 100 columns."""

from __future__ import annotations

from calib.show.lines import WIDTH
from calib.show.tables import Column, labelled, name_column, table_lines

NUMBERS = [Column("max", 9), Column("mean", 9)]


def test_columns_are_aligned():
    columns = [name_column("Error [mm]", 16), *NUMBERS, Column("unit", left=True, gap=2)]
    lines = table_lines(columns, [("nominal", "4.099", "2.331", "mm"), ("a", "1", "-", "")])
    assert lines == [
        "Error [mm]             max      mean  unit",
        "nominal              4.099     2.331  mm",
        "a                        1         -",
    ]


def test_long_cells_widen_their_column():
    lines = table_lines(
        [name_column("", 4), Column("x", 3)], [("joint_1", "-1000.000"), ("b", "1")]
    )
    assert lines == ["                x", "joint_1 -1000.000", "b               1"]


def test_a_table_without_headings_has_none():
    assert table_lines([name_column(""), Column("")], [("a", "1"), ("bb", "22")]) == [
        "a   1",
        "bb 22",
    ]


def test_a_text_instead_of_cells_is_a_line_of_its_own():
    text = "the robot with the joint origins of a file with a long name:"
    lines = table_lines([name_column("", 4), Column("n")], [text, ("  a", "1")])
    assert lines == ["     n", text, "  a  1"]


def test_a_name_without_room_gets_a_line_of_its_own():
    columns = [name_column("Parameter"), *(Column("value", 24) for _ in range(3))]
    name = "  " + "x" * 60
    lines = table_lines(columns, [("short", "1", "2", "3"), (name, "1", "2", "3")])
    assert max(map(len, lines)) <= WIDTH
    assert lines[2] == name
    assert lines[3].split() == ["1", "2", "3"]
    assert [line.index("3") for line in (lines[1], lines[3])] == [WIDTH - 1, WIDTH - 1]


def test_a_label_and_its_text():
    lines = labelled("observability", "word " * 40, 15, "  ").splitlines()
    assert lines[0].startswith("  observability  word word")
    assert all(line.startswith(" " * 17 + "word") for line in lines[1:])
    assert max(map(len, lines)) <= WIDTH
