"""Pages: sections and blocks are drawn on their media, in their order; what is empty is not drawn."""

from __future__ import annotations

import pytest

from calib.show.as_text import blocks_text, page_text
from calib.show.blocks import (
    HTML,
    NOTEBOOK,
    TERMINAL,
    Bullets,
    Drawing,
    Facts,
    Page,
    Paragraph,
    Section,
    Verdict,
)
from calib.show.page import notebook_html, page_bytes
from calib.show.tables import Column, Table, name_column
from tests.show.pages import Page as Drawn


def refuse():
    raise AssertionError("a section is made only where it is drawn")


def page(*sections: Section) -> Page:
    return Page("Report", "robot <r>", sections, date="today")


SECTIONS = (
    Section(lambda: [Paragraph("For a terminal.")], on=TERMINAL),
    Section(
        lambda: [
            Verdict("use", ["It is better.", "It is known."]),
            Paragraph("For a page.", on=HTML),
            Bullets([f"b{k}" for k in range(4)], "Some:", "  ", {TERMINAL: 2, HTML: 3}),
        ],
        "First",
    ),
    Section(lambda: [Table("Empty", [name_column("a")], []), Paragraph("")]),
    Section(
        lambda: [Table("Error [mm]", COLUMNS, ROWS, "A note.", [0], {HTML: 1}, "the file")], "T"
    ),
    Section(lambda: [Facts([("rows", "4"), ("none", "")])], on=NOTEBOOK),
)

COLUMNS = [
    name_column("set", 8),
    Column("n", 5),
    Column("x", unit="mm", group="span", note="Span."),
    Column("y", unit="mm", group="span", optional=True),
]
ROWS = [("all", 1234, 1.5e-3, float("nan")), ("some", 2, -2e-9, float("nan"))]


def test_a_terminal_has_lines():
    assert page_text(page(*SECTIONS)).split("\n\n") == [
        "For a terminal.",
        "Verdict: use\n  It is better.\n  It is known.",
        "Some:\n  b0\n  b1\n  and 2 more",
        "Error [mm]     n span x\nall         1234  1.500\nsome           2  0.000",
    ]


def test_a_page_has_numbered_sections_and_tables():
    drawn = Drawn(page_bytes(page(*SECTIONS)).decode())
    assert drawn.text.startswith("Report: robot <r> 1 First ✓ Verdict: use It is better.")
    assert (
        "For a page. Some: b0 b1 b2 and 1 more 2 T Table 1. Error [mm] span set n x" in drawn.text
    )
    assert "all 1,234 1.500 A note. Span. 1 more are in the file." in drawn.text
    assert "For a terminal." not in drawn.text
    assert drawn.table("Error")[0][-1] == "span"


def test_a_notebook_has_what_is_for_it_alone():
    assert " ".join(Drawn(notebook_html(page(*SECTIONS))).texts) == "rows 4"


def test_sections_are_made_only_where_they_are_drawn():
    elsewhere = page(Section(refuse, on=HTML), Section(lambda: [Paragraph("x")], on=TERMINAL))
    assert page_text(elsewhere) == "x"
    with pytest.raises(AssertionError, match="only where"):
        page_bytes(elsewhere)


def test_a_tight_block_follows_without_an_empty_line():
    text = blocks_text([Paragraph("a"), Paragraph("", tight=True), Paragraph("b", tight=True)])
    assert text == "a\nb"


def test_figures_are_for_pages_only():
    assert blocks_text([Drawing("f", "s", "A figure", "Of it.", refuse)]) == ""
