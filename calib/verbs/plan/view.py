"""The pages of a plan and of a region: one HTML file each.

A plan: the robot at one pose after the other, in the order to drive, with its numbers; the targets of all poses, the
boxes about it, and the tracker with its lines of sight. A region: its voxels as coloured points about the nominal
robot, in bands by density. Each can be shown and hidden.
"""

from __future__ import annotations

import meshcat
import numpy as np

from calib.basics.arrays import Array
from calib.show.look import BEAM, ESTIMATION, VALIDATION
from calib.show.scene.html_page import Key, Page
from calib.show.scene.scene import (
    Dots,
    draw_boxes,
    draw_dots,
    draw_lines,
)
from calib.verbs.plan.forecast import position_std
from calib.verbs.plan.images.plan_file import distances_and_tilts, image_name
from calib.verbs.plan.images.sensitivity import sensitivity_of
from calib.verbs.plan.images.view import shown
from calib.verbs.plan.plan import Plan
from calib.verbs.view.page import WAY_COLOUR, About, view_page
from calib.verbs.view.view import View, joint_texts

#: Radius of a target's ball, as a part of the scene's size.
_BALL = 0.008


#: Colour of the boxes.
_BOXES_COLOUR = "#b9a58c"

#: Colour of poses measured already.
_TAKEN_COLOUR = "#8a94a0"


def plan_page(plan: Plan, *, first_row: int = 1) -> Page:
    """Make the page of a plan: the robot at each pose, in the order to drive, with its numbers.

    Args:
        plan: The plan.
        first_row: Number of the first row of its table, see `calib.verbs.plan.plan_file.write_plan`.
    """
    view = _plan_view(plan, first_row)
    plan = shown(plan)
    places = plan.places(plan.joints)
    taken = plan.places(plan.taken).reshape(-1, 3)

    def draw(group: meshcat.Visualizer, size: float) -> list[Key]:
        keys = draw_dots(group, _plan_dots(plan, places, taken), _BALL * size)
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


def _plan_view(plan: Plan, first_row: int) -> View:
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


def _plan_numbers(plan: Plan, first_row: int) -> dict[str, tuple[str, ...]]:
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


def _image_numbers(plan: Plan, first_row: int) -> dict[str, tuple[str, ...]]:
    """Return the name of each image, and where the board is in it, in words; see `_plan_numbers`."""
    distances, tilts = distances_and_tilts(plan)
    return {
        "image": tuple(image_name(first_row + k) for k in range(len(plan.joints))),
        "distance of the board": tuple(f"{1e3 * value:.0f} mm" for value in distances),
        "tilt of the board": tuple(f"{value:.1f} deg" for value in np.degrees(tilts)),
    }


def _target_numbers(plan: Plan, first_row: int) -> dict[str, tuple[str, ...]]:
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


def _plan_dots(plan: Plan, places: Array, taken: Array) -> tuple[Dots, ...]:
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
        Dots("estimate", ESTIMATION, estimate, places[chosen]),
        Dots("validate", VALIDATION, validate, places[~chosen]),
        Dots("taken", _TAKEN_COLOUR, f"measured already, {len(plan.taken)}", taken),
    )


def _draw_boxes_of(scene: meshcat.Visualizer, plan: Plan) -> list[Key]:
    """Draw the boxes of the cell, if there are any; return their entry of the legend."""
    boxes = plan.cell.boxes
    if not boxes:
        return []
    sizes = [box.size for box in boxes]
    poses = [box.T_base_box for box in boxes]
    draw_boxes(scene["around"], sizes, poses, _BOXES_COLOUR)
    return [Key(", ".join(box.name for box in boxes), _BOXES_COLOUR, "around")]


def _sight_keys(plan: Plan) -> list[Key]:
    """Return the entries of the legend of the tracker and its lines of sight, which the script draws."""
    if plan.cell.tracker is None:
        return []
    return [
        Key("tracker and its line of sight", BEAM, "tracker"),
        Key("lines of sight to all poses", BEAM, "sight", on=False),
    ]


def _box_ends(plan: Plan) -> Array:
    """Return two points of each box of the cell, shape (K, 3), in the base [m], that the camera sees."""
    ends = []
    for box in plan.cell.boxes:
        middle = box.T_base_box[:3, 3]
        ends += [middle - 0.5 * box.size, middle + 0.5 * box.size]
    return np.reshape(ends, (-1, 3))
