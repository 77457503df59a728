"""Cameras: which poses of a printed board they see, how exactly, and the images of its corners.

A corner P of the board is seen at u = lens(R P + p), with the pose (R, p) of the board in the camera and the numbers of
lens and print of `calib.camera.optics`. The board must be in focus, not too slanted, and in the image.

The c corners of an image depend on the parameters only through the motion of the board in the camera (6 numbers) and a
few numbers of lens and print (k - 6). With the derivative J of their images by these, (2 c, k), in standard deviations
of the noise, and the derivative D of these by the parameters, (k, p),

    A = J D,    A^T A = (R D)^T (R D),    J = Q R

so that k rows, R D, stand for the 2 c rows of an image. The robot's repeatability moves all corners of an image alike,
by a translation with the standard deviation r along each axis: with B = r R_t, R_t the columns of R for translations,

    A -> L^-1 R D,    L L^T = I + B B^T

Errors of single corners on the print are left out: each corner is seen in many images, and soon known well.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

import calib.data.kinds as registry
from calib.basics.arrays import Array, Mask, read_only
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.values import Value
from calib.boards.board import BODY, Board
from calib.camera import optics
from calib.camera.camera import UNKNOWN, Camera
from calib.camera.lenses import LENSES
from calib.data.cell import Cell
from calib.data.kinds import Kind
from calib.data.measurements import Measurements
from calib.data.surroundings import TrackerNoise
from calib.errors import CalibError, ModelError
from calib.instruments.instrument import Assumption, Condition, Instrument, Sightline, transform
from calib.model.error_model import ErrorModel, Parameter
from calib.numerics.geometry import pose_of
from calib.robot.robot import Robot

#: Kind of the rows of a table of corners.
PIXEL = "pixel"

#: Largest angle between the line of sight and the board's normal [rad]: beyond, corners are detected less precisely.
LARGEST_TILT = math.radians(55.0)

#: Shares of the image's diagonal that the board's diagonal fills at the nearest and at the farthest distance.
_FILLED = (0.80, 0.15)

#: Margin at the edges of the image, as a share of its width.
_MARGIN = 0.01

#: Focal length that is assumed for an unknown camera, as a share of the image's width: 64 deg from left to right.
_ASSUMED_FOCAL = 0.8

#: Angle beyond the widest ray of the image [rad] from which on points would be in it only because the lens polynomial
#: folds back.
_BEYOND = 0.02

#: Widest ray of a lens that cannot be inverted at the edges of the image [rad].
_WIDEST = math.radians(80.0)

#: Distance from the camera at which the view of a corner begins [m], beyond its housing and its mount.
_AHEAD = 0.060

#: Number of images whose derivatives are held at a time.
_AT_A_TIME = 128

Entry = TypeVar("Entry")


@dataclass(frozen=True, slots=True)
class SightLimits(Value):
    """Where a board may be in the camera."""

    #: Least and largest distance of the board's centre from the camera [m]; None: it fills 15 to 80 % of the image.
    distances: tuple[float, float] | None = None
    #: Largest angle between the line of sight and the board's normal [rad].
    tilt: float = LARGEST_TILT
    #: Share of the corners that must be in the image; 1: the whole pattern.
    share: float = 1.0

    def __post_init__(self) -> None:
        """Refuse limits within which no board can be; raises `CalibError`."""
        nearest, farthest = self.distances or (1.0, 2.0)
        if not 0.0 < nearest < farthest < np.inf:
            raise CalibError(
                f"A board is planned for at distances from {1e3 * nearest:g} to {1e3 * farthest:g} mm; the "
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


#: The whole board must be in the image, at usual distances.
USUAL_LIMITS = SightLimits()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CameraInstrument(Instrument):
    """A camera that sees a printed board."""

    VIEWPOINT_NUMBERS: ClassVar[int] = 6  # pixel (2), distance, tilt, direction of the tilt, roll

    #: The camera, with intrinsics, which may be assumed ones.
    camera: Camera
    #: The board, which is the target.
    board: Board
    #: Where the board may be.
    limits: SightLimits
    #: Standard deviation of the board's position in the camera along one axis, by the robot's repeatability [m].
    repeatability: float
    #: Shape (c, `calib.camera.optics.COUNT`), internals at each corner: the numbers of lens and print.
    internals: Array
    kind: Kind
    sigma: Mapping[str, float]
    T_instrument_base: Array | None
    points: Array
    ahead: float = _AHEAD
    assumed: tuple[tuple[Assumption, tuple[float, ...]], ...] = ()

    def __post_init__(self) -> None:
        """Refuse limits that the board's pattern does not allow; raises `CalibError`."""
        if not self.board.markers and self.limits.share < 1.0:
            raise CalibError(
                f"The board '{self.board.name}' has no markers, so that all of its corners must be in the image; "
                f"the share of {self.limits.share:g} is for boards with markers. Leave it out."
            )

    @classmethod
    def of(cls, cell: Cell, limits: SightLimits = USUAL_LIMITS) -> CameraInstrument:
        """Return the only camera of a cell, with its only board.

        Args:
            cell: Camera and board, the pose of the camera's link in the camera (None: the link is its optical frame),
                noise. For a camera without intrinsics some are assumed, which a fit takes as unknown.
            limits: Where the board may be in the camera.

        Raises:
            CalibError: No camera or board, or several, or limits that the board's pattern does not allow.
        """
        camera = _only(cell.cameras, "camera")
        board = _only(cell.boards, "board")
        if board.pattern == BODY:
            raise CalibError(
                f"The board '{board.name}' is a body of tags, whose far tags a camera does not see; images are planned "
                "for flat boards. Choose the poses of a body by hand: two or more tags towards the camera, and the "
                "body turned to each side."
            )
        if camera.values is None:
            unknown = np.full(len(LENSES[camera.lens].names), UNKNOWN)
            camera = replace(camera, values=assumed_intrinsics(camera), sigma=unknown)
        sigma = {
            unit: cell.sigma.get(unit, of.assumed_sigma) for unit, of in RESIDUAL_UNITS.items()
        }
        assumed: list[tuple[Assumption, tuple[float, ...]]] = []
        if camera.sigma is not None and np.all(np.isinf(camera.sigma)):
            assumed.append(("camera_assumed", (float(intrinsics(camera)[0]),)))
        if "px" not in cell.sigma:
            assumed.append(("image_noise", (sigma["px"],)))
        noise = TrackerNoise() if cell.tracker is None else cell.tracker.noise
        T_camera_base, T_tip_board = camera_and_board_places(cell)
        if T_tip_board is None:
            raise CalibError(
                "To plan images it must be known roughly where the board is in its link: --board-at, such as "
                '"500 0 0 mm 180 0 0 deg" for one that lies face up in front of the robot.'
            )
        if limits.distances is None:
            limits = replace(limits, distances=usual_distances(camera, board))
        return cls(
            camera=camera,
            board=board,
            limits=limits,
            repeatability=noise.repeatability,
            internals=corner_internals(camera, board),
            kind=registry.get(PIXEL),
            sigma=sigma,
            T_instrument_base=read_only(np.eye(4) if T_camera_base is None else T_camera_base),
            points=read_only(np.concatenate([board.centre[None], outline(board)])),
            assumed=tuple(assumed),
        )

    @property
    def locates(self) -> bool:
        """True: images give the pose of the board in the camera."""
        return True

    def in_cell(self, cell: Cell) -> Cell:
        """Return a cell with the camera as assumed, and a board whose corners have no errors of their own."""
        board = replace(self.board, sigma_corner=0.0)
        return replace(cell, kind=PIXEL, cameras={"": self.camera}, boards={"": board})

    def with_internals(self, internals: Array) -> CameraInstrument:
        """Return the camera with internals at each corner, (c, `calib.camera.optics.COUNT`), that number it."""
        return replace(self, internals=internals)

    def stops(self, q: Array) -> Array:
        """Return the joint values of n images, shape (n, m) [rad or m], each once of those of N rows, (N, m).

        A table of corners has many rows for an image.
        """
        _, first = np.unique(q, axis=0, return_index=True)
        return np.asarray(q[np.sort(first)])

    # Which poses of the board it sees

    def sees(self, sightlines: Sequence[Sightline]) -> Iterator[Condition]:
        """Yield the conditions that the board is in focus, that its front is seen, and enough of it is in the image."""
        for sightline in sightlines:
            for reason, passes in (
                ("focus", self.in_focus),
                ("tilt", self.is_facing),
                ("image", self.in_image),
            ):
                yield Condition(reason, _along(sightline, passes))

    def in_focus(self, T_camera_board: Array) -> Mask:
        """Test whether the board's centre is between the limits of distance at N poses (N, 4, 4) [m], shape (N,)."""
        distance = self.board_distances(T_camera_board)
        nearest, farthest = self._distances
        return np.asarray((distance >= nearest) & (distance <= farthest))

    def is_facing(self, T_camera_board: Array) -> Mask:
        """Test whether the board's front is seen, and not too slanted, at N poses (N, 4, 4) [m], shape (N,)."""
        return np.asarray(board_tilts(self.board, T_camera_board) <= self.limits.tilt)

    def in_image(self, T_camera_board: Array) -> Mask:
        """Test whether enough of the board is in the image at N poses T_camera_board (N, 4, 4) [m], shape (N,).

        Enough is the stated share of the corners, or for a share of 1 the whole pattern.
        """
        points = self.board.corners
        if self.limits.share == 1.0:
            points = np.concatenate([points, outline(self.board)])
        inside = self.visible(T_camera_board, points)
        return np.asarray(inside.mean(axis=1) >= self.limits.share)

    def board_distances(self, T_camera_board: Array) -> Array:
        """Return how far the board's centre is from the camera at poses (N, 4, 4), shape (N,) [m]."""
        return np.asarray(np.linalg.norm(_centres(self.board, T_camera_board), axis=1))

    def visible(self, T_camera_board: Array, points: Array) -> Mask:
        """Test which points of the board are in the image, inside its margin.

        Args:
            T_camera_board: Poses of the board in the camera, shape (N, 4, 4), [m].
            points: Points in the board's frame, shape (c, 3), [m].

        Returns:
            Shape (N, c).
        """
        in_camera = transform(T_camera_board, points)
        off_axis = np.arctan2(np.hypot(in_camera[..., 0], in_camera[..., 1]), in_camera[..., 2])
        in_lens = off_axis <= widest_ray(self.camera) + _BEYOND
        u, v = self.project(np.where(in_lens[..., None], in_camera, [0.0, 0.0, 1.0]))
        margin = _MARGIN * self.camera.width
        in_columns = (u >= margin - 0.5) & (u <= self.camera.width - 0.5 - margin)
        in_rows = (v >= margin - 0.5) & (v <= self.camera.height - 0.5 - margin)
        return np.asarray(in_lens & in_columns & in_rows)

    def coverage(self, T_camera_board: Array, columns: int = 8, rows: int = 6) -> float:
        """Return the share of the image's cells in which at least one corner is seen.

        Args:
            T_camera_board: Poses of the board in the camera, shape (N, 4, 4), [m].
            columns: Cells along the image's width.
            rows: Cells along its height.
        """
        pixels = self.predict(T_camera_board)
        u, v = pixels[np.isfinite(pixels[..., 0])].T
        column = np.floor((u + 0.5) / self.camera.width * columns)
        row = np.floor((v + 0.5) / self.camera.height * rows)
        return len(np.unique(row * columns + column)) / (columns * rows)

    def viewpoints(self, unit: Array) -> Array:
        """Return poses of the board within the limits of distance and tilt, its centre anywhere in the image.

        With the ray r of a random pixel, a distance d, a tilt t in a random direction and a random roll, the centre of
        the board is at d r, and the angle between its normal and r is t. Tilts are spread evenly, because images that
        always show a board head on hardly separate focal length from distance. Reciprocals of distances are spread
        evenly, so that the sizes of the board in the image are. Poses whose board is not in the image are left out.

        Args:
            unit: Random numbers between 0 and 1, shape (n, 6).

        Returns:
            T_camera_board, shape (n or fewer, 4, 4), [m].

        Raises:
            ModelError: The board is never in the image.
        """
        camera, (nearest, farthest) = self.camera, self._distances
        pixels = unit[:, :2] * [camera.width, camera.height] - 0.5
        rays = LENSES[camera.lens].undistort(pixels, intrinsics(camera))
        rays = np.where(np.isfinite(rays), rays, [0.0, 0.0, 1.0])
        rays = np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
        nearness = 1.0 / farthest + unit[:, 2] * (1.0 / nearest - 1.0 / farthest)

        # The smallest turn that brings z onto the ray, then the tilt, then the roll about the normal.
        axis = np.cross([0.0, 0.0, 1.0], rays)
        sine = np.linalg.norm(axis, axis=1, keepdims=True)
        angle = np.arctan2(sine, rays[:, 2:])
        towards = Rotation.from_rotvec(axis / np.where(sine > 0.0, sine, 1.0) * angle)
        direction, roll = (2.0 * np.pi * unit[:, 4:]).T
        aside = np.column_stack([np.cos(direction), np.sin(direction), np.zeros(len(rays))])
        tilt = Rotation.from_rotvec(aside * (self.limits.tilt * unit[:, 3])[:, None])
        about_normal = Rotation.from_rotvec(roll[:, None] * [0.0, 0.0, 1.0])
        rotations = (towards * tilt * about_normal).as_matrix()

        T = np.tile(np.eye(4), (len(unit), 1, 1))
        T[:, :3, :3] = rotations
        T[:, :3, 3] = rays / nearness[:, None] - rotations @ self.board.centre
        T = T[self.in_image(T)]
        if not len(T):
            raise ModelError(
                f"At distances from {1e3 * nearest:.4g} to {1e3 * farthest:.4g} mm the board "
                f"'{self.board.name}' is never in the image of {camera.width} x {camera.height} px "
                f"({100 * self.limits.share:.3g} % of its corners). Widen the distances, take a smaller board, or ask "
                "for a smaller share of the corners."
            )
        return T

    # What it reads, and how exactly

    def noise(self, distance: Array) -> Array:
        """Return the standard deviation of an image coordinate, the same at all distances (n,), shape (n,) [px]."""
        return np.full(len(distance), self.sigma["px"])

    def stop_rows(self, robot: Robot, targets: Sequence[str], group: str) -> Measurements:
        """Return a row for each corner of the board, as if all were seen in the image's middle with all joints at 0."""
        corners = self.board.corners
        count = len(corners)
        return Measurements(
            joint_names=robot.joint_names,
            joints=np.zeros((count, len(robot.joint_names))),
            points=np.full((count, 3), np.nan),
            targets=tuple(targets) * count,
            groups=(group,) * count,
            kinds=(PIXEL,) * count,
            readings={
                "u": np.full(count, 0.5 * self.camera.width),
                "v": np.full(count, 0.5 * self.camera.height),
            },
            board_points=corners,
            corners=tuple(map(str, range(count))),
            prismatic=tuple(joint.name for joint in robot.inputs if joint.type == "prismatic"),
        )

    def predict(self, T_frame_target: Array) -> Array:
        """Predict the images of the c corners at poses (n, 4, 4) of the board, shape (n, c, 2) [px]; NaN: not seen."""
        corners = self.board.corners
        seen = self.visible(T_frame_target, corners)
        in_camera = transform(T_frame_target, corners)
        pixels = self.project(np.where(seen[..., None], in_camera, [0.0, 0.0, 1.0]))
        return np.where(seen[..., None], np.stack(pixels, axis=-1), np.nan)

    def whitened(
        self, T_frame_target: Array, twists: Array, noise: Array, model: ErrorModel
    ) -> Array:
        """Differentiate the images of the board's corners by the parameters, whitened by the noise.

        Args:
            T_frame_target: shape (n, 1, 4, 4), poses of the board in the camera [m].
            twists: shape (n, 1, 6, p), motion of the board along the camera's axes by each parameter, linear then
                angular.
            noise: shape (n,), standard deviation of a coordinate of an image [px].
            model: The p parameters, with those of lens and print.

        Returns:
            shape (n, k, p), k combinations of the images' coordinates whose errors are independent and of variance 1;
            zero if no corner is seen.
        """
        own = [
            (number, parameter.internal)
            for number, parameter in model.internals
            if self._has(parameter)
        ]
        numbers = [number for number, _ in own]
        columns = [column for _, column in own if column is not None]
        by_own = np.eye(len(model))[numbers]
        corners = len(self.internals)
        parts = []
        for start in range(0, len(T_frame_target), _AT_A_TIME):
            block = slice(start, start + _AT_A_TIME)

            # Images by the board's motion, and by the numbers of lens and print, in standard deviations of the noise;
            # zero for corners outside of the image.
            T = T_frame_target[block, 0]
            T_of_corners = np.repeat(T, corners, axis=0)
            motions = np.broadcast_to(np.eye(6), (len(T_of_corners), 6, 6))
            by_motion, by_internals = optics.image_derivatives(
                T_of_corners, motions, np.tile(self.internals, (len(T), 1))
            )
            by_place = np.concatenate([by_motion, by_internals[:, :, columns]], axis=2)
            seen = self.visible(T, self.board.corners).reshape(-1, 1, 1)
            sigma = np.repeat(noise[block], corners)[:, None, None]
            by_place = np.where(seen, by_place / sigma, 0.0)
            by_place = by_place.reshape(len(T), 2 * corners, -1)

            # The repeatability of the robot moves all corners of an image together: their errors are correlated.
            R = np.asarray(np.linalg.qr(by_place, mode="r"))
            shared = self.repeatability * R[:, :, :3]
            covariance = np.eye(R.shape[1]) + shared @ shared.swapaxes(1, 2)
            L_R = np.linalg.solve(np.linalg.cholesky(covariance), R)
            unknown = np.broadcast_to(by_own, (len(R), *by_own.shape))
            parts.append(L_R @ np.concatenate([twists[block, 0], unknown], axis=1))
        return np.concatenate(parts)

    def _has(self, parameter: Parameter) -> bool:
        """Return whether a parameter is of this camera or its board, and not of another one of the cell."""
        owners = (optics.CAMERA, optics.BOARD)
        return all(
            number == self.internals[0, column]
            for column, number in parameter.samples
            if column in owners
        )

    def project(self, in_camera: Array) -> tuple[Array, Array]:
        """Return the images u and v [px], shape (...) each, of points in the camera's frame, (..., 3) [m]."""
        lens = LENSES[self.camera.lens]
        pixels = lens.project(in_camera.reshape(-1, 3), intrinsics(self.camera))
        u, v = pixels.T.reshape(2, *in_camera.shape[:-1])
        return u, v

    @property
    def _distances(self) -> tuple[float, float]:
        """The least and the largest distance of the board's centre [m]."""
        assert self.limits.distances is not None
        return self.limits.distances


