"""The page of a plan: one HTML file with the robot at one pose after the other, in the order to drive.

It has the numbers of each pose, the targets of all poses, the boxes around the robot, and the tracker with its lines of
sight. Each can be shown and hidden. The robot stands on its foot, even if the chain begins at a camera in its hand.
"""

from __future__ import annotations

from dataclasses import replace
from functools import singledispatch

import meshcat
import numpy as np

from calib.basics.arrays import read_only, rigid_inverse
from calib.data.cell import Box
from calib.instruments.camera import CameraInstrument
from calib.instruments.instrument import Instrument
from calib.show.look import BEAM, ESTIMATION, VALIDATION
from calib.show.scene.html_page import LegendEntry, Page
from calib.show.scene.scene import (
    Dots,
    draw_boxes,
    draw_dots,
    draw_lines,
)
from calib.verbs.plan.approach import side_name
from calib.verbs.plan.forecast import position_std
from calib.verbs.plan.plan import Plan
from calib.verbs.plan.plan_file import distances_and_tilts, image_name
from calib.verbs.plan.sensitivity import Sensitivity
from calib.verbs.view.robots_page import WAY_COLOUR, About, view_page
from calib.verbs.view.view import View, joint_texts

#: Radius of a target's ball, as a share of the scene's size.
_BALL = 0.008

#: Colour of the boxes.
_BOXES_COLOUR = "#b9a58c"

#: Colour of poses measured already.
_TAKEN_COLOUR = "#8a94a0"

#: Thickness of a board, and edge of a camera that stands [m].
_THICKNESS = 0.004
_CAMERA = 0.05


def plan_page(plan: Plan, *, first_row: int = 1) -> Page:
    """Make the page of a plan in 3D: the robot at each pose, in the order to drive, with targets, boxes and numbers.

    Args:
        plan: The plan.
        first_row: Number of the first row or image of its table, see `calib.verbs.plan.plan_file.write_plan`.
    """
    moving = on_foot(plan.instrument, plan)
    count, forecast = len(plan.joints), plan.forecast
    poses = f"{count} poses to measure"
    if plan.request.approach == "both":
        poses = f"{count // 2} poses to measure, each from both sides"
    name = plan.robot.name or "Robot"
    kinds = ["estimation" if word == "estimate" else "validation" for word in plan.sets]
    fitted, moves = plan.fitted
    sensitivity = Sensitivity.of(plan.robot, plan.cell, plan.instrument)
    error = position_std(sensitivity, fitted, plan.joints, moves).max(axis=1)
    view = View(
        moving.robot,
        None,
        moving.joints,
        labels=tuple(f"pose {k + 1} of {count}" for k in range(count)),
        kinds=tuple(kinds),
        nominal_target=moving.T_tip_target[0],
        title=f"{name}: {poses}",
        note=f"Expected error of a predicted position after the calibration: {1e3 * forecast.rms:.3f} mm rms over the "
        f"workspace, {1e3 * forecast.rms_low:.3f} to {1e3 * forecast.rms_high:.3f} mm in 90 % of calibrations.",
        names=((name, "as planned"),),
        numbers={
            **joint_texts(moving.robot, moving.joints),
            **_approaches(plan),
            **_numbers(plan.instrument, plan, first_row),
            "expected error once calibrated": tuple(f"{1e3 * value:.3f} mm rms" for value in error),
        },
    )

    places = moving.places(moving.joints)
    taken = moving.places(moving.taken).reshape(-1, 3)
    tracker, boxes = plan.cell.tracker, moving.cell.boxes

    def draw(group: meshcat.Visualizer, size: float) -> list[LegendEntry]:
        chosen = np.array(moving.sets) == "estimate"
        estimate = f"to estimate from, {chosen.sum()}"
        validate = f"to validate with, {(~chosen).sum()}"
        dots = (
            Dots("estimate", ESTIMATION, estimate, places[chosen]),
            Dots("validate", VALIDATION, validate, places[~chosen]),
            Dots("taken", _TAKEN_COLOUR, f"measured already, {len(moving.taken)}", taken),
        )
        keys = draw_dots(group, dots, _BALL * size)
        if boxes:
            sizes = [box.size for box in boxes]
            draw_boxes(group["around"], sizes, [box.T_base_box for box in boxes], _BOXES_COLOUR)
            keys.append(LegendEntry(", ".join(box.name for box in boxes), _BOXES_COLOUR, "around"))
        if tracker is not None:  # the page's script draws it
            keys.append(LegendEntry("tracker and its line of sight", BEAM, "tracker"))
            keys.append(LegendEntry("lines of sight to all poses", BEAM, "sight", on=False))
        keys.append(LegendEntry("line to the next pose", WAY_COLOUR, "next"))
        ways = np.stack([places[:-1, 0], places[1:, 0]], axis=1)
        draw_lines(group["way"], ways, WAY_COLOUR, 0.55)
        keys.append(LegendEntry("order of all poses", WAY_COLOUR, "way", on=False))
        return keys

    ends = []
    for box in boxes:
        middle = box.T_base_box[:3, 3]
        ends += [middle - 0.5 * box.size, middle + 0.5 * box.size]
    about = About(
        points=np.concatenate([places.reshape(-1, 3), taken, np.reshape(ends, (-1, 3))]),
        draw=draw,
        tracker=None if tracker is None else tracker.position,
        targets=places,
    )
    return view_page(view, about=about)


