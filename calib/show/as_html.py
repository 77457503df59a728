"""Pages as HTML that prints on A4, and as excerpts for notebooks: one file, figures inside, no script, no network.

The look, and how each kind of block is drawn, are in ``page.html.j2``.
"""

from __future__ import annotations

import base64
from itertools import groupby
from pathlib import Path
from typing import Any

from calib.errors import FileError
from calib.show.blocks import HTML, NOTEBOOK, Drawing, Medium, Page
from calib.show.tables import Table, format_cells

#: A figure with more bytes than this as SVG goes into the page as PNG: browsers scroll slowly over large SVG.
_LARGE = 260_000

#: A longer word in a table [letters] may be broken anywhere: it would push its table off the page.
_LONGEST_WORD = 24


def check_ending(path: str | Path) -> None:
    """Refuse a file name that does not end in .html or .htm.

    Raises:
        FileError: It does not.
    """
    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise FileError(
            f"'{path}': a report is a page; let the name end in .html. The summary is its text."
        )


def page_bytes(page: Page) -> bytes:
    """Draw the sections of a page that are for HTML, UTF-8.

    Two pages of the same content differ in their date only.

    Raises:
        CalibError: It has a figure, and matplotlib is not installed.
    """
    return _draw(page, HTML).encode("utf-8", "replace")


def notebook_html(page: Page) -> str:
    """Draw the sections of a page that are for a notebook, as an element of HTML; every text is escaped."""
    return _draw(page, NOTEBOOK)


def _draw(page: Page, medium: Medium) -> str:
    """Fill in the template ``page.html.j2`` with the sections of a page that a medium draws, as HTML text."""
    import jinja2
    from markupsafe import Markup

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.tests["long"] = lambda text: max(map(len, text.split()), default=0) > _LONGEST_WORD
    environment.globals |= {
        "cells_of": _table_context,
        "picture_of": _figure_address,
        "jpeg_of": lambda picture: _data_address("jpeg", picture.jpeg),
    }
    sections = [
        (section, [(type(block).__name__, block) for block in blocks])
        for section, blocks in page.drawn_on(medium)
    ]
    in_notebook = medium is NOTEBOOK
    return environment.get_template("page.html.j2").render(
        page=page,
        medium=medium,
        sections=sections,
        in_notebook=in_notebook,
        # A notebook has no style sheet of ours.
        left=Markup(' style="text-align:left"' if in_notebook else ""),
        right=Markup(' style="text-align:right"' if in_notebook else ' class="r"'),
    )


def _table_context(table: Table) -> dict[str, Any]:
    """Return what the template draws of a table.

    These are columns, headings above several of them, texts of the rows that HTML lists, a note that also counts the
    other rows, and whether the first column is wide.
    """
    columns, rows = format_cells(table.columns, table.rows[: table.most.get(HTML)])
    groups = [
        (label, len(list(below))) for label, below in groupby(column.group for column in columns)
    ]
    more = len(table.rows) - len(rows)
    notes = [table.note, *dict.fromkeys(column.note for column in columns)]
    if more:
        notes.append(f"{more:,} more are in {table.elsewhere}.")
    return {
        "columns": columns,
        "groups": groups if any(label for label, _ in groups) else [],
        "rows": rows,
        "note": " ".join(note for note in notes if note),
        "has_long_names": max((len(row[0]) for row in rows if not isinstance(row, str)), default=0)
        > 12,
    }


def _figure_address(drawing: Drawing) -> str:
    """Draw a figure and return it as a data address: SVG, or a PNG if that is large; CalibError without matplotlib."""
    from calib.show.plotting import render

    media_type = "svg+xml"
    data = render(drawing, "svg")
    if len(data) > _LARGE:
        media_type = "png"
        data = render(drawing, "png")
    return _data_address(media_type, data)


def _data_address(media_type: str, data: bytes) -> str:
    """Return a picture as a data address, ``data:image/...;base64,...``, so that it stands in the page itself."""
    return f"data:image/{media_type};base64,{base64.b64encode(data).decode('ascii')}"
