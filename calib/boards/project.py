"""Pixels of a board's corners as OpenCV projects them, and which of them a camera sees.

What simulates pictures and tables of corners: none of the code of the fit, whose lenses are `calib.camera.lenses`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from calib.basics.arrays import Array, Mask
from calib.basics.values import Value
from calib.boards.opencv import opencv
from calib.errors import CalibError

#: Nearer than this to the camera's plane nothing is projected [m].
NEAREST = 1e-3

#: Name of the lens that OpenCV's `cv2.fisheye` has; the other is that of `cv2.projectPoints`.
_FISHEYE = "fisheye"

#: Iterations of OpenCV's search for the ray of a pixel.
_ITERATIONS = 15


class Camera(Protocol):
    """A camera as OpenCV needs it; z along the line of sight, x right, y down."""

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
        """fx, fy, cx, cy [px], then the distortion; None: not known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sight(Value):
    """Conditions under which a corner counts as seen."""

    #: Distance that corners keep to the image's edges [px].
    margin: float = 10.0
    #: Largest angle between the board's normal and the line of sight [rad].
    tilt: float = np.deg2rad(65.0)


#: The usual sight.
USUAL_SIGHT = Sight()


def camera_matrix(camera: Camera) -> tuple[Array, Array]:
    """Return a camera's numbers as OpenCV takes them.

    Returns:
        K, shape (3, 3) [px], and the distortion, shape (4,) or (5,).

    Raises:
        CalibError: The camera's numbers are not known.
    """
    if camera.values is None:
        raise CalibError(
            f"The camera '{camera.name}' has no focal length and principal point; nothing can be projected without."
        )
    fx, fy, cx, cy = camera.values[:4]
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return K, np.asarray(camera.values[4:], dtype=np.float64)


def project(camera: Camera, points: Array) -> Array:
    """Project points by OpenCV.

    Args:
        camera: The camera, whose numbers are known.
        points: In the camera's frame, shape (..., 3) [m].

    Returns:
        Pixels, shape (..., 2) [px]; NaN for points that are not in front of the camera.

    Raises:
        CalibError: The camera's numbers are not known.
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
    """Return points of a board in the camera.

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
    """Project a board's corners, and say which are seen.

    Args:
        camera: The camera, whose numbers are known.
        corners: In the board's frame, shape (n, 3) [m], see `calib.boards.printed.Print.corners`.
        T_camera_board: Poses of the board in the camera, shape (N, 4, 4) [m].
        sight: What counts as seen.

    Returns:
        Pixels, shape (N, n, 2) [px], NaN for points that are not in front of the camera; and whether each is seen,
        shape (N, n): in front, in the image with the margin, the board's face towards the camera and not too steep.

    Raises:
        CalibError: The camera's numbers are not known.
    """
    points = in_camera(T_camera_board, corners)
    pixels = project(camera, points)
    distance = np.linalg.norm(points, axis=-1)
    along_normal = np.einsum("Ni,Nni->Nn", T_camera_board[:, :3, 2], points)
    # z of a board points into the page: positive where the camera is before its face.
    faces = along_normal >= np.cos(sight.tilt) * distance
    return pixels, in_image(camera, pixels, sight.margin) & faces


def in_image(camera: Camera, pixels: Array, margin: float) -> Mask:
    """Return whether pixels (..., 2) [px] are in the image and keep a margin to its edges [px], shape (...)."""
    low = margin - 0.5
    high = np.array([camera.width, camera.height]) - 0.5 - margin
    # NaN compares as not in the image.
    return np.asarray(((pixels >= low) & (pixels <= high)).all(axis=-1))


def rays(camera: Camera, pixels: Array) -> Array:
    """Return the rays of pixels by OpenCV.

    Args:
        camera: The camera, whose numbers are known.
        pixels: shape (n, 2) [px].

    Returns:
        In the camera's frame, shape (n, 3), z = 1.

    Raises:
        CalibError: The camera's numbers are not known.
    """
    K, distortion = camera_matrix(camera)
    undistorted = _undistort(camera, pixels.reshape(-1, 1, 2), K, distortion)
    return np.column_stack([undistorted.reshape(-1, 2), np.ones(len(pixels))])


def _undistort(camera: Camera, pixels: Array, K: Array, distortion: Array) -> Any:  # noqa: ANN401  OpenCV has no types
    """Return the pixels (n, 1, 2) [px] of a camera without distortion and with focal length 1, shape (n, 1, 2)."""
    cv2 = opencv()
    end = (cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, _ITERATIONS, 1e-10)
    if camera.lens == _FISHEYE:
        return cv2.fisheye.undistortPoints(pixels, K, distortion, criteria=end)
    if hasattr(cv2, "undistortPointsIter"):  # OpenCV 4
        return cv2.undistortPointsIter(pixels, K, distortion, None, None, end)
    return cv2.undistortPoints(pixels, K, distortion, criteria=end)
