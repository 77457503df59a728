"""Blocks of a document: whole tables, nothing empty, names as one safe line."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.errors import CalibError
from calib.show.document import (
    Document,
    Facts,
    Paragraph,
    Section,
    Table,
    blocks,
    plain,
    table,
)


def test_a_table_has_a_cell_for_every_column():
    made = table("Lengths [mm]", ["name", "value"], [("a", "1.0"), ("b", "2.0")], "lr", note="n")
    assert made == Table("Lengths [mm]", ("name", "value"), (("a", "1.0"), ("b", "2.0")), "lr", "n")
    assert table("Lengths [mm]", ["name", "value"], [], "lr") is None


@pytest.mark.parametrize(
    ("rows", "align", "groups", "said"),
    [
        ([("a",)], "lr", (), "rows of [1, 2], 2 in 'align' and 0 under its groups"),
        ([("a", "b")], "l", (), "rows of [2], 1 in 'align' and 0 under its groups"),
        ([("a", "b")], "lr", (("both", 3),), "rows of [2], 2 in 'align' and 3 under its groups"),
    ],
)
def test_another_number_of_columns_is_refused(rows, align, groups, said):
    with pytest.raises(CalibError) as raised:
        table("Lengths [mm]", ("name", "value"), rows, align, groups=groups)
    assert str(raised.value) == (
        f"The table 'Lengths [mm]' has 2 columns in its head, {said}; give each the same number."
    )


def test_what_is_empty_is_left_out():
    sections = (Section("empty", ()), Section("full", blocks(None, Paragraph("text"), None)))
    document = Document("title", Facts(()), sections)
    assert [section.title for section in document.sections] == ["full"]
    assert document.sections[0].blocks == (Paragraph("text"),)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("two\nlines\tand\r\nmore", "two lines and  more"),
        ("\x1b[31mred\x1b[0m \x07 \x9b1m", "\\x1b[31mred\\x1b[0m \\x07 \\x9b1m"),
        ("evil \u202egnp.exe", "evil \\u202egnp.exe"),
        ("half \ud800", "half \\ud800"),
        ("Ünïcöde 関節 עברית 🤖 n\u200dj", "Ünïcöde 関節 עברית 🤖 n\u200dj"),
    ],
)
def test_what_controls_a_terminal_or_the_direction_is_written_out(text, shown):
    assert plain(text) == shown


@given(st.text())
def test_plain_is_one_line_that_can_be_printed(text):
    shown = plain(text)
    assert len(shown.splitlines()) <= 1
    assert plain(shown) == shown
    assert all(c.isprintable() or c in "\u200c\u200d" or c.isspace() for c in shown)
    shown.encode("utf-8")
