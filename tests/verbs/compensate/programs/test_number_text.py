"""Numbers in the style of those that they replace."""

from __future__ import annotations

import numpy as np
import pytest

from calib.verbs.compensate.programs.number_text import (
    decimals_for,
    in_column,
    written_integer,
    written_number,
)


@pytest.mark.parametrize(
    ("old", "value", "decimals", "new"),
    [
        ("100", 100.1234567, 4, "100.1235"),
        ("+1.0", 1.5, 2, "+1.50"),
        ("+1.0", -1.5, 2, "-1.50"),
        ("-1.0", 0.00001, 3, "0.000"),
        (".5", 0.25, 2, ".25"),
        ("-.5", -1.25, 2, "-1.25"),
        ("5.", 5.5, 1, "5.5"),
        ("1.23456789", 1.23, 4, "1.23000000"),
        ("1.0E-3", 0.0012345678, 7, "1.2346E-3"),
        ("1.0e+2", 123.45678, 4, "1.234568e+2"),
        ("9.3E-16", 0.5, 6, "0.500000"),
        ("- 5.0", -6.0, 1, "- 6.0"),
        ("1,5", 2.5, 2, "2,50"),
    ],
)
def test_style(old, value, decimals, new):
    written = written_number(old, value, decimals)
    assert written.text == new
    if "," not in new and " " not in new:
        assert written.value == pytest.approx(float(new), rel=1e-15)


def test_no_more_decimals_than_are_read():
    assert written_number("1.000", 1.23456, 6, 3).text == "1.235"
    assert written_number("1200", 1234.6, 6, 0).text == "1235"


def test_decimals_of_units():
    mm, degree, inch = 1e-3, np.pi / 180.0, 0.0254
    assert [decimals_for("length", s) for s in (mm, 1.0, inch)] == [4, 7, 6]
    assert [decimals_for("angle", s) for s in (degree, 1.0)] == [6, 8]
    assert decimals_for("plain", 1.0) == 8


def test_constants():
    assert written_integer("'B010'", 3) == "'B011'"
    assert written_integer("'H0A'", 31) == "'H1F'"
    assert written_integer("43", 35) == "35"


def test_a_column_stays_one():
    assert in_column("X =   1.5", 6, "1.5", "-1.5000") == (4, "-1.5000")
    assert in_column("X = 1.5", 4, "1.5", "-1.5000") == (4, "-1.5000")
    assert in_column("X =   15.5", 6, "15.5", "5.5") == (6, " 5.5")
