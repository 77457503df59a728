"""Views of a board: how it was seen, and what such pictures cannot tell."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Integers
from calib.diagnosis.reasons import Reason, Why
from calib.fit.estimate.fitting import Fitted

#: A board that was never tilted by more than this was always seen head on [rad].
_HEAD_ON = np.radians(15.0)

#: A picture with fewer corners tells the board's pose badly, however well it fits.
_FEW_CORNERS = 15

#: So many pictures with few corners, as a share of all, are worth a word.
_SHARE = 0.2

#: Turns of the hand that spread by less about all axes but one leave the camera's place along that one open [rad].
_ONE_AXIS = np.radians(10.0)


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """The n views of a fit: a board in a camera at one pose of the robot."""

    #: shape (n,), number of corners seen
    corners: Integers
    #: shape (n,), angle between the line of sight to the board and its normal [rad]
    tilt: Array
    #: shape (n, 3, 3), orientation of the tip in the base
    R_base_tip: Array


def views_of_fit(fitted: Fitted) -> Views:
    """Return the views that a fit saw.

    Args:
        fitted: A fit, of which some rows are images.
    """
    rows = fitted.estimate.problem.rows
    images = rows.select(rows.where(lambda kind: kind.optical))
    T_camera_board = fitted.kinematics.poses(fitted.estimate.x, images.samples)
    points = images.points(T_camera_board)
    labels = np.column_stack([images.blocks, images.samples.frame, images.samples.target])
    _, first, view = np.unique(labels, axis=0, return_index=True, return_inverse=True)
    view = view.reshape(-1)
    count = np.bincount(view)
    middle = np.stack([np.bincount(view, column) for column in points.T], axis=1) / count[:, None]
    sight = middle / np.linalg.norm(middle, axis=1, keepdims=True)
    cosine = np.abs(np.sum(sight * T_camera_board[first, :3, 2], axis=1))
    R_base_tip = fitted.task.robot.poses(images.joints[first])[:, :3, :3]
    return Views(count, np.arccos(np.minimum(cosine, 1.0)), R_base_tip)


def doubtful_views(fitted: Fitted) -> Iterator[Reason]:
    """Doubt pictures that all show the board head on, or few of its corners, or turned about one axis only.

    Args:
        fitted: A fit; nothing is doubted without images.

    Yields:
        A reason for each.
    """
    rows = fitted.estimate.problem.rows
    if not np.any(rows.where(lambda kind: kind.optical)):
        return
    views = views_of_fit(fitted)
    most = float(np.max(views.tilt))
    if most < _HEAD_ON:
        yield Reason.of(Why.BOARD_HEAD_ON, tilt_rad=most)
    few = int(np.sum(views.corners < _FEW_CORNERS))
    if few > _SHARE * len(views.corners):
        yield Reason.of(Why.FEW_CORNERS, images=few, all=len(views.corners), corners=_FEW_CORNERS)
    across = spread_of_axes(views.R_base_tip)
    if across < _ONE_AXIS:
        yield Reason.of(Why.ONE_AXIS, across_rad=across)


def spread_of_axes(rotations: Array) -> float:
    """Return how far rotations go about other axes than their main one.

    Args:
        rotations: shape (n, 3, 3).

    Returns:
        Root mean square of their rotation vectors from a middle one, along the second of their principal axes [rad].
    """
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_matrix(rotations)
    vectors = (turns * turns.mean().inv()).as_rotvec()
    return float(np.sqrt(np.linalg.eigvalsh(vectors.T @ vectors / len(vectors))[1]))
