"""The content that a verb shows, as values: a page of sections, and sections of blocks.

A verb says once what its page contains. `calib.show.as_text` draws it for a terminal, `calib.show.as_html` as HTML to
print and as an excerpt for notebooks. A section, or a block in it, may be for some media only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Flag, auto
from typing import TYPE_CHECKING

from calib.basics.dates import now

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Medium(Flag):
    """A medium on which a page is drawn."""

    #: Text of 100 columns
    TERMINAL = auto()
    #: A page that prints on A4
    HTML = auto()
    #: A few tables in place of a value's line
    NOTEBOOK = auto()


TERMINAL = Medium.TERMINAL
HTML = Medium.HTML
NOTEBOOK = Medium.NOTEBOOK
EVERYWHERE = TERMINAL | HTML | NOTEBOOK


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """A part of a page; without content it is not drawn."""

    #: The media that draw it
    on: Medium = EVERYWHERE
    #: In a terminal it follows the block above without an empty line
    tight: bool = False


@dataclass(frozen=True, slots=True)
class Paragraph(Block):
    """Sentences."""

    text: str


@dataclass(frozen=True, slots=True)
class Bullets(Block):
    """A list of sentences, in a terminal a line each."""

    items: Sequence[str]
    #: The sentence before them
    lead: str = ""
    #: In a terminal: spaces before each item
    indent: str = ""
    #: Items that a medium lists at most; the others are counted
    most: Mapping[Medium, int] = field(default_factory=dict)

    def listed(self, medium: Medium) -> list[str]:
        """Return the items that a medium lists; if there are more, a last one counts them: ``"and 3 more"``."""
        listed = list(self.items[: self.most.get(medium)])
        more = len(self.items) - len(listed)
        return [*listed, f"and {more} more"] if more else listed


@dataclass(frozen=True, slots=True)
class Facts(Block):
    """Labels with a text each; those without a text are not drawn."""

    pairs: Sequence[tuple[str, str]]


#: The sign and the shade of each verdict or outcome: a word and a sign, never a colour alone.
_SHADES = {
    "pass": ("\u2713", "good"),
    "use": ("\u2713", "good"),
    "undecided": ("!", "care"),
    "use with care": ("!", "care"),
    "fail": ("\u2715", "bad"),
    "do not use": ("\u2715", "bad"),
    "none": ("\u2013", "none"),
}


@dataclass(frozen=True, slots=True)
class Verdict(Block):
    """A verdict, or the outcome of an acceptance test, with what it rests on."""

    #: Such as ``"use with care"`` or ``"pass"``; ``"none"``
    use: str
    #: All that it rests on, the most important first
    reasons: Sequence[str]

    @property
    def text(self) -> str:
        """The verdict as it stands on a page: ``"Verdict: pass"``."""
        return f"Verdict: {self.use}"

    @property
    def sign(self) -> str:
        """The sign before the verdict, such as a check mark."""
        return _SHADES[self.use][0]

    @property
    def shade(self) -> str:
        """Class of its colour in the style sheet: ``"good"``, ``"care"``, ``"bad"`` or ``"none"``."""
        return _SHADES[self.use][1]


@dataclass(frozen=True, slots=True)
class Drawing(Block):
    """A figure that is not drawn yet; only pages on HTML have figures."""

    #: Its file's name without the ending
    name: str
    #: Section of the page that it belongs to
    section: str
    title: str
    #: Rows, units, and the meaning of lines and marks
    caption: str
    #: Draws it, each time it is called
    draw: Callable[[], Figure]


@dataclass(frozen=True, slots=True)
class GalleryPicture:
    """A small picture with marks."""

    #: Name of its file
    name: str
    #: Name of its camera; empty if it has none
    camera: str
    #: True if something of it is used
    is_used: bool
    #: Text about what is used of it, or why nothing is
    text: str
    #: Width and height of the picture that the marks are in [px]
    size: tuple[int, int]
    #: The small picture; empty without one
    jpeg: bytes
    #: Marked points [px], each set with whether it is used
    marks: Sequence[tuple[bool, Sequence[tuple[float, float]]]]


@dataclass(frozen=True, slots=True)
class Gallery(Block):
    """Pictures side by side, those that are not used listed before them; only pages on HTML have one."""

    pictures: Sequence[GalleryPicture]
    #: Meaning of the marks
    key: str


@dataclass(frozen=True, slots=True)
class Section:
    """A section of a page; its blocks are made when they are drawn."""

    #: Makes the blocks
    blocks: Callable[[], Iterable[Block]]
    #: Its heading on a page, which is numbered; empty: it continues the section above
    name: str = ""
    #: The media that draw it
    on: Medium = TERMINAL | HTML
    #: It is printed on one sheet
    whole: bool = False


def report_date() -> str:
    """Return the date and time of a page, UTC: that of the environment variable ``SOURCE_DATE_EPOCH``, or now."""
    return f"{now():%Y-%m-%d %H:%M} UTC"


@dataclass(frozen=True, slots=True)
class Page:
    """A page: the sections that a verb shows of a value, for all media."""

    #: Kind of document, such as ``"Calibration report"``
    document: str
    #: Its subject, such as the robot's name
    subject: str
    sections: Sequence[Section]
    #: When it was made
    date: str = field(default_factory=report_date)
    #: On HTML: a wide sheet of pictures for a screen, in place of a report on A4
    is_sheet: bool = False

    def drawn_on(self, medium: Medium) -> Iterator[tuple[Section, list[Block]]]:
        """Yield the sections that a medium draws, each with the blocks that it draws of them.

        Args:
            medium: One of `Medium`.
        """
        for section in self.sections:
            if medium in section.on:
                yield section, [block for block in section.blocks() if medium in block.on]
