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

from calib.design.plan import Plan
from calib.regions.region_rows import RegionView
from calib.report.figure_base import BEAM, ESTIMATION, LITTLE_TO_MUCH, NOMINAL, VALIDATION
from calib.report.figure_region import headings
from calib.units import Array
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

#: Radii of a target's ball and of a row's, and length of a line of sight, as a part of the scene's size.
_BALL, _ROW_BALL, _SIGHT = 0.008, 0.007, 0.12

#: Of what stands around, of poses measured already and of the way.
_AROUND, _TAKEN, _WAY = "#b9a58c", "#8a94a0", "#5b6775"

#: The bands of a region end at these shares, as far as the region goes.
_BANDS = (0.5, 0.8)

#: More voxels than this are thinned out, evenly.
_MOST_POINTS = 60_000

#: Edge of a point, as a part of a voxel; the robot is seen between them.
_POINT = 0.36


def plan_page(plan: Plan) -> Page:
    """A plan about the robot at its first pose."""
    places, taken = plan.places(plan.joints), plan.places(plan.taken).reshape(-1, 3)
    chosen, tracker, boxes = np.array(plan.sets) == "estimate", plan.cell.tracker, plan.cell.boxes

    def draw(scene: meshcat.Visualizer, size: float) -> list[Key]:
        sets = (
            ("estimate", ESTIMATION, f"to estimate from, {chosen.sum()}", places[chosen]),
            ("validate", VALIDATION, f"to validate with, {(~chosen).sum()}", places[~chosen]),
            ("taken", _TAKEN, f"measured already, {len(plan.taken)}", taken),
        )
        keys = _draw_dots(scene, sets, _BALL * size)
        draw_lines(scene["way"], np.stack([places[:-1, 0], places[1:, 0]], axis=1), _WAY, 0.55)
        keys.append(Key("order to drive", _WAY, "way"))
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
        return keys

    f = plan.forecast
    corners = [box.T_base_box[:3, 3] + sign * 0.5 * box.size for box in boxes for sign in (-1, 1)]
    return single_page(
        plan.robot,
        plan.joints[0],
        np.concatenate([places.reshape(-1, 3), taken, np.reshape(corners, (-1, 3))]),
        draw,
        title=f"{plan.robot.name}: {len(plan.joints)} poses to measure",
        text=f"Expected error of a predicted position after the calibration: {1e3 * f.rms:.3f} mm rms over the "
        f"workspace, {1e3 * f.rms_low:.3f} to {1e3 * f.rms_high:.3f} mm in 90 % of calibrations.",
        legend=f"{plan.robot.name} at the first pose",
    )


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


def region_page(view: RegionView) -> Page:
    """A region about the nominal robot, in bands by how often the target is there."""
    q = view.ranges.mean(axis=1)
    target = (view.robot.poses(q)[0] @ np.append(view.target, 1.0))[:3]
    centres = view.region.origin + view.region.voxel * (np.argwhere(view.region.cells) + 0.5)
    title, text = headings(view)

    def draw(scene: meshcat.Visualizer, size: float) -> list[Key]:
        node = scene["nominal"]["target"]
        node.set_object(mc.Sphere(_BALL * size), solid(NOMINAL))
        node.set_transform(translation(target))
        keys = _draw_voxels(scene, view, centres)
        if view.checked is not None:
            rows, points, _ = view.checked
            sets = (
                ("estimation", ESTIMATION, "estimation rows", points[rows.estimation]),
                ("validation", VALIDATION, "validation rows", points[rows.validation]),
            )
            keys += _draw_dots(scene, sets, _ROW_BALL * size)
        return keys

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
    chosen = np.sort(np.random.default_rng(0).permutation(len(centres))[:_MOST_POINTS])
    centres, needed, edge = centres[chosen], needed[chosen], _POINT * view.region.voxel
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
