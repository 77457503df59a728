"""The pages of a plan and of a region: one HTML file each.

A plan: the robot at one pose after the other, in the order to drive, with its numbers; the targets of all poses, the
boxes about it, and the tracker with its lines of sight. A region: its voxels as coloured points about the nominal
robot, in bands by density. Each can be shown and hidden.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import meshcat
import numpy as np
from meshcat import geometry as mc

from calib.arrays import Array
from calib.design.forecast import position_std
from calib.design.images.plan_file import distances_and_tilts, image_name
from calib.design.images.sensitivity import sensitivity_of
from calib.design.plan import PlanValues
from calib.regions.region_rows import RegionView
from calib.report.figure_base import BEAM, ESTIMATION, LITTLE_TO_MUCH, NOMINAL, VALIDATION
from calib.report.figure_region import headings
from calib.viewer.html_page import Key, Page
from calib.viewer.image_view import shown
from calib.viewer.page import WAY_COLOUR, About, view_page
from calib.viewer.puppet import translation
from calib.viewer.scene import (
    draw_boxes,
    draw_cloud,
    draw_lines,
    draw_points,
    single_page,
    solid,
)
from calib.viewer.view import View, joint_texts

#: Radius of a target's ball, as a part of the scene's size.
_BALL = 0.008

#: Radius of the ball of a row of a table, as a part of the scene's size.
_ROW_BALL = 0.007

#: Colour of the boxes.
_BOXES_COLOUR = "#b9a58c"

#: Colour of poses measured already.
_TAKEN_COLOUR = "#8a94a0"

#: Shares of the samples at which the bands of a region end, as far as the region goes.
_BANDS = (0.5, 0.8)

#: A band narrower than this share is joined with the next one.
_LEAST_BAND = 0.02

#: More voxels than this are thinned out, evenly.
_MOST_POINTS = 60_000

#: Voxels, about, that the camera is placed by.
_CAMERA_POINTS = 5000

#: Edge of a point, as a part of a voxel; the robot is seen between them.
_POINT = 0.09


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


def plan_page(plan: PlanValues, *, first_row: int = 1) -> Page:
    """Make the page of a plan: the robot at each pose, in the order to drive, with its numbers.

    Args:
        plan: The plan.
        first_row: Number of the first row of its table, see `calib.design.plan_file.write_plan`.
    """
    view = _plan_view(plan, first_row)
    plan = shown(plan)
    places = plan.places(plan.joints)
    taken = plan.places(plan.taken).reshape(-1, 3)

    def draw(group: meshcat.Visualizer, size: float) -> list[Key]:
        keys = _draw_dots(group, _plan_dots(plan, places, taken), _BALL * size)
        keys += _draw_boxes_of(group, plan)
        keys += _sight_keys(plan)
        keys.append(Key("line to the next pose", WAY_COLOUR, "next"))
        ways = np.stack([places[:-1, 0], places[1:, 0]], axis=1)
        draw_lines(group["way"], ways, WAY_COLOUR, 0.55)
        keys.append(Key("order of all poses", WAY_COLOUR, "way", on=False))
        return keys

    tracker = plan.cell.tracker
    about = About(
        points=np.concatenate([places.reshape(-1, 3), taken, _box_ends(plan)]),
        draw=draw,
        tracker=None if tracker is None else tracker.position,
        targets=places,
    )
    return view_page(view, about=about)


def _plan_view(plan: PlanValues, first_row: int) -> View:
    """Return the view of a plan's robot at its poses; the first row of its table has the number ``first_row``."""
    count = len(plan.joints)
    forecast = plan.forecast
    name = plan.robot.name or "Robot"
    moving = shown(plan)
    kinds = ["estimation" if word == "estimate" else "validation" for word in plan.sets]
    return View(
        moving.robot,
        None,
        moving.joints,
        labels=tuple(f"pose {k + 1} of {count}" for k in range(count)),
        kinds=tuple(kinds),
        nominal_target=moving.T_tip_target[0],
        title=f"{name}: {count} poses to measure",
        note=f"Expected error of a predicted position after the calibration: {1e3 * forecast.rms:.3f} mm rms over the "
        f"workspace, {1e3 * forecast.rms_low:.3f} to {1e3 * forecast.rms_high:.3f} mm in 90 % of calibrations.",
        names=((name, "as planned"),),
        numbers=_plan_numbers(plan, first_row),
    )


def _plan_numbers(plan: PlanValues, first_row: int) -> dict[str, tuple[str, ...]]:
    """Return what is shown in words for each pose of a plan: its joint values and where its targets are expected.

    Args:
        plan: The plan, of K poses and T targets.
        first_row: Number of the first row of its table; each target has a row, and a point named after it.

    Returns:
        K texts by what they are about: millimetres and degrees.
    """
    moving = shown(plan)
    numbers = joint_texts(moving.robot, moving.joints)
    if plan.sight is None:
        numbers |= _target_numbers(plan, first_row)
    else:
        numbers |= _image_numbers(plan, first_row)
    measured = np.concatenate([plan.taken, plan.estimation])
    sensitivity = sensitivity_of(plan.robot, plan.cell, plan.sight)
    error = position_std(sensitivity, measured, plan.joints).max(axis=1)
    numbers["expected error once calibrated"] = tuple(
        f"{1e3 * value:.3f} mm rms" for value in error
    )
    return numbers


def _image_numbers(plan: PlanValues, first_row: int) -> dict[str, tuple[str, ...]]:
    """Return the name of each image, and where the board is in it, in words; see `_plan_numbers`."""
    distances, tilts = distances_and_tilts(plan)
    return {
        "image": tuple(image_name(first_row + k) for k in range(len(plan.joints))),
        "distance of the board": tuple(f"{1e3 * value:.0f} mm" for value in distances),
        "tilt of the board": tuple(f"{value:.1f} deg" for value in np.degrees(tilts)),
    }


def _target_numbers(plan: PlanValues, first_row: int) -> dict[str, tuple[str, ...]]:
    """Return the points of each pose and where its targets are expected, in words; see `_plan_numbers`."""
    numbers: dict[str, tuple[str, ...]] = {}
    count = len(plan.targets)
    points = first_row + np.arange(len(plan.joints) * count).reshape(-1, count)
    for k, target in enumerate(plan.targets):
        suffix = f" of {target}" if count > 1 else ""
        numbers[f"point{suffix}"] = tuple(f"P{number}" for number in points[:, k])
        for axis, values in zip("xyz", 1e3 * plan.expected[:, k].T + 0.0, strict=True):
            numbers[f"expected {axis}{suffix}"] = tuple(f"{value:.3f} mm" for value in values)
    return numbers


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


def _sight_keys(plan: PlanValues) -> list[Key]:
    """Return the entries of the legend of the tracker and its lines of sight, which the script draws."""
    if plan.cell.tracker is None:
        return []
    return [
        Key("tracker and its line of sight", BEAM, "tracker"),
        Key("lines of sight to all poses", BEAM, "sight", on=False),
    ]


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
