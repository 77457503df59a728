"""The HTML pages about a scene: heading, legend, controls, and the scripts that may run. Every name is escaped.

The page of robots shows the nominal and the calibrated one side by side or overlaid, at every measured pose: its script
moves them from pose to pose and draws what was measured, with arrows at a stated magnification. Pages open from disk
and load nothing.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import meshcat
import numpy as np
from numpy.typing import ArrayLike, NDArray

import calib.report.figure_base as look
import calib.viewer.scene as stage
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.viewer.scene import Page
from calib.viewer.shapes import Puppet, Visual, packed, read_visuals, stage_poses
from calib.viewer.view import View, view_of

Array = NDArray[np.float64]

#: The colours of robots and of what was measured.
COLOURS = {"nominal": look.NOMINAL, "calibrated": look.CALIBRATED, "measured": look.INK}

#: What the rows of each kind are called, in colours of their own.
_ROWS = {
    "estimation": (look.ESTIMATION, "measured, fitted"),
    "validation": (look.VALIDATION, "measured, held back"),
    "flagged": (look.OUTLIER, "measured, flagged"),
}

#: What a page may talk to that came from a server on this computer.
_LIVE = "; connect-src 'self' ws://127.0.0.1:* ws://localhost:*"

#: The files of the script of a page of robots, in order.
_SCRIPTS = ("robots.js", "marks.js", "words.js", "controls.js")

#: Between slider and legend below and the heading above, as a part of the picture, see `look_at`.
_TEXT = (-0.54, 0.67)

#: Radius of the target's ball and length of the nominal robot's typical arrow, as parts of the scene's size.
_BALL, _ARROW = 0.009, 0.12

#: Factors that arrows and the robots' difference can be magnified by.
FACTORS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)


@dataclass(frozen=True, slots=True)
class Key:
    """A line of the legend that shows and hides nodes below `SCENE`, with blanks between them."""

    text: str
    colour: str
    nodes: str
    kind: str = ""
    on: bool = True


def filled_page(
    template: str,
    scene: bytes,
    *,
    table: Mapping[str, Any] | None = None,
    live: bool = False,
    **content: Any,  # noqa: ANN401  what the template names
) -> bytes:
    """The page about a scene's message, UTF-8, by ``"page.html"`` or a template that extends it.

    ``table`` is what the script of a page of robots is told; a ``live`` page listens to the server that it came from.
    """
    import jinja2
    from markupsafe import Markup

    folder, viewer = Path(__file__).parent, Path(meshcat.viewer_assets_path())
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )

    def read(path: Path) -> str:
        """A file whose text cannot end the script that it stands in."""
        return path.read_text("utf-8").replace("</script", "<\\/script").replace("<!--", "<\\!--")

    texts = [read(viewer / "dist/main.min.js"), read(folder / "page.js")]
    if table:
        own = "\n".join(read(folder / name) for name in _SCRIPTS)
        texts.append(f'"use strict";\n(() => {{\n{own}}})();\n')
    # No other script runs, whatever a name may hold.
    digests = [hashlib.sha256(text.encode("utf-8")).digest() for text in texts]
    hashes = " ".join(f"'sha256-{_base64(digest)}'" for digest in digests)
    # A block of JSON that no name in it can end.
    told = json.dumps(table, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    # The notices that must go with a copy of the viewer: meshcat's own and those of what it contains.
    notices = [viewer / "LICENSE", *sorted((viewer / "dist").glob("main.min.js.*LICENSE*"))]
    page = environment.get_template(template).render(
        hashes=Markup(hashes + (_LIVE if live else "")),
        live=live,
        colours=COLOURS,
        licences=Markup("\n\n".join(map(read, notices))),
        scene=_base64(scene),
        table=Markup(told) if table else "",
        scripts=[Markup(text) for text in texts],
        **content,
    )
    return page.encode("utf-8", "replace")


def _base64(data: bytes) -> str:
    """Bytes as text that needs no escaping."""
    return base64.b64encode(data).decode("ascii")


def floats(values: ArrayLike) -> str:
    """Numbers as base64 of little-endian float32."""
    return _base64(np.ascontiguousarray(values, dtype="<f4").tobytes())


def single_page(
    robot: Robot,
    q: Array,
    points: Array,
    draw: Callable[[meshcat.Visualizer, float], list[Key]],
    *,
    title: str,
    text: str,
    legend: str,
) -> Page:
    """A page of one robot at a pose q of shape (m,), and of what is drawn at points of shape (K, 3) in the base.

    ``draw`` draws below the node given, in the base frame, things about as large as the size given [m], and returns
    their lines of the legend.
    """
    visuals, warnings = read_visuals(robot.urdf)
    puppet = Puppet.of(robot, q[None], visuals, np.eye(4)[None], np.eye(4))
    upright = np.eye(4)
    upright[:3, :3] = stage_poses(robot, q[None])[0, :3, :3]
    drawn = puppet.outline() @ upright[:3, :3].T
    everything = np.concatenate([drawn, points @ upright[:3, :3].T])
    size = stage.span(everything)
    back = stage.row_direction(puppet.origins[0] @ upright[:3, :3].T)
    camera, grid = stage.look_at(everything, back), stage.round_length(size / 7.0)
    window, root = stage.new_scene()
    stage.draw_stage(root, camera, size=size, floor=float(drawn[:, 2].min()), grid=grid)
    scene = root[stage.SCENE]
    scene.set_transform(stage.translation(-camera.centre) @ upright)
    stage.draw_puppet(scene["nominal"], puppet, 0, look.NOMINAL, 0.0, front=False)
    keys = [Key(legend, look.NOMINAL, "nominal"), *draw(scene, size)]
    words: dict[str, Any] = {"title": title, "text": text, "warnings": warnings}
    return Page(filled_page("page.html", window.scene(), keys=keys, grid=grid, **words), warnings)


def write_page(calibration: Calibration, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write the page of a calibration, whole or not at all; see `Page.write`."""
    return view_page(view_of(calibration)).write(path, overwrite=overwrite)


