"""The tables of docs/performance.md: the one place of the figures. A table that is not measured keeps its rows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from studies import table_lines

#: The page.
PAGE = Path(__file__).resolve().parents[1] / "docs" / "performance.md"


def cells_of(name: str) -> list[list[str]]:
    """Return the cells of a table's rows, without its titles; none if it is not there."""
    _, lines, _ = _parts(PAGE.read_text(encoding="utf-8"), name)
    rows = [line.strip("|").split("|") for line in lines if line.startswith("|")]
    return [[cell.strip() for cell in row] for row in rows[2:]]


def write_table(
    name: str, titles: Sequence[str], rows: Iterable[Sequence[str]], *, keep: bool
) -> None:
    """Put a table into the page.

    Args:
        name: Name of the table between its marks.
        titles: Titles of the columns.
        rows: Cells of the rows that were measured.
        keep: Whether rows that were not measured keep their place and cells; otherwise they go.
    """
    text = PAGE.read_text(encoding="utf-8")
    head, _, tail = _parts(text, name)
    kept = [row for row in cells_of(name) if keep and len(row) == len(titles)]
    merged = {row[0]: row for row in (*kept, *map(list, rows))}
    table = "\n".join(table_lines(titles, merged.values()))
    PAGE.write_text(f"{head}\n\n{table}\n\n{tail}", encoding="utf-8")


def _parts(text: str, name: str) -> tuple[str, list[str], str]:
    """Return what is before a table, up to its mark, its lines, and what is after it, from its mark on."""
    begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
    head, rest = text.split(begin)
    table, tail = rest.split(end)
    return head + begin, table.strip().splitlines(), end + tail
