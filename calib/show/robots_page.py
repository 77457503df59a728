"""The HTML about two robots: heading, legend, controls, and the target magnified. Every name is escaped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.show.motion import FACTORS, colour_scale
from calib.show.page import COLOURS, escaped, filled_page, grid_text, key
from calib.show.palette import BEAM, ESTIMATION, LITTLE_TO_MUCH, OUTLIER, VALIDATION
from calib.show.view import Cloud, View

Array = NDArray[np.float64]

#: What the rows of each kind are called, in colours of their own.
_ROWS = {
    "estimation": (ESTIMATION, "measured, fitted"),
    "validation": (VALIDATION, "measured, held back"),
    "flagged": (OUTLIER, "measured, flagged"),
}

#: The files of the page's own script, in order.
SCRIPTS = ("robots.js", "marks.js", "words.js", "controls.js")

#: The largest factor that the robots' difference is magnified by: beyond it links fly apart.
_MOST_FOR_ROBOTS = 100

#: Drawings on buttons; letters for them are missing in many fonts.
_ICONS = {
    "back": "M10.5 3.5 5 8l5.5 4.5z",
    "play": "M4.5 3v10L13 8z",
    "forward": "M5.5 3.5 11 8l-5.5 4.5z",
}


@dataclass(frozen=True, slots=True, eq=False)
class PageParts:
    """What the page is made of.

    Attributes:
        view: What is shown.
        warnings: What could not be drawn, plain text.
        grid: Edge of a square of the floor [m].
        scene: The scene's message.
        motion: What the page's script is told.
        labels: Where the labels stand in the scene, shape (3,) each [m].
        live: Whether the page listens to the server that it came from.
    """

    view: View
    warnings: Sequence[str]
    grid: float
    scene: bytes
    motion: Mapping[str, Any]
    labels: Mapping[str, Array]
    live: bool


def robots_page(parts: PageParts) -> bytes:
    """The whole page, UTF-8."""
    view = parts.view
    click = "<span>A click on a ball shows its row.</span>" if view.measures else ""
    # Last, for its place is kept while it is not shown.
    scale = _scale(view.cloud) if view.cloud is not None and _has_cloud(view) else ""
    return filled_page(
        title=view.title or f"{view.nominal.name or 'Robot'}: {_both(view)}",
        facts=_facts(view),
        labels=_labels(view, parts.labels),
        controls=_controls(view, int(parts.motion["arrows"])),
        inset=_inset() if view.calibrated is not None or view.measures else "",
        warnings=parts.warnings,
        legend=_player(view)
        + f'<div class="keys">{_legend(view)}{grid_text(parts.grid)}{click}{scale}</div>',
        scene=parts.scene,
        table={**parts.motion, "names": [name for name, _ in view.names], "colours": _colours()},
        scripts=SCRIPTS,
        live=parts.live,
    )


def _both(view: View) -> str:
    """What the two robots are called together."""
    first, second = (name for name, _ in view.names)
    return f"{first.lower()} and {second.lower()}" if view.calibrated is not None else first.lower()


def _colours() -> dict[str, str]:
    """The colours that the script draws with."""
    rows = {kind: colour for kind, (colour, _) in _ROWS.items()}
    return {**COLOURS, **rows, "beam": BEAM}


def _facts(view: View) -> str:
    """What is known of the whole, and a line that the script fills in for each pose."""
    verdict = ""
    if view.verdict:
        kind = {"use": "use", "use with care": "care"}.get(view.verdict, "no")
        verdict = f'<b class="verdict {kind}">Verdict: {escaped(view.verdict)}.</b> '
    note = f"<p>{verdict}{escaped(view.note)}</p>" if verdict or view.note else ""
    few = ""
    if view.rows > len(view.q):
        few = f"<p>{len(view.q)} of {view.rows:,} rows are shown, spread evenly; flagged ones first.</p>"
    factors = '<p id="factors"></p>' if view.calibrated is not None or view.measures else ""
    return f'{note}{few}<p id="pose"></p>{factors}'


def _labels(view: View, places: Mapping[str, Array]) -> str:
    """The labels that the page's script keeps below the robots."""
    (first, what_first), (second, what_second) = view.names
    texts = {
        "nominal": ("side", first, what_first),
        "calibrated": ("side", second, what_second),
        "over": ("over", "Overlaid", f"{first.lower()} solid, {second.lower()} translucent"),
    }
    lines = []
    for who, place in places.items():
        mode, name, meaning = texts[who]
        if view.calibrated is None:  # one robot: the heading says what it is
            continue
        at = " ".join(f"{float(value):.6g}" for value in place)
        lines.append(
            f'<div class="over label" data-at="{at}" data-in="{mode}"><strong>{escaped(name)}</strong>'
            f"<span>{escaped(meaning)}</span></div>"
        )
    return "\n".join(lines)


