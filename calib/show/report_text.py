"""A document as text of 100 columns, without colour codes."""

from __future__ import annotations

import itertools
import unicodedata
from collections.abc import Iterable, Iterator, Sequence

from calib.show.document import (
    Block,
    Bullets,
    Document,
    Facts,
    Judgement,
    Paragraph,
    Picture,
    Section,
    Signatures,
    Table,
    plain,
)

#: Columns of the text.
WIDTH = 100

#: A text column of a table is not made narrower than this.
_NARROW = 12

#: Between the columns of a table.
_GAP = 2


def as_text(document: Document) -> str:
    """The whole document; it ends in a line feed. Figures are named, not drawn."""
    count = itertools.count(1)
    title = plain(document.title)
    parts = [f"{title}\n{'=' * columns_of(title)}", "\n".join(_facts(document.facts))]
    for number, section in enumerate(document.sections, 1):
        parts += _section(f"{number}  {plain(section.title)}", section, count)
    return "\n\n".join(parts) + "\n"


def _section(title: str, section: Section, count: Iterator[int]) -> Iterator[str]:
    """The heading, underlined, and the blocks."""
    yield f"{title}\n{'-' * columns_of(title)}"
    for block in section.blocks:
        yield "\n".join(_block(block, count))


def _block(block: Block, count: Iterator[int]) -> Iterator[str]:
    """The lines of one block."""
    if isinstance(block, Paragraph):
        yield from wrapped(block.text)
    elif isinstance(block, Bullets):
        for item in block.items:
            yield from wrapped(item, "- ", "  ")
    elif isinstance(block, Facts):
        yield from _facts(block)
    elif isinstance(block, Table):
        yield from _table(block, next(count))
    elif isinstance(block, Picture):
        yield from wrapped(f"Figure '{block.drawing.name}': {block.drawing.title}", "", "  ")
    elif isinstance(block, Judgement):
        yield f"Verdict: {block.use}"
        for reason in block.reasons:
            yield from wrapped(reason, "  ", "    ")
    else:
        yield from _signatures(block)


def _facts(block: Facts) -> Iterator[str]:
    """Names in a column, values beside them."""
    widest = max((columns_of(plain(name)) for name, _ in block.pairs), default=0) + _GAP
    for name, value in block.pairs:
        label = plain(name)
        yield from wrapped(value, label + " " * (widest - columns_of(label)), " " * widest)


def _signatures(block: Signatures) -> Iterator[str]:
    """Lines to write on."""
    for line in block.blanks:
        yield f"{plain(line) + ':':<40}{'_' * 50}"
    for party in block.parties:
        yield ""
        yield f"{plain(party)}"
        for line in block.lines:
            yield f"{'  ' + plain(line) + ':':<40}{'_' * 50}"


def _table(block: Table, number: int) -> Iterator[str]:
    """Title, head, rows and note; texts that are too wide are broken inside their column."""
    yield from wrapped(f"Table {number}: {block.title}", "", "  ")
    widths = _widths(block)
    if block.groups:
        yield _group_line(block, widths)
    yield from _row(block.head, block.align, widths)
    yield "-" * (sum(widths) + _GAP * (len(widths) - 1))
    for row in block.rows:
        yield from _row(row, block.align, widths)
    if block.note:
        yield from wrapped(block.note, "  ", "  ")


def _widths(block: Table) -> list[int]:
    """The width of each column: numbers whole, texts as wide as what is left allows."""
    cells = [block.head, *block.rows]
    widths = [max(columns_of(plain(row[k])) for row in cells) for k in range(len(block.head))]
    texts = sorted(
        (k for k, side in enumerate(block.align) if side == "l"), key=lambda k: widths[k]
    )
    room = WIDTH - _GAP * (len(widths) - 1)
    for done, k in enumerate(texts):
        # What the numbers and the texts that are settled leave, shared by the wider ones.
        settled = sum(w for j, w in enumerate(widths) if j not in texts[done:])
        share = (room - settled) // (len(texts) - done)
        widths[k] = min(widths[k], max(share, _NARROW))
    return widths


def _group_line(block: Table, widths: Sequence[int]) -> str:
    """The labels above the head, each over its columns."""
    parts, start = [], 0
    for label, span in block.groups:
        width = sum(widths[start : start + span]) + _GAP * (span - 1)
        start += span
        text = plain(label)
        parts.append(text.center(width, "-" if text else " ") if span > 1 else text.ljust(width))
    return (" " * _GAP).join(parts).rstrip()


def _row(cells: Sequence[str], align: str, widths: Sequence[int]) -> Iterator[str]:
    """The lines of one row."""
    columns = [_broken(plain(cell), width) for cell, width in zip(cells, widths, strict=True)]
    for line in itertools.zip_longest(*columns, fillvalue=""):
        parts = [
            " " * (width - columns_of(text)) + text
            if side == "r"
            else text + " " * (width - columns_of(text))
            for text, side, width in zip(line, align, widths, strict=True)
        ]
        yield (" " * _GAP).join(parts).rstrip()


def wrapped(text: str, first: str = "", rest: str = "") -> Iterator[str]:
    """A text in lines of at most `WIDTH` columns.

    Args:
        text: One paragraph.
        first: What the first line begins with.
        rest: What the others begin with.
    """
    indents = itertools.chain([first], itertools.repeat(rest))
    room = WIDTH - max(columns_of(first), columns_of(rest))
    for indent, line in zip(indents, _broken(plain(text), room), strict=False):
        yield (indent + line).rstrip()


def _broken(text: str, width: int) -> list[str]:
    """Words in lines of a width; a word that is wider is cut. At least one line."""
    lines, line = [], ""
    for word in _pieces(text.split(" "), width):
        joined = f"{line} {word}" if line else word
        if columns_of(joined) <= width:
            line = joined
        else:
            lines.append(line)
            line = word
    # A blank behind a word that fills its line is no line of its own.
    return [*lines, line] if line or not lines else lines


def _pieces(words: Iterable[str], width: int) -> Iterator[str]:
    """Words no wider than a line."""
    for word in words:
        piece = ""
        for character in word:
            if columns_of(piece + character) > width:
                yield piece
                piece = ""
            piece += character
        yield piece


def columns_of(text: str) -> int:
    """How many columns of a terminal a text takes: two for a wide character, none for an accent."""
    if text.isascii():
        return len(text)
    return sum(
        0
        if unicodedata.combining(c) or unicodedata.category(c) in ("Mn", "Me", "Cf")
        else 2
        if unicodedata.east_asian_width(c) in "WF"
        else 1
        for c in text
    )
