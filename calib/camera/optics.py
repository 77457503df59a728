"""Optics of a row: all numbers of its camera and its board with which the image of one corner is predicted.

A corner is designed to be at P = (X, Y, Z) on its board. The print has another scale and errors of its own, and a flat
board is not quite flat:

    P' = [(1 + s_x) X + e_x, (1 + s_y) Y + e_y, (1 + s_z) Z + e_z + w_x (1 - xi^2) + w_y (1 - eta^2)]

with the relative errors s of the scale along x, y and z (the scale along a printer's feed differs from that across it),
the corner's own errors e, the sag w of the board's middle along x and along y, and the corner's place xi and eta across
the board, from -1 to 1. Of a flat board, Z = 0, only the sag is along z; a body of tags does not sag. In the camera it
is at R P' + p, which the lens (`calib.camera.lenses`) projects. These numbers are columns of an array (N, `COUNT`),
with one row for each corner.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from calib.basics.arrays import Array, Integers
from calib.camera.board_pose import board_poses
from calib.camera.lenses import LENSES, Lens

#: The first intrinsics, those that lenses of five coefficients or fewer have; one that has fewer leaves the last ones
#: at zero. `intrinsic_columns` also has those beyond them.
INTRINSICS = slice(0, 9)

#: The two focal lengths among them [px].
FOCAL = slice(0, 2)

#: Number of the lens, in the order of `LENSES`.
LENS = 9

#: The corner on the board as designed [m].
POINT = slice(10, 13)

#: The corner across the board along x and y, from -1 to 1.
ACROSS = slice(13, 15)

#: Relative error of the board's scale along x, y and z.
SCALE = (15, 16, 33)

#: Sag of the board's middle along x and along y, towards its z [m].
WARP = slice(17, 19)

#: The corner's own errors on the print, along x, y and z [m].
OFFSET = (19, 20, 34)

#: Number of the corner's name, from 0.
CORNER = 21

#: Number of the camera, and of the printed board, from 0.
CAMERA = 22
BOARD = 23

#: Further intrinsics of lenses that have more; the columns of all other numbers are those of results in files.
_FURTHER = slice(24, 33)

#: Columns of an array of optics.
COUNT = 35


def intrinsic_columns(lens: Lens) -> Integers:
    """Return the columns of the m intrinsics of a lens in an array of optics, in the order of its names, shape (m,)."""
    columns = np.arange(COUNT)
    return np.concatenate([columns[INTRINSICS], columns[_FURTHER]])[: len(lens.names)]


def board_points(optics: Array) -> Array:
    """Return where the corners are on their boards, with the errors of print and flatness.

    Args:
        optics: shape (n, `COUNT`), the numbers of the board and the camera of each corner.

    Returns:
        shape (n, 3), in the board's frame [m].
    """
    designed = optics[:, POINT]
    points: Array = designed + (optics[:, SCALE] * designed + optics[:, OFFSET])
    points[:, 2] += np.sum(optics[:, WARP] * _bulge(optics), axis=1)
    return points


def images(T_camera_board: Array, optics: Array) -> Array:
    """Predict the images of corners.

    Args:
        T_camera_board: shape (n, 4, 4), pose of each row's board in its camera [m].
        optics: shape (n, `COUNT`), the numbers of the board and the camera of each corner.

    Returns:
        shape (n, 2) [px].
    """
    points = _in_camera(T_camera_board, board_points(optics))
    result = np.empty((len(optics), 2))
    for lens, rows in _by_lens(optics):
        result[rows] = lens.project(points[rows], _intrinsics(lens, optics[rows]))
    return result


def image_derivatives(T_camera_board: Array, twists: Array, optics: Array) -> tuple[Array, Array]:
    """Return the derivatives of the images of corners by the boards' motions, and by the optics.

    Args:
        T_camera_board: shape (n, 4, 4), pose of each row's board in its camera [m].
        twists: shape (n, 6, p), velocity of the board's origin and angular velocity, along the camera's axes, by each
            of p parameters.
        optics: shape (n, `COUNT`), the numbers of the board and the camera of each corner.

    Returns:
        shape (n, 2, p), [px] per unit of each parameter; and (n, 2, `COUNT`), [px] per unit of each number.
    """
    points = _in_camera(T_camera_board, board_points(optics))
    by_point = np.empty((len(optics), 2, 3))
    by_optics = np.zeros((len(optics), 2, COUNT))
    for lens, rows in _by_lens(optics):
        values = _intrinsics(lens, optics[rows])
        by_point[rows], by_values = lens.derivatives(points[rows], values)
        by_optics[rows[:, None, None], np.arange(2)[:, None], intrinsic_columns(lens)] = by_values
    by_board_point = by_point @ T_camera_board[:, :3, :3]
    by_optics[:, :, SCALE] = by_board_point * optics[:, None, POINT]
    by_optics[:, :, WARP] = by_board_point[:, :, 2:] * _bulge(optics)[:, None]
    by_optics[:, :, OFFSET] = by_board_point
    lever = points - T_camera_board[:, :3, 3]
    # A turn w moves the point by w x lever, so that row d of by_point gives w . (lever x d).
    by_turn = np.cross(lever[:, None], by_point)
    return np.concatenate([by_point, by_turn], axis=2) @ twists, by_optics


def view_poses(views: Sequence[tuple[Array, Array]]) -> list[Array | None]:
    """Estimate the poses of boards in cameras, each from the corners of one view.

    Args:
        views: Images of the corners of each view, shape (k, 2) [px], and the numbers of lens and print of each corner,
            shape (k, `COUNT`).

    Returns:
        T_camera_board, shape (4, 4) [m], of each view; None for one whose corners do not determine it.
    """
    by_camera: dict[float, list[int]] = {}
    for k, (_, optics) in enumerate(views):
        by_camera.setdefault(float(optics[0, CAMERA]), []).append(k)
    result: list[Array | None] = [None] * len(views)
    for numbers in by_camera.values():
        of_camera = views[numbers[0]][1][0]
        lens = list(LENSES.values())[int(of_camera[LENS])]
        corners = [(board_points(views[k][1]), views[k][0]) for k in numbers]
        poses = board_poses(corners, lens, of_camera[intrinsic_columns(lens)])
        for k, pose in zip(numbers, poses, strict=True):
            result[k] = None if pose is None else pose.T_camera_board
    return result


def across(points: Array, centre: Array, size: tuple[float, float]) -> Array:
    """Return the places of points across a board, from -1 to 1 along x and y, shape (n, 2).

    Args:
        points: shape (n, 3), in the board's frame [m].
        centre: shape (3,), the board's middle [m].
        size: Width and height of the board [m]; a body seen from its edge has none, and its points are in its middle.
    """
    extent = np.array(size)
    return np.asarray(2.0 * (points[:, :2] - centre[:2]) / np.where(extent > 0.0, extent, 1.0))


def _bulge(optics: Array) -> Array:
    """Return the height of a board's corners per unit of its two sags, shape (n, 2)."""
    return np.asarray(1.0 - optics[:, ACROSS] ** 2)


def _in_camera(T_camera_board: Array, points: Array) -> Array:
    """Return points (n, 3) [m], each of a board with the pose (n, 4, 4) [m] in its camera, in that camera's frame."""
    turned = (T_camera_board[:, :3, :3] @ points[:, :, None])[:, :, 0]
    return np.asarray(turned + T_camera_board[:, :3, 3])


def _by_lens(optics: Array) -> Iterator[tuple[Lens, Integers]]:
    """Yield each lens that occurs in optics (n, `COUNT`), and the indices, from 0, of its rows."""
    number = optics[:, LENS]
    for k, lens in enumerate(LENSES.values()):
        rows = np.flatnonzero(number == k)
        if len(rows):
            yield lens, rows


def _intrinsics(lens: Lens, optics: Array) -> Array:
    """Return the m intrinsics of a lens from optics (n, `COUNT`), shape (n, m)."""
    return optics[:, intrinsic_columns(lens)]
