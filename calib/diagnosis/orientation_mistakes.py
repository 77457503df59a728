"""Mistakes that only orientations show: the positions of poses are plausible, their orientations are not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array
from calib.diagnosis.joint_mistakes import shifted_zeros
from calib.diagnosis.misfit import misfit, with_joints
from calib.diagnosis.reasons import Reason, Why
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.robot.robot import Robot

PLAUSIBLE = 0.02
"""Nominal errors below this need no other explanation than an uncalibrated arm [m]."""

PLAUSIBLE_ANGLE = 0.1
"""Errors of orientations below this need no other explanation than an uncalibrated arm [rad]."""

FAR_BETTER = 0.2
"""A mistake is named only if undoing it lowers the error to this share."""


def orientation_mistake(robot: Robot, setup: Setup, rows: Rows) -> Reason | None:
    """Explain orientations that make no sense as given: joints turned the other way, zeros, conventions of software.

    A target on the last joint's axis stands where it does whatever that joint's sign and zero are.

    Args:
        robot: The nominal robot, whose positions are plausible.
        setup: Frames and targets as given.
        rows: Rows as measured, points or poses.

    Returns:
        The mistake, with the rms errors of orientations as given and with it undone [rad]; None if the error is
        plausible, a row has no orientation, or no mistake explains them.
    """
    if not np.all(rows.where(lambda kind: kind.orientation)):
        return None
    _, given = misfit(robot, setup, rows)
    if given < PLAUSIBLE_ANGLE:
        return None
    best, reason = np.inf, None
    for changed, why, values in _trials(robot, rows):
        position_error, error = misfit(robot, setup, changed)
        if error < best and position_error < PLAUSIBLE:
            best = error
            reason = Reason.of(why, given_rad=given, error_rad=error, **values)
    return reason if best < FAR_BETTER * given else None


def _trials(robot: Robot, rows: Rows) -> Iterator[tuple[Rows, Why, dict[str, Any]]]:
    """Read orientations by other conventions, reverse the sign of a joint, and shift its zero, one at a time.

    Args:
        robot: The nominal robot.
        rows: Rows of poses.

    Yields:
        The rows, the code of the mistake, and the values of its reason.
    """
    for scalar, orientations in by_other_conventions(rows.measured).items():
        columns = np.hstack([rows.measured[:, :3], orientations])
        why = Why.SCALAR_ELSEWHERE if scalar else Why.ORIENTATIONS_INVERSE
        yield replace(rows, measured=columns), why, {"scalar": scalar} if scalar else {}
    q = rows.joints
    for i, joint in enumerate(robot.inputs):
        if joint.type == "prismatic":
            continue
        signs = 1.0 - 2.0 * np.eye(q.shape[1])[i]
        yield with_joints(rows, q * signs), Why.ORIENTATIONS_JOINT_TURNED, {"joint": joint.name}
        for shifted, _, values in shifted_zeros(joint.name, i, q):
            yield with_joints(rows, shifted), Why.ORIENTATIONS_JOINT_ZERO, values


def by_other_conventions(poses: Array) -> dict[str, Array]:
    """Read the orientations of poses by the conventions of other software.

    Args:
        poses: Position [m] and the nine entries of the rotation matrix, row after row, shape (N, 12).

    Returns:
        The nine entries of each rotation matrix, shape (N, 9): under ``"last"`` and ``"first"`` if the scalar of the
        quaternions stands last or first, and was read from the other end; under ``""`` of the inverse rotations.
    """
    given = Rotation.from_matrix(poses[:, 3:12].reshape(-1, 3, 3))
    wxyz = given.as_quat(scalar_first=True)
    rotations = {
        "last": Rotation.from_quat(wxyz),
        "first": Rotation.from_quat(np.roll(wxyz, -2, 1)),
        "": given.inv(),
    }
    return {scalar: R.as_matrix().reshape(-1, 9) for scalar, R in rotations.items()}
