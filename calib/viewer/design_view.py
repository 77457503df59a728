"""A plan or a region in the browser: one HTML file.

A plan: the robot at its first pose, where the targets will be, what stands around, the way from pose to pose and the
lines of sight. A region: its voxels as coloured points about the nominal robot, in bands by how often the target is
there. Each can be hidden.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import meshcat
import numpy as np
from meshcat import geometry as mc
from numpy.typing import NDArray

from calib.data.surroundings import Box
from calib.design.plan import Plan
from calib.design.workspace import RegionView
from calib.report.figure_base import BEAM, ESTIMATION, LITTLE_TO_MUCH, NOMINAL, VALIDATION
from calib.report.figure_region import headings
from calib.viewer.scene import (
    Key,
    Page,
    draw_boxes,
    draw_cloud,
    draw_lines,
    draw_points,
    single_page,
    solid,
)
from calib.viewer.view import translation

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
    chosen, first = np.array(plan.sets) == "estimate", places[:, 0]
    keys = _draw_dots(
        scene,
        (
            ("estimate", ESTIMATION, f"to estimate from, {chosen.sum()}", places[chosen]),
            ("validate", VALIDATION, f"to validate with, {(~chosen).sum()}", places[~chosen]),
            ("taken", _TAKEN, f"measured already, {len(plan.taken)}", taken),
        ),
        _BALL * size,
    )
    if len(first) > 1:
        draw_lines(scene["way"], np.stack([first[:-1], first[1:]], axis=1), _WAY, 0.55)
        keys.append(Key("order to drive", _WAY, "way"))
    return keys


def _draw_dots(
    scene: meshcat.Visualizer, sets: Iterable[tuple[str, str, str, Array]], radius: float
) -> list[Key]:
    """Points by node, colour and text, as far as there are any; the lines of the legend."""
    keys = []
    for name, colour, text, points in sets:
        if len(points):
            draw_points(scene[name], points.reshape(-1, 3), colour, radius)
            keys.append(Key(text, colour, name, "dot"))
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
    q = view.pose
    T_tip = view.robot.poses(q)[0]
    target = T_tip[:3, :3] @ view.target + T_tip[:3, 3]
    centres = view.region.origin + view.region.voxel * (np.argwhere(view.region.cells) + 0.5)
    title, text = headings(view)

    def draw(scene: meshcat.Visualizer, size: float) -> list[Key]:
        if np.any(view.target):
            node = scene["nominal"]["target"]
            node.set_object(mc.Sphere(_TARGET_BALL * size), solid(NOMINAL))
            node.set_transform(translation(target))
        return [*_draw_voxels(scene, view, centres), *_draw_rows(scene, view, size)]

    return single_page(
        view.robot,
        q,
        np.concatenate([target[None], centres[:: 1 + len(centres) // 5000]]),
        draw,
        title=title,
        text=text,
        legend=f"{view.robot.name}, nominal",
    )


def _draw_voxels(scene: meshcat.Visualizer, view: RegionView, centres: Array) -> list[Key]:
    """The region's voxels, shape (K, 3) of centres, in bands, and their lines of the legend."""
    needed = view.density.share_of(centres)
    rng = np.random.default_rng(0)
    chosen = np.sort(rng.permutation(len(centres))[:_MOST_POINTS])
    copies = max(1, _WANTED_POINTS // len(centres))
    centres, needed = (np.repeat(one[chosen], copies, axis=0) for one in (centres, needed))
    edge = _POINT * view.region.voxel / np.cbrt(copies)
    # Anywhere in its voxel: points in rows would make patterns of their own.
    centres = centres + view.region.voxel * rng.uniform(-0.5, 0.5, centres.shape)
    share = view.region.share
    ends = [0.0, *[end for end in _BANDS if end < share - 0.02], share]
    keys = []
    for i, (start, end) in enumerate(itertools.pairwise(ends)):
        colour = LITTLE_TO_MUCH[len(LITTLE_TO_MUCH) - 1 - i]
        band = (needed > start) & ((needed <= end) | (end == share))
        if band.any():
            draw_cloud(scene[f"band{i}"], centres[band], colour, edge)
            words = f"the densest {100 * end:.3g} %" if i == 0 else f"up to {100 * end:.3g} %"
            keys.append(Key(words, colour, f"band{i}"))
    return keys


def _draw_rows(scene: meshcat.Visualizer, view: RegionView, size: float) -> list[Key]:
    """The points of a table, and their lines of the legend."""
    if view.checked is None:
        return []
    rows, points, *_ = view.checked
    # A wild point is not looked for at the end of the world.
    near = np.linalg.norm(points, axis=1) < 5.0 * size
    sets = (
        ("estimation", ESTIMATION, "estimation rows", points[rows.estimation & near]),
        ("validation", VALIDATION, "validation rows", points[rows.validation & near]),
    )
    return _draw_dots(scene, sets, _ROW_BALL * size)
