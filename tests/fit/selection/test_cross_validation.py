"""Cross-validation against leave-one-out by hand, of the calibrated and of the nominal robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell
from calib.fit.estimate.fitting import fit
from calib.fit.estimate.task import Task
from calib.fit.registration.registration import register
from calib.fit.selection.cross_validation import cross_validation, nominal_cross_validation
from tests.fit.selection.models import fitted_to, task_of, task_of_case


def test_each_row_is_predicted_by_a_fit_to_the_others(make_scene):
    """So few rows that no fold is taken from the linear problem."""
    scene = make_scene(93, frames=[np.eye(4)], length=3e-4, angle=3e-3, noise=2e-5)
    table = scene.points(9)
    task, rows = task_of(scene, table, Cell())
    outliers = np.zeros(9, dtype=bool)
    done = []
    found = cross_validation(fit(task, rows), outliers, lambda k, count: done.append((k, count)))
    for row in (0, 5):
        others = fit(task, rows.select(np.arange(9) != row))
        np.testing.assert_allclose(found.residual[row], others.residual(rows)[row], atol=1e-12)
    assert done == [(k, 9) for k in range(1, 10)]


def test_the_nominal_robot_is_given_what_the_calibrated_one_is(calibrated):
    """Its frames and targets are registered without the fold, and its errors are those of the robot as it is."""
    scene, c = calibrated("set-ups")
    task, rows = task_of_case((scene, c))
    found = nominal_cross_validation(task, rows, c.fit.geometry.estimate.outliers)
    assert found.method == c.cross_validation.method
    assert found.errors["m"].rms > 20 * c.cross_validation.errors["m"].rms
    frames = fit(Task(scene.robot, c.fit.cell, task.setup, "frames"), rows)
    assert found.errors["m"].rms >= frames.residual(rows).std() * 0.9


@pytest.mark.parametrize("cell", [Cell(), Cell(estimate_frame=True)], ids=["target", "frame too"])
def test_nominal_errors_are_those_of_a_registration_without_the_pose(make_scene, cell):
    """Leave-one-out by hand: neither the pose itself nor an outlier has a part in the registration."""
    scene = make_scene(94, frames=[np.eye(4)], length=3e-4, angle=3e-3, noise=2e-5)
    task, rows = task_of(scene, scene.points(10), cell)
    outliers = np.arange(10) == 6
    T_base_tip = task.robot.poses(rows.joints)
    expected = np.empty((10, 3))
    for pose in range(10):
        kept = ~outliers & (np.arange(10) != pose)
        registered = register(T_base_tip[kept], task.setup, rows.select(kept))
        predicted = registered.target_poses(T_base_tip, rows.samples)
        expected[pose] = rows.residual(predicted)[pose]
    found = nominal_cross_validation(task, rows, outliers)
    np.testing.assert_allclose(found.residual, expected, atol=1e-9)
    # Far from what a registration to all rows leaves.
    setup = register(T_base_tip, task.setup, rows)
    fitted = rows.residual(setup.target_poses(T_base_tip, rows.samples))
    assert np.sum(expected**2) > 1.2 * np.sum(fitted**2)


def test_a_station_that_was_held_out_is_registered_with_the_target_of_the_others(make_scene, join):
    scene = make_scene(95, frames=3, length=3e-4, angle=3e-3, noise=2e-5)
    table = join(*(scene.points(8, f) for f in range(3)))
    task, rows = task_of(scene, table, Cell(estimate_frame=True))
    T_base_tip = task.robot.poses(rows.joints)
    expected = np.empty((24, 3))
    for station in range(3):
        held_out = rows.samples.frame == station
        others = register(T_base_tip[~held_out], task.setup, rows.select(~held_out))
        target = others.with_fixed(np.zeros(3, dtype=bool), np.ones(1, dtype=bool))
        own = register(T_base_tip[held_out], target, rows.select(held_out))
        predicted = own.target_poses(T_base_tip, rows.samples)
        expected[held_out] = rows.residual(predicted)[held_out]
    found = nominal_cross_validation(task, rows, np.zeros(24, dtype=bool))
    np.testing.assert_allclose(found.residual, expected, atol=1e-9)


def test_held_out_stations_are_registered_to_their_good_rows(make_scene, join):
    scene = make_scene(5, frames=3, noise=2e-5)
    table = join(*(scene.points(20, f) for f in range(3)))
    points = table.points.copy()
    points[44] += 0.02
    outliers = np.arange(60) == 44
    fitted = fitted_to(scene, replace(table, points=points), Cell(estimate_frame=True))
    residual = cross_validation(fitted, outliers).residual
    assert np.sqrt(np.mean(residual[40:][~outliers[40:]] ** 2)) < 1e-4
    np.testing.assert_allclose(residual[44], 0.02, atol=5e-4)
