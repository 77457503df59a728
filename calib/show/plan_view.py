"""A plan in the browser: the robot at its first pose, where the targets will be, and what stands around, in one file.

The way from pose to pose and the lines of sight are drawn too; each can be hidden. See `calib.show.scene` for the page.
"""

from __future__ import annotations

from pathlib import Path

import meshcat
import numpy as np
from meshcat import geometry as mc
from numpy.typing import NDArray

from calib.design.plan import Plan
from calib.measure.surroundings import Box, Tracker
from calib.show.bodies import bodies
from calib.show.marks import draw_bodies, draw_lines, draw_points, number
from calib.show.page import escaped, key
from calib.show.palette import BEAM, ESTIMATION, NOMINAL, VALIDATION
from calib.show.single import Layout, single_page
from calib.show.stage import Page
from calib.show.visuals import read_visuals
from calib.show.window import without_shadow

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
    visuals, warnings = read_visuals(plan.robot.urdf)
    places = plan.places(plan.joints)
    taken = plan.places(plan.taken).reshape(-1, 3) if len(plan.taken) else np.zeros((0, 3))
    seen = np.concatenate([places.reshape(-1, 3), taken, *map(_corners, plan.cell.boxes)])
    parts = bodies(plan.robot, plan.joints[0], visuals)
    layout = Layout.of(plan.robot, plan.joints[0], parts, seen)

    def draw(scene: meshcat.Visualizer) -> list[str]:
        draw_bodies(scene["nominal"], parts, NOMINAL)
        words = f"{escaped(plan.robot.name)} at the first pose"
        keys = [key(words, NOMINAL, "nominal")]
        keys += _draw_targets(scene, plan, places, taken, layout.size)
        return keys + _draw_around(scene, plan, places, layout.size)

    title = f"{plan.robot.name}: {len(plan.joints)} poses to measure"
    return single_page(layout, draw, title=title, text=_facts(plan), warnings=warnings)


def _draw_targets(
    scene: meshcat.Visualizer, plan: Plan, places: Array, taken: Array, size: float
) -> list[str]:
    """Where the targets will be, by their set, and the way; the lines of the legend."""
    keys = []
    sets = np.array(plan.sets)
    for word, colour, text in (
        ("estimate", ESTIMATION, "to estimate from"),
        ("validate", VALIDATION, "to validate with"),
    ):
        points = places[sets == word].reshape(-1, 3)
        if len(points):
            draw_points(scene[word], points, colour, _BALL * size)
            keys.append(key(f"{text}, {np.sum(sets == word)}", colour, word, "dot"))
    if len(taken):
        draw_points(scene["taken"], taken, _TAKEN, _BALL * size)
        keys.append(key(f"measured already, {len(plan.taken)}", _TAKEN, "taken", "dot"))
    first = places[:, 0]
    if len(first) > 1:
        draw_lines(scene["way"], np.stack([first[:-1], first[1:]], axis=1), _WAY, 0.55)
        keys.append(key("order to drive", _WAY, "way"))
    return keys


def _draw_around(scene: meshcat.Visualizer, plan: Plan, places: Array, size: float) -> list[str]:
    """Boxes, and where the tracker looks from; the lines of the legend."""
    keys = []
    for i, box in enumerate(plan.cell.boxes):
        node = scene["around"][f"{i:02d}"]
        material = mc.MeshPhongMaterial(color=number(_AROUND), opacity=0.35, transparent=True)
        node.set_object(mc.Box(box.size.tolist()), material)
        without_shadow(node)
        node.set_transform(box.T_base_box)
    if plan.cell.boxes:
        keys.append(key(escaped(", ".join(box.name for box in plan.cell.boxes)), _AROUND, "around"))
    tracker = plan.cell.tracker
    if tracker is not None:
        draw_lines(scene["sight"], _beams(places, size, tracker), BEAM, 0.7)
        keys.append(key("towards the tracker", BEAM, "sight"))
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
    size, T = box.size, box.T_base_box
    unit = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)
    return np.asarray(unit * size @ T[:3, :3].T + T[:3, 3])


def _facts(plan: Plan) -> str:
    """What the plan will give, in a sentence."""
    f = plan.forecast
    return (
        f"Expected error of a predicted position after the calibration: {1e3 * f.rms:.3f} mm rms over the workspace, "
        f"{1e3 * f.rms_low:.3f} to {1e3 * f.rms_high:.3f} mm in 90 % of calibrations."
    )
