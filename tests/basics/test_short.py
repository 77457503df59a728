"""Values in one line."""

from __future__ import annotations

from calib.basics.short import one_line


def test_parts_that_are_empty_are_left_out():
    assert one_line("Fleet", "3 robots", "", "0 failed") == "Fleet(3 robots, 0 failed)"
    assert one_line("Cell") == "Cell()"


def test_a_line_is_one_and_not_too_long():
    line = one_line("Robot", "a\nb" * 99)
    assert len(line) == 120
    assert "\n" not in line
    assert line.endswith("...)")
