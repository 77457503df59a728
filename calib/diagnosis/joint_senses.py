"""Senses of joints: whether images determine in which direction each joint counts.

Frames, targets and the zeros of the joints may make up for a joint with the wrong sign: it then fits within
millimetres, and every figure looks good. So each joint's values are reversed in turn, and the poses of the boards are
fitted again.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.data.priors import Priors
from calib.diagnosis.misfit import poses_of_images, with_joints
from calib.diagnosis.reasons import Reason, Why
from calib.errors import CalibError
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.fit.registration.table_rows import rows_and_setup
from calib.robot.robot import Robot

#: Reversed values fit far better if their error is less than this share of that of the values as given.
_FAR_BETTER = 0.5

#: They fit as well if their error is no more than this multiple of it.
_AS_WELL = 1.5

#: Views that are enough.
_VIEWS = 60

#: The fewest views.
_FEWEST = 6


def doubtful_senses(robot: Robot, cell: Cell, table: Measurements) -> Iterator[Reason]:
    """Find joints that seem to count the other way, and joints whose direction the images do not determine.

    Args:
        robot: The nominal robot.
        cell: The cell as given.
        table: The rows that are fitted; none is examined unless all are images.

    Yields:
        At most one reason of each sort, with the names of the joints.
    """
    from_images = poses_of_images(robot, cell, table)
    if from_images is None:
        return
    table_of_poses, cell_of_poses = from_images
    if len(table_of_poses) < _FEWEST:
        return
    rows, setup = rows_and_setup(robot, table_of_poses, cell_of_poses)
    rows = rows.select(rows.evenly(_VIEWS))
    given = _errors(robot, setup, rows)
    if given is None:
        return

    turned, unknown = [], []
    for j, name in enumerate(robot.joint_names):
        reversed_joint = np.where(np.arange(rows.joints.shape[1]) == j, -1.0, 1.0)
        other = _errors(robot, setup, with_joints(rows, rows.joints * reversed_joint))
        if other is None:
            continue
        ratio = max(other[0] / given[0], other[1] / given[1])
        if ratio < _FAR_BETTER:
            turned.append((ratio, name, other[0]))
        elif ratio < _AS_WELL:
            unknown.append(name)
    if turned:
        _, name, error = min(turned)
        yield Reason.of(Why.SENSE_REVERSED, joint=name, given_m=given[0], error_m=error)
    if unknown:
        yield Reason.of(Why.SENSE_UNKNOWN, joints=", ".join(unknown))


def _errors(robot: Robot, setup: Setup, rows: Rows) -> tuple[float, float] | None:
    """Fit frames, targets and joint zeros to poses: median errors [m], [rad]; None if there is no fit."""
    cell = Cell(priors=Priors("given"))
    try:
        fitted = fit(Task(robot, cell, setup, "zeros"), rows)
    except CalibError:
        return None
    residual = fitted.residual(rows)
    lengths = np.linalg.norm(residual[:, :3], axis=1)
    angles = np.linalg.norm(residual[:, 3:6], axis=1)
    tiny = np.finfo(float).tiny
    return max(float(np.median(lengths)), tiny), max(float(np.median(angles)), tiny)
