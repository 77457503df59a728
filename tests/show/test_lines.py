"""Paragraphs of at most 100 columns, lists of rows, numbers."""

from __future__ import annotations

import math

import pytest

from calib.show.lines import WIDTH, deg, fill, mm, number, plural, row_ranges, wrap

WORDS = " ".join(["kinematic"] * 40)


def test_a_paragraph_is_broken_at_100_columns_and_indented():
    lines = fill(WORDS, "  ", "    ").splitlines()
    assert max(map(len, lines)) <= WIDTH
    assert lines[0].startswith("  kinematic")
    assert all(line.startswith("      kinematic") for line in lines[1:])
    assert " ".join(line.strip() for line in lines) == WORDS


def test_long_words_are_kept_by_fill_and_broken_by_wrap():
    name = "a" * 250
    assert fill(name) == name
    lines = wrap(name, "  ").splitlines()
    assert max(map(len, lines)) == WIDTH
    assert lines[1].startswith("    a")
    assert "".join(line.strip() for line in lines) == name


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ([], ""),
        ([4], "4"),
        ([5, 4], "4, 5"),
        ([9, 7, 8, 4], "4, 7 to 9"),
        (range(1, 31), "1 to 30"),
    ],
)
def test_consecutive_rows_are_a_range(rows, text):
    assert row_ranges(rows) == text


def test_rows_beyond_the_limit_are_counted():
    assert row_ranges([1, 3, 5, 7, 8, 9], limit=2) == "1, 3 and 4 more"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (number(1.23456), "1.235"),
        (number(-1e-9), "0.000"),
        (number(0.5, 1, "+"), "+0.5"),
        (number(math.nan), "-"),
        (number(math.inf), "-"),
        (mm(1.2345e-3), "1.234"),
        (mm(-0.1, 1), "-100.0"),
        (deg(math.pi, 1), "180.0"),
        (plural(1, "row"), "1 row"),
        (plural(0, "row"), "0 rows"),
        (plural(2, "row"), "2 rows"),
        (plural(2000, "row"), "2,000 rows"),
    ],
)
def test_numbers(text, expected):
    assert text == expected
