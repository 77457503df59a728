"""Errors of images in metres at the board."""

from __future__ import annotations

import numpy as np
import pytest

from calib.basics.channels import Channels
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.table_rows import rows_and_setup
from calib.result.image_errors import ImageFigures, errors_at_board, metres_per_pixel
from tests.images import BOARD, arm, cell, mounts, poses, table


def test_a_pixel_is_as_long_as_the_corner_is_far():
    robot = arm()
    q = poses(8)
    rows, setup = rows_and_setup(robot, table(q, noise=0.1), cell())
    fitted = fit(Task(robot, cell(), setup, "frames"), rows)
    T_camera_base, T_tip_board = mounts()
    T = T_camera_base @ robot.poses(q) @ T_tip_board
    depth = BOARD.corners @ T[:, 2, :3].T + T[:, 2, 3]
    expected = depth.T.ravel() / 702.5
    np.testing.assert_allclose(metres_per_pixel(fitted, rows), expected, rtol=0.01)


def test_lengths_are_pixels_times_their_length():
    measured = np.array([[True, True], [True, True], [False, False]])
    residual = np.array([[3.0, 4.0], [0.0, 1.0], [9.0, 9.0]])
    scale = np.array([1e-3, 2e-3, np.nan])
    errors = errors_at_board(residual, Channels.of_unit(measured, "px"), scale)["m"]
    assert errors.n == 2
    assert errors.max == pytest.approx(5e-3)
    assert errors.mean == pytest.approx(3.5e-3)


def test_two_images_of_one_pose_are_two():
    q = poses(3)[[0, 0, 1]]
    m = table(q)
    rows, _ = rows_and_setup(arm(), m, cell())
    residual = np.tile([3.0, 4.0], (len(m), 1))
    figures = ImageFigures.of(residual, np.full(len(m), 1e-3), rows, m.images)
    assert (figures.images, figures.corners) == (3, 3 * len(BOARD.corners))
    assert (figures.mean, figures.bias) == (pytest.approx(5.0), (3.0, 4.0))
    assert figures.largest_at_board == pytest.approx(5e-3)
    unnamed = ImageFigures.of(residual, np.full(len(m), 1e-3), rows, ("",) * len(m))
    assert unnamed.images == 2
