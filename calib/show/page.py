"""The HTML page about a scene: heading, legend, controls, and the scripts that may run. Every name is escaped."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import meshcat
import numpy as np
from numpy.typing import ArrayLike, NDArray

from calib.identify.result import Calibration
from calib.model.robot import Robot
from calib.show.rows import (
    BEAM,
    CALIBRATED,
    ESTIMATION,
    LITTLE_TO_MUCH,
    MEASURED,
    NOMINAL,
    OUTLIER,
    VALIDATION,
)
from calib.show.scene import (
    SCENE,
    Camera,
    Page,
    as_base64,
    draw_puppet,
    draw_stage,
    look_at,
    new_scene,
    round_length,
    row_direction,
    translation,
    viewer_licences,
    viewer_script,
)
from calib.show.shapes import Puppet, Visual, packed, read_visuals, same_visuals, span, stage_poses
from calib.show.view import Cloud, View, view_of

Array = NDArray[np.float64]

#: The colours of robots and of what was measured.
COLOURS = {"nominal": NOMINAL, "calibrated": CALIBRATED, "measured": MEASURED}

#: What a page may talk to that came from a server on this computer.
_LIVE = "; connect-src 'self' ws://127.0.0.1:* ws://localhost:*"


@dataclass(frozen=True, slots=True)
class Key:
    """A line of the legend that shows and hides a part of the scene.

    Attributes:
        text: What it is.
        colour: As CSS has it.
        nodes: Which nodes below `SCENE`, blanks between them.
        kind: ``"dot"`` for a round mark, and others of the style sheet.
        on: Whether it is shown at first.
    """

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
    scripts: Sequence[str] = (),
    live: bool = False,
    **content: Any,  # noqa: ANN401  what the template names
) -> bytes:
    """The page about a scene, UTF-8.

    Args:
        template: ``"page.html"``, or one that extends it.
        scene: The scene's message.
        table: What the page's own script is told; None for a page without one.
        scripts: Names of that script's files.
        live: Whether the page listens to the server that it came from.
        content: What the template is filled with: ``title``, ``text``, ``keys``, ``grid`` and ``warnings`` at least.
    """
    import jinja2
    from markupsafe import Markup

    folder = Path(__file__).parent
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    texts = [viewer_script(), (folder / "page.js").read_text(encoding="utf-8")]
    if scripts:
        own = "\n".join((folder / name).read_text(encoding="utf-8") for name in scripts)
        texts.append(f'"use strict";\n(() => {{\n{own}}})();\n')
    texts = [_no_end_tag(text) for text in texts]
    hashes = " ".join(f"'sha256-{_hash(text)}'" for text in texts) + (_LIVE if live else "")
    # A block of JSON that no name in it can end.
    told = json.dumps(table, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    page = environment.get_template(template).render(
        hashes=Markup(hashes),
        live=live,
        colours=COLOURS,
        licences=Markup(_no_end_tag(viewer_licences())),
        scene=as_base64(scene),
        table=Markup(told) if table else "",
        scripts=[Markup(text) for text in texts],
        **content,
    )
    return page.encode("utf-8", "replace")


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
    """A page of one robot at one pose, and what else is drawn about it.

    Args:
        robot: The robot.
        q: shape (m,), [rad] or [m], how it stands.
        points: shape (K, 3), in the base, of what else is to be seen [m].
        draw: Draws below the node given, in the base frame, things about as large as the size given [m], and returns
            their lines of the legend.
        title: The heading.
        text: Sentences below it.
        legend: What the legend says of the robot.

    Raises:
        UrdfError: Pinocchio cannot build a model of the URDF.
    """
    visuals, warnings = read_visuals(robot.urdf)
    puppet = Puppet.of(robot, q[None], visuals, np.eye(4)[None], np.eye(4))
    upright = np.eye(4)
    upright[:3, :3] = stage_poses(robot, q[None])[0, :3, :3]
    drawn = puppet.outline(0) @ upright[:3, :3].T
    everything = np.concatenate([drawn, points @ upright[:3, :3].T])
    size, grid = span(everything), round_length(span(everything) / 7.0)
    camera = look_at(everything, row_direction(puppet.origins[0] @ upright[:3, :3].T))
    window, root = new_scene()
    floor = float(drawn[:, 2].min())
    draw_stage(root, camera, size=size, floor=floor, grid=grid, through=np.zeros(3))
    root[SCENE].set_transform(translation(-camera.centre) @ upright)
    draw_puppet(root[SCENE]["nominal"], puppet, 0, NOMINAL, 0.0, front=False)
    keys = [Key(legend, NOMINAL, "nominal"), *draw(root[SCENE], size)]
    html = filled_page(
        "page.html", window.scene(), title=title, text=text, keys=keys, grid=grid, warnings=warnings
    )
    return Page(html, tuple(warnings))


def _no_end_tag(text: str) -> str:
    """A script whose strings cannot end it."""
    return text.replace("\r\n", "\n").replace("</script", "<\\/script").replace("<!--", "<\\!--")


def _hash(script: str) -> str:
    """A script's name in the page's policy: no other script runs, whatever a name may hold."""
    return as_base64(hashlib.sha256(script.encode("utf-8")).digest())


#: The files of the page's own script, in order.
SCRIPTS = ("robots.js", "marks.js", "words.js", "controls.js")

#: Between slider and legend below and the heading above, as a part of the picture, see `look_at`.
_TEXT = (-0.54, 0.67)

#: Radius of the target's ball, as a part of the scene's size.
_BALL = 0.009

#: The typical arrow of the nominal robot is about this long, as a part of the scene's size.
_ARROW = 0.12

#: Factors that arrows can be magnified by, and the largest for the robots: beyond it links fly apart.
FACTORS, _MOST_FOR_ROBOTS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000), 100

#: At most this many poses are shown, and fewer where robots have many links: so many numbers of movers in all.
MOST_POSES, _MOST_MOVERS = 400, 16_000

#: Between which quantiles of the standard deviation the cloud's colours change.
_ENDS = (0.02, 0.98)

#: What the rows of each kind are called, in colours of their own.
_ROWS = {
    "estimation": (ESTIMATION, "measured, fitted"),
    "validation": (VALIDATION, "measured, held back"),
    "flagged": (OUTLIER, "measured, flagged"),
}


def write_view(view: View, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write a view as one HTML file that opens from disk without a network.

    Raises:
        FileError: The file exists and ``overwrite`` is False, or it cannot be written.
    """
    return view_page(view).write(path, overwrite=overwrite)


