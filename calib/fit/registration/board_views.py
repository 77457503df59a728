"""Views of boards as poses: where a registration by images begins.

The corners that a camera sees of a board at one pose of the robot determine the board's pose in the camera: in closed
form, then by least squares (`calib.camera.planar_pose`). Cameras and boards are registered to these poses first, in
closed form too, and from there to the images themselves. So no guess of either is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array, Integers
from calib.camera import optics
from calib.camera.lenses import LENSES
from calib.camera.planar_pose import planar_poses
from calib.errors import MeasurementError
from calib.fit.registration.rows import Rows


def images_as_poses(rows: Rows) -> tuple[Rows, Integers]:
    """Replace the images of a table by the poses of the boards that they show.

    Args:
        rows: N rows, of which some are images.

    Returns:
        One pose row for each view and the rows that are not images, all in table order; and the number in the table of
        a row with the same joint values, shape (n,): of a view that of its first corner. A view of too few corners, or
        whose corners lie on a line, is left out.

    Raises:
        MeasurementError: All are.
    """
    is_image = rows.where(lambda kind: kind.optical)
    labels = np.column_stack([rows.blocks, rows.samples.frame, rows.samples.target])
    _, view = np.unique(labels, axis=0, return_inverse=True)
    view = view.reshape(-1)
    values = rows.samples.optics
    assert values is not None
    first: list[int] = []
    poses: list[Array] = []
    for camera in np.unique(values[is_image, optics.CAMERA]):
        of_camera = is_image & (values[:, optics.CAMERA] == camera)
        numbers = np.unique(view[of_camera])
        of_views = [np.flatnonzero(of_camera & (view == number)) for number in numbers]
        for T_camera_board, of_view in zip(_board_poses(rows, of_views), of_views, strict=True):
            if T_camera_board is not None:
                first.append(int(of_view[0]))
                poses.append(
                    np.concatenate([T_camera_board[:3, 3], T_camera_board[:3, :3].ravel()])
                )
    if not first:
        raise MeasurementError(
            "No image shows enough of a board to tell its pose: four corners that are not on a line."
        )

    pose = registry.get("pose")
    measured = np.zeros((len(rows), max(rows.measured.shape[1], pose.size)))
    measured[:, : rows.measured.shape[1]] = rows.measured
    measured[first] = 0.0
    measured[first, : pose.size] = poses
    kind = rows.kind.copy()
    kind[first] = len(rows.kinds)
    with_poses = replace(rows, kinds=(*rows.kinds, pose), kind=kind, measured=measured)
    mask = ~is_image
    mask[first] = True
    return with_poses.select(mask), np.flatnonzero(mask)


def _board_poses(rows: Rows, views: Sequence[Integers]) -> list[Array | None]:
    """Return T_camera_board, (4, 4) [m], of each view (its rows) of one camera; None if the view is not enough."""
    values = rows.samples.optics
    assert values is not None
    points = optics.board_points(values)
    lens = list(LENSES.values())[int(values[views[0][0], optics.LENS])]
    intrinsics = values[views[0][0], : len(lens.names)]
    corners = [(points[view], rows.measured[view, :2]) for view in views]
    poses = planar_poses(corners, lens, intrinsics)
    return [None if pose is None else pose.T_camera_board for pose in poses]
