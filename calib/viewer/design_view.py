"""A plan or a region in the browser: one HTML file.

A plan: the robot at its first pose, where the targets will be, what stands around, the way from pose to pose and the
lines of sight. A region: its voxels as coloured points about the nominal robot, in bands by how often the target is
there. Each can be hidden.
"""

from __future__ import annotations

import itertools

import meshcat
import numpy as np
from meshcat import geometry as mc
from numpy.typing import NDArray

from calib.data.surroundings import Box
from calib.design.plan import Plan
from calib.design.workspace import Density
from calib.report.figure_region import RegionView
from calib.report.label_rows import BEAM, ESTIMATION, LITTLE_TO_MUCH, NOMINAL, VALIDATION
from calib.viewer.page import Key, single_page
from calib.viewer.scene import (
    Page,
    draw_boxes,
    draw_cloud,
    draw_lines,
    draw_points,
    solid,
    translation,
)

Array = NDArray[np.float64]

#: Radius of a ball and length of a line of sight, as a part of the scene's size.
_BALL, _SIGHT = 0.008, 0.12

#: A tracker farther away than this many sizes of the scene is not in the picture; its direction is.
_NEAR = 1.0

#: Of what stands around, of poses measured already and of the way.
_AROUND, _TAKEN, _WAY = "#b9a58c", "#8a94a0", "#5b6775"


def plan_page(plan: Plan) -> Page:
    """A plan about the robot at its first pose."""
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
        # The last piece of each line of sight.
        points = places.reshape(-1, 3)
        towards = tracker.position - points
        length = np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
        ends = points + towards / length * np.minimum(length, _SIGHT * size)
        draw_lines(scene["sight"], np.stack([points, ends], axis=1), BEAM, 0.7)
        keys.append(Key("towards the tracker", BEAM, "sight"))
        if np.linalg.norm(tracker.position) < _NEAR * size:
            draw_points(scene["tracker"], tracker.position[None], BEAM, 2.0 * _BALL * size)
    return keys


def _corners(box: Box) -> Array:
    """The corners of a box in the base, shape (8, 3), [m]."""
    T, unit = box.T_base_box, np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    return np.asarray(unit * box.size @ T[:3, :3].T + T[:3, 3])


#: The bands end at these shares, as far as the region goes.
_BANDS = (0.5, 0.8)

#: More voxels than this are thinned out, evenly; fewer than the other number get more than one point each.
_MOST_POINTS, _WANTED_POINTS = 60_000, 15_000

#: Edge of a point, as a part of a voxel; the robot is seen between them.
_POINT = 0.36

#: Radius of the target's ball and of a row's, as a part of the scene's size.
_TARGET_BALL, _ROW_BALL = 0.011, 0.007


def region_page(view: RegionView) -> Page:
    """A region about the nominal robot, in bands by how often the target is there."""
    T_tip = view.robot.poses(view.q)[0]
    target = T_tip[:3, :3] @ view.target + T_tip[:3, 3]
    centres = _centres(view.density, view.region.cells)

    def draw(scene: meshcat.Visualizer, size: float) -> list[Key]:
        if np.any(view.target):
            node = scene["nominal"]["target"]
            node.set_object(mc.Sphere(_TARGET_BALL * size), solid(NOMINAL))
            node.set_transform(translation(target))
        return [*_draw_voxels(scene, view), *_draw_rows(scene, view, size)]

    return single_page(
        view.robot,
        view.q,
        np.concatenate([target[None], centres[:: 1 + len(centres) // 5000]]),
        draw,
        title=view.title,
        text=view.text,
        legend=f"{view.robot.name}, nominal",
    )


def _draw_voxels(scene: meshcat.Visualizer, view: RegionView) -> list[Key]:
    """The region's voxels in bands, and their lines of the legend."""
    centres = _centres(view.density, view.region.cells)
    # The centre of a voxel may lie beyond the box that cuts it.
    needed = view.density.share_of(np.clip(centres, *view.region.box))
    inside = np.ones(len(centres), dtype=np.bool_)
    rng = np.random.default_rng(0)
    if len(centres) > _MOST_POINTS:
        chosen = rng.permutation(len(centres))[:_MOST_POINTS]
        inside &= np.isin(np.arange(len(centres)), chosen)
    copies = max(1, _WANTED_POINTS // len(centres))
    centres, needed = np.repeat(centres, copies, axis=0), np.repeat(needed, copies)
    inside = np.repeat(inside, copies)
    edge = _POINT * view.density.voxel / np.cbrt(copies)
    # Anywhere in its voxel: points in rows would make patterns of their own.
    centres = centres + view.density.voxel * rng.uniform(-0.5, 0.5, centres.shape)
    inside &= np.all((centres >= view.region.box[0]) & (centres <= view.region.box[1]), axis=1)
    share = view.region.share
    ends = [0.0, *[end for end in _BANDS if end < share - 0.02], share]
    keys = []
    for i, (start, end) in enumerate(itertools.pairwise(ends)):
        colour = LITTLE_TO_MUCH[len(LITTLE_TO_MUCH) - 1 - i]
        last = end == share
        band = inside & (needed > start) & ((needed <= end) | last)
        points = centres[band]
        if not len(points):
            continue
        draw_cloud(scene[f"band{i}"], points, colour, edge)
        words = f"the densest {100 * end:.3g} %" if i == 0 else f"up to {100 * end:.3g} %"
        keys.append(Key(words, colour, f"band{i}"))
    return keys


def _draw_rows(scene: meshcat.Visualizer, view: RegionView, size: float) -> list[Key]:
    """The points of a table, and their lines of the legend."""
    if view.marked is None:
        return []
    keys = []
    for chosen, colour, word in (
        (~view.marked.validation, ESTIMATION, "estimation"),
        (view.marked.validation, VALIDATION, "validation"),
    ):
        points = view.marked.points[chosen]
        # A wild point is not looked for at the end of the world.
        points = points[np.linalg.norm(points, axis=1) < 5.0 * size]
        if not len(points):
            continue
        draw_points(scene[word], points, colour, _ROW_BALL * size)
        keys.append(Key(f"{word} rows", colour, word, "dot"))
    return keys


def _centres(density: Density, cells: NDArray[np.bool_]) -> Array:
    """Centres of voxels, shape (K, 3), [m]."""
    result: Array = density.origin + density.voxel * (np.argwhere(cells) + 0.5)
    return result
