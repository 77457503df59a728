"""Corners of boards at their estimated places: what the choice of a model need not estimate again for each candidate.

Every corner of a print has two errors of its own, often more than the robot has parameters. They hardly depend on the
robot's model, so that candidates are compared with the corners where a first fit has them.
"""

from __future__ import annotations

from dataclasses import replace

from calib.basics.arrays import read_only
from calib.camera.optics import OFFSET
from calib.fit.estimate.fitting import Fitted
from calib.fit.estimate.task import Task
from calib.fit.registration.rows import Rows


def with_known_corners(task: Task, fitted: Fitted, rows: Rows) -> tuple[Task, Rows]:
    """Return a task and its rows with the places of corners as a fit estimated them, and known.

    Args:
        task: The task of other models.
        fitted: A fit to these rows.
        rows: N rows.

    Returns:
        The same task and rows where no corner's place is estimated.
    """
    optics = fitted.kinematics.optics(fitted.estimate.x, rows.samples)
    if optics is None or rows.samples.optics is None:
        return task, rows
    columns = range(OFFSET.start, OFFSET.stop)
    kept = [unknown for unknown in task.setup.optics if unknown.parameter.optic not in columns]
    if len(kept) == len(task.setup.optics):
        return task, rows
    values = rows.samples.optics.copy()
    values[:, OFFSET] = optics.values[:, OFFSET]
    samples = replace(rows.samples, optics=read_only(values))
    setup = replace(task.setup, optics=tuple(kept))
    return replace(task, setup=setup), replace(rows, samples=samples)
