"""The pages of a plan and of a region: one HTML file each.

A plan: the robot at its first pose, the targets of all poses, the boxes about it, the way from pose to pose and the
lines of sight. A region: its voxels as coloured points about the nominal robot, in bands by density. Each can be
hidden.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import meshcat
import numpy as np
from meshcat import geometry as mc

from calib.design.plan import PlanValues
from calib.regions.region_rows import RegionView
from calib.report.figure_base import BEAM, ESTIMATION, LITTLE_TO_MUCH, NOMINAL, VALIDATION
from calib.report.figure_region import headings
from calib.units import Array
from calib.viewer.html_page import Key, Page
from calib.viewer.puppet import translation
from calib.viewer.scene import (
    draw_boxes,
    draw_cloud,
    draw_lines,
    draw_points,
    single_page,
    solid,
)

#: Radius of a target's ball, as a part of the scene's size.
_BALL = 0.008

#: Radius of the ball of a row of a table, as a part of the scene's size.
_ROW_BALL = 0.007

#: Length of the drawn piece of a line of sight at most, as a part of the scene's size.
_SIGHT = 0.12

#: Colour of the boxes.
_BOXES_COLOUR = "#b9a58c"

#: Colour of poses measured already.
_TAKEN_COLOUR = "#8a94a0"

#: Colour of the way from pose to pose.
_WAY_COLOUR = "#5b6775"

#: Shares of the samples at which the bands of a region end, as far as the region goes.
_BANDS = (0.5, 0.8)

#: A band narrower than this share is joined with the next one.
_LEAST_BAND = 0.02

#: More voxels than this are thinned out, evenly.
_MOST_POINTS = 60_000

#: Voxels, about, that the camera is placed by.
_CAMERA_POINTS = 5000

#: Edge of a point, as a part of a voxel; the robot is seen between them.
_POINT = 0.36


class _Dots(NamedTuple):
    """Points of one set."""

    #: Name of their node in the scene
    node: str
    #: ``"#rrggbb"``
    colour: str
    #: Their entry of the legend
    text: str
    #: Shape (..., 3), in the base [m]
    points: Array


def plan_page(plan: PlanValues) -> Page:
    """Make the page of a plan, with the robot at its first pose."""
    places = plan.places(plan.joints)
    taken = plan.places(plan.taken).reshape(-1, 3)

    def draw(scene: meshcat.Visualizer, size: float) -> list[Key]:
        keys = _draw_dots(scene, _plan_dots(plan, places, taken), _BALL * size)
        ways = np.stack([places[:-1, 0], places[1:, 0]], axis=1)
        draw_lines(scene["way"], ways, _WAY_COLOUR, 0.55)
        keys.append(Key("order to drive", _WAY_COLOUR, "way"))
        keys += _draw_boxes_of(scene, plan)
        keys += _draw_sight(scene, plan, places.reshape(-1, 3), _SIGHT * size)
        return keys

    forecast = plan.forecast
    return single_page(
        plan.robot,
        plan.joints[0],
        np.concatenate([places.reshape(-1, 3), taken, _box_ends(plan)]),
        draw,
        title=f"{plan.robot.name}: {len(plan.joints)} poses to measure",
        text=f"Expected error of a predicted position after the calibration: {1e3 * forecast.rms:.3f} mm rms over the "
        f"workspace, {1e3 * forecast.rms_low:.3f} to {1e3 * forecast.rms_high:.3f} mm in 90 % of calibrations.",
        legend=f"{plan.robot.name} at the first pose",
    )


def _plan_dots(plan: PlanValues, places: Array, taken: Array) -> tuple[_Dots, ...]:
    """Return the targets of a plan by set.

    Args:
        plan: The plan.
        places: shape (N, K, 3), the targets at its poses, in the base [m].
        taken: shape (L, 3), those at poses measured already [m].
    """
    chosen = np.array(plan.sets) == "estimate"
    estimate = f"to estimate from, {chosen.sum()}"
    validate = f"to validate with, {(~chosen).sum()}"
    return (
        _Dots("estimate", ESTIMATION, estimate, places[chosen]),
        _Dots("validate", VALIDATION, validate, places[~chosen]),
        _Dots("taken", _TAKEN_COLOUR, f"measured already, {len(plan.taken)}", taken),
    )


def _draw_boxes_of(scene: meshcat.Visualizer, plan: PlanValues) -> list[Key]:
    """Draw the boxes of the cell, if there are any; return their entry of the legend."""
    boxes = plan.cell.boxes
    if not boxes:
        return []
    sizes = [box.size for box in boxes]
    poses = [box.T_base_box for box in boxes]
    draw_boxes(scene["around"], sizes, poses, _BOXES_COLOUR)
    return [Key(", ".join(box.name for box in boxes), _BOXES_COLOUR, "around")]


def _draw_sight(
    scene: meshcat.Visualizer, plan: PlanValues, points: Array, longest: float
) -> list[Key]:
    """Draw the last piece of each line of sight from the tracker, if there is one.

    Args:
        scene: Node of the scene.
        plan: The plan.
        points: shape (N, 3), the targets in the base [m].
        longest: Length of a piece at most [m].

    Returns:
        The entry of the legend.
    """
    tracker = plan.cell.tracker
    if tracker is None:
        return []
    towards = tracker.position - points
    length = np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
    ends = points + towards / length * np.minimum(length, longest)
    draw_lines(scene["sight"], np.stack([points, ends], axis=1), BEAM, 0.7)
    return [Key("towards the tracker", BEAM, "sight")]


def _box_ends(plan: PlanValues) -> Array:
    """Return two points of each box of the cell, shape (K, 3), in the base [m], that the camera sees."""
    ends = []
    for box in plan.cell.boxes:
        middle = box.T_base_box[:3, 3]
        ends += [middle - 0.5 * box.size, middle + 0.5 * box.size]
    return np.reshape(ends, (-1, 3))


def _draw_dots(scene: meshcat.Visualizer, sets: Sequence[_Dots], radius: float) -> list[Key]:
    """Draw the points of each set that has any, with a radius [m]; return the entries of the legend."""
    keys = []
    for dots in sets:
        if len(dots.points):
            draw_points(scene[dots.node], dots.points.reshape(-1, 3), dots.colour, radius)
            keys.append(Key(dots.text, dots.colour, dots.node, "dot"))
    return keys


def region_page(view: RegionView) -> Page:
    """Make the page of a region about the nominal robot, in bands by the density of the target's positions."""
    q = view.ranges.mean(axis=1)
    target = (view.robot.poses(q)[0] @ np.append(view.target, 1.0))[:3]
    centres = view.region.origin + view.region.voxel * (np.argwhere(view.region.cells) + 0.5)
    title, text = headings(view)

    def draw(scene: meshcat.Visualizer, size: float) -> list[Key]:
        node = scene["nominal"]["target"]
        node.set_object(mc.Sphere(_BALL * size), solid(NOMINAL))
        node.set_transform(translation(target))
        keys = _draw_voxels(scene, view, centres)
        keys += _draw_dots(scene, _row_dots(view), _ROW_BALL * size)
        return keys

    return single_page(
        view.robot,
        q,
        np.concatenate([target[None], centres[:: 1 + len(centres) // _CAMERA_POINTS]]),
        draw,
        title=title,
        text=text,
        legend=f"{view.robot.name}, nominal",
    )


def _row_dots(view: RegionView) -> tuple[_Dots, ...]:
    """Return the points of a table's rows by set; none without a table."""
    if view.checked is None:
        return ()
    rows, points, _ = view.checked
    return (
        _Dots("estimation", ESTIMATION, "estimation rows", points[rows.estimation]),
        _Dots("validation", VALIDATION, "validation rows", points[rows.validation]),
    )


def _draw_voxels(scene: meshcat.Visualizer, view: RegionView, centres: Array) -> list[Key]:
    """Draw the voxels of a region in bands by density.

    Args:
        scene: Node of the scene.
        view: The region.
        centres: shape (K, 3), middles of its voxels in the base [m].

    Returns:
        The entries of the legend, the densest band first.
    """
    share_of = view.density.share_of(centres)
    chosen = np.sort(np.random.default_rng(0).permutation(len(centres))[:_MOST_POINTS])
    centres = centres[chosen]
    share_of = share_of[chosen]
    share = view.region.share
    inner = [end for end in _BANDS if end < share - _LEAST_BAND]
    keys = []
    for i, (start, end) in enumerate(itertools.pairwise([0.0, *inner, share])):
        colour = LITTLE_TO_MUCH[len(LITTLE_TO_MUCH) - 1 - i]
        band = (share_of > start) & ((share_of <= end) | (end == share))
        if band.any():
            draw_cloud(scene[f"band{i}"], centres[band], colour, _POINT * view.region.voxel)
            prefix = "the densest" if i == 0 else "up to"
            keys.append(Key(f"{prefix} {100 * end:.3g} %", colour, f"band{i}"))
    return keys
