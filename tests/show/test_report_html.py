"""The page: whole, without scripts, hostile names shown as they are, and nothing wider than A4."""

from __future__ import annotations

import base64
import re
from html.parser import HTMLParser

import pytest

from calib.show.document import (
    Bullets,
    Document,
    Facts,
    Judgement,
    Paragraph,
    Picture,
    Section,
    Signatures,
    Table,
)
from calib.show.figure_base import width_of
from calib.show.figures import Drawing, drawings, rendered
from calib.show.report_html import as_html

#: Elements of HTML that have no end tag.
EMPTY = {"meta", "img"}

NASTY = "</style></table><script>alert(1)</script>\" onerror='x' & \\ {{ 7*7 }} é"


class Page(HTMLParser):
    """Elements, texts and attributes of a page; every element is closed."""

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.texts: list[str] = []
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs
        if tag not in EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if data.strip() and self.open[-1] != "style":
            self.texts.append(data.strip())


def test_an_option_of_the_command_is_not_broken_at_its_dashes():
    facts = Facts((("Command", "calib fit a.urdf --report <b>"), ("Robot", "two words")))
    page = as_html(Document("Title", facts, ()))
    assert '<span class="word">--report</span> <span class="word">&lt;b&gt;</span>' in page
    assert "<td>two words</td>" in page


def document_of(*blocks, title: str = "Title") -> Document:
    return Document(title, Facts((("Robot", "ur3"),)), (Section("Section", blocks),))


def test_nothing_in_a_name_means_anything():
    block = Table(NASTY, (NASTY, "n"), ((NASTY, "1"),), "lr", note=NASTY, groups=((NASTY, 2),))
    judged = Judgement("use", (NASTY,))
    signed = Signatures((NASTY,), (NASTY,), (NASTY,))
    page = Page(
        as_html(
            document_of(block, Paragraph(NASTY), Bullets((NASTY,)), judged, signed, title=NASTY)
        )
    )
    assert "script" not in page.tags
    assert page.tags.count("style") == 1
    assert not [name for name, _ in page.attributes if name.startswith("on")]
    assert sum(NASTY in text for text in page.texts) >= 10
    assert not any("49" in text for text in page.texts)


def test_the_policy_lets_no_script_and_no_host_in():
    attributes = dict(Page(as_html(document_of(Paragraph("p")))).attributes)
    assert attributes["content"] is not None
    (policy,) = re.findall(r'Security-Policy" content="([^"]*)"', as_html(document_of()))
    assert policy == "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


@pytest.mark.parametrize(
    ("use", "sign", "css"),
    [
        ("use", "✓", "good"),
        ("use with care", "!", "care"),
        ("do not use", "✕", "bad"),
        ("none", "–", "none"),
    ],
)
def test_a_verdict_has_a_word_a_sign_and_a_colour(use: str, sign: str, css: str):
    page = as_html(document_of(Judgement(use, ("Because.",))))
    assert f'<div class="verdict {css}">' in page
    assert f"<b>{sign}</b>Verdict: {use}</p>" in page


def test_tables_and_figures_are_numbered_and_a_large_drawing_is_a_picture(paper_calibration):
    from matplotlib.figure import Figure

    def large() -> Figure:
        figure = Figure(figsize=(2, 2))
        figure.subplots().plot([k % 97 for k in range(8_000)], "o")
        return figure

    small = next(d for d in drawings(paper_calibration) if d.name == "singular-values")
    block = Table("T", ("a",), (("1",),), "r")
    document = document_of(
        block, block, Picture(small), Picture(Drawing("large", "Large", "A caption.", large))
    )
    page = as_html(document)
    assert re.findall(r"<b>(Table \d+|Figure \d+)", page) == [
        "Table 1", "Table 2", "Figure 1", "Figure 2",
    ]  # fmt: skip
    kinds = re.findall(r'src="data:image/([^;]+);base64,([^"]+)"', page)
    assert [kind for kind, _ in kinds] == ["svg+xml", "png"]
    assert b"<svg" in base64.b64decode(kinds[0][1])
    assert base64.b64decode(kinds[1][1])[:4] == b"\x89PNG"
    assert "<b>Figure 2. Large.</b> A caption." in page
    again = as_html(document_of(Picture(small)))
    assert again == as_html(document_of(Picture(small)))


def test_letters_of_all_figures_have_one_size(paper_calibration):
    narrow = next(one for one in drawings(paper_calibration) if one.name == "correlations")
    wide = next(one for one in drawings(paper_calibration) if one.name == "histograms")
    page = as_html(Document("t", Facts(()), (Section("s", (Picture(narrow), Picture(wide))),)))
    shares = [float(share) for share in re.findall(r'style="--share: ([0-9.]+)%"', page)]
    inches = [one.draw().get_figwidth() for one in (narrow, wide)]
    assert shares == pytest.approx([100.0 * inches[0] / inches[1], 100.0], abs=0.06)
    assert [width_of(rendered(narrow, kind), kind) for kind in ("svg", "png")] == pytest.approx(
        [inches[0]] * 2, abs=0.01
    )


def test_the_foot_of_the_page_is_a_css_string():
    page = as_html(document_of(title='robot "a\\b" </style>' + "x" * 200))
    (foot,) = re.findall(r"@bottom-left \{ content: (.*?); font:", page)
    assert re.fullmatch(r'"(?:[A-Za-z0-9 ]|\\[0-9a-f]+ )*"', foot)
    said = re.sub(r"\\([0-9a-f]+) ", lambda m: chr(int(m[1], 16)), foot[1:-1])
    assert said.startswith('robot "a\\b" </style>xxx')
    assert said.endswith("x…")
    assert len(said) == 81


def test_chromium_shows_and_prints_hostile_names(browser, calibrations, tmp_path):
    c = calibrations.made("hostile_names")
    path = tmp_path / "report.html"
    c.write_report(path)
    # The size of A4 at 96 dots an inch.
    with browser.open(path.as_uri(), size=(794, 1123)) as tab:
        assert tab.complaints == []
        assert tab.elsewhere == []
        assert (
            tab.evaluate("document.title") == f"Calibration report: robot {calibrations.HOSTILE[0]}"
        )
        assert tab.evaluate("document.scripts.length") == 0
        text = tab.evaluate("document.body.innerText")
        for name in (*calibrations.HOSTILE, calibrations.HOSTILE_SOURCE.replace("\n", " ")):
            assert name in text, name
        figures = tab.evaluate("[...document.images].map(i => i.complete && i.naturalWidth)")
        assert len(figures) == len(drawings(c))
        assert min(figures) > 300
        # No table is wider than the page, no column of words so narrow that they break.
        wide = "[...document.querySelectorAll('.wide')].map(e => e.scrollWidth - e.clientWidth)"
        assert max(tab.evaluate(wide)) <= 0
        assert tab.evaluate("document.documentElement.scrollWidth") <= 794
        heights = "[...document.querySelectorAll('table.data thead tr:last-child')].map(e => e.offsetHeight)"
        assert max(tab.evaluate(heights)) < 40
        assert tab.screenshot().std() > 10
        pdf = tab.pdf()
    assert pdf.startswith(b"%PDF")
    assert 8 <= len(re.findall(rb"/Type /Page\b", pdf)) <= 20
