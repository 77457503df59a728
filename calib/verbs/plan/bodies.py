"""Bodies of a plan: the robot with what it holds and its surroundings, to be checked for collisions.

A rod from the tip stands for a target of a tracker and what holds it, a plate for a board, half a square wider than its
pattern on all sides, and for a camera a rod if it is in the hand, or else a ball.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial, singledispatch

import numpy as np
from pinocchio import hppfcl

from calib.instruments.camera import CameraInstrument
from calib.instruments.instrument import Condition, Instrument, Sightline
from calib.verbs.plan.collision import CollisionCheck, CollisionModel
from calib.verbs.plan.notes import Note
from calib.verbs.plan.sensitivity import Sensitivity, View
from calib.verbs.plan.solids import Solid, box_solids, rods, target_solids

#: Thickness of a board, on the side away from the camera [m].
_THICKNESS = 0.010

#: Radius of the ball around the centre of projection of a camera that stands [m].
_CAMERA_RADIUS = 0.035


@singledispatch
def collision_model(
    _instrument: Instrument, sensitivity: Sensitivity, check: CollisionCheck
) -> CollisionModel:
    """Return the robot with its targets and the cell's boxes, which tests poses and moves for collisions.

    Args:
        _instrument: The instrument that measures the targets.
        sensitivity: The nominal robot in its cell, with the places of the targets.
        check: Clearance, radius of what holds the targets, and folders of meshes.

    Raises:
        UrdfError: Pinocchio cannot read the URDF, a mesh is missing or cannot be read, or no link has a shape.
    """
    if len(sensitivity.views) > 1:
        return _model_of_views(sensitivity, check)
    setup = sensitivity.setup
    targets = dict(zip(setup.targets, setup.T_tip_target[:, :3, 3], strict=True))
    return CollisionModel.of(sensitivity.kinematics.robot, sensitivity.cell.boxes, targets, check)


def _model_of_views(sensitivity: Sensitivity, check: CollisionCheck) -> CollisionModel:
    """Return the robot with what stands on the links of several views: targets of trackers, or cameras and boards.

    The boxes are in the frame of the cell's base, or else the root.
    """
    robot, setup = sensitivity.kinematics.robot, sensitivity.setup
    home = sensitivity.cell.base or robot.urdf.root
    carried: dict[tuple[str, int], Solid] = {}
    for view in sensitivity.views:
        chain = robot.chains[view.chain]
        if isinstance(view.instrument, CameraInstrument):
            (sightline,) = sensitivity.sightlines_of(view)
            (t,) = view.targets
            _, from_root = robot.urdf.chain(robot.urdf.root, chain.base)
            in_hand = any(robot.urdf.joint(name).type != "fixed" for name in from_root)
            names = setup.groups[view.frame], setup.targets[t]
            camera, board = (
                f"the {what} '{name}'"
                for what, name in zip(("camera", "board"), names, strict=True)
            )
            carried["board", t] = _plate(view.instrument, sightline, board)
            carried["camera", view.frame] = _housing(sightline, check, camera, in_hand=in_hand)
            continue
        for t in view.targets:
            places = {setup.targets[t]: setup.T_tip_target[t, :3, 3]}
            (carried["target", t],) = target_solids(chain, places, check.holder_radius)
    boxes = [solid._replace(link=home) for solid in box_solids(robot, sensitivity.cell.boxes)]
    model = CollisionModel.of(robot, check=check, attached=[*carried.values(), *boxes])
    if not isinstance(sensitivity.instrument, CameraInstrument):
        return model
    return _with_note_of_images(model)


def _plate(instrument: CameraInstrument, sightline: Sightline, name: str) -> Solid:
    """Return the board of a camera as a plate on its link."""
    board = instrument.board
    width, height = board.size
    plate = hppfcl.Box(width + board.square, height + board.square, _THICKNESS)
    T_board_plate = np.eye(4)
    T_board_plate[:3, 3] = board.centre
    T_board_plate[2, 3] += 0.5 * _THICKNESS
    return Solid(name, "target", sightline.robot.tip, sightline.T_tip_target @ T_board_plate, plate)


def _housing(sightline: Sightline, check: CollisionCheck, name: str, *, in_hand: bool) -> Solid:
    """Return a camera as a rod from the link in whose hand it is, or as a ball where it stands."""
    base = sightline.robot.base
    if in_hand:
        T_base_rods, half_lengths = rods(np.zeros((1, 3)), sightline.eye[None].copy())
        housing = hppfcl.Capsule(check.holder_radius, 2.0 * float(half_lengths[0]))
        return Solid(name, "target", base, T_base_rods[0], housing)
    T_base_camera = np.eye(4)
    T_base_camera[:3, 3] = sightline.eye
    return Solid(name, "target", base, T_base_camera, hppfcl.Sphere(_CAMERA_RADIUS))


def _with_note_of_images(model: CollisionModel) -> CollisionModel:
    """Return a model whose first note is on cameras and boards, not on targets and the radius of their holders."""
    checked, *others = model.notes
    return replace(model, notes=(Note("images_checked", checked.values[1:]), *others))


@collision_model.register
def _(
    instrument: CameraInstrument, sensitivity: Sensitivity, check: CollisionCheck
) -> CollisionModel:
    """Return the robot with the camera, the board as a plate, and the cell's boxes.

    The boxes are in the frame of that link of camera and board that the robot does not move.
    """
    if len(sensitivity.views) > 1:
        return _model_of_views(sensitivity, check)
    (sightline,) = sensitivity.sightlines
    robot = sightline.robot
    standing = robot.rebuilt(base=robot.tip, tip=robot.base) if robot.base_moves else robot
    attached = [
        _plate(instrument, sightline, "the board"),
        _housing(sightline, check, "the camera", in_hand=robot.base_moves),
        *box_solids(standing, sensitivity.cell.boxes),
    ]
    return _with_note_of_images(CollisionModel.of(robot, check=check, attached=attached))


def free_lines_of_sight(
    sensitivity: Sensitivity, body: CollisionModel, view: View | None = None
) -> Iterator[Condition]:
    """Yield a condition for each point that must not be hidden: no link and no box is between it and the instrument.

    Args:
        sensitivity: The nominal robot in its cell, with its instrument and targets; without the instrument's place no
            condition is yielded.
        body: The robot and the boxes, any of which may hide a point.
        view: The instrument and its targets; None: the first of the cell.
    """
    view = view or sensitivity.views[0]
    instrument = view.instrument
    for sightline in sensitivity.sightlines_of(view):
        along = replace(body, robot=sightline.robot)
        for point in instrument.points:
            T_tip_point = sightline.T_tip_target.copy()
            T_tip_point[:3, 3] += sightline.T_tip_target[:3, :3] @ point
            passes = partial(along.beam_free, T_tip_point, sightline.eye, ahead=instrument.ahead)
            yield Condition("beam", passes)
