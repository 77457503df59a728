"""The HTML page about a scene: heading, labels, legend and the target magnified. Every name is escaped."""

from __future__ import annotations

import hashlib
import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template

import numpy as np
from numpy.typing import NDArray

from calib.show.window import as_base64, viewer_licences, viewer_script

Array = NDArray[np.float64]

#: Okabe and Ito's blue and vermilion, softened, and near black: told apart with any colour vision.
COLOURS = {"nominal": "#98aec4", "calibrated": "#ee8420", "measured": "#16202a"}

_LABELS = {
    "nominal": ("Nominal", "the URDF as given"),
    "both": ("Overlaid", "nominal solid, calibrated translucent"),
    "calibrated": ("Calibrated", "the corrected URDF"),
}


#: Between which of the target's points distances are given.
_PAIRS = (("nominal", "measured"), ("calibrated", "measured"), ("nominal", "calibrated"))

#: What a box in the legend shows and hides: nodes below `SCENE`.
_NODES = {
    "nominal": "nominal both/nominal",
    "calibrated": "calibrated both/calibrated",
    "measured": "both/measured",
}

#: The scene's node that holds the groups.
SCENE = "robots"


@dataclass(frozen=True, slots=True, eq=False)
class Spot:
    """Where a label stands.

    Attributes:
        group: ``nominal``, ``both`` or ``calibrated``.
        at: shape (3,), [m], in the scene.
    """

    group: str
    at: Array


def html_page(
    *,
    title: str,
    pose_name: str,
    points: Mapping[str, Array],
    spots: Sequence[Spot],
    grid: float,
    warnings: Sequence[str],
    scene: bytes,
) -> bytes:
    """The whole page, UTF-8.

    Args:
        title: The heading, plain text.
        pose_name: What the pose is called, plain text; may be empty.
        points: The target at the pose by ``nominal``, ``calibrated`` and perhaps ``measured``, shape (3,), [m].
        spots: The labels.
        grid: Edge of a square of the floor, [m].
        warnings: What could not be drawn, plain text.
        scene: The scene's message.
    """
    return filled_page(
        title=title,
        facts=_facts(pose_name, points),
        labels="\n".join(_label(spot) for spot in spots),
        inset=_inset(points),
        warnings=warnings,
        legend=_legend(points, grid),
        scene=scene,
    )


def filled_page(
    *,
    title: str,
    facts: str,
    labels: str = "",
    inset: str = "",
    warnings: Sequence[str],
    legend: str,
    scene: bytes,
) -> bytes:
    """The page about any scene, UTF-8. What is HTML must have its names escaped, see `escaped`.

    Args:
        title: The heading, plain text.
        facts: HTML below the heading.
        labels: HTML of the labels in the scene.
        inset: HTML in the corner.
        warnings: What could not be drawn, plain text.
        legend: HTML at the foot, see `key` and `grid_text`.
        scene: The scene's message.
    """
    folder = Path(__file__).parent
    # A script must not hold what ends it, nor may a text block; the base64 of the scene cannot.
    viewer = _no_end_tag(viewer_script())
    start = _no_end_tag((folder / "page.js").read_text(encoding="utf-8"))
    page = Template((folder / "page.html").read_text(encoding="utf-8"))
    text = page.substitute(
        hashes=f"{_hash(viewer)} {_hash(start)}",
        title=escaped(title),
        facts=facts,
        labels=labels,
        inset=inset,
        warnings=_warnings(warnings),
        legend=legend,
        licences=_no_end_tag(viewer_licences()),
        scene=as_base64(scene),
        viewer=viewer,
        start=start,
        **COLOURS,
    )
    return text.encode("utf-8")


def escaped(text: str) -> str:
    """Text for HTML, in an element or in quotes; characters that UTF-8 lacks become a question mark."""
    return html.escape(text.encode("utf-8", "replace").decode("utf-8"), quote=True)


def _no_end_tag(text: str) -> str:
    """A script whose strings cannot end it."""
    return text.replace("\r\n", "\n").replace("</script", "<\\/script").replace("<!--", "<\\!--")


def _hash(script: str) -> str:
    """A script's name in the page's policy: no other script runs, whatever a name may hold."""
    return f"'sha256-{as_base64(hashlib.sha256(script.encode('utf-8')).digest())}'"


def _mm(length: float) -> str:
    """A length in mm with three figures."""
    millimetres = 1e3 * length
    digits = 2 if millimetres < 100.0 else 0
    return f"{millimetres:.{digits}f} mm"


