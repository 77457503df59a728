"""Starts of a registration that is not linear: targets at several places, with the frames that suit each."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array
from calib.fit.registration.closed_form import orientation_setup, with_frames_fitted
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.model.error_model import DIRECTIONS

#: Distances from the tip at which a target is tried when its place was not given [m]: a flange and a long tool.
_REACHES = (0.15, 0.7)

#: Rotations of a frame, by direction, and the axis they turn about.
_AXES = {"rx": "x", "ry": "y", "rz": "z"}


def starts_of(setup: Setup, T_base_tip: Array, rows: Rows) -> list[Setup]:
    """Return setups from which to refine a registration; one where orientations determine it.

    Args:
        setup: Frames and targets, with what is estimated of them.
        T_base_tip: shape (N, 4, 4), pose of the tip at each row [m].
        rows: N rows.
    """
    by_orientation = orientation_setup(setup, T_base_tip, rows)
    if by_orientation is not None:
        return [by_orientation]
    result = []
    for turned, T_tip_target in itertools.product(_turned_frames(setup), target_poses(setup)):
        start = turned.placed(turned.T_frame_base, T_tip_target)
        result.append(with_frames_fitted(start, T_base_tip, rows))
    return result


def target_poses(setup: Setup) -> list[Array]:
    """Return poses of all targets in the tip to start from, each of shape (T, 4, 4): as they are, and along each axis.

    Args:
        setup: Targets, and which of them are estimated.
    """
    result = [setup.T_tip_target]
    if not setup.estimate_target:
        return result
    axes = [*np.eye(3), *-np.eye(3)]
    offsets = [reach * axis for reach in _REACHES for axis in axes]
    if np.any(setup.target_given & setup.target_unknown):
        offsets.append(np.zeros(3))
    for offset in offsets:
        moved = setup.T_tip_target.copy()
        moved[setup.target_unknown, :3, 3] = offset
        result.append(moved)
    return result


def _turned_frames(setup: Setup) -> list[Setup]:
    """The setup, and its frame turned by quarters about each rotation that is estimated, if not all are.

    Refinement converges from any of them; a frame that is wholly unknown is fitted in closed form.
    """
    result = [setup]
    directions = setup.unknown[0]
    if len(setup.groups) > 1 or len(directions) == len(DIRECTIONS):
        return result
    for direction, axis in _AXES.items():
        if direction not in directions:
            continue
        for quarter in (1, 2, 3):
            R = np.eye(4)
            R[:3, :3] = Rotation.from_euler(axis, quarter * np.pi / 2).as_matrix()
            result.append(setup.placed(setup.T_frame_base @ R, setup.T_tip_target))
    return result
