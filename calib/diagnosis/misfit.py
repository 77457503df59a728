"""Errors of a robot on rows as given or changed, with what is unknown of frames and targets registered to them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.basics.arrays import Array
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.fit.registration.registration import register
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.fit.registration.table_rows import rows_and_setup
from calib.fit.registration.views import views_as_poses
from calib.numerics.errors import Errors
from calib.robot.robot import Robot

#: Tolerance of a registration: five digits are enough to compare.
TOLERANCE = 1e-6


def misfit(robot: Robot, setup: Setup, rows: Rows) -> tuple[float, float]:
    """Register what the setup leaves unknown, and return the errors of the robot then.

    Args:
        robot: The robot.
        setup: Frames and targets, with what is registered.
        rows: Rows of points or poses.

    Returns:
        The rms error of positions [m], and of orientations [rad]; the latter is NaN for points.
    """
    T_base_tip = robot.poses(rows.joints)
    registered = register(T_base_tip, setup, rows, tolerance=TOLERANCE)
    errors = Errors.of(rows.residual(registered.sightings(T_base_tip, rows.samples)), rows.channels)
    return errors["m"].rms, errors["rad"].rms


def with_joints(rows: Rows, q: Array) -> Rows:
    """Copy rows with other joint values, shape (N, m) [rad] or [m]."""
    return replace(rows, samples=replace(rows.samples, q=q))


def poses_of_images(
    robot: Robot, cell: Cell, table: Measurements
) -> tuple[Measurements, Cell] | None:
    """Replace a table of images by the poses of the boards that they show, one row a view.

    Args:
        robot: The nominal robot.
        cell: The cell as given.
        table: Rows of any kind.

    Returns:
        The poses, with the numbers of the first corner of each view, and the cell with cameras as frames that are
        estimated unless they are given; None unless all rows are corners in images.
    """
    if not len(table) or not np.all(table.is_image):
        return None
    rows, setup = rows_and_setup(robot, table, cell)
    views, source_rows = views_as_poses(rows)
    mask = np.zeros(len(table), dtype=bool)
    mask[source_rows] = True
    first = table.select(mask)
    poses = replace(
        first,
        kinds=("pose",) * len(first),
        points=views.measured[:, :3],
        rotations=views.measured[:, 3:12].reshape(-1, 3, 3),
        readings={},
        board_points=None,
        sigma={},
        images=(),
        corners=(),
    )
    estimated = any(bool(directions) for directions in setup.unknown)
    return poses, replace(cell, estimate_frame=estimated, kind=None)
