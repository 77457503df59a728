"""A document as one HTML page: figures inside, no script, nothing from the network; set for the screen and for A4.

Every name goes through the template's escaping, and the page's policy lets no script run whatever a name may hold.
"""

from __future__ import annotations

import base64
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from calib.show.document import (
    Block,
    Bullets,
    Document,
    Facts,
    Judgement,
    Paragraph,
    Picture,
    Signatures,
    Table,
    plain,
)
from calib.show.figure_base import WIDTH, Drawing, rendered, width_of

#: A drawing with more bytes than this as SVG goes in as PNG.
_LARGE = 260_000

#: A longer title is shortened at the foot of the page.
_LONGEST = 80

#: A longer word in a table is broken anywhere.
_LONGEST_WORD = 24

#: What the template calls each kind of block.
_KINDS: dict[type, str] = {
    Paragraph: "paragraph",
    Bullets: "bullets",
    Facts: "facts",
    Table: "table",
    Picture: "picture",
    Judgement: "judgement",
    Signatures: "signatures",
}

#: The sign and the class of each verdict: a word and a sign, never a colour alone.
_VERDICTS = {
    "use": ("\N{CHECK MARK}", "good"),
    "use with care": ("!", "care"),
    "do not use": ("\N{MULTIPLICATION X}", "bad"),
}


@dataclass(frozen=True, slots=True)
class _Set:
    """A block as the template takes it.

    Attributes:
        kind: Which part of the template sets it.
        block: The block.
        number: Of a table or figure.
        source: The address of a figure, its data.
        share: Its width over that of the widest, so that all have letters of one size [%].
        sign: Of a verdict.
        css: Class of a verdict.
    """

    kind: str
    block: Block
    number: int = 0
    source: str = ""
    share: str = ""
    sign: str = ""
    css: str = ""


def as_html(document: Document) -> str:
    """The whole page."""
    import jinja2
    from markupsafe import Markup

    environment = jinja2.Environment(
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["plain"] = plain
    environment.tests["long"] = _long
    template = environment.from_string(
        (Path(__file__).parent / "report.html.j2").read_text(encoding="utf-8")
    )
    tables, figures = itertools.count(1), itertools.count(1)
    sections = [
        (section.title, [_set(block, tables, figures) for block in section.blocks])
        for section in document.sections
    ]
    footer = Markup(_css_string(plain(document.title)))
    return template.render(document=document, sections=sections, footer=footer)


def _long(text: str) -> bool:
    """Whether a text has a word that may be cut, or it would push its table off the page."""
    return max(map(len, text.split()), default=0) > _LONGEST_WORD


def _css_string(text: str) -> str:
    """A text in quotes for CSS: all but letters, digits and blanks as numbers, so that nothing ends it; shortened."""
    short = text if len(text) <= _LONGEST else f"{text[:_LONGEST]}\N{HORIZONTAL ELLIPSIS}"
    safe = (c if c == " " or (c.isascii() and c.isalnum()) else f"\\{ord(c):x} " for c in short)
    return f'"{"".join(safe)}"'


def _set(block: Block, tables: Iterator[int], figures: Iterator[int]) -> _Set:
    """One block with its number, and a figure with its data."""
    kind = _KINDS[type(block)]
    if isinstance(block, Table):
        return _Set(kind, block, next(tables))
    if isinstance(block, Picture):
        source, share = _picture(block.drawing)
        return _Set(kind, block, next(figures), source=source, share=share)
    if isinstance(block, Judgement):
        sign, css = _VERDICTS.get(block.use, ("\N{EN DASH}", "none"))
        return _Set(kind, block, sign=sign, css=css)
    return _Set(kind, block)


def _picture(drawing: Drawing) -> tuple[str, str]:
    """The figure as a data address, lines as SVG and as PNG where that would be large; and its width [%]."""
    kind, data = "svg", rendered(drawing, "svg")
    if len(data) > _LARGE:
        kind, data = "png", rendered(drawing, "png")
    media = "svg+xml" if kind == "svg" else kind
    share = f"{100.0 * width_of(data, kind) / WIDTH:.1f}"
    return f"data:image/{media};base64,{base64.b64encode(data).decode('ascii')}", share
