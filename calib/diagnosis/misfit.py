"""Errors of a robot on rows, with what is unknown of frames and targets registered to them."""

from __future__ import annotations

from dataclasses import replace

from calib.basics.arrays import Array
from calib.fit.registration.registration import register
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.numerics.errors import Errors
from calib.robot.robot import Robot

TOLERANCE = 1e-6
"""Tolerance of a registration: five digits are enough to compare."""


def misfit(robot: Robot, setup: Setup, rows: Rows) -> tuple[float, float]:
    """Register what the setup leaves unknown, and return the errors of the robot then.

    Args:
        robot: The robot.
        setup: Frames and targets, with what is registered.
        rows: Rows of points or poses.

    Returns:
        The rms error of positions [m], and of orientations [rad]; the latter is NaN of points.
    """
    T_base_tip = robot.poses(rows.joints)
    placed = register(T_base_tip, setup, rows, tolerance=TOLERANCE)
    T_frame_target = placed.target_poses(T_base_tip, rows.samples)
    errors = Errors.of(rows.residual(T_frame_target), rows.channels)
    return errors["m"].rms, errors["rad"].rms


def with_joints(rows: Rows, q: Array) -> Rows:
    """Copy rows with other joint values, shape (N, m) [rad] or [m]."""
    return replace(rows, samples=replace(rows.samples, q=q))
