"""The page of robots: the nominal and the calibrated one side by side or overlaid, at every measured pose.

Its script moves them from pose to pose and draws the measured positions, with arrows at a stated magnification. Every
name is escaped; the page opens from disk and loads nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import calib.report.figure_base as look
import calib.viewer.scene as stage
from calib.channels import RESIDUAL_UNITS
from calib.result.calibration import CalibrationValues
from calib.units import Array
from calib.viewer.html_page import COLOURS, Page, filled_page, floats
from calib.viewer.puppet import Puppet, Visual, packed, read_visuals, translation
from calib.viewer.scene import Camera, Scene
from calib.viewer.view import View, view_of

#: Colour and text in the legend of the rows of each kind.
_ROWS = {
    "estimation": (look.ESTIMATION, "measured, estimation"),
    "validation": (look.VALIDATION, "measured, validation"),
    "flagged": (look.OUTLIER, "measured, flagged"),
}

#: Ends of the text below and of the heading above, as a part of the picture's half height, see `look_at`.
_TEXT = (-0.54, 0.67)

#: Radius of the target's ball, as a part of the scene's size.
_BALL = 0.009

#: Length of the nominal robot's typical arrow at most, as a part of the scene's size.
_ARROW = 0.12

#: Factors that arrows and the robots' difference can be magnified by.
FACTORS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)

#: Gap between two robots side by side, as a part of the scene's size.
_GAP = 0.06

#: Least distance of two robots side by side, as a part of the scene's size.
_LEAST_DISTANCE = 0.4

#: Labels stand in front of the parts of a robot up to this height above its foot, as a part of the scene's size.
_FOOT_HEIGHT = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class _Layout:
    """Places of the robots, labels and cameras of a page; the frame is the base of the calibrated robot."""

    #: Diagonal of a robot's bounding box over all poses [m]
    size: float
    #: Shape (3,), displacement of each robot side by side [m]
    offsets: dict[str, Array]
    #: Shape (3,), place of the label of a robot that is not displaced [m]
    foot: Array
    #: The camera for the robots side by side
    side: Camera
    #: The camera for the overlaid robots
    over: Camera


def write_page(
    calibration: CalibrationValues, path: str | Path, *, overwrite: bool = False
) -> Path:
    """Write the page of a calibration.

    Args:
        calibration: The result.
        path: Name of the file.
        overwrite: Replace an existing file.

    Returns:
        The file's path.

    Raises:
        FileError: The file exists or cannot be written.
    """
    return view_page(view_of(calibration)).write(path, overwrite=overwrite)


def view_page(view: View, *, live: bool = False) -> Page:
    """Make the page of a view.

    Args:
        view: The content.
        live: The page listens to the server that it came from.
    """
    visuals, warnings = _read_visuals(view)
    shown = puppets(view, visuals)
    layout = _layout(view, shown)
    scene = _draw(view, shown, layout)
    factor = magnification(view, layout.size)
    names = [name.lower() for name, _ in view.names[: len(shown)]]
    html = filled_page(
        "robots.html",
        scene.window.scene(),
        title=view.title or f"{view.nominal.name or 'Robot'}: {' and '.join(names)}",
        warnings=warnings,
        grid=scene.square,
        legend=_legend(view),
        names=names,
        beam=look.BEAM,
        groups=list(shown),
        view=view,
        two=len(shown) > 1,
        factors=FACTORS,
        labels=_labels(view, layout),
        table=script_table(view, shown) | _layout_table(layout, factor),
        arrows=factor,
        live=live,
    )
    return Page(html, warnings)


def _read_visuals(view: View) -> tuple[dict[str, Sequence[Visual]], tuple[str, ...]]:
    """Read the shapes of the robots, by ``"nominal"`` and ``"calibrated"``, and the warnings, each once."""
    visuals: dict[str, Sequence[Visual]] = {}
    warnings: dict[str, None] = {}
    for name, robot in view.robots.items():
        visuals[name], texts = read_visuals(robot.urdf)
        warnings |= dict.fromkeys(texts)
    return visuals, tuple(warnings)


def puppets(view: View, visuals: Mapping[str, Sequence[Visual]]) -> dict[str, Puppet]:
    """Place the robots of a view in the base of the calibrated one.

    Args:
        view: The robots, their poses, targets and bases.
        visuals: The shapes of each robot, by ``"nominal"`` and ``"calibrated"``.

    Returns:
        The robots by the same names.
    """
    nominal = Puppet.of(
        view.nominal, view.q, visuals["nominal"], view.T_base_nominal, view.nominal_target
    )
    if view.calibrated is None:
        return {"nominal": nominal}
    base = np.broadcast_to(np.eye(4), (len(view.q), 4, 4))
    calibrated = Puppet.of(
        view.calibrated, view.q, visuals["calibrated"], base, view.calibrated_target
    )
    return {"nominal": nominal, "calibrated": calibrated}


def _layout(view: View, shown: Mapping[str, Puppet]) -> _Layout:
    """Place robots, labels and cameras.

    Only the robots count, not the measured positions: a wild measurement must not make the robots small.

    Args:
        view: The content, of which the pose shown first counts.
        shown: The robots by ``"nominal"`` and ``"calibrated"``, in the base of the latter.
    """
    first = slice(view.start, view.start + 1)
    at_start = _outline(shown, first)
    outline = np.concatenate([at_start, _outline(shown, slice(None))])
    size = stage.span(outline)
    origins = shown["nominal"].poses[view.start, :, :3, 3]
    towards_camera = stage.camera_direction(origins)
    foot = _foot(at_start, towards_camera, size)
    overlaid = np.vstack([outline, foot])
    offsets = {"nominal": np.zeros(3)}
    if len(shown) > 1:
        offsets = _offsets(outline, towards_camera, size)
    side_by_side = np.concatenate([overlaid + offset for offset in offsets.values()])
    side = stage.look_at(side_by_side, towards_camera, _TEXT)
    over = stage.look_at(overlaid, towards_camera, _TEXT)
    return _Layout(size, offsets, foot, side, over)


def _outline(shown: Mapping[str, Puppet], poses: slice) -> Array:
    """Return points (K, 3) [m] that enclose all robots at some of their poses; see `Puppet.outline`."""
    return np.concatenate([puppet.outline(poses) for puppet in shown.values()])


def _to_the_right(towards_camera: Array) -> Array:
    """Return the horizontal unit vector to the right of the picture, shape (3,)."""
    return np.array([-towards_camera[1], towards_camera[0], 0.0])


def _offsets(outline: Array, towards_camera: Array, size: float) -> dict[str, Array]:
    """Return the displacements (3,) [m] of two robots side by side, which then do not overlap.

    Args:
        outline: shape (K, 3), points that enclose both robots at all poses [m].
        towards_camera: shape (3,), horizontal unit vector.
        size: The scene's size [m].

    Returns:
        By ``"nominal"``, to the left of the picture, and ``"calibrated"``, to the right.
    """
    right = _to_the_right(towards_camera)
    width = np.ptp(outline @ right) + _GAP * size
    half_distance = 0.5 * max(width, _LEAST_DISTANCE * size) * right
    return {"nominal": -half_distance, "calibrated": half_distance}


def _foot(at_start: Array, towards_camera: Array, size: float) -> Array:
    """Return the point (3,) [m] for a label: below the middle of a robot, in front of what stands on the floor.

    Args:
        at_start: shape (K, 3), points that enclose the robot at the first pose [m].
        towards_camera: shape (3,), horizontal unit vector.
        size: The scene's size [m].
    """
    right = _to_the_right(towards_camera)
    across = at_start @ right
    foot: Array = 0.5 * (across.min() + across.max()) * right
    foot[2] = at_start[:, 2].min()
    low = at_start[at_start[:, 2] < foot[2] + _FOOT_HEIGHT * size]
    foot += (low @ towards_camera).max() * towards_camera
    return foot


def _draw(view: View, shown: Mapping[str, Puppet], layout: _Layout) -> Scene:
    """Draw the robots side by side at the pose shown first; return the scene."""
    scene = stage.new_scene(layout.side, layout.size, layout.foot[2])
    for name, puppet in shown.items():
        group = scene.root[stage.SCENE][name]
        group.set_transform(translation(layout.offsets[name] - layout.side.centre))
        material = stage.solid(COLOURS[name], front=name == "calibrated")
        stage.draw_puppet(group, puppet, view.start, material, _BALL * layout.size)
    return scene


def _labels(view: View, layout: _Layout) -> list[tuple[Array, str, str, str]]:
    """Return the labels in the scene: place (3,) [m], arrangement ``"side"`` or ``"over"``, name and description.

    A robot alone has none: the heading names it.
    """
    if view.calibrated is None:
        return []
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


def _layout_table(layout: _Layout, factor: int) -> dict[str, Any]:
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
        "arrows": factor,
    }


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
        Values that JSON can hold; arrays as text, see `floats`.
    """
    colours = {kind: colour for kind, (colour, _) in _ROWS.items()}
    links = shown["nominal"].links
    return {
        "start": view.start,
        "labels": list(view.labels),
        "kinds": list(view.kinds),
        "names": [name for name, _ in view.names],
        "colours": {**COLOURS, **colours, "beam": look.BEAM},
        "robots": {name: _robot_table(puppet, links) for name, puppet in shown.items()},
        "measured": floats(view.measured),
        "errors": [_errors_table(unit, errors) for unit, errors in view.errors.items()],
        "instruments": packed(view.instruments).tolist(),
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