def _facts(pose_name: str, points: Mapping[str, Array]) -> str:
    """What the target does at this pose, in a paragraph or two."""
    apart = float(np.linalg.norm(points["nominal"] - points["calibrated"]))
    where = f"Pose of {escaped(pose_name)}. " if pose_name else ""
    lines = [
        f"{where}The two robots put the target <b>{_mm(apart)}</b> apart here, drawn true to scale."
    ]
    if "measured" in points:
        before, after = (
            _mm(float(np.linalg.norm(points["measured"] - points[who])))
            for who in ("nominal", "calibrated")
        )
        lines.append(
            f"From where it was measured: nominal <b>{before}</b>, calibrated <b>{after}</b>."
        )
    return "".join(f"<p>{line}</p>" for line in lines)


def _label(spot: Spot) -> str:
    """A label that the page's script keeps below its robot."""
    name, meaning = _LABELS[spot.group]
    at = " ".join(f"{float(value):.6g}" for value in spot.at)
    return f'<div class="over label" data-at="{at}"><strong>{name}</strong><span>{meaning}</span></div>'


def _legend(points: Mapping[str, Array], grid: float) -> str:
    """The colours and what the picture is."""
    keys = [
        ("nominal", "", "nominal"),
        ("calibrated", "", "calibrated"),
    ]
    if "measured" in points:
        keys.append(("measured", "dot", "measured target; small: at other poses"))
    items = [key(text, f"var(--{who})", _NODES[who], kind) for who, kind, text in keys]
    return "".join([*items, grid_text(grid)])


def key(text: str, colour: str, nodes: str, kind: str = "") -> str:
    """A line of the legend that shows and hides a part of the scene, HTML.

    Args:
        text: What it is, HTML.
        colour: As CSS has it.
        nodes: Which nodes below `SCENE`, blanks between them.
        kind: ``"dot"`` for a round mark.
    """
    return (
        f'<label class="key"><input type="checkbox" checked data-show="{nodes}">'
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


def _inset(points: Mapping[str, Array]) -> str:
    """The target's points in the plane through them, magnified, with a bar of a round length."""
    flat = _in_their_plane(points)
    low, high = np.min(list(flat.values()), axis=0), np.max(list(flat.values()), axis=0)
    if not np.any(high > low):
        return ""
    # 170 by 92 units: room for the dots at the edges and the bar below.
    scale = 1.0 / float(np.max((high - low) / (142.0, 50.0)))
    middle = 0.5 * (low + high)
    at = {
        who: (85.0 + scale * (x - middle[0]), 36.0 - scale * (y - middle[1]))
        for who, (x, y) in flat.items()
    }
    pairs = [pair for pair in _PAIRS if pair[0] in at and pair[1] in at]
    lines = [
        f'<line x1="{at[one][0]:.1f}" y1="{at[one][1]:.1f}" x2="{at[other][0]:.1f}" '
        f'y2="{at[other][1]:.1f}" stroke="var(--{one})" stroke-width="2"/>'
        for one, other in pairs[:2]
    ]
    dots = [
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{5 if who == "measured" else 7}" fill="var(--{who})"/>'
        for who, (x, y) in at.items()
    ]
    bar = round_length(80.0 / scale)
    drawing = (
        f'<svg viewBox="0 0 170 92" role="img" aria-label="The target magnified">{"".join(lines + dots)}'
        f'<path d="M8 78v6h{scale * bar:.1f}v-6" fill="none" stroke="#5a6875"/>'
        f'<text x="{16 + scale * bar:.1f}" y="88" font-size="12" fill="#5a6875">{1e3 * bar:g} mm</text></svg>'
    )
    rows = [
        f"<tr><td>{one} to {other}</td><td>{_mm(float(np.linalg.norm(points[one] - points[other])))}</td></tr>"
        for one, other in pairs
    ]
    table = f"<table>{''.join(rows)}</table>"
    return f'<aside class="over">{drawing}<div><h2>The target, magnified</h2>{table}</div></aside>'


def _in_their_plane(points: Mapping[str, Array]) -> dict[str, Array]:
    """Two or three points in the plane through them, shape (2,), [m]: no distance is foreshortened."""
    origin = points["nominal"]
    x = points["calibrated"] - origin
    if not x.any():
        x = points.get("measured", origin) - origin
    x = x / max(float(np.linalg.norm(x)), 1e-300)
    result = {}
    for who, point in points.items():
        along = float((point - origin) @ x)
        across = float(np.linalg.norm(point - origin - along * x))
        result[who] = np.array([along, across])
    return result


def round_length(longest: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is not above a length."""
    power = 10.0 ** np.floor(np.log10(longest))
    return float(power * max(step for step in (1, 2, 5) if step * power <= longest * 1.000001))