def view_page(view: View, *, live: bool = False) -> Page:
    """Draw a view; a ``live`` page listens to the server that it came from."""
    visuals = {who: read_visuals(robot.urdf) for who, robot in view.robots.items()}
    warnings = tuple(dict.fromkeys(text for _, texts in visuals.values() for text in texts))
    shown = puppets(view, {who: found for who, (found, _) in visuals.items()})
    first = slice(view.start, view.start + 1)
    start = np.concatenate([puppet.outline(first) for puppet in shown.values()])
    outline = np.concatenate([start, *(puppet.outline() for puppet in shown.values())])
    size = stage.span(outline)
    back = stage.row_direction(shown["nominal"].origins[view.start])
    right = np.array([-back[1], back[0], 0.0])
    # Side by side nothing of one robot reaches into the other.
    step = 0.5 * max(np.ptp(outline @ right) + 0.06 * size, 0.4 * size) * right
    offsets = dict(zip(shown, (-step, step) if len(shown) > 1 else (0 * step,), strict=True))
    # Labels stand at the foot, below the middle of a robot.
    across = start @ right
    foot = 0.5 * (across.min() + across.max()) * right
    foot[2] = start[:, 2].min()
    foot += (start[start[:, 2] < foot[2] + 0.2 * size] @ back).max() * back
    # A wild measurement must not make the robots small: what was measured far away is not looked at.
    one = np.vstack([outline, foot])
    side = stage.look_at(np.concatenate([one + at for at in offsets.values()]), back, _TEXT)
    over = stage.look_at(one, back, _TEXT)
    window, root, grid = *stage.new_scene(), stage.round_length(size / 7.0)
    stage.draw_stage(root, side, size=size, floor=foot[2], grid=grid)
    for who, puppet in shown.items():
        group = root[stage.SCENE][who]
        group.set_transform(stage.translation(offsets[who] - side.centre))
        front = who == "calibrated"
        stage.draw_puppet(group, puppet, view.start, COLOURS[who], _BALL * size, front=front)
    names = [name.lower() for name, _ in view.names[: len(shown)]]
    labels = [
        (at + foot - side.centre, "side", *view.names[k]) for k, at in enumerate(offsets.values())
    ]
    over_text = f"{names[0]} solid, {names[-1]} translucent"
    labels.append((foot - over.centre, "over", "Overlaid", over_text))
    factor = magnification(view, size)
    table = script_table(view, shown) | {
        "places": {who: (offset - side.centre).tolist() for who, offset in offsets.items()},
        "over": (-over.centre).tolist(),
        "floor": (side.centre - over.centre).tolist(),
        "cameras": {"side": side.position, "over": over.position},
        "size": size,
        "ball": _BALL * size,
        "arrows": factor,
    }
    html = filled_page(
        "robots.html",
        window.scene(),
        title=view.title or f"{view.nominal.name or 'Robot'}: {' and '.join(names)}",
        warnings=warnings,
        grid=grid,
        keys=_keys(view),
        view=view,
        two=len(shown) > 1,
        arrows=factor,
        factors=FACTORS,
        labels=labels if len(shown) > 1 else [],  # of one robot the heading says what it is
        table=table,
        live=live,
    )
    return Page(html, warnings)


