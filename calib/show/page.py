"""The HTML page about a scene: heading, legend, controls, and the scripts that may run. Every name is escaped."""

from __future__ import annotations

import hashlib
import html
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from calib.show.palette import CALIBRATED, MEASURED, NOMINAL
from calib.show.window import as_base64, viewer_licences, viewer_script

#: The colours of robots and of what was measured.
COLOURS = {"nominal": NOMINAL, "calibrated": CALIBRATED, "measured": MEASURED}

#: The scene's node that holds the robots.
SCENE = "robots"

#: What a page may talk to that came from a server on this computer.
_LIVE = "; connect-src 'self' ws://127.0.0.1:* ws://localhost:*"


def filled_page(
    *,
    title: str,
    facts: str,
    labels: str = "",
    controls: str = "",
    inset: str = "",
    warnings: Sequence[str],
    legend: str,
    scene: bytes,
    table: Mapping[str, Any] | None = None,
    scripts: Sequence[str] = (),
    live: bool = False,
) -> bytes:
    """The page about any scene, UTF-8. What is HTML must have its names escaped, see `escaped`.

    Args:
        title: The heading, plain text.
        facts: HTML below the heading.
        labels: HTML of the labels in the scene.
        controls: HTML beside the heading.
        inset: HTML in the corner.
        warnings: What could not be drawn, plain text.
        legend: HTML at the foot, see `key` and `grid_text`.
        scene: The scene's message.
        table: What the page's own script is told; None for a page without one.
        scripts: Names of that script's files.
        live: Whether the page listens to the server that it came from.
    """
    folder = Path(__file__).parent
    # A script must not hold what ends it, nor may a text block; the base64 of the scene cannot.
    viewer = _no_end_tag(viewer_script())
    start = _no_end_tag((folder / "page.js").read_text(encoding="utf-8"))
    own = _no_end_tag(_joined([(folder / name).read_text(encoding="utf-8") for name in scripts]))
    page = Template((folder / "page.html").read_text(encoding="utf-8"))
    text = page.substitute(
        hashes=" ".join(_hash(one) for one in (viewer, start, own) if one)
        + (_LIVE if live else ""),
        live=" data-live" if live else "",
        title=escaped(title),
        facts=facts,
        labels=labels,
        controls=controls,
        inset=inset,
        warnings=_warnings(warnings),
        legend=legend,
        licences=_no_end_tag(viewer_licences()),
        scene=as_base64(scene),
        viewer=viewer,
        start=start,
        table=_table(table),
        own=f"<script>{own}</script>" if own else "",
        **COLOURS,
    )
    return text.encode("utf-8")


def escaped(text: str) -> str:
    """Text for HTML, in an element or in quotes; characters that UTF-8 lacks become a question mark."""
    return html.escape(text.encode("utf-8", "replace").decode("utf-8"), quote=True)


def _joined(files: Sequence[str]) -> str:
    """Several files as one script with names of its own; none for no files."""
    return '"use strict";\n(() => {\n' + "\n".join(files) + "})();\n" if files else ""


def _no_end_tag(text: str) -> str:
    """A script whose strings cannot end it."""
    return text.replace("\r\n", "\n").replace("</script", "<\\/script").replace("<!--", "<\\!--")


def _hash(script: str) -> str:
    """A script's name in the page's policy: no other script runs, whatever a name may hold."""
    return f"'sha256-{as_base64(hashlib.sha256(script.encode('utf-8')).digest())}'"


def _table(table: Mapping[str, Any] | None) -> str:
    """A block of JSON that no name in it can end."""
    if table is None:
        return ""
    text = json.dumps(table, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return f'<script type="application/json" id="table">{text}</script>'


def key(text: str, colour: str, nodes: str, kind: str = "", *, on: bool = True) -> str:
    """A line of the legend that shows and hides a part of the scene, HTML.

    Args:
        text: What it is, HTML.
        colour: As CSS has it.
        nodes: Which nodes below `SCENE`, blanks between them.
        kind: ``"dot"`` for a round mark.
        on: Whether it is shown at first.
    """
    return (
        f'<label class="key"><input type="checkbox"{" checked" if on else ""} data-show="{nodes}">'
        f'<i class="{kind}" style="background: {colour}"></i>{text}</label>'
    )


def grid_text(grid: float) -> str:
    """How large the floor's squares are, and how to turn the scene, HTML."""
    size = f"{grid:g} m" if grid >= 0.1 else f"{1e3 * grid:g} mm"
    return f"<span>Floor squares {size}. Drag to turn, scroll to zoom.</span>"


def _warnings(warnings: Sequence[str]) -> str:
    """A list that opens on a click; nothing if there are none."""
    if not warnings:
        return ""
    items = "".join(f"<li>{escaped(warning)}</li>" for warning in warnings)
    count = f"{len(warnings)} shape{'s' * (len(warnings) > 1)} not drawn as in the URDF"
    return f'<details class="over"><summary>{count}</summary><ul>{items}</ul></details>'


def round_length(longest: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is not above a length."""
    power = 10.0 ** np.floor(np.log10(longest))
    return float(power * max(step for step in (1, 2, 5) if step * power <= longest * 1.000001))
