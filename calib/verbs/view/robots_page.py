"""The page of robots: the nominal and the calibrated one side by side or overlaid, at every measured pose.

Its script moves them from pose to pose and draws the measured positions, with arrows at a stated magnification. Every
name is escaped; the page opens from disk and loads nothing.
"""

from __future__ import annotations

import os
import sys
import tempfile
import webbrowser
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import meshcat
import numpy as np

from calib.basics.arguments import check_flags, check_path, check_type
from calib.basics.arrays import Array
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.files import check_writable
from calib.data.cell import Cell
from calib.data.inputs import ROBOT, RobotInput, robot_of
from calib.result.calibration import Calibration
from calib.result.calibration_file import RESULT, is_result_file, result_of
from calib.robot.robot import Robot
from calib.show.lines import mm
from calib.show.look import BEAM, ESTIMATION, OUTLIER, SURE_TO_UNSURE, VALIDATION
from calib.show.scene.html_page import COLOURS, LegendEntry, Page, fill_page, floats
from calib.show.scene.posed_robot import (
    PosedRobot,
    Visual,
    chain_bases,
    packed,
    read_visuals,
    translation,
)
from calib.show.scene.scene import (
    SCENE,
    blended,
    draw_coloured,
    draw_robot,
    new_scene,
    solid,
    span,
)
from calib.show.uncertainty_map import UncertaintyMap
from calib.verbs.view.arrangement import Arrangement, arrange, outline_of
from calib.verbs.view.camera_images import draw_cameras, images_table
from calib.verbs.view.view import View, view_of, view_of_result, view_of_robots

#: Colour and text in the legend of the rows of each kind.
_ROWS = {
    "estimation": (ESTIMATION, "measured, estimation"),
    "validation": (VALIDATION, "measured, validation"),
    "flagged": (OUTLIER, "measured, flagged"),
}

#: Radius of the target's ball, as a fraction of the scene's size.
_BALL = 0.009

#: Largest length of the nominal robot's typical arrow, as a fraction of the scene's size.
_ARROW = 0.12

#: Factors that arrows and the robots' difference can be magnified by.
FACTORS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)

#: Edge of a dot of the map of uncertainty, as a fraction of the scene's size.
_MAP_DOT = 0.008

#: Colour of the path from pose to pose.
WAY_COLOUR = "#5b6775"

#: A tracker is in the picture if it is no further from the base than this, in sizes of the scene.
_NEAR_TRACKER = 3.0

#: Variables that are set on a Linux computer with a graphical browser.
_BROWSER_VARIABLES = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")


@dataclass(frozen=True, slots=True, eq=False)
class About:
    """Points, drawings and the tracker around a robot alone, besides measured targets, in its base."""

    #: Shape (K, 3), points that the camera sees too [m]
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))
    #: Draws below the node given, gets the scene's size [m], and returns its entries of the legend; None: nothing
    draw: Callable[[meshcat.Visualizer, float], list[LegendEntry]] | None = None
    #: Shape (3,), the tracker [m]; None without one
    tracker: Array | None = None
    #: Shape (N, T, 3), of a plan all targets at each pose, which the tracker sees one after the other [m]
    targets: Array = field(default_factory=lambda: np.zeros((0, 1, 3)))


# Pages of results and robots as files


