"""The corners that the cameras of a calibration saw: measured, predicted, and the poses of their boards.

A residual is measured minus predicted, in pixels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array, Integers, Mask
from calib.basics.values import Value
from calib.boards.board import BODY, Board, unfolded
from calib.camera import optics
from calib.camera.lenses import LENSES
from calib.fit.registration.table_rows import rows_and_setup
from calib.instruments.internals import number_corners
from calib.result.calibration import Calibration
from calib.show.look import short_names


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SeenCorners(Value):
    """N corners in the images of one camera."""

    #: Name of the camera
    camera: str
    #: Columns and rows of its images [px]
    size: tuple[int, int]
    #: Name of the image of each corner
    images: tuple[str, ...]
    #: Name of its board
    boards: tuple[str, ...]
    #: Name of the corner on its board
    corners: tuple[str, ...]
    #: Shape (N,), index of each in the table of measurements, from 0
    rows: Integers
    #: Shape (N, 2), measured images [px]
    measured: Array
    #: Shape (N, 2), residuals of the nominal robot [px]; NaN if it is not judged
    nominal: Array
    #: Shape (N, 2), residuals of the calibrated robot [px]
    calibrated: Array
    #: Shape (N, 2), residuals of a fit without the corner's image [px]; NaN without cross-validation
    held_out: Array
    #: Shape (N,), corners of validation images
    validation: Mask
    #: Shape (N,), corners that were flagged
    flagged: Mask
    #: Shape (N, 4, 4), predicted pose of each corner's board in the camera [m]
    T_camera_board: Array
    #: Shape (N, 3), each corner on its board as designed [m]
    designed: Array
    #: Shape (N, 2), the same on a sheet on which the tags of a body are side by side [m]
    on_sheet: Array
    #: Shape (N, 3, 3), axes of the sheet at each corner in the board's frame; the identity for flat boards
    R_board_sheet: Array
    #: Shape (N, 3), as printed, with the errors of print and flatness that the fit estimated [m]
    printed: Array
    #: Shape (N, 2, 3), change of the predicted image by a displacement of the corner along the camera's axes [px/m]
    by_point: Array

    def __len__(self) -> int:
        """The number of corners."""
        return len(self.images)

    @property
    def label(self) -> str:
        """The camera as titles of panels have it."""
        return short_names([self.camera])[0]

    @property
    def points(self) -> Array:
        """Predicted corners in the camera, shape (N, 3) [m]."""
        turned = np.einsum("nij,nj->ni", self.T_camera_board[:, :3, :3], self.printed)
        return np.asarray(turned + self.T_camera_board[:, :3, 3])

    @property
    def by_image(self) -> dict[str, Integers]:
        """Indices of the corners of each image, from 0, by the image's name; in the order of the table."""
        return _indices_by_name(self.images)

    def of_board(self, board: str) -> dict[str, Integers]:
        """Return the indices of each corner of one board, from 0, by the corner's name."""
        names = [
            corner if of == board else ""
            for corner, of in zip(self.corners, self.boards, strict=True)
        ]
        found = _indices_by_name(names)
        found.pop("", None)
        return found

    def along_board(self, indices: Integers, residual: Array) -> Array:
        """Return the displacement along a board's sheet that explains residuals of one corner best, by least squares.

        Args:
            indices: Those of the corner, from 0.
            residual: shape (N, 2), of all corners [px].

        Returns:
            shape (2,), along x and y of the sheet [m].
        """
        R_camera_sheet = self.T_camera_board[indices][:, :3, :3] @ self.R_board_sheet[indices]
        by_board = self.by_point[indices] @ R_camera_sheet[:, :, :2]
        solution, *_ = np.linalg.lstsq(
            by_board.reshape(-1, 2), residual[indices].ravel(), rcond=None
        )
        return np.asarray(solution)

    def board_views(self) -> tuple[Array, Array, Array]:
        """Return how the boards stood in the V views; a view is one board in one image.

        Returns:
            Angle between the board's normal and the line of sight to its middle, shape (V,) [rad]; direction in the
            image to which the board faces, from right over down, shape (V,) [rad]; and distance of the middle of the
            corners seen from the camera, shape (V,) [m]. The normal of a body is the mean of those of the tags seen.
        """
        views = [f"{image}\n{board}" for image, board in zip(self.images, self.boards, strict=True)]
        indices = _indices_by_name(views).values()
        points = self.points
        middles = np.array([points[of_view].mean(axis=0) for of_view in indices])
        into = np.einsum("nij,nj->ni", self.T_camera_board[:, :3, :3], self.R_board_sheet[:, :, 2])
        # A board's z points into the page, away from the camera.
        normals = -np.array([into[of_view].mean(axis=0) for of_view in indices])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        distance = np.linalg.norm(middles, axis=1)
        cosine = -np.sum(normals * middles, axis=1) / distance
        tilt = np.arccos(np.clip(cosine, -1.0, 1.0))
        return tilt, np.arctan2(normals[:, 1], normals[:, 0]), distance


