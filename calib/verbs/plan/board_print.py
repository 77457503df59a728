"""The print of a calibrated board: where its corners are by its scale and sag as estimated, and how well that is known.

A corner designed at (X, Y) is at

    P = ((1 + s_x) X,  (1 + s_y) Y,  w_x (1 - xi^2) + w_y (1 - eta^2)),

xi and eta its place across the board, from -1 to 1; see `calib.camera.optics`. The corners' own errors are left out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calib.basics.arrays import Array
from calib.boards.board import Board
from calib.camera.optics import across
from calib.result.fitted_model import FittedModel


class PrintedCorners(NamedTuple):
    """Corners of a board as printed."""

    #: Shape (k, 3), in the board's frame [m].
    points: Array
    #: Shape (k, 3, 3), along the axes of the board's frame [m^2].
    covariance: Array


def printed_corners(part: FittedModel, board: Board, target: str, points: Array) -> PrintedCorners:
    """Return corners as printed; as designed where a result has no estimate of the print.

    Args:
        part: A result's geometry or its non-geometric model.
        board: The board as designed.
        target: Name of the board among the result's targets.
        points: The corners as designed, shape (k, 3), [m].

    Returns:
        The corners with the estimated scale and sag, and the covariance of these.
    """
    names = [parameter.name for parameter in part.parameters]
    place = across(points, board.centre, board.size)
    numbers, slopes = [], []
    for name, slope in _slopes(points, place).items():
        for known in (name, f"{name}[{target}]"):
            if known in names:
                numbers.append(names.index(known))
                slopes.append(slope)
    if not numbers:
        return PrintedCorners(points, np.zeros((len(points), 3, 3)))
    by_print = np.stack(slopes, axis=2)
    values = part.x[numbers]
    covariance = part.covariance[np.ix_(numbers, numbers)]
    return PrintedCorners(
        points=points + by_print @ values,
        covariance=by_print @ covariance @ by_print.swapaxes(1, 2),
    )


def _slopes(points: Array, place: Array) -> dict[str, Array]:
    """Return the derivatives of corners by scale and sag, by the names of these parameters.

    Args:
        points: The corners as designed, shape (k, 3), [m].
        place: The same across the board along x and y, from -1 to 1, shape (k, 2).

    Returns:
        Shape (k, 3) each, [m a unit].
    """
    zero = np.zeros(len(points))
    return {
        "board_scale_x": np.column_stack([points[:, 0], zero, zero]),
        "board_scale_y": np.column_stack([zero, points[:, 1], zero]),
        "board_sag_x": np.column_stack([zero, zero, 1.0 - place[:, 0] ** 2]),
        "board_sag_y": np.column_stack([zero, zero, 1.0 - place[:, 1] ** 2]),
    }