def view(
    shown: Calibration | RobotInput,
    other: RobotInput | None = None,
    *,
    path: str | Path | None = None,
    overwrite: bool = False,
) -> Path:
    """Show a calibration, a robot or two robots in the browser, or write the page as a file.

    Args:
        shown: A calibration, or the path of its file; or a robot, the path of its URDF or xacro, or its name such as
            ``"ur3"``. A result that was read from a file is shown without measurements.
        other: A second robot with the same joints, in one of these forms.
        path: Name of the file that the page is written to, completely or not at all; the browser does not open. None: a
            file in a new temporary folder, which the browser opens, if there is one.
        overwrite: Replace an existing file.

    Returns:
        The file's path.

    Raises:
        ArgumentError: An argument of another type.
        FileError: The file exists or cannot be written.
        ModelError: The robots have different joints.
    """
    check_flags(overwrite=overwrite)
    if path is not None:
        check_path("path", path)
        check_writable(path, overwrite=overwrite)
    allowed = f"{RESULT}; or {ROBOT}"
    check_type("shown", shown, (Calibration, Robot, str, Path), allowed)
    if isinstance(shown, Calibration) or is_result_file(shown):
        result = result_of(shown, "shown")
        is_from_file = result.fit_in_memory is None
        content = view_of_result(result, result.nominal) if is_from_file else view_of(result)
    else:
        first = robot_of(shown, argument="shown")
        second = None
        if other is not None:
            coupling = first.reading_coupling
            chain = Cell(base=first.base, tip=first.tip, coupling=coupling)
            second = robot_of(other, chain, argument="other")
        names = (("First", first.urdf.source), ("Second", (second or first).urdf.source))
        content = view_of_robots(first, second, names=names)
    return write_or_open(view_page(content), path, overwrite=overwrite)


def write_or_open(page: Page, path: str | Path | None, *, overwrite: bool = False) -> Path:
    """Write a page to a file, or to a temporary file that the browser opens.

    Args:
        page: The page.
        path: Name of the file; None: one in a new temporary folder, opened if there is a graphical browser.
        overwrite: Replace an existing file.

    Returns:
        The file's path.

    Raises:
        FileError: The file exists or cannot be written.
    """
    if path is not None:
        return page.write(path, overwrite=overwrite)
    folder = Path(tempfile.mkdtemp(prefix="calib-"))
    written = page.write(folder / "view.html")
    has_windows = sys.platform in ("win32", "darwin")
    # A browser without windows would take over the terminal.
    if has_windows or any(os.environ.get(name) for name in _BROWSER_VARIABLES):
        webbrowser.open(written.as_uri())
    return written


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
    content = view_of(calibration, accepted=accepted)
    return view_page(content).write(path, overwrite=overwrite)


# The page of a view


def view_page(view: View, *, about: About | None = None) -> Page:
    """Make the page of a view.

    Args:
        view: The content.
        about: Points, drawings and the tracker around the only robot; None for nothing.

    Returns:
        The page, with a warning for each shape of a URDF that is not drawn as it is there.
    """
    about = about or About()
    visuals: dict[str, Sequence[Visual]] = {}
    warnings: dict[str, None] = {}  # in order, each once
    for name, robot in view.robots.items():
        visuals[name], texts = read_visuals(robot.urdf)
        warnings |= dict.fromkeys(texts)
    shown = pose_robots(view, visuals)
    size = span(outline_of(shown))
    factor = magnification(view, size)
    images = None if view.measured is None else view.measured.images

    around = [about.points]
    if images is not None:
        around.append(images.outline)
    if about.tracker is not None and np.linalg.norm(about.tracker) <= _NEAR_TRACKER * size:
        around.append(about.tracker[None])
    places = arrange(
        shown,
        view.start,
        size,
        magnified=_magnified_targets(view, factor),
        around=np.vstack(around),
        tracker=about.tracker,
        only_moves=view.calibrated is None and set(view.kinds) == {"pose"},
    )

    scene = new_scene(places.side, size, places.foot[2])
    for name, posed in shown.items():
        group = scene.root[SCENE][name]
        group.set_transform(translation(places.offsets[name] - places.side.centre))
        material = solid(COLOURS[name], front=name == "calibrated")
        draw_robot(group, posed, view.start, material, _BALL * size)
    keys: list[LegendEntry] = []
    if about.draw is not None:
        drawn = about.draw(scene.root[SCENE]["nominal"], size)
        keys += [key._replace(nodes=f"nominal/{key.nodes}") for key in drawn]
    if images is not None:
        keys.append(draw_cameras(scene, shown, images))
    if view.uncertainty is not None:
        keys.append(_draw_map(scene.root[SCENE], list(shown)[-1], view.uncertainty, size))

    names = [name.lower() for name, _ in view.names[: len(shown)]]
    html = fill_page(
        "robots.html",
        scene.window.scene(),
        title=view.title or f"{view.nominal.name or 'Robot'}: {' and '.join(names)}",
        warnings=tuple(warnings),
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
        labels=_labels(view, places, about),
        table=script_table(view, shown) | _places_table(places, factor, about),
    )
    return Page(html, tuple(warnings))


