"""Senses of joints: whether poses tell in which direction each joint counts.

A joint with the wrong sign may be made up for by frames, targets and the zeros of the joints: it then fits within
millimetres, and every figure looks well. So each joint's values are reversed in turn, and the poses are fitted again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.data.priors import Priors
from calib.diagnosis.images.poses import as_poses
from calib.diagnosis.misfit import with_joints
from calib.diagnosis.reasons import Reason, Why
from calib.errors import CalibError
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup
from calib.fit.registration.table_rows import rows_and_setup
from calib.robot.robot import Robot

#: Reversed values fit far better where their error is less than this share of that of the values as given.
_FAR_BETTER = 0.5

#: They fit as well where their error is no more than this multiple of it.
_AS_WELL = 1.5

#: Views that are enough.
_VIEWS = 60

#: The fewest views.
_FEWEST = 6


@dataclass(frozen=True, slots=True)
class _Fit:
    """Errors of a fit of frames, targets and joint zeros to poses, medians over them."""

    #: Distance of positions [m]
    length: float
    #: Turn of orientations [rad]
    angle: float


def doubtful_senses(robot: Robot, cell: Cell, table: Measurements) -> Iterator[Reason]:
    """Find joints that seem to count the other way, and joints whose direction the images cannot tell.

    Args:
        robot: The nominal robot.
        cell: The cell as given.
        table: The rows that are fitted; none is examined unless all are images.

    Yields:
        At most one reason of each sort, with the names of the joints.
    """
    if not len(table) or not np.all(table.where(lambda kind: kind.optical)):
        return
    poses, cell_of_poses = as_poses(robot, cell, table)
    if not len(poses) >= _FEWEST:
        return
    rows, setup = rows_and_setup(robot, poses, cell_of_poses)
    rows = rows.select(rows.evenly(_VIEWS))
    given = _fitted(robot, setup, rows)
    if given is None:
        return
    turned, unknown = [], []
    for j, name in enumerate(robot.joint_names):
        reversed_joint = np.where(np.arange(rows.joints.shape[1]) == j, -1.0, 1.0)
        other = _fitted(robot, setup, with_joints(rows, rows.joints * reversed_joint))
        if other is None:
            continue
        ratio = max(other.length / given.length, other.angle / given.angle)
        if ratio < _FAR_BETTER:
            turned.append((ratio, name, other))
        elif ratio < _AS_WELL:
            unknown.append(name)
    if turned:
        _, name, other = min(turned)
        yield Reason.of(
            Why.SENSE_REVERSED,
            joint=name,
            given_m=given.length,
            error_m=other.length,
        )
    if unknown:
        yield Reason.of(Why.SENSE_UNKNOWN, joints=", ".join(unknown))


def _fitted(robot: Robot, setup: Setup, rows: Rows) -> _Fit | None:
    """Fit frames, targets and joint zeros to poses; None where nothing comes of it."""
    cell = Cell(priors=Priors("given"))
    try:
        fitted = fit(Task(robot, cell, setup, "zeros"), rows)
    except CalibError:
        return None
    return _errors(fitted.residual(rows))


def _errors(residual: Array) -> _Fit:
    """Return the medians of the errors of poses, residuals of shape (N, 6)."""
    lengths = np.linalg.norm(residual[:, :3], axis=1)
    angles = np.linalg.norm(residual[:, 3:6], axis=1)
    tiny = np.finfo(float).tiny
    return _Fit(max(float(np.median(lengths)), tiny), max(float(np.median(angles)), tiny))