def write_page(calibration: Calibration, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write a self-contained page that shows both robots.

    Raises:
        FileError: The file exists, or cannot be written.
    """
    return write_view(view_of(calibration), path, overwrite=overwrite)


def view_page(view: View, *, live: bool = False) -> Page:
    """Draw a view.

    Args:
        view: The view; of many poses some hundred are shown, see `thinned`.
        live: Whether the page listens to the server that it came from.

    Raises:
        UrdfError: Pinocchio cannot build a model of a URDF.
    """
    view = thinned(view)
    visuals, warnings = read_both(view)
    shown = puppets(view, visuals)
    layout = Layout.of(view, shown)
    window, root = new_scene()
    draw_stage(
        root,
        layout.side,
        size=layout.size,
        floor=layout.foot[2],
        grid=layout.grid,
        through=layout.offsets["nominal"],
    )
    ball = _BALL * layout.size
    for who, puppet in shown.items():
        group = root[SCENE][who]
        group.set_transform(translation(layout.offsets[who] - layout.side.centre))
        draw_puppet(group, puppet, view.start, COLOURS[who], ball, front=who == "calibrated")
    cloud = None if view.nominal.base_moves else view.cloud
    factor = magnification(view, layout.size)
    both = " and ".join(name for name, _ in view.names[: len(shown)]).lower()
    html = filled_page(
        "robots.html",
        window.scene(),
        title=view.title or f"{view.nominal.name or 'Robot'}: {both}",
        warnings=warnings,
        grid=layout.grid,
        keys=_keys(view, cloud),
        view=view,
        two=len(shown) > 1,
        measures=view.measures,
        count=len(view.q),
        arrows=factor,
        factors=FACTORS,
        robot_factors=[one for one in FACTORS if one <= _MOST_FOR_ROBOTS],
        labels=_labels(view, layout),
        scale=[] if cloud is None else [f"{float(f'{1e3 * v:.2g}'):g}" for v in _scale(cloud)],
        little_to_much=LITTLE_TO_MUCH,
        table=_table(view, shown, layout, cloud, factor),
        scripts=SCRIPTS,
        live=live,
    )
    return Page(html, warnings)


def read_both(view: View) -> tuple[dict[str, tuple[Visual, ...]], tuple[str, ...]]:
    """What each robot looks like, and what could not be drawn as its URDF says."""
    visuals: dict[str, tuple[Visual, ...]] = {}
    warnings: list[str] = []
    for who, robot in view.robots.items():
        if who == "calibrated" and same_visuals(view.nominal.urdf, robot.urdf):
            visuals[who] = visuals["nominal"]
            continue
        visuals[who], more = read_visuals(robot.urdf)
        warnings += more
    return visuals, tuple(dict.fromkeys(warnings))


def puppets(view: View, visuals: Mapping[str, Sequence[Visual]]) -> dict[str, Puppet]:
    """The robots of a view by ``"nominal"`` and ``"calibrated"``, upright on the stage."""
    T_stage_base = stage_poses(view.nominal, view.q)
    shown = {
        "nominal": (T_stage_base @ view.T_base_nominal, view.nominal_target),
        "calibrated": (T_stage_base, view.calibrated_target),
    }
    return {
        who: Puppet.of(robot, view.q, visuals[who], *shown[who])
        for who, robot in view.robots.items()
    }


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Where everything goes on the stage [m].

    Attributes:
        offsets: Where each robot stands when they stand side by side, shape (3,).
        foot: shape (3,), below the middle of a robot, towards the camera: where its label stands.
        size: Diagonal of one robot and the points that it reaches.
        grid: Edge of a square of the floor.
        side: The camera when they stand side by side; its centre is the scene's origin.
        over: The camera when one is laid over the other.
    """

    offsets: Mapping[str, Array]
    foot: Array
    size: float
    grid: float
    side: Camera
    over: Camera

    @classmethod
    def of(cls, view: View, shown: Mapping[str, Puppet]) -> Layout:
        """Place the robots side by side so that nothing of one reaches into the other."""
        start = np.concatenate([puppet.outline(view.start) for puppet in shown.values()])
        outline = np.concatenate([start, *(puppet.reach() for puppet in shown.values())])
        size = span(outline)
        back = row_direction(shown["nominal"].origins[view.start])
        right = np.array([-back[1], back[0], 0.0])
        step = 0.5 * max(np.ptp(outline @ right) + 0.06 * size, 0.4 * size) * right
        offsets = (
            {"nominal": -step, "calibrated": step} if len(shown) > 1 else {"nominal": 0 * step}
        )
        across = start @ right
        foot = 0.5 * (across.min() + across.max()) * right
        foot[2] = start[:, 2].min()
        foot += (start[start[:, 2] < foot[2] + 0.2 * size] @ back).max() * back
        # A wild measurement must not make the robots small: what was measured far away is not looked at.
        one = np.vstack([outline, foot])
        return cls(
            offsets=offsets,
            foot=foot,
            size=size,
            grid=round_length(size / 7.0),
            side=look_at(np.concatenate([one + at for at in offsets.values()]), back, _TEXT),
            over=look_at(one, back, _TEXT),
        )


def thinned(view: View) -> View:
    """The view, or a choice of its poses where they are many.

    Kept are the one shown first, flagged rows, and rows spread evenly over the table, as many for validation as their
    part of the table is, ten at least.
    """
    count = len(view.q)
    most = max(1, min(MOST_POSES, _MOST_MOVERS // (len(view.nominal.urdf.links) + 3)))
    if count <= most:
        return view
    kinds = np.array(view.kinds)
    flagged = _spread(np.flatnonzero(kinds == "flagged"), most // 4)
    held = np.flatnonzero(kinds == "validation")
    share = max(min(10, most // 4), most * len(held) // count)
    validation = _spread(held, min(share, 3 * most // 4 - len(flagged)))
    kept = np.union1d(np.union1d(flagged, validation), [view.start])
    rest = np.setdiff1d(np.flatnonzero(~np.isin(kinds, ("flagged", "validation"))), kept)
    chosen = np.union1d(kept, _spread(rest, max(most - len(kept), 0)))
    return view.select(chosen, int(np.searchsorted(chosen, view.start)))


def magnification(view: View, size: float) -> int:
    """The factor of `FACTORS` that makes the typical arrow of the nominal robot well visible, of rows not flagged."""
    nominal, calibrated = view.predicted
    apart = np.linalg.norm(calibrated - nominal, axis=1)
    lengths = view.distances[0] if view.measures else apart
    there = np.isfinite(lengths)
    good = there & (np.array(view.kinds) != "flagged")
    lengths = lengths[good if np.any(good) else there]
    typical = float(np.median(lengths)) if len(lengths) else 0.0
    wanted = _ARROW * size / typical if typical > 0 else 1.0
    return max((factor for factor in FACTORS if factor <= wanted), default=1)


def _labels(view: View, layout: Layout) -> list[tuple[str, str, str, str]]:
    """The labels below the robots: where, in which mode, the name and what it means; none for one robot."""
    if view.calibrated is None:  # the heading says what it is
        return []
    (first, what_first), (second, what_second) = view.names
    overlaid = f"{first.lower()} solid, {second.lower()} translucent"
    places = {who: at + layout.foot - layout.side.centre for who, at in layout.offsets.items()}
    found = [
        (places["nominal"], "side", first, what_first),
        (places["calibrated"], "side", second, what_second),
        (layout.foot - layout.over.centre, "over", "Overlaid", overlaid),
    ]
    return [
        (" ".join(f"{v:.6g}" for v in at.tolist()), mode, name, what)
        for at, mode, name, what in found
    ]


def _keys(view: View, cloud: Cloud | None) -> list[Key]:
    """What is drawn in which colour; each can be hidden."""
    groups = tuple(view.robots)

    def nodes(name: str) -> str:
        return " ".join(f"{group}/{name}" for group in groups)

    names = [name.lower() for name, _ in view.names[: len(groups)]]
    keys = [
        Key(name, f"var(--{who})", f"{who}/robot") for who, name in zip(groups, names, strict=True)
    ]
    measured = np.isfinite(view.measured[:, 0])
    for kind, (colour, text) in _ROWS.items():
        count = int(np.sum((np.array(view.kinds) == kind) & measured))
        keys += [Key(f"{text} ({count})", colour, nodes(kind), "dot")] * bool(count)
    if view.measures:
        keys.append(Key("error arrows, predicted to measured", "", nodes("arrows"), "arrow"))
        keys.append(Key("predicted, in the robot's colour", "", nodes("predicted"), "ring"))
    elif len(groups) > 1:
        keys.append(Key(f"from {names[0]} to {names[1]}", "", "nominal/arrows", "arrow"))
    keys.append(Key("frames of base, tip, target", "", nodes("frames"), "frame", on=False))
    if np.any(np.isfinite(view.instruments)):
        nodes_of = f"{groups[-1]}/instrument"
        keys.append(Key("measurement frame and beams", BEAM, nodes_of, on=False))
    if cloud is not None:
        region, everywhere = LITTLE_TO_MUCH[1:3]
        keys.append(Key("region measured, by uncertainty", region, "calibrated/cloud", on=False))
        keys.append(Key("whole workspace", everywhere, "calibrated/cloud-everywhere", on=False))
    return keys


def _table(
    view: View, shown: Mapping[str, Puppet], layout: Layout, cloud: Cloud | None, factor: int
) -> dict[str, Any]:
    """Everything that the script needs, as values that JSON can hold; arrays as base64 of little-endian float32."""
    on_stage = stage_poses(view.nominal, view.q)
    measured = np.einsum("nij,nj->ni", on_stage[:, :3, :3], view.measured) + on_stage[:, :3, 3]
    instruments, seen_from = _instruments(on_stage, view.instruments)
    side = layout.side.centre
    return {
        "start": view.start,
        "labels": list(view.labels),
        "kinds": list(view.kinds),
        "names": [name for name, _ in view.names],
        "colours": {**COLOURS, **{kind: c for kind, (c, _) in _ROWS.items()}, "beam": BEAM},
        "robots": {who: _robot(shown[who], shown["nominal"]) for who in shown},
        "measured": floats(measured),
        "errors": [_numbers(values) for values in view.errors],
        "angles": [_numbers(values) for values in view.angles],
        "instruments": instruments,
        "seenFrom": seen_from,
        "places": {who: (offset - side).tolist() for who, offset in layout.offsets.items()},
        "over": (-layout.over.centre).tolist(),
        "floor": (side - layout.over.centre).tolist(),
        "cameras": {"side": layout.side.position, "over": layout.over.position},
        "size": layout.size,
        "ball": _BALL * layout.size,
        "arrows": factor,
        "cloud": None if cloud is None else _cloud(cloud),
    }


def _robot(puppet: Puppet, nominal: Puppet) -> dict[str, Any]:
    """One robot: its movers at each pose, its rods, and which mover of the nominal robot is the same."""
    count, movers = puppet.poses.shape[1], len(puppet.links)
    number = {link: k for k, link in enumerate(nominal.links)}
    same = [number.get(link, -1) for link in puppet.links]
    same += [len(nominal.links) + k for k in range(count - movers)]
    rods = [*(list(rod) for rod in puppet.rods), [count - 2, count - 1]]
    return {"movers": count, "poses": floats(packed(puppet.poses)), "rods": rods, "same": same}


def _instruments(on_stage: Array, instruments: Array) -> tuple[list[list[float]], list[int]]:
    """The different instruments as positions and quaternions, and which of them saw each row; -1 where unknown."""
    known = np.all(np.isfinite(instruments), axis=(1, 2))
    seen_from = np.full(len(instruments), -1)
    if not np.any(known):
        return [], seen_from.tolist()
    poses = packed(on_stage[known] @ instruments[known])
    different, which = np.unique(poses.round(5), axis=0, return_inverse=True)
    seen_from[known] = np.ravel(which)
    return different.astype(float).tolist(), seen_from.tolist()


def _scale(cloud: Cloud) -> tuple[float, float]:
    """The standard deviations of the first and of the last colour of a cloud [m]."""
    low, high = np.quantile(cloud.std, _ENDS)
    return float(low), float(max(high, low * 1.0001, 1e-12))


def _cloud(cloud: Cloud) -> dict[str, str]:
    """The cloud's points with their colours."""
    low, high = (max(value, 1e-15) for value in _scale(cloud))
    share = np.log(np.maximum(cloud.std, 1e-15) / low) / np.log(high / low)
    stops = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in LITTLE_TO_MUCH]) / 255.0
    along = np.linspace(0.0, 1.0, len(stops))
    rgb = np.stack([np.interp(share, along, stops[:, k]) for k in range(3)], axis=1)
    values = {"points": cloud.points, "colours": rgb, "measured": cloud.measured}
    return {name: floats(value) for name, value in values.items()}


def floats(values: ArrayLike) -> str:
    """Numbers as base64 of little-endian float32."""
    return as_base64(np.ascontiguousarray(values, dtype="<f4").tobytes())


def _numbers(values: Array) -> list[float | None]:
    """Numbers as JSON has them, nothing for NaN."""
    return [float(f"{value:.9g}") if np.isfinite(value) else None for value in values]


def _spread(numbers: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """At most so many of some numbers, evenly spread."""
    if len(numbers) <= most:
        return numbers
    at = np.linspace(0, len(numbers) - 1, most).round().astype(int)
    return numbers[at] if most else numbers[:0]