def _draw_map(
    robots: meshcat.Visualizer, who: str, shown: UncertaintyMap, size: float
) -> LegendEntry:
    """Draw the uncertainty over the joint limits around a robot in a scene of a size [m]; return its legend entry.

    It is hidden at first.
    """
    colours = blended(SURE_TO_UNSURE, shown.shares)
    draw_coloured(robots[who]["uncertainty"], shown.places, colours, _MAP_DOT * size)
    low, high = (mm(value) for value in shown.scale)
    text = f"U of the target (95.45 %), {low} to {high} mm: {len(shown.places)} poses in the joint limits"
    gradient = f"linear-gradient(90deg, {', '.join(SURE_TO_UNSURE)})"
    return LegendEntry(text, gradient, f"{who}/uncertainty", "scale", on=False)


def pose_robots(view: View, visuals: Mapping[str, Sequence[Visual]]) -> dict[str, PosedRobot]:
    """Place the robots of a view at their bases.

    Args:
        view: The robots, their poses and targets.
        visuals: The shapes of each robot, by ``"nominal"`` and ``"calibrated"``.

    Returns:
        The robots by the same names.
    """
    targets = {"nominal": view.nominal_target, "calibrated": view.calibrated_target}
    return {
        name: PosedRobot.of(
            robot,
            view.q,
            visuals[name],
            chain_bases(robot, view.q, view.chain),
            targets[name],
            view.chain,
            view.marks.get(name, ()),
        )
        for name, robot in view.robots.items()
    }


def magnification(view: View, size: float) -> int:
    """Choose the factor of the arrows: the largest with which the nominal robot's typical one stays short.

    Args:
        view: The rows; flagged ones do not count.
        size: The scene's size [m].

    Returns:
        One of `FACTORS`: with it the median arrow is at most a fixed fraction of the scene's size.
    """
    nominal, calibrated = view.predicted
    end = view.points if view.has_points else calibrated
    lengths = np.linalg.norm(end - nominal, axis=1)
    lengths = lengths[np.isfinite(lengths) & (np.array(view.kinds) != "flagged")]
    typical = float(np.median(lengths)) if np.any(lengths) else np.inf
    short = [factor for factor in FACTORS if factor * typical <= _ARROW * size]
    return max(short, default=1)


def _magnified_targets(view: View, factor: int) -> Array:
    """Return the calibrated robot's targets at unflagged poses, (M, 3) [m], their displacement magnified by a factor.

    Both robots stand at one base; M is 0 for one robot alone.
    """
    if view.calibrated is None:
        return np.zeros((0, 3))
    # The bases are one above the other.
    nominal = chain_bases(view.nominal, view.q, view.chain)
    nominal = (nominal @ view.nominal.poses(view.q, view.chain) @ view.nominal_target)[:, :3, 3]
    is_shown = np.array(view.kinds) != "flagged"
    moved = nominal + factor * (view.predicted[1] - nominal)
    return np.asarray(moved[is_shown])


def _labels(view: View, places: Arrangement, about: About) -> list[tuple[Array, str, str, str]]:
    """Return the labels in the scene: place (3,) [m], arrangement ``"side"`` or ``"over"``, name and description.

    Places count from the centre of the arrangement's camera. A robot alone has no label, because the heading names it;
    its tracker has one.
    """
    if view.calibrated is None:
        if about.tracker is None:
            return []
        meaning = ", ".join(f"{1e3 * value:.0f}" for value in about.tracker)
        below = about.tracker - [0.0, 0.0, 2.5 * _BALL * places.size]
        return [(below - places.side.centre, "side", "Tracker", f"{meaning} mm")]
    labels = []
    for offset, (name, meaning) in zip(places.offsets.values(), view.names, strict=True):
        labels.append((offset + places.foot - places.side.centre, "side", name, meaning))
    first, second = (name.lower() for name, _ in view.names)
    meaning = f"{first} solid, {second} translucent"
    labels.append((places.foot - places.over.centre, "over", "Overlaid", meaning))
    return labels