def _along(sightline: Sightline, passes: Callable[[Array], Mask]) -> Callable[[Array], Mask]:
    """Return a test of N joint values (N, m) from one of the poses of the board in the camera, (N, 4, 4) [m]."""
    return lambda q: passes(sightline.target_poses(q))


def _only(entries: Mapping[str, Entry], what: str) -> Entry:
    """Return the only camera, or the only board; raises `CalibError` if there is none, or several."""
    if len(entries) != 1:
        given = f"{len(entries)} were given" if entries else "none was given"
        example = "1280x720" if what == "camera" else "board.toml"
        raise CalibError(
            f"Images are planned for one {what} at a time, and {given}. Give one: --{what} {example}."
        )
    return next(iter(entries.values()))


def camera_and_board_places(cell: Cell) -> tuple[Array | None, Array | None]:
    """Return the places of camera and board in a cell: its measurement frame is the camera, its target the board.

    Returns:
        T_camera_base and T_tip_board, shape (4, 4) each, [m]; None: not given.

    Raises:
        CalibError: It gives the position of the board, and not its orientation.
    """
    T_camera_base = cell.T_frame_base
    if len(cell.frames) == 1:
        T_camera_base = next(iter(cell.frames.values()))
    position = cell.target
    if len(cell.targets) == 1:
        position = next(iter(cell.targets.values()))
    if position is None:
        return T_camera_base, None
    if cell.target_rotation is None:
        raise CalibError(
            "The cell gives the position of the board in its link, and not its orientation: add target_rpy_deg, or "
            "leave both out."
        )
    return T_camera_base, pose_of(position, cell.target_rotation)