def _indices_by_name(names: Sequence[str]) -> dict[str, Integers]:
    """Return the indices of each name, from 0, in the order in which names first occur."""
    indices: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        indices.setdefault(name, []).append(index)
    return {name: np.array(of_name) for name, of_name in indices.items()}


def image_rows(c: Calibration) -> Mask:
    """Return the rows that are images of corners, shape (N,)."""
    of_images = {kind for kind in set(c.rows.kinds) if registry.get(kind).is_image}
    return np.array([kind in of_images for kind in c.rows.kinds], dtype=bool)


def seen_corners(c: Calibration) -> tuple[SeenCorners, ...]:
    """Return the corners that each camera saw, camera by camera; nothing without images."""
    is_image = image_rows(c)
    if not np.any(is_image):
        return ()
    m, cell = c.fit.measurements, c.fit.cell
    rows, _ = rows_and_setup(c.nominal, m, cell)
    T_base_tip = c.robot.poses(m.joints_for(c.nominal.joint_names), rows.samples.chain)
    sightings = c.setup.sightings(T_base_tip, rows.samples)
    assert sightings.internals is not None
    internals = sightings.internals.values
    names, corner = number_corners(m)
    measured = np.column_stack([m.reading("u"), m.reading("v")])
    held_out = np.full((len(m), 2), np.nan)
    if c.cross_validation is not None:
        held_out[m.estimation] = c.cross_validation.residual[:, :2]
    flagged = c.rows.flagged
    # An image without a name is called by the number of its pose, from 1.
    images = [
        image or f"pose {pose + 1}"
        for image, pose in zip(m.images, rows.blocks.tolist(), strict=True)
    ]

    # A board without a name may have been moved to several places, each a target.
    boards = m.targets
    if "" in cell.boards:
        nameless = cell.boards[""].name
        boards = tuple(name if name in cell.boards else nameless for name in m.targets)

    on_sheet, R_board_sheet = _on_sheets(cell.boards, m.targets, names, corner, internals)

    seen = []
    numbers = internals[:, optics.CAMERA]
    for number in np.unique(numbers[is_image]):
        at = np.flatnonzero(is_image & (numbers == number))
        values = internals[at]
        T_camera_board = sightings.T_frame_target[at]
        printed = optics.board_points(values)
        turned = np.einsum("nij,nj->ni", T_camera_board[:, :3, :3], printed)
        lens = list(LENSES.values())[int(values[0, optics.LENS])]
        by_point, _ = lens.derivatives(
            turned + T_camera_board[:, :3, 3], values[:, optics.intrinsic_columns(lens)]
        )
        # A camera without a name may stand at several stations.
        station = m.groups[at[0]]
        name = station if station in cell.cameras else ""
        camera = cell.cameras[name]
        seen.append(
            SeenCorners(
                camera=name or camera.name,
                size=(camera.width, camera.height),
                images=tuple(images[i] for i in at),
                boards=tuple(boards[i] for i in at),
                corners=tuple(names[corner[i]] for i in at),
                rows=at,
                measured=measured[at],
                nominal=c.rows.residual_nominal[at, :2],
                calibrated=c.rows.residual_calibrated[at, :2],
                held_out=held_out[at],
                validation=m.validation[at],
                flagged=flagged[at],
                T_camera_board=T_camera_board,
                designed=values[:, optics.POINT],
                on_sheet=on_sheet[at],
                R_board_sheet=R_board_sheet[at],
                printed=printed,
                by_point=by_point,
            )
        )
    return tuple(seen)


def _on_sheets(
    boards: Mapping[str, Board],
    targets: Sequence[str],
    names: Sequence[str],
    corner: Integers,
    internals: Array,
) -> tuple[Array, Array]:
    """Return where N rows' corners are on the sheets of their boards, (N, 2) [m], and the sheets' axes, (N, 3, 3).

    The corners are numbered among ``names``. One that its body does not have by this name is where it is designed.
    """
    on_sheet: Array = internals[:, optics.POINT][:, :2].copy()
    R_board_sheet = np.tile(np.eye(3), (len(internals), 1, 1))
    for key, board in boards.items():
        if board.pattern != BODY:
            continue
        places, R = unfolded(board)
        for i, target in enumerate(targets):
            name = names[corner[i]]
            is_of_board = target == key or (key == "" and target not in boards)
            if is_of_board and name.isdecimal() and int(name) < len(places):
                on_sheet[i], R_board_sheet[i] = places[int(name)], R[int(name)]
    return on_sheet, R_board_sheet
