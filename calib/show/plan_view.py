"""A plan in the browser: the robot at its first pose, where the targets will be, and what stands around, in one file.

The way from pose to pose and the lines of sight are drawn too; each can be hidden.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import meshcat
import numpy as np
from numpy.typing import NDArray

from calib.design.plan import Plan
from calib.measure.surroundings import Box, Tracker
from calib.show.page import Key, single_page
from calib.show.rows import BEAM, ESTIMATION, VALIDATION
from calib.show.scene import Page, draw_boxes, draw_lines, draw_points

Array = NDArray[np.float64]

#: Radius of a ball and length of a line of sight, as a part of the scene's size.
_BALL, _SIGHT = 0.008, 0.12

#: A tracker farther away than this many sizes of the scene is not in the picture; its direction is.
_NEAR = 1.0

#: Of what stands around, of poses measured already and of the way.
_AROUND, _TAKEN, _WAY = "#b9a58c", "#8a94a0", "#5b6775"


def write_plan_view(plan: Plan, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write a plan as one HTML file that opens from disk without a network.

    Raises:
        FileError: The file exists and ``overwrite`` is False, or it cannot be written.
    """
    return plan_page(plan).write(path, overwrite=overwrite)


def plan_page(plan: Plan) -> Page:
    """Draw a plan.

    Raises:
        UrdfError: Pinocchio cannot build a model of the URDF.
    """
    places = plan.places(plan.joints)
    taken = plan.places(plan.taken).reshape(-1, 3) if len(plan.taken) else np.zeros((0, 3))
    boxes = plan.cell.boxes
    f = plan.forecast
    return single_page(
        plan.robot,
        plan.joints[0],
        np.concatenate([places.reshape(-1, 3), taken, *map(_corners, boxes)]),
        lambda scene, size: [
            *_draw_targets(scene, plan, places, taken, size),
            *_draw_around(scene, plan, places, size),
        ],
        title=f"{plan.robot.name}: {len(plan.joints)} poses to measure",
        text=f"Expected error of a predicted position after the calibration: {1e3 * f.rms:.3f} mm rms over the "
        f"workspace, {1e3 * f.rms_low:.3f} to {1e3 * f.rms_high:.3f} mm in 90 % of calibrations.",
        legend=f"{plan.robot.name} at the first pose",
    )


def _draw_targets(
    scene: meshcat.Visualizer, plan: Plan, places: Array, taken: Array, size: float
) -> list[Key]:
    """Where the targets will be, by their set, and the way; the lines of the legend."""
    keys = []
    sets = np.array(plan.sets)
    for name, colour, text, count, points in (
        ("estimate", ESTIMATION, "to estimate from", np.sum(sets == "estimate"), None),
        ("validate", VALIDATION, "to validate with", np.sum(sets == "validate"), None),
        ("taken", _TAKEN, "measured already", len(plan.taken), taken),
    ):
        at = places[sets == name].reshape(-1, 3) if points is None else points
        if len(at):
            draw_points(scene[name], at, colour, _BALL * size)
            keys.append(Key(f"{text}, {count}", colour, name, "dot"))
    first = places[:, 0]
    if len(first) > 1:
        draw_lines(scene["way"], np.stack([first[:-1], first[1:]], axis=1), _WAY, 0.55)
        keys.append(Key("order to drive", _WAY, "way"))
    return keys


def _draw_around(scene: meshcat.Visualizer, plan: Plan, places: Array, size: float) -> list[Key]:
    """Boxes, and where the tracker looks from; the lines of the legend."""
    keys, boxes, tracker = [], plan.cell.boxes, plan.cell.tracker
    if boxes:
        poses = [box.T_base_box for box in boxes]
        draw_boxes(scene["around"], [box.size for box in boxes], poses, _AROUND)
        keys.append(Key(", ".join(box.name for box in boxes), _AROUND, "around"))
    if tracker is not None:
        draw_lines(scene["sight"], _beams(places, size, tracker), BEAM, 0.7)
        keys.append(Key("towards the tracker", BEAM, "sight"))
        if np.linalg.norm(tracker.position) < _NEAR * size:
            draw_points(scene["tracker"], tracker.position[None], BEAM, 2.0 * _BALL * size)
    return keys


def _beams(places: Array, size: float, tracker: Tracker) -> Array:
    """The last piece of each line of sight, shape (N, 2, 3), [m]."""
    points = places.reshape(-1, 3)
    towards = tracker.position - points
    length = np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
    ends = points + towards / length * np.minimum(length, _SIGHT * size)
    return np.stack([points, ends], axis=1)


def _corners(box: Box) -> Array:
    """The corners of a box in the base, shape (8, 3), [m]."""
    T, unit = box.T_base_box, np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    return np.asarray(unit * box.size @ T[:3, :3].T + T[:3, 3])