def _legend(view: View) -> list[tuple[str, str, str]]:
    """Return text, colour and kind of the measured rows of each kind, with their number; none without rows."""
    is_measured = np.isfinite(view.points[:, 0])
    counts = Counter(np.array(view.kinds)[is_measured].tolist())
    legend = []
    for kind, (colour, text) in _ROWS.items():
        if counts[kind]:
            legend.append((f"{text} ({counts[kind]})", colour, kind))
    return legend


# Values for the script: all of them JSON can hold; arrays are text, see `floats`


def script_table(view: View, shown: Mapping[str, PosedRobot]) -> dict[str, Any]:
    """Return the poses, errors and measured positions for the script.

    Args:
        view: The content of the page.
        shown: The robots by ``"nominal"`` and ``"calibrated"``.

    Returns:
        Values that JSON can hold. ``robots`` has of each robot the number of movers, their poses, the rods as pairs of
        movers, and for each mover the index of the nominal robot's (``same``), or -1. The last three movers are the
        frames of base, tip and target. ``bases`` is `View.T_base_nominal`, empty if the robots share their base.
    """
    links = shown["nominal"].links
    index_of = {link: index for index, link in enumerate(links)}
    frames = range(len(links), len(links) + 3)
    robots = {}
    for name, posed in shown.items():
        count = posed.poses.shape[1]
        target_rod = [count - 2, count - 1]
        robots[name] = {
            "movers": count,
            "poses": floats(packed(posed.poses)),
            "rods": [*map(list, posed.rods), target_rod],
            "same": [*(index_of.get(link, -1) for link in posed.links), *frames],
        }

    measured = view.measured
    errors = []
    for symbol, of_robots in ({} if measured is None else measured.errors).items():
        unit = RESIDUAL_UNITS[symbol]
        mark = "\N{DEGREE SIGN}" if unit.shown == "deg" else f" {unit.shown}"
        values = [floats(of_robot) for of_robot in of_robots]
        errors.append({"factor": unit.to_shown, "mark": mark, "robots": values})

    colours = {kind: colour for kind, (colour, _) in _ROWS.items()}
    return {
        "start": view.start,
        "labels": list(view.labels),
        "kinds": list(view.kinds),
        "names": [name for name, _ in view.names],
        "colours": {**COLOURS, **colours, "beam": BEAM, "way": WAY_COLOUR},
        "robots": robots,
        "measured": floats(view.points),
        "errors": errors,
        "instruments": [] if measured is None else packed(measured.stations).tolist(),
        "bases": floats(packed(view.T_base_nominal)) if view.is_registered_apart else "",
        "numbers": {name: list(texts) for name, texts in view.numbers.items()},
        "images": images_table(None if measured is None else measured.images, FACTORS),
    }


def _places_table(places: Arrangement, factor: int, about: About) -> dict[str, Any]:
    """Return places, cameras, sizes, the arrows' factor, and a plan's tracker and targets for the script."""
    side = places.side
    over = places.over
    offsets = {name: (offset - side.centre).tolist() for name, offset in places.offsets.items()}
    table = {
        "places": offsets,
        "over": (-over.centre).tolist(),
        "floor": (side.centre - over.centre).tolist(),
        "cameras": {"side": side.position, "over": over.position},
        "size": places.size,
        "ball": _BALL * places.size,
        "factor": factor,
        "planned": len(about.targets) > 0,
        "tracker": None,
        "targets": "",
    }
    if about.tracker is not None:
        table |= {"tracker": about.tracker.tolist(), "targets": floats(about.targets)}
    return table