def puppets(view: View, visuals: Mapping[str, Sequence[Visual]]) -> dict[str, Puppet]:
    """The robots of a view by ``"nominal"`` and ``"calibrated"``, upright on the stage."""
    T_stage_base = stage_poses(view.nominal, view.q)
    places = (
        (T_stage_base @ view.T_base_nominal, view.nominal_target),
        (T_stage_base, view.calibrated_target),
    )
    return {
        who: Puppet.of(robot, view.q, visuals[who], *place)
        for (who, robot), place in zip(view.robots.items(), places, strict=False)
    }


def magnification(view: View, size: float) -> int:
    """The factor of `FACTORS` that makes the typical arrow of the nominal robot well visible, of rows not flagged."""
    nominal, calibrated = view.predicted
    apart = np.linalg.norm((view.measured if view.measures else calibrated) - nominal, axis=1)
    good = np.isfinite(apart) & (np.array(view.kinds) != "flagged")
    typical = float(np.median(apart[good])) if np.any(good) else 0.0
    wanted = _ARROW * size / typical if typical > 0 else 1.0
    return max((factor for factor in FACTORS if factor <= wanted), default=1)


def _keys(view: View) -> list[Key]:
    """What is drawn in which colour; each can be hidden."""
    groups = tuple(view.robots)
    names = [name.lower() for name, _ in view.names[: len(groups)]]
    kinds = np.array(view.kinds)[np.isfinite(view.measured[:, 0])].tolist()

    def nodes(name: str) -> str:
        return " ".join(f"{group}/{name}" for group in groups)

    keys = [Key(n, f"var(--{w})", f"{w}/robot") for w, n in zip(groups, names, strict=True)]
    keys += [
        Key(f"{text} ({kinds.count(kind)})", colour, nodes(kind), "dot")
        for kind, (colour, text) in _ROWS.items()
        if kind in kinds
    ]
    if view.measures:
        keys.append(Key("error arrows, predicted to measured", "", nodes("arrows"), "arrow"))
        keys.append(Key("predicted, in the robot's colour", "", nodes("predicted"), "ring"))
    elif len(groups) > 1:
        keys.append(Key(f"from {names[0]} to {names[1]}", "", "nominal/arrows", "arrow"))
    keys.append(Key("frames of base, tip, target", "", nodes("frames"), "frame", on=False))
    instrument = Key("measurement frame", look.BEAM, f"{groups[-1]}/instrument", on=False)
    return keys + [instrument] * bool(len(view.instruments))


def script_table(view: View, shown: Mapping[str, Puppet]) -> dict[str, Any]:
    """What the script needs of the poses, as values that JSON can hold; arrays as `floats`."""

    def numbers(rows: Array) -> list[list[float | None]]:
        return [[float(f"{v:.9g}") if np.isfinite(v) else None for v in row] for row in rows]

    on_stage = stage_poses(view.nominal, view.q)
    measured = np.einsum("nij,nj->ni", on_stage[:, :3, :3], view.measured) + on_stage[:, :3, 3]
    return {
        "start": view.start,
        "labels": list(view.labels),
        "kinds": list(view.kinds),
        "names": [name for name, _ in view.names],
        "colours": {**COLOURS, **{kind: c for kind, (c, _) in _ROWS.items()}, "beam": look.BEAM},
        "robots": {who: _robot(puppet, shown["nominal"]) for who, puppet in shown.items()},
        "measured": floats(measured),
        "errors": numbers(view.errors),
        "angles": numbers(view.angles),
        "instruments": packed(on_stage[view.start] @ view.instruments).tolist(),
    }


def _robot(puppet: Puppet, nominal: Puppet) -> dict[str, Any]:
    """One robot: its movers at each pose, its rods, and which mover of the nominal robot is the same."""
    count, others = puppet.poses.shape[1], len(nominal.links)
    same = [nominal.links.index(one) if one in nominal.links else -1 for one in puppet.links]
    same += range(others, others + count - len(puppet.links))
    rods = [*map(list, puppet.rods), [count - 2, count - 1]]
    return {"movers": count, "poses": floats(packed(puppet.poses)), "rods": rods, "same": same}