def _controls(view: View, arrows: int) -> str:
    """How the robots stand, and by what factors arrows and differences are magnified."""
    two = view.calibrated is not None
    modes = (
        '<div class="modes"><button type="button" data-mode="side" aria-pressed="true">Side by side</button>'
        '<button type="button" data-mode="over" aria-pressed="false">Overlaid</button></div>'
    )
    rows = []
    if two or view.measures:
        rows.append(
            _factor("arrows", "Error arrows" if view.measures else "Arrows", arrows, FACTORS)
        )
    if two:
        small = [factor for factor in FACTORS if factor <= _MOST_FOR_ROBOTS]
        rows.append(_factor("robots", "Robots' difference", 1, small))
    if not two and not rows:
        return ""
    return f'<div class="panel">{modes if two else ""}{"".join(rows)}</div>'


def _factor(name: str, text: str, chosen: int, factors: Sequence[int]) -> str:
    """A choice of a factor."""
    options = "".join(
        f'<option value="{factor}"{" selected" if factor == chosen else ""}>&times; {factor}</option>'
        for factor in factors
    )
    return f'<label class="factor">{text}<select id="{name}">{options}</select></label>'


def _player(view: View) -> str:
    """Buttons and a slider that go through the poses; nothing for one pose."""
    if len(view.q) < 2:
        return ""
    buttons = {
        name: f'<button type="button" id="{name}" title="{title}"><svg viewBox="0 0 16 16"><path d="{_ICONS[name]}"/>'
        "</svg></button>"
        for name, title in (
            ("back", "The pose before (arrow left)"),
            ("play", "Go through all poses (space)"),
            ("forward", "The next pose (arrow right)"),
        )
    }
    slider = (
        f'<input type="range" id="row" min="0" max="{len(view.q) - 1}" value="{view.start}" '
        'aria-label="Pose"><output id="which"></output>'
    )
    return (
        f'<div class="player">{buttons["back"]}{buttons["play"]}{buttons["forward"]}{slider}</div>'
    )


def _legend(view: View) -> str:
    """What is drawn in which colour; each can be hidden."""
    groups = ("nominal", "calibrated") if view.calibrated is not None else ("nominal",)

    def nodes(name: str) -> str:
        return " ".join(f"{group}/{name}" for group in groups)

    items = [
        key(escaped(view.names[k][0].lower()), f"var(--{who})", f"{who}/robot")
        for k, who in enumerate(groups)
    ]
    measured = np.isfinite(view.measured[:, 0])
    for kind, (colour, text) in _ROWS.items():
        count = int(np.sum((np.array(view.kinds) == kind) & measured))
        if count:
            items.append(key(f"{text} ({count})", colour, nodes(kind), "dot"))
    if view.measures:
        items.append(key("error arrows, predicted to measured", "", nodes("arrows"), "arrow"))
    elif len(groups) > 1:
        words = f"from {view.names[0][0].lower()} to {view.names[1][0].lower()}"
        items.append(key(escaped(words), "", "nominal/arrows", "arrow"))
    if view.measures:
        items.append(key("predicted, in the robot's colour", "", nodes("predicted"), "ring"))
    items.append(key("frames of base, tip, target", "", nodes("frames"), "frame", on=False))
    if np.any(np.isfinite(view.instruments)):
        items.append(key("measurement frame and beams", BEAM, f"{groups[-1]}/instrument", on=False))
    if _has_cloud(view):
        region, everywhere = LITTLE_TO_MUCH[1:3]
        items.append(key("region measured, by uncertainty", region, "calibrated/cloud", on=False))
        items.append(key("whole workspace", everywhere, "calibrated/cloud-everywhere", on=False))
    return "".join(items)


def _has_cloud(view: View) -> bool:
    """Whether the clouds are drawn: they stand in the base, which must stand still."""
    return view.cloud is not None and not view.nominal.base_moves


def _scale(cloud: Cloud) -> str:
    """The colours of the clouds, and what they mean."""
    ends = [f"{float(f'{1e3 * value:.2g}'):g}" for value in colour_scale(cloud)]
    bar = f"linear-gradient(90deg, {', '.join(LITTLE_TO_MUCH)})"
    return f'<span class="scale">standard deviation {ends[0]}<i style="background: {bar}"></i>{ends[1]} mm</span>'


def _inset() -> str:
    """Where the script draws the target's points magnified; the tables' numbers beside it."""
    return (
        '<aside class="over" id="inset"><svg viewBox="0 0 170 92" role="img" aria-label="The target magnified"></svg>'
        "<div><h2>The target, magnified</h2><table></table></div></aside>"
    )
