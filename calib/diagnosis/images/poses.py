"""Images as measured poses: what the tests of tables of poses look at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.fit.registration.board_views import images_as_poses
from calib.fit.registration.table_rows import rows_and_setup
from calib.robot.robot import Robot


def as_poses(robot: Robot, cell: Cell, table: Measurements) -> tuple[Measurements, Cell]:
    """Replace a table of images by the poses of the boards in them, one row a view.

    Args:
        robot: The nominal robot.
        cell: The cell as given.
        table: Images alone.

    Returns:
        The poses, with the rows' numbers of the first corner of each view, and the cell with cameras as frames that are
        estimated unless they are given.
    """
    rows, setup = rows_and_setup(robot, table, cell)
    views, source_rows = images_as_poses(rows)
    measured = views.measured
    mask = np.zeros(len(table), dtype=bool)
    mask[source_rows] = True
    first = table.select(mask)
    poses = replace(
        first,
        kinds=("pose",) * len(first),
        points=measured[:, :3],
        rotations=measured[:, 3:12].reshape(-1, 3, 3),
        readings={},
        board_points=None,
        sigma={},
        images=(),
        corners=(),
    )
    estimated = any(bool(directions) for directions in setup.unknown)
    return poses, replace(cell, estimate_frame=estimated, kind=None)
