"""Pages as text for a terminal: lines of at most 100 columns, without colours."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

from calib.show.blocks import (
    TERMINAL,
    Block,
    Bullets,
    Drawing,
    Facts,
    Page,
    Paragraph,
    Verdict,
)
from calib.show.lines import wrap
from calib.show.tables import Table, name_column, table_lines


def page_text(page: Page) -> str:
    """Draw the sections of a page that are for a terminal; empty lines stand between the blocks."""
    return blocks_text(block for _, blocks in page.drawn_on(TERMINAL) for block in blocks)


def blocks_text(blocks: Iterable[Block]) -> str:
    """Draw blocks for a terminal."""
    text = ""
    for block in blocks:
        lines = _LINES[type(block)](block)
        if lines:
            gap = "\n" if block.tight else "\n\n"
            text += (gap if text else "") + "\n".join(lines)
    return text


def _paragraph_lines(paragraph: Paragraph) -> list[str]:
    """Break a paragraph into lines."""
    return [wrap(paragraph.text)] if paragraph.text else []


def _bullet_lines(bullets: Bullets) -> list[str]:
    """Write an item a line, after the lead; nothing without items."""
    lines = [wrap(item, bullets.indent) for item in bullets.listed(TERMINAL)]
    return [wrap(bullets.lead), *lines] if lines and bullets.lead else lines


def _fact_lines(facts: Facts) -> list[str]:
    """Write a label and its text a line; labels without a text are left out."""
    return [wrap(f"{label}: {text}") for label, text in facts.pairs if text]


def _verdict_lines(verdict: Verdict) -> list[str]:
    """Write a verdict, and below it what it rests on."""
    return [verdict.text, *(wrap(reason, "  ") for reason in verdict.reasons)]


def _table_lines(table: Table) -> list[str]:
    """Align a table, its title above or at the head of the names; rows beyond the most are counted."""
    if not table.rows:
        return []
    first, *others = table.columns
    rows = [
        row if isinstance(row, str) else (table.indent + first.text(row[0], short=True), *row[1:])
        for row in table.rows[: table.most.get(TERMINAL)]
    ]
    more = len(table.rows) - len(rows)
    counted = [f"  and {more} more"] if more else []
    if table.title_above:
        names = replace(first, head=table.indent + first.head)
        lines = table_lines([names, *others], rows)
        return [wrap(f"{table.title}:"), *lines, *counted]
    title = name_column(table.title, first.width)
    return [*table_lines([title, *others], rows), *counted]


#: How each kind of block is drawn; figures are for pages only.
_LINES: dict[type[Block], Callable[[Any], list[str]]] = {
    Paragraph: _paragraph_lines,
    Bullets: _bullet_lines,
    Facts: _fact_lines,
    Verdict: _verdict_lines,
    Table: _table_lines,
    Drawing: lambda _: [],
}