@singledispatch
def on_foot(_instrument: Instrument, plan: Plan) -> Plan:
    """Return a plan whose chain leads from what stands to what the robot carries, for the viewer.

    What the robot carries is the target of that plan: an instrument in its hand, with the board as a box of the cell,
    or the board, with the camera as a box.
    """
    return plan


@on_foot.register
def _(instrument: CameraInstrument, plan: Plan) -> Plan:
    """Return the plan of a camera from the foot to the hand, with a box where the camera or the board stands."""
    sightline, robot = plan.sightline, plan.robot
    T_base_camera = rigid_inverse(sightline.T_instrument_base)
    T_tip_middle = sightline.T_tip_target.copy()
    T_tip_middle[:3, 3] += sightline.T_tip_target[:3, :3] @ instrument.board.centre
    joints, taken = plan.joints, plan.taken
    if robot.base_moves:
        robot = robot.rebuilt(base=robot.tip, tip=robot.base)
        columns = [plan.robot.joint_names.index(name) for name in robot.joint_names]
        joints, taken = joints[:, columns], taken[:, columns]
        size = np.array([*instrument.board.size, _THICKNESS])
        carried, standing = T_base_camera, Box("board", size, T_tip_middle)
    else:
        carried, standing = T_tip_middle, Box("camera", np.full(3, _CAMERA), T_base_camera)
    return replace(
        plan,
        robot=robot,
        cell=replace(plan.cell, boxes=(*plan.cell.boxes, standing)),
        joints=read_only(joints),
        taken=read_only(taken),
        T_tip_target=read_only(carried[None]),
        views=(replace(plan.views[0], targets=(0,), chain=0),),
    )


def _approaches(plan: Plan) -> dict[str, tuple[str, ...]]:
    """Return where each joint comes from, in words for each pose; nothing for poses that are approached straight."""
    if plan.via is None:
        return {}
    texts = []
    for move in plan.moves:
        steps = []
        for joint, value in zip(plan.robot.inputs, np.abs(move), strict=True):
            slides = joint.type == "prismatic"
            steps.append(f"{1e3 * value:.3g} mm" if slides else f"{np.degrees(value):.3g} deg")
        texts.append(f"{side_name(move)} by {' / '.join(dict.fromkeys(steps))}")
    return {"approach": tuple(texts)}


@singledispatch
def _numbers(_instrument: Instrument, plan: Plan, first_row: int) -> dict[str, tuple[str, ...]]:
    """Return texts for each pose, by their labels: the names of its points, and where its targets are expected [mm]."""
    numbers: dict[str, tuple[str, ...]] = {}
    count = len(plan.targets)
    # The pose to come from has the row before.
    rows = count if plan.via is None else count + 1
    points = first_row + np.arange(len(plan.joints) * rows).reshape(-1, rows)[:, -count:]
    for k, target in enumerate(plan.targets):
        suffix = f" of {target}" if count > 1 else ""
        numbers[f"point{suffix}"] = tuple(f"P{number}" for number in points[:, k])
        for axis, values in zip("xyz", 1e3 * plan.expected[:, k].T + 0.0, strict=True):
            numbers[f"expected {axis}{suffix}"] = tuple(f"{value:.3f} mm" for value in values)
    return numbers


@_numbers.register
def _(instrument: CameraInstrument, plan: Plan, first_row: int) -> dict[str, tuple[str, ...]]:
    """Return texts for each pose, by their labels: the name of the image, and distance and tilt of the board."""
    distances, tilts = distances_and_tilts(instrument, plan)
    group, _ = plan.sights[0]
    return {
        "image": tuple(image_name(first_row + k, group) for k in range(len(plan.joints))),
        "distance of the board": tuple(f"{1e3 * value:.0f} mm" for value in distances),
        "tilt of the board": tuple(f"{value:.1f} deg" for value in np.degrees(tilts)),
    }
