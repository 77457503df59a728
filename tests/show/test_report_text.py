"""A document as text: 100 columns, whatever the names; numbers aligned and whole."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from calib.show.document import (
    Bullets,
    Document,
    Facts,
    Judgement,
    Paragraph,
    Section,
    Signatures,
    Table,
)
from calib.show.report_text import WIDTH, as_text, columns_of, wrapped


def lines_of(*blocks) -> list[str]:
    """The lines of a section with these blocks, its title left out."""
    document = Document("Title", Facts((("Robot", "ur3"),)), (Section("Section", blocks),))
    text = as_text(document)
    assert text.endswith("\n")
    assert not text.endswith("\n\n")
    return text.splitlines()[7:]


def test_headings_are_underlined_and_numbered():
    document = Document(
        "Report 関節",
        Facts((("Robot", "ur3"), ("Date", "today"))),
        (Section("One", (Paragraph("p"),)),),
    )
    assert as_text(document) == (
        "Report 関節\n===========\n\nRobot  ur3\nDate   today\n\n1  One\n------\n\np\n"
    )


def test_blocks():
    assert lines_of(Bullets(("one", "two"))) == ["", "- one", "- two"]
    assert lines_of(Judgement("use", ("It is better.",))) == ["", "Verdict: use", "  It is better."]
    signed = lines_of(Signatures(("Place",), ("Approved by",), ("Name",)))
    assert [line.rstrip("_ ") for line in signed] == ["", "Place:", "", "Approved by", "  Name:"]


def test_numbers_stand_below_each_other():
    block = Table(
        "Errors [mm]",
        ("rows", "max", "mean"),
        (("estimation", "10.123", "-1.000"), ("validation 関節", "0.5", "2.000")),
        "lrr",
        note="A note.",
        groups=(("", 1), ("error", 2)),
    )
    assert lines_of(block) == [
        "",
        "Table 1: Errors [mm]",
        "                 ----error-----",
        "rows                max    mean",
        "-------------------------------",
        "estimation       10.123  -1.000",
        "validation 関節     0.5   2.000",
        "  A note.",
    ]


def test_a_long_name_is_broken_inside_its_column_and_stays_whole():
    name = "joint_" + "very_long_" * 30
    block = Table("T", ("joint", "value"), ((name, "1.000"), ("short", "2.000")), "lr")
    lines = lines_of(block)
    assert max(map(len, lines)) == WIDTH
    first = next(k for k, line in enumerate(lines) if "1.000" in line)
    broken = [line.replace("1.000", "").strip() for line in lines[first:-1]]
    assert "".join(broken) == name
    assert lines[-1].split() == ["short", "2.000"]


@pytest.mark.parametrize(
    ("text", "columns"),
    [("abc", 3), ("関節", 4), ("e\u0301", 1), ("🤖", 2), ("n\u200dj", 2), ("", 0)],
)
def test_columns_of_a_terminal(text, columns):
    assert columns_of(text) == columns


@given(st.text(alphabet=st.sampled_from("ab 関é-_\n"), max_size=400), st.integers(0, 12))
def test_wrapped_text_is_whole_and_fits(text, indent):
    lines = list(wrapped(text, "- ", " " * indent))
    assert all(columns_of(line) <= WIDTH for line in lines)
    first, *others = lines
    whole = "".join([first[2:], *(line[indent:] for line in others)])
    assert "".join(whole.split()) == "".join(text.split())


@given(
    st.lists(
        st.tuples(st.text(max_size=150), st.text(max_size=40), st.just("-123.456"), st.just("0.1")),
        min_size=1,
        max_size=4,
    )
)
@example([("0" * 21 + " ", "", "-123.456", "0.1"), ("x" * 150, "y" * 40, "-123.456", "0.1")])
@example(
    [
        ("", "0000000\x1f\U00018cd6", "-123.456", "0.1"),
        ("0000000000\x1f\x1f\x1f\U00018cd6\U00018d09\U00018d09\U00018d09\n", "", "-123.456", "0.1"),
    ]
)
def test_no_table_is_wider_than_the_text(rows):
    block = Table("t", ("a", "b", "c", "d"), tuple(rows), "llrr")
    lines = lines_of(block)
    assert all(columns_of(line) <= WIDTH for line in lines)
    assert sum("-123.456" in line for line in lines) >= len(rows)
