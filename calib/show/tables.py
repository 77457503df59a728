"""Tables and lists of labels as text of at most 100 columns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from calib.show.lines import WIDTH, fill, wrap


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a printed table."""

    #: Its heading
    head: str
    #: The fewest characters of its cells; longer cells widen the column
    width: int = 0
    #: Cells are aligned to the left, else to the right
    left: bool = False
    #: Spaces before it; the first column has none
    gap: int = 1

    def cell(self, text: str, width: int) -> str:
        """Align the text of a cell.

        Args:
            text: The text.
            width: Characters of the column.

        Returns:
            The text, filled with spaces to that width.
        """
        return text.ljust(width) if self.left else text.rjust(width)


def name_column(head: str, width: int = 0) -> Column:
    """First column of a table: names, aligned to the left."""
    return Column(head, width, left=True)


def table_lines(columns: Sequence[Column], rows: Iterable[Sequence[str] | str]) -> list[str]:
    """Align a table.

    A column is as wide as its longest cell. Where the table would be wider than 100 characters, a name in the first
    column that does not fit gets a line of its own, above its cells.

    Args:
        columns: The columns, names first.
        rows: The rows, with a cell for each column; a cell may be empty. A text instead of cells is a line of its own.

    Returns:
        The line of headings, if there are any, and the lines of the rows, without spaces at their ends.
    """
    heads = [column.head for column in columns]
    every = [heads, *rows] if any(heads) else list(rows)
    widths = _widths(columns, [row for row in every if not isinstance(row, str)])
    lines = []
    for row in every:
        if isinstance(row, str):
            lines.append(row)
            continue
        name, others = row[0], row[1:]
        if len(name) > widths[0]:
            lines += _wrapped(name)
            name = ""
        lines.append(_line(columns, widths, [name, *others]))
    return lines


def _widths(columns: Sequence[Column], cells: Sequence[Sequence[str]]) -> list[int]:
    """Find the width of each column; the first one may be narrower than its longest name."""
    widths = [column.width for column in columns]
    for row in cells:
        widths = [max(width, len(cell)) for width, cell in zip(widths, row, strict=True)]
    others = sum(widths[1:]) + sum(column.gap for column in columns[1:])
    widths[0] = min(widths[0], max(WIDTH - others, columns[0].width))
    return widths


def _wrapped(name: str) -> list[str]:
    """Break a name into lines with its indent."""
    stripped = name.lstrip()
    return wrap(stripped, name.removesuffix(stripped)).splitlines()


def _line(columns: Sequence[Column], widths: Sequence[int], cells: Sequence[str]) -> str:
    """Join the cells of a row, each in the width of its column."""
    parts = [columns[0].cell(cells[0], widths[0])]
    for column, width, text in zip(columns[1:], widths[1:], cells[1:], strict=True):
        parts.append(" " * column.gap + column.cell(text, width))
    return "".join(parts).rstrip()


def labelled(label: str, text: str, width: int, indent: str = "") -> str:
    """Put a text behind its label; further lines are below the text.

    Args:
        label: The label.
        text: The text, of any length.
        width: The column at which the text begins, counted from the label's first character.
        indent: Spaces before the label.

    Returns:
        Lines of at most 100 columns.
    """
    return fill(f"{label:<{width - 1}} {text}", indent, " " * width)
