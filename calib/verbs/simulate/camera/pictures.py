"""Pictures that the camera of a virtual cell takes: the board's pose in each, and the pixels of its corners.

    pixel = lens(T_camera_board(q) corner) + noise,   T_camera_board(q) = T_camera_base  T_base_tip(q)  T_tip_board

with the robot, the camera, the mounts and the print as they really are, and the robot's repeatability besides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

import calib.data.kinds as registry
from calib.basics.arguments import check_names
from calib.basics.arrays import Array, Integers, read_only
from calib.basics.values import Value, one_line
from calib.boards.project import Sight, corner_pixels
from calib.data.columns import SETS
from calib.data.measurements import Measurements
from calib.errors import CalibError
from calib.verbs.simulate.camera.cell import CameraCell
from calib.verbs.simulate.random_streams import stream

#: The kind of the rows.
PIXEL = "pixel"

#: Displacement of outliers: of a corner that was taken for another edge nearby [px].
OUTLIER = 5.0

#: Corners that are found: not at the very edge of the picture, nor on a board that is seen from its side.
SIGHT = Sight(margin=5.0, tilt=float(np.deg2rad(70.0)))


@dataclass(frozen=True, slots=True, eq=False)
class Pictures(Value):
    """P pictures, and the R corners that are seen in them."""

    #: The cell.
    cell: CameraCell
    #: Names of the pictures' files.
    images: tuple[str, ...]
    #: ``"estimate"`` or ``"validate"`` for each picture.
    sets: tuple[str, ...]
    #: Readings of the joints, shape (P, m), [rad] or [m].
    readings: Array
    #: True joint values, shape (P, m), [rad] or [m].
    q: Array
    #: True pose of the board in the camera, shape (P, 4, 4) [m].
    T_camera_board: Array
    #: The picture of each corner, shape (R,), from 0.
    picture: Integers
    #: Its id on the board, shape (R,).
    corner: Integers
    #: Where it is, shape (R, 2) [px].
    true_pixels: Array
    #: Where it is found, shape (R, 2) [px].
    pixels: Array
    #: Displacement of outliers, shape (R, 2) [px]; zero in other rows.
    outliers: Array
    #: Standard deviation of the noise of a coordinate [px].
    sigma: float
    #: Of the random numbers.
    seed: int

    def __repr__(self) -> str:
        """Return one line: pictures, corners and the seed."""
        count = f"{len(self.images)} pictures"
        return one_line("Pictures", count, f"{len(self.picture)} corners", f"seed {self.seed}")

    @property
    def measurements(self) -> Measurements:
        """The table of corners, one row each, as `calib calibrate` reads it."""
        robot, board = self.cell.truth.nominal, self.cell.printed.board
        rows = self.picture.tolist()
        sigma = {"px": np.full(len(rows), self.sigma)} if self.sigma > 0.0 else {}
        return Measurements(
            joint_names=robot.joint_names,
            joints=self.readings[self.picture],
            sets=tuple(self.sets[k] for k in rows),
            sigma=sigma,
            prismatic=tuple(joint.name for joint in robot.inputs if joint.type == "prismatic"),
            kinds=(PIXEL,) * len(rows),
            images=tuple(self.images[k] for k in rows),
            corners=tuple(str(corner) for corner in self.corner.tolist()),
            board_points=board.corners[self.corner],
            **Measurements.columns_of(registry.get(PIXEL), self.pixels),
        )

    @property
    def outlier_rows(self) -> tuple[int, ...]:
        """Row numbers of the outliers, from 1."""
        return tuple((np.flatnonzero(self.outliers.any(axis=1)) + 1).tolist())


class _Corners(NamedTuple):
    """R corners that are seen; see `Pictures`, but without outliers in the pixels."""

    picture: Integers
    corner: Integers
    true_pixels: Array
    pixels: Array
    outliers: Array


def take_pictures(
    cell: CameraCell, q: ArrayLike, seed: int = 0, sets: Sequence[str] | None = None
) -> Pictures:
    """Take a picture at every pose.

    Args:
        cell: The robot, the camera and the board.
        q: Poses that the robot is sent to, shape (P, m), [rad] or [m].
        seed: Of the random numbers.
        sets: ``"estimate"`` or ``"validate"`` for each pose; None: all to estimate from.

    Returns:
        The pictures.

    Raises:
        CalibError: Values that are none of these joints, or the board is seen from none of the poses.
    """
    robot = cell.truth.nominal
    commanded = robot.columns(q)
    if sets is not None:
        check_names("sets", sets)
    names = (SETS[0],) * len(commanded) if sets is None else tuple(sets)
    slides = [joint.type == "prismatic" for joint in robot.inputs]
    true_q, readings = cell.scenario.encoder.measure(commanded, slides, seed)
    T = _displaced(cell, cell.truth.poses(true_q), seed)
    corners = _corners(cell, T, names, seed)
    return Pictures(
        cell=cell,
        images=_names(len(commanded)),
        sets=names,
        readings=read_only(readings),
        q=read_only(true_q),
        T_camera_board=read_only(T),
        picture=corners.picture,
        corner=corners.corner,
        true_pixels=read_only(corners.true_pixels),
        pixels=read_only(corners.pixels + corners.outliers),
        outliers=read_only(corners.outliers),
        sigma=_sigma(cell),
        seed=int(seed),
    )


def _sigma(cell: CameraCell) -> float:
    """Return the standard deviation of the noise of a corner's coordinate [px]."""
    return cell.scenario.sigma.get("px", 0.0)


