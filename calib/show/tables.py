"""Tables: columns with their type and unit, rows of values; drawn as lines of at most 100 columns here.

A row holds values: texts, counts, and numbers in SI units. A column says how they are written, so that every drawing of
a table has the same digits. `calib.show.as_html` draws tables as HTML.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.units import UNITS
from calib.show.blocks import Block, Medium
from calib.show.lines import WIDTH, fill, number, wrap

#: Rows, poses, targets or combinations of parameters that a page lists at most; the others are counted.
MOST_LISTED = 40


class Label(NamedTuple):
    """A name of a row that a terminal has shorter, because there it is read below the row above."""

    full: str
    short: str


#: A text, a count, or a number in SI units; NaN for none.
Cell = str | int | float | Label

#: The cells of a row, one for each column; or a text that takes the whole row.
Row = Sequence[Cell] | str


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table."""

    #: Its heading
    head: str
    #: In a terminal: its least width in characters; longer cells widen the column
    width: int = 0
    #: Cells are aligned to the left, otherwise to the right
    left: bool = False
    #: In a terminal: spaces before it; the first column has none
    gap: int = 1
    #: Unit in which its numbers are shown, such as ``"mm"``; empty: numbers are shown as they are
    unit: str = ""
    #: Digits after the point of its numbers
    digits: int = 3
    #: ``"+"``: positive numbers have a sign too
    sign: str = "-"
    #: Heading that it shares with its neighbours
    group: str = ""
    #: Left out of a table in which no row has a value for it
    optional: bool = False
    #: Meaning of the column, below the table on a page
    note: str = ""

    def text(self, cell: Cell, *, short: bool = False) -> str:
        """Write a cell, a number in the column's unit but without it.

        Args:
            cell: The value, a number in SI units; a dash stands for a number that is not finite.
            short: Write names short, and counts without separators, as a terminal has them.
        """
        if isinstance(cell, str):
            return cell
        if isinstance(cell, Label):
            return cell.short if short else cell.full
        if isinstance(cell, int):
            return str(cell) if short else f"{cell:,}"
        factor = 1.0 / UNITS[self.unit].to_si if self.unit else 1.0
        return number(factor * cell, self.digits, self.sign)


def name_column(head: str, width: int = 0) -> Column:
    """Return the first column of a table: names under ``head``, aligned to the left."""
    return Column(head, width, left=True)


def residual_column(head: str, unit: str, width: int = 0, *, group: str = "") -> Column:
    """Return a column of errors in a unit of residuals, by its symbol such as ``"m"``, with the digits of that unit."""
    of_unit = RESIDUAL_UNITS[unit]
    return Column(head, width, unit=of_unit.shown, digits=of_unit.digits, group=group)


@dataclass(frozen=True, slots=True)
class Table(Block):
    """A table; without rows it is not shown."""

    #: Its title, with the unit if all numbers have the same
    title: str
    #: Its columns, names first
    columns: Sequence[Column]
    rows: Sequence[Row]
    #: Sentences below the table, on a page
    note: str = ""
    #: Indices of the rows in bold, on a page, from 0
    strong: Sequence[int] = ()
    #: Rows that a medium lists at most; the others are counted
    most: Mapping[Medium, int] = field(default_factory=dict)
    #: The place of the others, for a page
    elsewhere: str = ""
    #: In a terminal the title is a line of its own; otherwise it is the heading of the first column
    title_above: bool = False
    #: In a terminal: spaces before the names of its rows
    indent: str = ""


def format_cells(
    columns: Sequence[Column], rows: Iterable[Row], *, short: bool = False
) -> tuple[list[Column], list[list[str] | str]]:
    """Write the cells of a table.

    Args:
        columns: The columns.
        rows: The rows.
        short: As of `Column.text`.

    Returns:
        The columns without the optional ones in which no row has a value, and the texts of each row.
    """
    listed = list(rows)
    cells = [row for row in listed if not isinstance(row, str)]
    kept = [
        k
        for k, column in enumerate(columns)
        if not column.optional or any(_has_value(row[k]) for row in cells)
    ]
    texts: list[list[str] | str] = []
    for row in listed:
        if isinstance(row, str):
            texts.append(row)
        else:
            texts.append([columns[k].text(row[k], short=short) for k in kept])
    return [columns[k] for k in kept], texts


def _has_value(cell: Cell) -> bool:
    """Return True if a cell of a table, a text or number, is neither empty nor NaN."""
    return not math.isnan(cell) if isinstance(cell, float) else bool(cell)


def table_lines(columns: Sequence[Column], rows: Iterable[Row]) -> list[str]:
    """Align a table.

    A column is as wide as its longest cell. If the table would be wider than 100 characters, a name in the first column
    that does not fit gets a line of its own, above its cells; if that is not enough, the other columns move closer
    together.

    Args:
        columns: The columns, names first.
        rows: The rows; a text is a line of its own.

    Returns:
        The line of headings, if there are any, and the lines of the rows, without spaces at their ends.
    """
    shown, texts = format_cells(columns, rows, short=True)
    heads = []
    group = ""
    for column in shown:
        starts_group = column.group and column.group != group
        heads.append(f"{column.group} {column.head}" if starts_group else column.head)
        group = column.group
    every = [heads, *texts] if any(heads) else texts

    # Columns as wide as their longest cell; if there is no room, the first one and then the widest are narrower.
    rows_of_cells = [row for row in every if not isinstance(row, str)]
    longest = [max((len(row[k]) for row in rows_of_cells), default=0) for k in range(len(shown))]
    widths = [max(column.width, width) for column, width in zip(shown, longest, strict=True)]
    room = WIDTH - sum(column.gap for column in shown[1:])
    widths[0] = min(widths[0], max(room - sum(widths[1:]), shown[0].width))
    while sum(widths) > room:
        loose = [k for k in range(1, len(widths)) if widths[k] > longest[k]]
        if not loose:
            break
        widths[max(loose, key=lambda k: widths[k])] -= 1

    lines = []
    for row in every:
        if isinstance(row, str):
            lines.append(row)
            continue
        name, others = row[0], row[1:]
        if len(name) > widths[0]:
            stripped = name.lstrip()
            lines += wrap(stripped, name.removesuffix(stripped)).splitlines()
            name = ""
        line = name.ljust(widths[0]) if shown[0].left else name.rjust(widths[0])
        for column, width, text in zip(shown[1:], widths[1:], others, strict=True):
            line += " " * column.gap + (text.ljust(width) if column.left else text.rjust(width))
        lines.append(line.rstrip())
    return lines


def labelled(label: str, text: str, width: int, indent: str = "") -> str:
    """Put a text after its label; further lines are below the text.

    Args:
        label: The label.
        text: The text, of any length.
        width: The column at which the text begins, counted from the label's first character.
        indent: Spaces before the label.

    Returns:
        Lines of at most 100 columns.
    """
    return fill(f"{label:<{width - 1}} {text}", indent, " " * width)
