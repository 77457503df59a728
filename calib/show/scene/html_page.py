"""The HTML page that carries a scene: meshcat's viewer, the scene's message, scripts and their security policy."""

from __future__ import annotations

import base64
import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import meshcat
import numpy as np
from numpy.typing import ArrayLike

from calib.basics.files import write_atomically
from calib.show.look import CALIBRATED, INK, NOMINAL

#: Folder of the templates and scripts.
_FOLDER = Path(__file__).parent

#: The files of the script of a page of robots, in order.
_SCRIPTS = ("robots.js", "marks.js", "inset.js", "image.js", "texts.js", "controls.js")

#: Colours of robots and measured positions.
COLOURS = {"nominal": NOMINAL, "calibrated": CALIBRATED, "measured": INK}


class Page(NamedTuple):
    """A complete HTML page."""

    #: The page, UTF-8
    html: bytes
    #: A sentence for each shape that is not drawn as the URDF says
    warnings: tuple[str, ...]

    def write(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
        """Write the page, completely or not at all.

        Args:
            path: Name of the file.
            overwrite: Replace an existing file.

        Returns:
            The file's path.

        Raises:
            FileError: The file exists or cannot be written.
        """
        return write_atomically(path, self.html, overwrite=overwrite)


class LegendEntry(NamedTuple):
    """An entry of the legend, which shows and hides nodes."""

    #: Its text
    text: str
    #: Colour of its mark, ``"#rrggbb"``; of a scale of colours a gradient, as CSS has it
    colour: str
    #: Nodes below `calib.show.scene.scene.SCENE`, with blanks between them
    nodes: str
    #: Shape of its mark: ``"dot"``, ``"arrow"``, ``"scale"``, ...; empty for a square
    kind: str = ""
    #: The nodes are shown at first
    on: bool = True


def fill_page(
    template: str,
    scene: bytes,
    *,
    table: Mapping[str, Any] | None = None,
    **content: Any,  # noqa: ANN401  what the template names
) -> bytes:
    """Fill in the template of a page.

    Args:
        template: ``"page.html"`` or the name of a template that extends it.
        scene: The scene's message, see `calib.show.scene.scene.SceneWindow.scene`.
        table: Values for the script of a page of robots; None for a page without one.
        content: The template's other variables.

    Returns:
        The page, UTF-8.
    """
    import jinja2
    from markupsafe import Markup

    viewer = Path(meshcat.viewer_assets_path())
    scripts = [_safe_text(viewer / "dist/main.min.js"), _safe_text(_FOLDER / "page.js")]
    if table:
        joined = "\n".join(_safe_text(_FOLDER / name) for name in _SCRIPTS)
        scripts.append(f'"use strict";\n(() => {{\n{joined}}})();\n')
    # The page's security policy: no other script runs, whatever a name may hold.
    digests = [hashlib.sha256(text.encode()).digest() for text in scripts]
    sources = " ".join(f"'sha256-{_base64(digest)}'" for digest in digests)

    # The notices that must go with a copy of the viewer: meshcat's own and those of its contents.
    notices = [viewer / "LICENSE", *sorted((viewer / "dist").glob("main.min.js.*LICENSE*"))]
    licences = "\n\n".join(_safe_text(path) for path in notices)

    # A block of JSON that no name in it can end.
    json_text = json.dumps(table, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_FOLDER),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    page = environment.get_template(template).render(
        hashes=Markup(sources),
        colours=COLOURS,
        licences=Markup(licences),
        scene=_base64(scene),
        table=Markup(json_text) if table else "",
        scripts=[Markup(text) for text in scripts],
        **content,
    )
    return page.encode("utf-8", "replace")


def _safe_text(path: Path) -> str:
    """Read a file as text that cannot end the script that it stands in."""
    return path.read_text("utf-8").replace("</script", "<\\/script").replace("<!--", "<\\!--")


def _base64(data: bytes) -> str:
    """Return bytes as base64, a text that needs no escaping."""
    return base64.b64encode(data).decode("ascii")


def floats(values: ArrayLike) -> str:
    """Return numbers, an array of any shape, as base64 of little-endian float32, in C order."""
    return _base64(np.ascontiguousarray(values, dtype="<f4").tobytes())
