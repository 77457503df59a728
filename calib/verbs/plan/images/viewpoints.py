"""Viewpoints: poses of a board in a camera from which it is measured well, spread over distance, tilt, roll and image.

With the ray r of a random pixel, a distance d, a tilt t in a random direction and a random roll, the centre of the
board is at d r, and its normal t away from r.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array
from calib.camera.lenses import LENSES
from calib.verbs.plan.images.sight import CameraSight, intrinsics

#: Random numbers of a viewpoint: pixel (2), distance, tilt, direction of the tilt, roll.
NUMBERS = 6


def viewpoints(sight: CameraSight, unit: Array) -> Array:
    """Return poses of a board in a camera, within the limits of distance and tilt, its centre anywhere in the image.

    Tilts are spread evenly: a board that is always seen head on tells little of focal length and distance. Of distances
    the reciprocals are: as many views of a large board as of a small one.

    Args:
        sight: The camera, the board, and where the board may be.
        unit: Random numbers between 0 and 1, shape (n, 6).

    Returns:
        T_camera_board, shape (n, 4, 4), [m].
    """
    limits = sight.limits
    rays = _rays(sight, unit[:, :2])
    nearness = 1.0 / limits.farthest + unit[:, 2] * (1.0 / limits.nearest - 1.0 / limits.farthest)
    rotations = _turns(rays, limits.tilt * unit[:, 3], 2.0 * np.pi * unit[:, 4:])
    T = np.tile(np.eye(4), (len(unit), 1, 1))
    T[:, :3, :3] = rotations
    T[:, :3, 3] = rays / nearness[:, None] - rotations @ sight.board.centre
    return T


def _rays(sight: CameraSight, unit: Array) -> Array:
    """Return unit vectors in the camera to pixels; numbers between 0 and 1 (n, 2) are shares of width and height."""
    camera = sight.camera
    pixels = unit * [camera.width, camera.height] - 0.5
    rays = LENSES[camera.lens].undistort(pixels, intrinsics(camera))
    rays = np.where(np.isfinite(rays), rays, [0.0, 0.0, 1.0])
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _turns(rays: Array, tilts: Array, angles: Array) -> Array:
    """Return orientations of a board in the camera.

    Args:
        rays: Unit vectors from the camera to the board, shape (n, 3).
        tilts: Angles between ray and normal, shape (n,), [rad].
        angles: Direction of the tilt about the ray, and roll about the normal, shape (n, 2), [rad].

    Returns:
        R_camera_board, shape (n, 3, 3).
    """
    # The smallest turn that brings z onto the ray.
    axis = np.cross([0.0, 0.0, 1.0], rays)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine, rays[:, 2:])
    towards = Rotation.from_rotvec(axis / np.where(sine > 0.0, sine, 1.0) * angle)
    direction = np.column_stack([np.cos(angles[:, 0]), np.sin(angles[:, 0]), np.zeros(len(rays))])
    tilt = Rotation.from_rotvec(direction * tilts[:, None])
    roll = Rotation.from_rotvec(angles[:, 1:] * [0.0, 0.0, 1.0])
    return np.asarray((towards * tilt * roll).as_matrix())