def corner_internals(camera: Camera, board: Board) -> Array:
    """Return the numbers of lens and print at each corner of a board as described.

    Args:
        camera: The camera, with intrinsics.
        board: The board, of c corners.

    Returns:
        Shape (c, `calib.camera.optics.COUNT`), read-only.
    """
    values = np.zeros((len(board.corners), optics.COUNT))
    values[:, optics.intrinsic_columns(LENSES[camera.lens])] = intrinsics(camera)
    values[:, optics.LENS] = list(LENSES).index(camera.lens)
    values[:, optics.POINT] = board.corners
    values[:, optics.ACROSS] = optics.across(board.corners, board.centre, board.size)
    values[:, optics.CORNER] = np.arange(len(board.corners))
    return read_only(values)


def usual_distances(camera: Camera, board: Board) -> tuple[float, float]:
    """Return the distances from which a board seen head on fills 80 and 15 % of the image's diagonal [m]."""
    image = math.hypot(camera.width, camera.height)
    full = math.hypot(*board.size) * focal_length(camera) / image
    nearest, farthest = (full / filled for filled in _FILLED)
    return nearest, farthest


def board_tilts(board: Board, T_camera_board: Array) -> Array:
    """Return the angle between the line of sight to a board's centre and its normal.

    Args:
        board: The board.
        T_camera_board: Its poses in the camera, shape (N, 4, 4), [m].

    Returns:
        Shape (N,), [rad]: 0 head on; above pi / 2 the camera sees the back of the board.
    """
    along = _centres(board, T_camera_board)
    normal = T_camera_board[:, :3, 2]
    across = np.linalg.norm(np.cross(normal, along), axis=1)
    return np.asarray(np.arctan2(across, np.einsum("ni,ni->n", normal, along)))


