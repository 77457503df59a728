"""Sight of a camera: whether it sees a printed board at a pose of the robot, sharp, not too slanted, not too small.

The board's pose in the camera is T_camera_board = T_frame_base T_base_tip(q) T_tip_board, with the link that carries
the camera as the base of the chain and the link that carries the board as its tip.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, Mask, read_only, rigid_inverse
from calib.basics.values import Value
from calib.boards.board import CHESSBOARD, Board
from calib.camera.camera import Camera
from calib.camera.lenses import LENSES
from calib.errors import CalibError
from calib.robot.robot import Robot

#: Shares of the image's diagonal that the board's diagonal fills at the nearest and at the farthest distance.
_FILLED = (0.80, 0.15)

#: Margin at the edges of the image, as a share of its width.
_MARGIN = 0.01

#: Largest angle between the line of sight and the board's normal [rad]: detection loses precision beyond.
LARGEST_TILT = math.radians(55.0)

#: Focal length of a camera of which nothing is known, as a share of the image's width: 64 deg from left to right.
_ASSUMED_FOCAL = 0.8

#: A point this much beyond the widest ray of the image [rad] can be in it only where the lens polynomial folds back.
_BEYOND = 0.02

#: The widest ray where the lens cannot be inverted at the edges of the image [rad].
_WIDEST = math.radians(80.0)


@dataclass(frozen=True, slots=True, eq=False)
class SightLimits(Value):
    """Limits of where a board may be in the camera."""

    #: Least distance of the board's centre from the camera [m].
    nearest: float
    #: Largest distance of the board's centre from the camera [m].
    farthest: float
    #: Largest angle between the line of sight and the board's normal [rad].
    tilt: float = LARGEST_TILT
    #: Share of the corners that must be in the image; 1: the whole pattern.
    share: float = 1.0
    #: Width of a strip at the edges of the image in which no corner counts [px].
    margin: float = 0.0

    def __post_init__(self) -> None:
        """Refuse limits that no board can keep."""
        if not 0.0 < self.nearest < self.farthest < np.inf:
            raise CalibError(
                f"A board is planned for at distances from {1e3 * self.nearest:g} to {1e3 * self.farthest:g} mm; the "
                "first must be above 0 and less than the second."
            )
        if not 0.0 < self.tilt < 0.5 * math.pi:
            raise CalibError(
                f"The largest tilt of the board is {math.degrees(self.tilt):g} deg; it must be above 0 and below 90."
            )
        if not 0.0 < self.share <= 1.0:
            raise CalibError(
                f"{self.share:g} of the corners must be in the image; the share is above 0 and at most 1."
            )

    @classmethod
    def of(cls, camera: Camera, board: Board) -> SightLimits:
        """Return the usual limits: the board fills 15 to 80 % of the image, up to 55 deg tilted, wholly in view.

        Args:
            camera: The camera, with intrinsics.
            board: The board.
        """
        image = math.hypot(camera.width, camera.height)
        # The distance at which the board would fill the image, head on and along the diagonal.
        full = math.hypot(*board.size) * focal_length(camera) / image
        nearest, farthest = (full / filled for filled in _FILLED)
        return cls(nearest, farthest, margin=_MARGIN * camera.width)


@dataclass(frozen=True, slots=True, eq=False)
class CameraSight(Value):
    """A camera and a board on the two ends of a chain, and where the board may be in the camera."""

    #: The camera, with intrinsics, at least assumed ones.
    camera: Camera
    #: The board.
    board: Board
    #: Shape (4, 4), pose in the camera of the link that carries it [m].
    T_frame_base: Array
    #: Shape (4, 4), pose of the board in the link that carries it [m].
    T_tip_board: Array
    #: Where the board may be.
    limits: SightLimits

    def __post_init__(self) -> None:
        """Refuse limits that the board's pattern does not allow."""
        if self.board.pattern == CHESSBOARD and self.limits.share < 1.0:
            raise CalibError(
                f"The board '{self.board.name}' is a plain chessboard, of which all corners must be in the image; "
                f"the share of {self.limits.share:g} is for boards with markers. Leave it out."
            )

    def board_poses(self, robot: Robot, q: Array) -> Array:
        """Predict the pose of the board in the camera, by the nominal robot.

        Args:
            robot: The robot, from the camera's link to the board's link.
            q: Joint values of N poses, shape (N, m), [rad] or for sliding joints [m], columns as ``robot.joint_names``.

        Returns:
            T_camera_board, shape (N, 4, 4), [m].
        """
        return np.asarray(self.T_frame_base @ robot.poses(q) @ self.T_tip_board)

    def tip_poses(self, T_camera_board: Array) -> Array:
        """Return the poses of the tip in the base with the board at poses (N, 4, 4) in the camera, the same [m]."""
        T_base_frame = rigid_inverse(self.T_frame_base)
        return np.asarray(T_base_frame @ T_camera_board @ rigid_inverse(self.T_tip_board))

    def centres(self, T_camera_board: Array) -> Array:
        """Return the centre of the board in the camera at poses (N, 4, 4), shape (N, 3) [m]."""
        return transformed(T_camera_board, self.board.centre[None])[:, 0]

    def distances(self, T_camera_board: Array) -> Array:
        """Return how far the board's centre is from the camera at poses (N, 4, 4), shape (N,) [m]."""
        return np.asarray(np.linalg.norm(self.centres(T_camera_board), axis=1))

    def tilts(self, T_camera_board: Array) -> Array:
        """Return the angle between the line of sight to the board's centre and its normal.

        Args:
            T_camera_board: Poses of the board in the camera, shape (N, 4, 4), [m].

        Returns:
            Shape (N,), [rad]: 0 head on; above pi / 2 the camera sees the back of the board.
        """
        along = self.centres(T_camera_board)
        normal = T_camera_board[:, :3, 2]
        across = np.linalg.norm(np.cross(normal, along), axis=1)
        return np.asarray(np.arctan2(across, np.einsum("ni,ni->n", normal, along)))

    def in_focus(self, T_camera_board: Array) -> Mask:
        """Test whether the board's centre is between the nearest and the farthest distance, shape (N,)."""
        distance = self.distances(T_camera_board)
        return np.asarray((distance >= self.limits.nearest) & (distance <= self.limits.farthest))

    def is_facing(self, T_camera_board: Array) -> Mask:
        """Test whether the camera sees the front of the board, not too slanted, shape (N,)."""
        return np.asarray(self.tilts(T_camera_board) <= self.limits.tilt)

    def in_image(self, T_camera_board: Array) -> Mask:
        """Test whether enough of the board is in the image.

        Args:
            T_camera_board: Poses of the board in the camera, shape (N, 4, 4), [m].

        Returns:
            True where the share of the corners is in the image, or for a share of 1 the whole pattern, shape (N,).
        """
        points = self.board.corners
        if self.limits.share == 1.0:
            points = np.concatenate([points, outline(self.board)])
        inside = self.visible(T_camera_board, points)
        return np.asarray(inside.mean(axis=1) >= self.limits.share)

    def visible(self, T_camera_board: Array, points: Array) -> Mask:
        """Test which points of the board are in the image, inside its margin.

        Args:
            T_camera_board: Poses of the board in the camera, shape (N, 4, 4), [m].
            points: Points in the board's frame, shape (c, 3), [m].

        Returns:
            Shape (N, c).
        """
        in_camera = transformed(T_camera_board, points)
        off_axis = np.arctan2(np.hypot(in_camera[..., 0], in_camera[..., 1]), in_camera[..., 2])
        in_lens = off_axis <= widest_ray(self.camera) + _BEYOND
        u, v = self.pixels(np.where(in_lens[..., None], in_camera, [0.0, 0.0, 1.0]))
        margin = self.limits.margin
        in_columns = (u >= margin - 0.5) & (u <= self.camera.width - 0.5 - margin)
        in_rows = (v >= margin - 0.5) & (v <= self.camera.height - 0.5 - margin)
        return np.asarray(in_lens & in_columns & in_rows)

    def corner_pixels(self, T_camera_board: Array) -> tuple[Array, Array]:
        """Return the images u and v of the board's corners at poses (N, 4, 4), (N, c) each [px]; NaN: not seen."""
        corners = self.board.corners
        seen = self.visible(T_camera_board, corners)
        in_camera = transformed(T_camera_board, corners)
        u, v = self.pixels(np.where(seen[..., None], in_camera, [0.0, 0.0, 1.0]))
        return np.where(seen, u, np.nan), np.where(seen, v, np.nan)

    def pixels(self, in_camera: Array) -> tuple[Array, Array]:
        """Return the images u and v of points in the camera (..., 3) [m], shape (...) each [px]."""
        lens = LENSES[self.camera.lens]
        pixels = lens.project(in_camera.reshape(-1, 3), intrinsics(self.camera))
        u, v = pixels.T.reshape(2, *in_camera.shape[:-1])
        return u, v


