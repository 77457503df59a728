"""The corners that a camera saw: measured, predicted, and where their boards were. Values only.

A residual is measured minus predicted, in pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.basics.values import Value
from calib.show.figure_base import short_names


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
    #: Shape (N, 2), residuals of the nominal robot [px]; NaN where it is not judged
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
    def pictures(self) -> dict[str, Integers]:
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
        """Return the displacement along a board that explains residuals of one corner best, by least squares.

        Args:
            indices: Those of the corner, from 0.
            residual: shape (N, 2), of all corners [px].

        Returns:
            shape (2,), along x and y of the board [m].
        """
        by_board = self.by_point[indices] @ self.T_camera_board[indices][:, :3, :2]
        solution, *_ = np.linalg.lstsq(
            by_board.reshape(-1, 2), residual[indices].ravel(), rcond=None
        )
        return np.asarray(solution)


@dataclass(frozen=True, slots=True, eq=False)
class BoardViews:
    """Tilt and distance of the boards in the views of one camera: a view is one board in one image."""

    #: Shape (V,), angle between the board's normal and the line of sight to its middle [rad]
    tilt: Array
    #: Shape (V,), direction in the image to which the board faces, from right over down [rad]
    facing: Array
    #: Shape (V,), distance of the middle of the corners seen from the camera [m]
    distance: Array


def board_views(seen: SeenCorners) -> BoardViews:
    """Return how the boards stood in each image."""
    keys = _indices_by_name(
        [f"{image}\n{board}" for image, board in zip(seen.images, seen.boards, strict=True)]
    )
    points = seen.points
    middles = np.array([points[indices].mean(axis=0) for indices in keys.values()])
    first = [int(indices[0]) for indices in keys.values()]
    # A board's z points into the page, away from the camera.
    normals = -seen.T_camera_board[first][:, :3, 2]
    distance = np.linalg.norm(middles, axis=1)
    cosine = -np.sum(normals * middles, axis=1) / distance
    return BoardViews(
        tilt=np.arccos(np.clip(cosine, -1.0, 1.0)),
        facing=np.arctan2(normals[:, 1], normals[:, 0]),
        distance=distance,
    )


def rms(residual: Array) -> float:
    """Return the root mean square of the lengths of residuals (n, 2) or (n, 3); NaN for none."""
    if not len(residual):
        return float("nan")
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))


def _indices_by_name(names: list[str] | tuple[str, ...]) -> dict[str, Integers]:
    """Return the indices of each name, from 0, in the order in which names first occur."""
    indices: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        indices.setdefault(name, []).append(index)
    return {name: np.array(of_name) for name, of_name in indices.items()}
