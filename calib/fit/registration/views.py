"""Views of boards as poses: where a registration by images begins.

The corners that a camera sees of a board at one pose of the robot tell the board's pose in the camera: in closed form,
then by least squares (`calib.camera.planar_pose`). Cameras and boards are registered to these poses first, in closed
form too, and from there to the images themselves. So no guess of either is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array, Integers, Mask
from calib.camera import optics
from calib.camera.lenses import LENSES
from calib.camera.planar_pose import planar_poses
from calib.errors import MeasurementError
from calib.fit.registration.rows import Rows


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """The views of boards, as rows that measure poses, with the other rows of a table."""

    #: Rows: one pose for each view, and the rows that are no images
    rows: Rows
    #: shape (n,), index in the table of a row that has each row's joint values
    first: Integers


def views_of(rows: Rows) -> Views:
    """Replace the images of a table by the poses of the boards that they show.

    Args:
        rows: N rows, of which some are images.

    Returns:
        The views; one of too few corners, or whose corners lie on a line, is left out.

    Raises:
        MeasurementError: All are.
    """
    is_image = rows.where(lambda kind: kind.optical)
    labels = np.column_stack([rows.blocks, rows.samples.frame, rows.samples.target])
    _, view = np.unique(labels, axis=0, return_inverse=True)
    view = view.reshape(-1)
    first: list[int] = []
    measured: list[Array] = []
    for of_camera in _rows_by_camera(rows, is_image):
        numbers = np.unique(view[of_camera])
        of_views = [np.flatnonzero(of_camera & (view == number)) for number in numbers]
        for T_camera_board, of_view in zip(_board_poses(rows, of_views), of_views, strict=True):
            if T_camera_board is not None:
                first.append(int(of_view[0]))
                measured.append(_reading(T_camera_board))
    if not first:
        raise MeasurementError(
            "No image shows enough of a board to tell its pose: four corners that are not on a line."
        )
    others = np.flatnonzero(~is_image)
    return _as_poses(rows, np.array(first, dtype=np.int_), np.array(measured), others)


def _rows_by_camera(rows: Rows, is_image: Mask) -> list[Mask]:
    """Return the images of each camera, shape (N,) each."""
    values = rows.samples.optics
    assert values is not None
    cameras = np.unique(values[is_image, optics.CAMERA])
    return [is_image & (values[:, optics.CAMERA] == camera) for camera in cameras]


def _board_poses(rows: Rows, views: Sequence[Integers]) -> list[Array | None]:
    """Return the pose of the board in each view of one camera, shape (4, 4) [m]; None where the view does not tell it.

    Args:
        rows: All rows.
        views: Indices of the rows of each view.
    """
    values = rows.samples.optics
    assert values is not None
    points = optics.board_points(values)
    lens = list(LENSES.values())[int(values[views[0][0], optics.LENS])]
    intrinsics = values[views[0][0], : len(lens.names)]
    corners = [(points[view], rows.measured[view, :2]) for view in views]
    poses = planar_poses(corners, lens, intrinsics)
    return [None if pose is None else pose.T_camera_board for pose in poses]


def _reading(T_camera_board: Array) -> Array:
    """Return a pose as rows of the kind ``pose`` measure it, shape (12,)."""
    return np.concatenate([T_camera_board[:3, 3], T_camera_board[:3, :3].ravel()])


def _as_poses(rows: Rows, first: Integers, measured: Array, others: Integers) -> Views:
    """Return rows that measure poses, one for each view, and behind them the rows that are no images.

    Args:
        rows: N rows.
        first: shape (n,), index of a row of each view.
        measured: shape (n, 12), the pose of the board in each view.
        others: Indices of the rows that are no images.
    """
    pose = registry.get("pose")
    values = np.zeros((len(rows), max(rows.measured.shape[1], pose.size)))
    values[:, : rows.measured.shape[1]] = rows.measured
    values[first] = 0.0
    values[first, : pose.size] = measured
    kind = rows.kind.copy()
    kind[first] = len(rows.kinds)
    with_poses = replace(rows, kinds=(*rows.kinds, pose), kind=kind, measured=values)
    chosen = np.sort(np.concatenate([first, others]))
    mask = np.zeros(len(rows), dtype=bool)
    mask[chosen] = True
    return Views(with_poses.select(mask), chosen)