def transformed(T: Array, points: Array) -> Array:
    """Return points (c, 3) [m] at poses (N, 4, 4) [m] of their frame, shape (N, c, 3) [m]."""
    return np.asarray(points @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3])


def outline(board: Board) -> Array:
    """Return the outer corners of a board's pattern in its frame, clockwise from the origin, shape (4, 3) [m]."""
    width, height = board.size
    return np.array([[0.0, 0.0, 0.0], [width, 0.0, 0.0], [width, height, 0.0], [0.0, height, 0.0]])


def with_intrinsics(camera: Camera) -> Camera:
    """Return the camera, with assumed intrinsics where nothing is known of them: 64 deg wide, no distortion."""
    if camera.values is not None:
        return camera
    values = np.zeros(len(LENSES[camera.lens].names))
    values[:2] = _ASSUMED_FOCAL * camera.width
    values[2:4] = 0.5 * (camera.width - 1), 0.5 * (camera.height - 1)
    return replace(camera, values=read_only(values))


def intrinsics(camera: Camera) -> Array:
    """Return the numbers of a camera's lens, shape (m,)."""
    assert camera.values is not None, "a camera without intrinsics: see with_intrinsics"
    return camera.values


def focal_length(camera: Camera) -> float:
    """Return the mean of a camera's two focal lengths [px]."""
    return float(np.mean(intrinsics(camera)[:2]))


def widest_ray(camera: Camera) -> float:
    """Return the largest angle between the camera's axis and a ray of its image [rad].

    A lens polynomial can fold rays from far outside back into the image: what is beyond this angle is not seen.

    Args:
        camera: The camera, with intrinsics.
    """
    right, bottom = camera.width - 0.5, camera.height - 0.5
    edges = np.array(
        [[u, v] for u in (-0.5, 0.5 * right, right) for v in (-0.5, 0.5 * bottom, bottom)]
    )
    rays = LENSES[camera.lens].undistort(edges, intrinsics(camera))
    angles = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    return float(np.nanmax(angles)) if np.isfinite(angles).any() else _WIDEST
