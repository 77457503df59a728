"""A camera and a board in a cell: which is carried by which link, and what the camera sees at joint values.

    T_camera_board(q) = T_camera_base  T_base_tip(q)  T_tip_board

The chain's base is the link that carries the camera, its tip the link that carries the board.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.basics.values import Value
from calib.boards.board import Board
from calib.boards.printed import Print
from calib.boards.project import Sight, corner_pixels, in_camera
from calib.camera.camera import Camera
from calib.robot.robot import Robot


@dataclass(frozen=True, slots=True, eq=False)
class CameraScene(Value):
    """A robot, a camera on one of its links, and a board on another."""

    #: The chain from the camera's link to the board's.
    robot: Robot
    #: The camera, whose numbers are known.
    camera: Camera
    #: The board.
    printed: Print
    #: Pose of the camera's link in the camera, shape (4, 4) [m].
    T_camera_base: Array
    #: Pose of the board in its link, shape (4, 4) [m].
    T_tip_board: Array

    def board_poses(self, q: Array) -> Array:
        """Return the poses of the board in the camera at readings (N, m) [rad] or [m], shape (N, 4, 4) [m]."""
        return np.asarray(self.T_camera_base @ self.robot.poses(q) @ self.T_tip_board)


@dataclass(frozen=True, slots=True, kw_only=True)
class Framing(Value):
    """Conditions under which a picture shows the board well."""

    #: Distance of the corners from the image's edges [px].
    margin: float = 15.0
    #: Largest angle between the board's normal and the line of sight to its middle [rad].
    tilt: float = np.deg2rad(50.0)
    #: Least and greatest share of the image's width or height, whichever is more, that the corners span.
    fill: tuple[float, float] = (0.2, 0.8)


#: The usual framing.
USUAL_FRAMING = Framing()


class View(NamedTuple):
    """Visible corners, tilt and size of the board at N of its poses."""

    #: Number of corners that are seen, shape (N,).
    seen: Array
    #: Angle between the board's normal and the line of sight to its middle, shape (N,) [rad].
    tilt: Array
    #: Share of the image's width or height, whichever is more, that the corners span, shape (N,).
    fill: Array


def view(scene: CameraScene, T_camera_board: Array, framing: Framing = USUAL_FRAMING) -> View:
    """Describe what the camera sees.

    Args:
        scene: Has the camera and the board.
        T_camera_board: Poses of the board in the camera, shape (N, 4, 4) [m].
        framing: Has the margin that counts as seen.
    """
    camera = scene.camera
    sight = Sight(margin=framing.margin, tilt=np.pi / 2.0)
    pixels, is_seen = corner_pixels(camera, scene.printed.corners, T_camera_board, sight)
    spans = pixels.max(axis=1) - pixels.min(axis=1)
    fill = (spans / [camera.width, camera.height]).max(axis=1)
    middle = in_camera(T_camera_board, scene.printed.board.centre[None])[:, 0]
    along_normal = np.einsum("ni,ni->n", T_camera_board[:, :3, 2], middle)
    cosine = np.clip(along_normal / np.linalg.norm(middle, axis=1), -1.0, 1.0)
    return View(is_seen.sum(axis=1), np.arccos(cosine), fill)


def filling_distance(camera: Camera, board: Board) -> float:
    """Return from how far a board fills the image's width or height, whichever is full first [m]."""
    assert camera.values is not None
    focal_lengths = camera.values[:2]
    shares = focal_lengths * board.size / [camera.width, camera.height]
    return float(shares.max())


def is_framed(scene: CameraScene, T_camera_board: Array, framing: Framing = USUAL_FRAMING) -> Mask:
    """Return whether pictures show the whole board as it is to be shown.

    Args:
        scene: Has the camera and the board.
        T_camera_board: Poses of the board in the camera, shape (N, 4, 4) [m].
        framing: How it is to be shown.

    Returns:
        shape (N,).
    """
    seen, tilt, fill = view(scene, T_camera_board, framing)
    least, most = framing.fill
    is_whole = seen == len(scene.printed.corners)
    return np.asarray(is_whole & (tilt <= framing.tilt) & (fill >= least) & (fill <= most))
