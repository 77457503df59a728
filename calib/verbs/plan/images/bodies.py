"""Camera and board as bodies: what the robot must not touch, and what must not come between them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from pinocchio import hppfcl

from calib.basics.arrays import Array, Mask, rigid_inverse
from calib.data.cell import Box
from calib.robot.robot import Robot
from calib.verbs.plan.collision import CollisionCheck, CollisionModel
from calib.verbs.plan.images.sight import CameraSight, outline
from calib.verbs.plan.notes import Note
from calib.verbs.plan.solids import Solid, box_solids, rods

#: Thickness of a board, behind its print [m].
_THICKNESS = 0.010

#: A camera is a ball of this radius around its centre of projection [m].
_CAMERA_RADIUS = 0.035

#: The view of a corner begins so far in front of the camera [m]: its housing and its mount do not count.
_AHEAD = 0.060


class ImageBodies(NamedTuple):
    """The robot with camera and board, and boxes around it."""

    #: Tests poses and moves.
    model: CollisionModel
    #: Shape (3,), position of the camera in its link [m].
    eye: Array
    #: Shape (5, 4, 4), points of the board that must not be hidden, as poses in the link that carries it [m].
    T_tip_points: Array

    @classmethod
    def of(
        cls, robot: Robot, sight: CameraSight, boxes: Iterable[Box], check: CollisionCheck
    ) -> ImageBodies:
        """Make the bodies of a camera that sees a board.

        Args:
            robot: The robot, from the camera's link to the board's link.
            sight: The camera and the board.
            boxes: Obstacles, in the frame of the base; where the base moves, as with a camera in the hand, in that of
                the tip.
            check: How poses are checked.

        Returns:
            The robot with these bodies.

        Raises:
            UrdfError: Pinocchio cannot read the URDF, a mesh is missing or cannot be read, or no link has a shape.
        """
        T_base_frame = rigid_inverse(sight.T_frame_base)
        standing = robot.rebuilt(base=robot.tip, tip=robot.base) if robot.base_moves else robot
        attached = [
            _board_solid(robot, sight),
            _camera_solid(robot, T_base_frame[:3, 3], check),
            *box_solids(standing, boxes),
        ]
        model = CollisionModel.of(robot, check=check, attached=attached)
        model = replace(model, notes=_notes(model))
        points = np.concatenate([sight.board.centre[None], outline(sight.board)])
        T_tip_points = np.tile(sight.T_tip_board, (len(points), 1, 1))
        T_tip_points[:, :3, 3] += points @ sight.T_tip_board[:3, :3].T
        return cls(model, T_base_frame[:3, 3], T_tip_points)

    def view_free(self, q: Array) -> Mask:
        """Test at which poses no link and no box is between the camera and the board's middle and corners.

        Args:
            q: Joint values of N poses, shape (N, m), [rad] or for sliding joints [m].

        Returns:
            Shape (N,).
        """
        free = np.ones(len(q), dtype=np.bool_)
        for T_tip_point in self.T_tip_points:
            still = np.flatnonzero(free)
            free[still] = self.model.beam_free(T_tip_point, self.eye, q[still], _AHEAD)
        return free


def _board_solid(robot: Robot, sight: CameraSight) -> Solid:
    """Return the board as a plate behind its pattern, half a square wider on all sides, fixed to the tip."""
    width, height = sight.board.size
    square = sight.board.square
    plate = hppfcl.Box(width + square, height + square, _THICKNESS)
    T_board_plate = np.eye(4)
    T_board_plate[:3, 3] = sight.board.centre
    T_board_plate[2, 3] += 0.5 * _THICKNESS
    return Solid("the board", "target", robot.tip, sight.T_tip_board @ T_board_plate, plate)


def _camera_solid(robot: Robot, position: Array, check: CollisionCheck) -> Solid:
    """Return the camera, fixed to the base: in the hand a rod from the link's origin, else a ball where it stands."""
    if robot.base_moves:
        T_base_rod, half_length = rods(np.zeros((1, 3)), position[None].copy())
        rod = hppfcl.Capsule(check.holder_radius, 2.0 * float(half_length[0]))
        return Solid("the camera", "target", robot.base, T_base_rod[0], rod)
    T_base_ball = np.eye(4)
    T_base_ball[:3, 3] = position
    return Solid("the camera", "target", robot.base, T_base_ball, hppfcl.Sphere(_CAMERA_RADIUS))


def _notes(model: CollisionModel) -> tuple[Note, ...]:
    """Return the notes of a collision model, the first of which is for a camera and a board, not for targets."""
    checked, *others = model.notes
    return (Note("images_checked", checked.values[1:]), *others)
