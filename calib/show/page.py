"""HTML pages that print on A4: one file, figures inside, no script, nothing from the network.

Every report is ``page.html.j2`` with sections of its own: a template that extends it, filled in with variables.
"""

from __future__ import annotations

import base64
import os
from collections.abc import Iterable, Mapping
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calib.errors import FileError

if TYPE_CHECKING:
    from calib.show.drawing import Drawing

#: A drawing with more bytes than this as SVG goes into the page as PNG: browsers scroll slowly over large SVG.
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


def page_bytes(
    template: Path, content: Mapping[str, Any], drawings: Iterable[Drawing] = ()
) -> bytes:
    """Return a page, UTF-8.

    Two pages of the same content differ in their date only: that of the environment variable ``SOURCE_DATE_EPOCH``
    (seconds since 1970), else now.

    Args:
        template: The template; those that it extends or includes are beside it, or beside this module.
        content: Its variables, ``document`` and ``first`` among them: the report's title and its `FirstPage`.
        drawings: The figures.
    """
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([template.parent, Path(__file__).parent]),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.tests["long"] = _has_long_word
    figures = [(drawing, _picture(drawing)) for drawing in drawings]
    variables = {**content, "date": _date(), "figures": figures}
    return environment.get_template(template.name).render(variables).encode("utf-8", "replace")


def _has_long_word(text: str) -> bool:
    """Tell if a cell holds a word that must be broken to fit its column."""
    return any(len(word) > _LONGEST_WORD for word in text.split())


def _date() -> str:
    """Return the date and time of the report, UTC."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "")
    date = datetime.now(timezone.utc)
    if epoch.isdecimal():
        date = datetime.fromtimestamp(int(epoch), timezone.utc)
    return f"{date:%Y-%m-%d %H:%M} UTC"


def _picture(drawing: Drawing) -> str:
    """Draw a figure and return it as a data address: SVG, or PNG where SVG would be large."""
    from calib.show.drawing import rendered

    media_type = "svg+xml"
    data = rendered(drawing, "svg")
    if len(data) > _LARGE:
        media_type = "png"
        data = rendered(drawing, "png")
    return f"data:image/{media_type};base64,{base64.b64encode(data).decode('ascii')}"
