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
    """Draw blocks as text for a terminal, with an empty line between them unless a block is tight."""
    text = ""
    for block in blocks:
        lines = _LINES[type(block)](block)
        if lines:
            gap = "\n" if block.tight else "\n\n"
            text += (gap if text else "") + "\n".join(lines)
    return text


def _bullet_lines(bullets: Bullets) -> list[str]:
    """Return the lines of a list of sentences for a terminal: its lead, and each item; none without items."""
    lines = [wrap(item, bullets.indent) for item in bullets.listed(TERMINAL)]
    return [wrap(bullets.lead), *lines] if lines and bullets.lead else lines


def _table_lines(table: Table) -> list[str]:
    """Return the lines of a table for a terminal, its title above or at the head of the names; none without rows.

    A last line counts the rows beyond those that a terminal lists.
    """
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


#: The function that draws each kind of block; figures are for pages only.
_LINES: dict[type[Block], Callable[[Any], list[str]]] = {
    Paragraph: lambda paragraph: [wrap(paragraph.text)] if paragraph.text else [],
    Bullets: _bullet_lines,
    Facts: lambda facts: [wrap(f"{label}: {text}") for label, text in facts.pairs if text],
    Verdict: lambda verdict: [verdict.text, *(wrap(reason, "  ") for reason in verdict.reasons)],
    Table: _table_lines,
    Drawing: lambda _: [],
}
