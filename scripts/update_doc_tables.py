"""Write what in the docs is made of something else: keys of records, columns of tables of errors, the list of pages.

    python scripts/update_doc_tables.py

A table of keys stands between ``<!-- keys of calib.data.cell.Cell -->`` and ``<!-- end of keys -->``; the name is that
of the record whose keys it has. The columns of errors stand between ``<!-- columns of errors -->`` and
``<!-- end of columns -->``. ``llms.txt`` lists all pages with their first paragraphs, for assistants. A test fails
while anything in the docs differs from what this script writes.
"""

from __future__ import annotations

import importlib
import re
from pathlib import Path

from calib.basics.records import key_rows
from calib.data.cell import FILE_KEYS, Cell
from calib.show.error_tables import ERROR_COLUMNS

DOCS = Path(__file__).parents[1] / "docs"

_TABLE = re.compile(r"(<!-- keys of calib\.([\w.]+) -->\n).*?(<!-- end of keys -->)", re.DOTALL)
_COLUMNS = re.compile(r"(<!-- columns of errors -->\n).*?(<!-- end of columns -->)", re.DOTALL)


def main() -> None:
    """Write the tables of all pages."""
    for page in sorted(DOCS.glob("*.md")):
        text = page.read_text(encoding="utf-8")
        page.write_text(with_tables(text), encoding="utf-8")
    (DOCS / "llms.txt").write_text(list_of_pages(), encoding="utf-8")


def list_of_pages() -> str:
    """Return the pages in the order of the site's contents, under its captions, each with its first paragraph."""
    index = (DOCS / "index.rst").read_text(encoding="utf-8")
    summary = index.split("\n\n")[1].replace("\n", " ")
    lines = [
        "# calib",
        "",
        f"> {summary}",
        "",
        "How an assistant uses calib for somebody: AGENTS.md in the repository.",
    ]
    for caption, names in re.findall(r":caption: (.+)\n\n((?:   [\w/-]+\n)+)", index):
        lines += ["", f"## {caption}", ""]
        for name in names.split():
            page = DOCS / f"{name}.md"
            if page.exists():
                title, paragraph = page.read_text(encoding="utf-8").split("\n\n")[:2]
                words = re.sub(
                    r"\[([^]]*)\]\([^)]*\)|\{doc\}`([^`]*)`", r"\1\2", " ".join(paragraph.split())
                )
                lines.append(f"- [{title.removeprefix('# ')}]({name}.md): {words}")
    return "\n".join(lines) + "\n"


def with_tables(text: str) -> str:
    """Return a page with its tables as calib declares them."""

    def replaced(found: re.Match[str]) -> str:
        module, _, name = found[2].rpartition(".")
        kind = getattr(importlib.import_module(f"calib.{module}"), name)
        return f"{found[1]}\n{table(kind)}\n\n{found[3]}"

    text = _TABLE.sub(replaced, text)
    return _COLUMNS.sub(lambda found: f"{found[1]}\n{error_columns()}\n\n{found[2]}", text)


def table(kind: type) -> str:
    """Return the table of a record's keys in Markdown."""
    lines = ["| key | value | default | meaning |", "|---|---|---|---|"]
    for name, value, default, meaning in key_rows(kind, FILE_KEYS if kind is Cell else ()):
        is_code = re.fullmatch(r'".*"|true|false', default)
        cells = (f"`{name}`", value, f"`{default}`" if is_code else default, meaning)
        lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
    return "\n".join(lines)


def error_columns() -> str:
    """Return the table of the columns of errors in Markdown."""
    lines = ["| column | meaning |", "|---|---|"]
    for column in ERROR_COLUMNS:
        name = f"{column.group} {column.head}" if column.group else column.head
        lines.append(f"| {name} | {column.meaning} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
