"""The page of robots: the nominal and the calibrated one side by side or overlaid, at every measured pose.

Its script moves them from pose to pose and draws the measured positions, with arrows at a stated magnification. Every
name is escaped; the page opens from disk and loads nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import meshcat
import numpy as np

import calib.show.scene.scene as stage
from calib.basics.arrays import Array
from calib.basics.channels import RESIDUAL_UNITS
from calib.result.calibration import Calibration
from calib.show.look import BEAM, ESTIMATION, OUTLIER, VALIDATION
from calib.show.scene.html_page import COLOURS, Key, Page, filled_page, floats
from calib.show.scene.puppet import Puppet, Visual, packed, read_visuals, translation
from calib.show.scene.scene import Scene
from calib.verbs.view.draw_sight import draw_sight, images_table
from calib.verbs.view.layout import Layout, layout_of, outline_of
from calib.verbs.view.view import View, view_of

#: Colour and text in the legend of the rows of each kind.
_ROWS = {
    "estimation": (ESTIMATION, "measured, estimation"),
    "validation": (VALIDATION, "measured, validation"),
    "flagged": (OUTLIER, "measured, flagged"),
}

#: Radius of the target's ball, as a part of the scene's size.
_BALL = 0.009

#: Length of the nominal robot's typical arrow at most, as a part of the scene's size.
_ARROW = 0.12

#: Factors that arrows and the robots' difference can be magnified by.
FACTORS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)

#: Colour of the way from pose to pose.
WAY_COLOUR = "#5b6775"

#: A tracker is in the picture if it is no further from the base than this, in sizes of the scene.
_NEAR_TRACKER = 3.0


def _draw_nothing(_group: meshcat.Visualizer, _size: float) -> list[Key]:
    """Draw nothing and return no entry of the legend."""
    return []


@dataclass(frozen=True, slots=True, eq=False)
class About:
    """Points, drawings and the tracker about a robot alone, besides measured targets, in its base."""

    #: Shape (K, 3), points that the camera sees too [m]
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))
    #: Draws it below the node given, gets the scene's size [m], and returns its entries of the legend
    draw: Callable[[meshcat.Visualizer, float], list[Key]] = _draw_nothing
    #: Shape (3,), the tracker [m]; None without one
    tracker: Array | None = None
    #: Shape (N, T, 3), of a plan all targets at each pose, which the tracker sees one after the other [m]
    targets: Array = field(default_factory=lambda: np.zeros((0, 1, 3)))


def write_page(
    calibration: Calibration,
    path: str | Path,
    *,
    overwrite: bool = False,
    accepted: bool = False,
) -> Path:
    """Write the page of a calibration.

    Args:
        calibration: The result.
        path: Name of the file.
        overwrite: Replace an existing file.
        accepted: The corrected URDF is used whatever the verdict says.

    Returns:
        The file's path.

    Raises:
        FileError: The file exists or cannot be written.
    """
    view = view_of(calibration, accepted=accepted)
    return view_page(view).write(path, overwrite=overwrite)


def view_page(view: View, *, live: bool = False, about: About | None = None) -> Page:
    """Make the page of a view.

    Args:
        view: The content.
        live: The page listens to the server that it came from.
        about: Points, drawings and the tracker about the only robot; None for nothing.
    """
    about = about or About()
    visuals, warnings = _read_visuals(view)
    shown = puppets(view, visuals)
    size = stage.span(outline_of(shown))
    factor = magnification(view, size)
    layout = layout_of(
        shown,
        view.start,
        size,
        magnified=_magnified(view, factor),
        around=_seen_around(view, about, size),
        tracker=about.tracker,
        only_moves=view.calibrated is None and set(view.kinds) == {"pose"},
    )
    scene = _draw(view, shown, layout)
    keys = _drawn_about(about, scene, size)
    if view.sight is not None:
        keys.append(draw_sight(scene, shown, view.sight))
    names = [name.lower() for name, _ in view.names[: len(shown)]]
    html = filled_page(
        "robots.html",
        scene.window.scene(),
        title=view.title or f"{view.nominal.name or 'Robot'}: {' and '.join(names)}",
        warnings=warnings,
        grid=scene.square,
        legend=_legend(view),
        names=names,
        beam=BEAM,
        groups=list(shown),
        view=view,
        two=len(shown) > 1,
        factors=FACTORS,
        factor=factor,
        keys=keys,
        labels=_labels(view, layout, about),
        table=script_table(view, shown) | _layout_table(layout, factor) | _about_table(about),
        live=live,
    )
    return Page(html, warnings)


def _drawn_about(about: About, scene: Scene, size: float) -> list[Key]:
    """Draw what stands about the only robot; return its entries of the legend, with their nodes in the scene.

    Args:
        about: What is drawn.
        scene: The scene, whose robot alone is ``"nominal"``.
        size: The scene's size [m].
    """
    drawn = about.draw(scene.root[stage.SCENE]["nominal"], size)
    return [key._replace(nodes=f"nominal/{key.nodes}") for key in drawn]


def _read_visuals(view: View) -> tuple[dict[str, Sequence[Visual]], tuple[str, ...]]:
    """Read the shapes of the robots, by ``"nominal"`` and ``"calibrated"``, and the warnings, each once."""
    visuals: dict[str, Sequence[Visual]] = {}
    warnings: dict[str, None] = {}
    for name, robot in view.robots.items():
        visuals[name], texts = read_visuals(robot.urdf)
        warnings |= dict.fromkeys(texts)
    return visuals, tuple(warnings)


def puppets(view: View, visuals: Mapping[str, Sequence[Visual]]) -> dict[str, Puppet]:
    """Place the robots of a view at their bases.

    Args:
        view: The robots, their poses and targets.
        visuals: The shapes of each robot, by ``"nominal"`` and ``"calibrated"``.

    Returns:
        The robots by the same names.
    """
    base = np.broadcast_to(np.eye(4), (len(view.q), 4, 4))
    nominal = Puppet.of(view.nominal, view.q, visuals["nominal"], base, view.nominal_target)
    if view.calibrated is None:
        return {"nominal": nominal}
    calibrated = Puppet.of(
        view.calibrated, view.q, visuals["calibrated"], base, view.calibrated_target
    )
    return {"nominal": nominal, "calibrated": calibrated}


def _magnified(view: View, factor: int) -> Array:
    """Return the targets of the calibrated robot (N, 3) [m], moved away from the nominal one's by the factor.

    Bases are one above the other; rows that are flagged do not count.
    """
    if view.calibrated is None:
        return np.zeros((0, 3))
    nominal = (view.nominal.poses(view.q) @ view.nominal_target)[:, :3, 3]
    is_shown = np.array(view.kinds) != "flagged"
    moved = nominal + factor * (view.predicted[1] - nominal)
    return np.asarray(moved[is_shown])


def _seen_around(view: View, about: About, size: float) -> Array:
    """Return the points (K, 3) [m] about a robot that are seen too: boards or cameras, and a tracker that is near."""
    points = [about.points]
    if view.sight is not None:
        points.append(view.sight.outline)
    if about.tracker is not None and np.linalg.norm(about.tracker) <= _NEAR_TRACKER * size:
        points.append(about.tracker[None])
    return np.vstack(points)


def _draw(view: View, shown: Mapping[str, Puppet], layout: Layout) -> Scene:
    """Draw the robots side by side at the pose shown first; return the scene."""
    scene = stage.new_scene(layout.side, layout.size, layout.foot[2])
    for name, puppet in shown.items():
        group = scene.root[stage.SCENE][name]
        group.set_transform(translation(layout.offsets[name] - layout.side.centre))
        material = stage.solid(COLOURS[name], front=name == "calibrated")
        stage.draw_puppet(group, puppet, view.start, material, _BALL * layout.size)
    return scene


def _labels(view: View, layout: Layout, about: About) -> list[tuple[Array, str, str, str]]:
    """Return the labels in the scene: place (3,) [m], arrangement ``"side"`` or ``"over"``, name and description.

    A robot alone has none: the heading names it; its tracker has one.
    """
    if view.calibrated is None:
        if about.tracker is None:
            return []
        meaning = ", ".join(f"{1e3 * value:.0f}" for value in about.tracker)
        below = about.tracker - [0.0, 0.0, 2.5 * _BALL * layout.size]
        return [(below - layout.side.centre, "side", "Tracker", f"{meaning} mm")]
    labels = []
    for offset, (name, meaning) in zip(layout.offsets.values(), view.names, strict=True):
        labels.append((offset + layout.foot - layout.side.centre, "side", name, meaning))
    first, second = (name.lower() for name, _ in view.names)
    meaning = f"{first} solid, {second} translucent"
    labels.append((layout.foot - layout.over.centre, "over", "Overlaid", meaning))
    return labels


def _legend(view: View) -> list[tuple[str, str, str]]:
    """Return text, colour and kind of the measured rows of each kind, with their number; none without rows."""
    is_measured = np.isfinite(view.measured[:, 0])
    counts = Counter(np.array(view.kinds)[is_measured].tolist())
    legend = []
    for kind, (colour, text) in _ROWS.items():
        if counts[kind]:
            legend.append((f"{text} ({counts[kind]})", colour, kind))
    return legend


def _layout_table(layout: Layout, factor: int) -> dict[str, Any]:
    """Return places, cameras and sizes for the script, as values that JSON can hold; ``factor`` magnifies arrows."""
    side = layout.side
    over = layout.over
    places = {name: (offset - side.centre).tolist() for name, offset in layout.offsets.items()}
    return {
        "places": places,
        "over": (-over.centre).tolist(),
        "floor": (side.centre - over.centre).tolist(),
        "cameras": {"side": side.position, "over": over.position},
        "size": layout.size,
        "ball": _BALL * layout.size,
        "factor": factor,
    }


def _about_table(about: About) -> dict[str, Any]:
    """Return whether the poses are planned, the tracker and the targets that it sees, as values that JSON can hold."""
    table = {"planned": len(about.targets) > 0, "tracker": None, "targets": ""}
    if about.tracker is not None:
        table |= {"tracker": about.tracker.tolist(), "targets": floats(about.targets)}
    return table


def magnification(view: View, size: float) -> int:
    """Choose the factor of the arrows: the largest with which the nominal robot's typical one stays short.

    Args:
        view: The rows; flagged ones do not count.
        size: The scene's size [m].

    Returns:
        One of `FACTORS`; of the median arrow, 12 % of the scene's size is not exceeded.
    """
    nominal, calibrated = view.predicted
    end = view.measured if view.measures else calibrated
    lengths = np.linalg.norm(end - nominal, axis=1)
    lengths = lengths[np.isfinite(lengths) & (np.array(view.kinds) != "flagged")]
    typical = float(np.median(lengths)) if np.any(lengths) else np.inf
    short = [factor for factor in FACTORS if factor * typical <= _ARROW * size]
    return max(short, default=1)


def script_table(view: View, shown: Mapping[str, Puppet]) -> dict[str, Any]:
    """Return the poses, errors and measured positions for the script.

    Args:
        view: The content of the page.
        shown: The robots by ``"nominal"`` and ``"calibrated"``.

    Returns:
        Values that JSON can hold; arrays as text, see `floats`. ``bases`` is `View.T_base_nominal`, empty where the
        robots share their base.
    """
    colours = {kind: colour for kind, (colour, _) in _ROWS.items()}
    links = shown["nominal"].links
    return {
        "start": view.start,
        "labels": list(view.labels),
        "kinds": list(view.kinds),
        "names": [name for name, _ in view.names],
        "colours": {**COLOURS, **colours, "beam": BEAM, "way": WAY_COLOUR},
        "robots": {name: _robot_table(puppet, links) for name, puppet in shown.items()},
        "measured": floats(view.measured),
        "errors": [_errors_table(unit, errors) for unit, errors in view.errors.items()],
        "instruments": packed(view.instruments).tolist(),
        "bases": floats(packed(view.T_base_nominal)) if view.is_registered_apart else "",
        "numbers": {name: list(texts) for name, texts in view.numbers.items()},
        "images": images_table(view.sight, FACTORS),
    }


def _errors_table(symbol: str, errors: Array) -> dict[str, Any]:
    """Return both robots' errors in one unit for the script.

    Args:
        symbol: Symbol of the unit.
        errors: shape (2, N), in this unit; NaN where a row has none.

    Returns:
        The errors, the factor to the unit that is shown, and that unit as it stands behind a number.
    """
    unit = RESIDUAL_UNITS[symbol]
    mark = "\N{DEGREE SIGN}" if unit.shown == "deg" else f" {unit.shown}"
    return {"factor": unit.to_shown, "mark": mark, "robots": [floats(robot) for robot in errors]}


def _robot_table(puppet: Puppet, links: Sequence[str]) -> dict[str, Any]:
    """Return a robot's movers for the script.

    Args:
        puppet: The robot.
        links: Links of the nominal robot that move.

    Returns:
        Number of movers, their poses, the rods, and for each mover the index of the nominal robot's (``same``), -1
        where it has none. The last three movers are the frames of base, tip and target.
    """
    count = puppet.poses.shape[1]
    index_of = {link: index for index, link in enumerate(links)}
    same = [index_of.get(link, -1) for link in puppet.links]
    frames = range(len(links), len(links) + 3)
    target_rod = [count - 2, count - 1]
    return {
        "movers": count,
        "poses": floats(packed(puppet.poses)),
        "rods": [*map(list, puppet.rods), target_rod],
        "same": [*same, *frames],
    }
