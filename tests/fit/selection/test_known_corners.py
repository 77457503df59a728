"""Corners at their estimated places: the same predictions with fewer parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.camera.optics import OFFSET
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from calib.fit.selection.known_corners import with_known_corners
from tests.images import BOARD, arm, cell, poses, table


def test_corners_are_where_the_fit_has_them():
    robot = arm()
    points = BOARD.corners + 1e-4 * np.random.default_rng(1).normal(size=(20, 3)) * [1, 1, 0]
    rows, setup = rows_and_setup(robot, table(poses(10), noise=0.05, points=points), cell())
    task = Task(robot, cell(), setup, "frames")
    fitted = fit(task, rows)
    fewer, known = with_known_corners(task, fitted, rows)
    assert len(fewer.error_model()) == len(task.error_model()) - 2 * len(BOARD.corners)
    offsets = known.samples.optics[:, OFFSET]
    estimated = dict(zip(fitted.kinematics.model.names, fitted.estimate.x, strict=True))
    np.testing.assert_allclose(offsets[3], [estimated["corner_3_x"], estimated["corner_3_y"]])
    again = fit(fewer, known)
    before, after = (np.sqrt(np.mean(r**2)) for r in (fitted.residual(rows), again.residual(known)))
    assert abs(after / before - 1.0) < 0.05


def test_without_unknown_corners_nothing_changes():
    robot = arm()
    c = cell(boards={"": replace(BOARD, sigma_corner=0.0)})
    rows, setup = rows_and_setup(robot, table(poses(6), noise=0.05), c)
    task = Task(robot, c, setup, "frames")
    same = with_known_corners(task, fit(task, rows), rows)
    assert same[0] is task
    assert same[1] is rows
