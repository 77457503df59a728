"""A document in neutral blocks: what is said, before anybody decides how it is set.

`calib.show.report_html`, `calib.show.report_markdown` and `calib.show.report_text` set one. Texts are plain, one line
each, without mark-up. Names come from files, so nothing in them is trusted; see `plain`.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from calib.errors import CalibError
from calib.show.figure_base import Drawing

#: Invisible characters that some scripts cannot do without: zero-width joiner and non-joiner.
_JOINERS = "\u200c\u200d"


@dataclass(frozen=True, slots=True)
class Paragraph:
    """A paragraph.

    Attributes:
        text: What it says.
    """

    text: str


@dataclass(frozen=True, slots=True)
class Bullets:
    """A list.

    Attributes:
        items: Its entries.
    """

    items: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Facts:
    """Names and values, one pair a line.

    Attributes:
        pairs: What it is, and its value.
    """

    pairs: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Table:
    """A table, all of its cells as text.

    Attributes:
        title: What it holds, its unit, and of which rows.
        head: A label for each column.
        rows: A text for each column, in each row.
        align: ``l`` (text) or ``r`` (numbers) for each column.
        note: Below it; may be empty.
        groups: Labels above the head, each with the number of columns it spans; none or all columns.
        strong: The rows that matter most, by their number from 0 on.

    Raises:
        CalibError: A row, ``align`` or ``groups`` has another number of columns than the head.
    """

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    align: str
    note: str = ""
    groups: tuple[tuple[str, int], ...] = ()
    strong: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Check that every row has a cell for every column."""
        columns = len(self.head)
        wide = [len(row) for row in self.rows if len(row) != columns]
        spans = sum(span for _, span in self.groups)
        if wide or len(self.align) != columns or (self.groups and spans != columns):
            message = (
                f"The table '{self.title}' has {columns} columns in its head, rows of {sorted({columns, *wide})}, "
                f"{len(self.align)} in 'align' and {spans} under its groups; give each the same number."
            )
            raise CalibError(message)


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure.

    Attributes:
        drawing: The figure, drawn where it is needed.
    """

    drawing: Drawing


@dataclass(frozen=True, slots=True)
class Judgement:
    """The verdict.

    Attributes:
        use: ``"use"``, ``"use with care"``, ``"do not use"`` or ``"none"``.
        reasons: Sentences, the weightiest first.
    """

    use: str
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Signatures:
    """Room to write on by hand.

    Attributes:
        blanks: What is filled in, a line each.
        parties: Who signs.
        lines: What each of them writes, such as name, date and signature.
    """

    blanks: tuple[str, ...]
    parties: tuple[str, ...]
    lines: tuple[str, ...]


Block = Paragraph | Bullets | Facts | Table | Picture | Judgement | Signatures


@dataclass(frozen=True, slots=True)
class Section:
    """A section.

    Attributes:
        title: Its heading.
        blocks: What stands in it.
    """

    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True, slots=True)
class Document:
    """A document.

    Attributes:
        title: Its heading.
        facts: What and when, below the heading.
        sections: Its sections; those without a block are left out.
    """

    title: str
    facts: Facts
    sections: tuple[Section, ...]

    def __post_init__(self) -> None:
        """Leave out what is empty."""
        object.__setattr__(self, "sections", tuple(s for s in self.sections if s.blocks))


def blocks(*some: Block | None) -> tuple[Block, ...]:
    """The blocks that there are."""
    return tuple(block for block in some if block is not None)


def table(
    title: str,
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    align: str,
    **more: str | tuple[tuple[str, int], ...] | tuple[int, ...],
) -> Table | None:
    """A table, or nothing where it has no rows; the arguments are those of `Table`."""
    cells = tuple(tuple(row) for row in rows)
    return Table(title, tuple(head), cells, align, **more) if cells else None  # type: ignore[arg-type]


def plain(text: str) -> str:
    r"""A text as one line that is safe to print: what controls a terminal or turns the line round is written out.

    Example:
        >>> plain("a\nb \x1b[31m c")
        'a b \\x1b[31m c'
    """
    return "".join(_shown(character) for character in text)


def _shown(character: str) -> str:
    """A character, a blank, or the escape that Python would print."""
    if character in "\n\r\t\u2028\u2029":
        return " "
    kind = unicodedata.category(character)
    if kind in ("Cc", "Cf", "Cs", "Co", "Cn") and character not in _JOINERS:
        return character.encode("unicode_escape").decode("ascii")
    return character
