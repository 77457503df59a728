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
from calib.instruments.instrument import Condition, Instrument
from calib.verbs.plan.collision import CollisionCheck, CollisionModel
from calib.verbs.plan.notes import Note
from calib.verbs.plan.sensitivity import Sensitivity
from calib.verbs.plan.solids import Solid, box_solids, rods

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
    setup = sensitivity.setup
    targets = dict(zip(setup.targets, setup.T_tip_target[:, :3, 3], strict=True))
    return CollisionModel.of(sensitivity.kinematics.robot, sensitivity.cell.boxes, targets, check)


@collision_model.register
def _(
    instrument: CameraInstrument, sensitivity: Sensitivity, check: CollisionCheck
) -> CollisionModel:
    """Return the robot with the camera, the board as a plate, and the cell's boxes.

    The boxes are in the frame of that link of camera and board that the robot does not move.
    """
    (sightline,) = sensitivity.sightlines
    robot, board = sightline.robot, instrument.board
    width, height = board.size
    plate = hppfcl.Box(width + board.square, height + board.square, _THICKNESS)
    T_board_plate = np.eye(4)
    T_board_plate[:3, 3] = board.centre
    T_board_plate[2, 3] += 0.5 * _THICKNESS
    if robot.base_moves:
        T_base_rods, half_lengths = rods(np.zeros((1, 3)), sightline.eye[None].copy())
        T_base_camera = T_base_rods[0]
        housing = hppfcl.Capsule(check.holder_radius, 2.0 * float(half_lengths[0]))
    else:
        T_base_camera = np.eye(4)
        T_base_camera[:3, 3] = sightline.eye
        housing = hppfcl.Sphere(_CAMERA_RADIUS)
    standing = robot.rebuilt(base=robot.tip, tip=robot.base) if robot.base_moves else robot
    attached = [
        Solid("the board", "target", robot.tip, sightline.T_tip_target @ T_board_plate, plate),
        Solid("the camera", "target", robot.base, T_base_camera, housing),
        *box_solids(standing, sensitivity.cell.boxes),
    ]
    model = CollisionModel.of(robot, check=check, attached=attached)
    # The first note is on targets and their holders: their radius, then the names of the surroundings.
    checked, *others = model.notes
    return replace(model, notes=(Note("images_checked", checked.values[1:]), *others))


def free_lines_of_sight(sensitivity: Sensitivity, body: CollisionModel) -> Iterator[Condition]:
    """Yield a condition for each point that must not be hidden: no link and no box is between it and the instrument.

    Args:
        sensitivity: The nominal robot in its cell, with its instrument and targets; without the instrument's place no
            condition is yielded.
        body: The robot and the boxes, any of which may hide a point.
    """
    instrument = sensitivity.instrument
    for sightline in sensitivity.sightlines:
        for point in instrument.points:
            T_tip_point = sightline.T_tip_target.copy()
            T_tip_point[:3, 3] += sightline.T_tip_target[:3, :3] @ point
            passes = partial(body.beam_free, T_tip_point, sightline.eye, ahead=instrument.ahead)
            yield Condition("beam", passes)