def _corners(cell: CameraCell, T: Array, sets: Sequence[str], seed: int) -> _Corners:
    """Draw where corners are found.

    Args:
        cell: The camera, the board and the noise.
        T: Poses of the board in the camera, shape (P, 4, 4) [m].
        sets: The set of each picture.
        seed: Of the random numbers.

    Raises:
        CalibError: No corner is seen in any picture.
    """
    pixels, is_seen = corner_pixels(cell.camera, cell.printed.corners, T, SIGHT)
    picture, corner = np.nonzero(is_seen)
    if not len(picture):
        raise CalibError(
            f"The camera sees no corner of the board from any of the {len(T)} poses; without --poses, poses are drawn "
            "from which it does."
        )
    # Drawn for all corners, seen or not, so that the noise of one does not depend on the others.
    noise = _sigma(cell) * stream(seed, "pixel noise").standard_normal(pixels.shape)
    outliers = _outliers(cell, [sets[k] for k in picture.tolist()], seed)
    return _Corners(picture, corner, pixels[is_seen], (pixels + noise)[is_seen], outliers)


def _names(count: int) -> tuple[str, ...]:
    """Return the names of pictures: ``picture_01.png``, with as many digits as the last one needs."""
    digits = max(2, len(str(count)))
    return tuple(f"picture_{number:0{digits}}.png" for number in range(1, count + 1))


def _outliers(cell: CameraCell, sets: Sequence[str], seed: int) -> Array:
    """Draw the displacement of each corner, of which each is in a set, shape (R, 2) [px]."""
    displacement = np.zeros((len(sets), 2))
    outliers = cell.scenario.outliers
    if outliers is None:
        return displacement
    candidates = [row for row, name in enumerate(sets) if name == SETS[0]]
    chosen = outliers.choose(candidates, seed)
    angle = stream(seed, "outlier directions").uniform(0.0, 2.0 * np.pi, len(sets))
    directions = np.column_stack([np.cos(angle), np.sin(angle)])
    displacement[chosen] = OUTLIER * directions[chosen]
    return displacement


def _displaced(cell: CameraCell, T: Array, seed: int) -> Array:
    """Return poses of the board in the camera (P, 4, 4) [m], displaced by what the robot does not repeat."""
    noise = cell.scenario.noise
    repeatability = 0.0 if noise is None else noise.repeatability
    displaced: Array = T.copy()
    displaced[:, :3, 3] += repeatability * stream(seed, "robot noise").standard_normal((len(T), 3))
    return displaced