def _centres(board: Board, T_camera_board: Array) -> Array:
    """Return the centre of a board in the camera at poses (N, 4, 4), shape (N, 3) [m]."""
    return transform(T_camera_board, board.centre[None])[:, 0]


def outline(board: Board) -> Array:
    """Return the outer corners of a board's pattern in its frame, clockwise from the origin, shape (4, 3) [m]."""
    width, height = board.size
    return np.array([[0.0, 0.0, 0.0], [width, 0.0, 0.0], [width, height, 0.0], [0.0, height, 0.0]])


def assumed_intrinsics(camera: Camera) -> Array:
    """Return intrinsics that are assumed for an unknown camera, shape (m,): 64 deg wide, no distortion."""
    values = np.zeros(len(LENSES[camera.lens].names))
    values[:2] = _ASSUMED_FOCAL * camera.width
    values[2:4] = 0.5 * (camera.width - 1), 0.5 * (camera.height - 1)
    return values


def intrinsics(camera: Camera) -> Array:
    """Return the numbers of the lens of a camera that has them, shape (m,)."""
    assert camera.values is not None, "a camera without intrinsics"
    return camera.values


def focal_length(camera: Camera) -> float:
    """Return the mean of a camera's two focal lengths [px]."""
    return float(np.mean(intrinsics(camera)[:2]))


def widest_ray(camera: Camera) -> float:
    """Return the largest angle between the camera's axis and a ray of its image [rad].

    Points beyond this angle are not seen, even if the lens polynomial folds their rays back into the image.

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
