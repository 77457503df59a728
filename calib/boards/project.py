"""Pixels of a board's corners as OpenCV projects them, and which of them a camera sees.

Simulated pictures and tables of corners are computed here. Fits to them use lenses of their own, so that an error of
one does not hide in the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.basics.values import Value
from calib.boards.opencv import opencv
from calib.errors import CalibError

#: Smallest depth in the camera at which points are projected [m].
NEAREST = 1e-3

#: Name of the lens of `cv2.fisheye`; any other is that of `cv2.projectPoints`.
_FISHEYE = "fisheye"

#: Maximum number of iterations in which OpenCV undistorts a pixel.
_ITERATIONS = 15


class Camera(Protocol):
    """The attributes of a camera that projection needs; its frame has z along the line of sight, x right, y down."""

    @property
    def name(self) -> str:
        """Name, for messages."""

    @property
    def width(self) -> int:
        """Columns of the image [px]."""

    @property
    def height(self) -> int:
        """Rows of the image [px]."""

    @property
    def lens(self) -> str:
        """``"pinhole"`` or ``"fisheye"``."""

    @property
    def values(self) -> Array | None:
        """fx, fy, cx, cy [px], then the distortion as OpenCV has it; None: not known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sight(Value):
    """Conditions under which a corner counts as seen."""

    #: Smallest distance to the image's edges [px].
    margin: float = 10.0
    #: Largest angle between the board's normal and the line of sight [rad].
    tilt: float = np.deg2rad(65.0)


#: The usual sight.
USUAL_SIGHT = Sight()


def camera_matrix(camera: Camera) -> tuple[Array, Array]:
    """Return a camera's intrinsics as OpenCV takes them.

    Returns:
        K, shape (3, 3) [px], and the distortion, shape (4,) or (5,).

    Raises:
        CalibError: The intrinsics are not known.
    """
    if camera.values is None:
        raise CalibError(
            f"The camera '{camera.name}' has no focal length and principal point; nothing can be projected without "
            "them."
        )
    fx, fy, cx, cy = camera.values[:4]
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return K, np.asarray(camera.values[4:], dtype=np.float64)


def project(camera: Camera, points: Array) -> Array:
    """Project points in the frame of a camera to pixels, by OpenCV.

    Args:
        camera: The camera, whose intrinsics are known.
        points: In the camera's frame, shape (..., 3) [m].

    Returns:
        Pixels, shape (..., 2) [px]; NaN for points that are not in front of the camera.

    Raises:
        CalibError: The camera's intrinsics are not known, or OpenCV is not installed.
    """
    cv2 = opencv()
    K, distortion = camera_matrix(camera)
    flat = points.reshape(-1, 1, 3)
    pixels = np.full((len(flat), 2), np.nan)
    in_front = flat[:, 0, 2] > NEAREST
    if in_front.any():
        no_motion = np.zeros(3)
        function = cv2.fisheye.projectPoints if camera.lens == _FISHEYE else cv2.projectPoints
        found, _ = function(flat[in_front], no_motion, no_motion, K, distortion)
        pixels[in_front] = found.reshape(-1, 2)
    return pixels.reshape(*points.shape[:-1], 2)


def in_camera(T_camera_board: Array, points: Array) -> Array:
    """Return points of a board in the camera's frame.

    Args:
        T_camera_board: Poses of the board in the camera, shape (N, 4, 4) [m].
        points: In the board's frame, shape (n, 3) [m].

    Returns:
        shape (N, n, 3) [m].
    """
    R = T_camera_board[:, None, :3, :3]
    turned = (R @ points[None, :, :, None])[..., 0]
    return np.asarray(turned + T_camera_board[:, None, :3, 3])


def corner_pixels(
    camera: Camera, corners: Array, T_camera_board: Array, sight: Sight = USUAL_SIGHT
) -> tuple[Array, Mask]:
    """Project a board's corners, and determine which are seen.

    Args:
        camera: The camera, whose intrinsics are known.
        corners: In the board's frame, shape (n, 3) [m], see `calib.boards.printed.Print.corners`.
        T_camera_board: Poses of the board in the camera, shape (N, 4, 4) [m].
        sight: What counts as seen.

    Returns:
        Pixels, shape (N, n, 2) [px], NaN for points that are not in front of the camera; and whether each is seen,
        shape (N, n): in front of the camera and inside the image, on the board's face and not at too steep an angle.

    Raises:
        CalibError: The camera's intrinsics are not known, or OpenCV is not installed.
    """
    points = in_camera(T_camera_board, corners)
    pixels = project(camera, points)
    distance = np.linalg.norm(points, axis=-1)
    along_normal = np.einsum("Ni,Nni->Nn", T_camera_board[:, :3, 2], points)
    # z of a board points into the page: positive if the camera is on the side of its face.
    faces = along_normal >= np.cos(sight.tilt) * distance
    return pixels, in_image(pixels, (camera.width, camera.height), sight.margin) & faces


def in_image(pixels: Array, image_size: tuple[int, int], margin: float) -> Mask:
    """Mark the pixels that are inside an image.

    Args:
        pixels: shape (..., 2) [px].
        image_size: Width and height of the image [px].
        margin: Least distance from its edges, which are half a pixel outside the outermost pixels' centres [px].

    Returns:
        shape (...); False for NaN.
    """
    low = margin - 0.5
    high = np.array(image_size) - 0.5 - margin
    return np.asarray(((pixels >= low) & (pixels <= high)).all(axis=-1))


def rays(camera: Camera, pixels: Array) -> Array:
    """Undistort pixels by OpenCV, and return the rays on which their points lie.

    Args:
        camera: The camera, whose intrinsics are known.
        pixels: shape (n, 2) [px].

    Returns:
        In the camera's frame, shape (n, 3), z = 1.

    Raises:
        CalibError: The camera's intrinsics are not known, or OpenCV is not installed.
    """
    cv2 = opencv()
    K, distortion = camera_matrix(camera)
    flat = pixels.reshape(-1, 1, 2)
    end = (cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, _ITERATIONS, 1e-10)
    if camera.lens == _FISHEYE:
        undistorted = cv2.fisheye.undistortPoints(flat, K, distortion, criteria=end)
    elif hasattr(cv2, "undistortPointsIter"):  # OpenCV 4
        undistorted = cv2.undistortPointsIter(flat, K, distortion, None, None, end)
    else:
        undistorted = cv2.undistortPoints(flat, K, distortion, criteria=end)
    return np.column_stack([undistorted.reshape(-1, 2), np.ones(len(pixels))])
