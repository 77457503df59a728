"""A document as Markdown: what a reader of Markdown makes of it is the text that went in."""

from __future__ import annotations

import re
from html.parser import HTMLParser

import pytest
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from calib.show.document import (
    Bullets,
    Document,
    Facts,
    Judgement,
    Paragraph,
    Section,
    Signatures,
    Table,
    plain,
)
from calib.show.report_markdown import as_markdown, escaped

READER = MarkdownIt("commonmark").enable(["table", "strikethrough"])

#: All that Markdown and HTML give a meaning to.
NASTY = st.text(alphabet=st.sampled_from("ab1 .()[]{}<>&*_~`#|\\!$-+=:@/\"'\n\t\x1bé"), max_size=40)


class _Page(HTMLParser):
    """The text of a page and the names of its elements."""

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.text, self.tags = "", []
        self.feed(page)
        self.close()

    def handle_data(self, data: str) -> None:
        self.text += data

    def handle_starttag(self, tag: str, _: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)


def squeezed(text: str) -> str:
    return "".join(text.split())


@given(NASTY)
def test_text_is_shown_as_it_is(text):
    page = _Page(READER.render(escaped(text)))
    assert squeezed(page.text) == squeezed(plain(text))
    assert set(page.tags) <= {"p"}


@given(NASTY, NASTY)
def test_cells_are_shown_as_they_are(one, other):
    block = Table("t", ("a", "b"), ((one, other),), "lr", strong=(0,))
    page = _Page(READER.render(document_of(block)))
    assert page.tags.count("td") == 2 + 2
    assert set(page.tags) <= {
        "h1", "h2", "p", "strong", "table", "thead", "tbody", "tr", "th", "td",
    }  # fmt: skip
    assert squeezed(plain(one)) + squeezed(plain(other)) in squeezed(page.text)


def document_of(*blocks) -> str:
    return as_markdown(Document("T", Facts((("Robot", "x"),)), (Section("S", blocks),)))


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("16.028", "16.028"),
        ("-0.5", "-0.5"),
        ("12. item", "12\\. item"),
        ("- item", "\\- item"),
        ("# heading", "\\# heading"),
        ("target_x", "target\\_x"),
        ("www.example.org", "www&#46;example.org"),
        ("https://example.org", "https&#58;//example.org"),
        ("a@b.c", "a&#64;b.c"),
    ],
)
def test_numbers_stay_readable_and_nothing_becomes_a_link(text, shown):
    assert escaped(text) == shown


def test_the_whole_document():
    text = document_of(
        Paragraph("A text."),
        Bullets(("one", "two")),
        Judgement("use with care", ("Few rows.",)),
        Table("E [mm]", ("a", "b"), (("x", "1"),), "lr", note="Note.", groups=(("", 1), ("g", 1))),
        Signatures(("Place",), ("Approved by",), ("Name",)),
    )
    assert text == (
        "# T\n\n| | |\n|---|---|\n| Robot | x |\n\n## 1. S\n\nA text.\n\n- one\n- two\n\n"
        "**Verdict: use with care**\n\n- Few rows.\n\n**Table 1: E \\[mm\\]**\n\n| a | g: b |\n| --- | ---: |\n"
        "| x | 1 |\n\nNote.\n\n| | |\n|---|---|\n| Place |  |\n| Approved by: name |  |\n"
    )
    assert not re.search(r"\n{3}", text)
