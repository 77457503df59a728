"""Residuals of held-out rows, and what only they see."""

from __future__ import annotations

import numpy as np

from calib.data.cell import Cell
from calib.fit.estimate.fitting import fit
from calib.fit.registration.registration import register
from calib.fit.selection.held_out import (
    held_out_residual,
    residual_after_registration,
    seen_only_by,
)
from tests.fit.selection.models import task_of


def test_held_out_rows_are_measured_minus_predicted(make_scene):
    scene = make_scene(94, frames=[np.eye(4)], length=3e-4, angle=3e-3, noise=2e-5)
    task, rows = task_of(scene, scene.points(30), Cell())
    held_out = np.arange(30) == 7
    fitted = fit(task, rows.select(~held_out))
    residual = held_out_residual(fitted, rows, held_out, np.zeros(30, dtype=bool))
    np.testing.assert_allclose(residual, fitted.residual(rows)[held_out], atol=1e-12)


def test_a_station_that_was_not_seen_is_registered_without_its_outliers(make_scene, join):
    scene = make_scene(95, frames=2, noise=0.0)
    table = join(*(scene.points(8, f) for f in range(2)))
    task, rows = task_of(scene, table, Cell(estimate_frame=True))
    T_base_tip = task.robot.poses(rows.joints)
    held_out = rows.samples.frame == 1
    outliers = np.arange(16) == 10
    placed = register(T_base_tip[~held_out], task.setup, rows.select(~held_out))
    target = placed.with_fixed(np.zeros(2, dtype=bool), np.ones(1, dtype=bool))
    good = held_out & ~outliers
    own = register(T_base_tip[good], target, rows.select(good))
    expected = rows.residual(own.target_poses(T_base_tip, rows.samples))[held_out]
    found = residual_after_registration(
        T_base_tip[held_out], placed, rows, held_out, ~held_out, outliers
    )
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_parameters_that_only_some_rows_see(calibrated):
    _, c = calibrated("set-ups")
    rows = c.fit.geometry.estimate.problem.rows
    station = rows.samples.frame == 1
    own = seen_only_by(c.fit.geometry, station)
    names = {name for name, is_own in zip(c.model.names, own, strict=True) if is_own}
    assert names == {f"frame_{d}[1]" for d in ("x", "y", "z", "rx", "ry", "rz")}
    half = station & (np.arange(len(rows)) % 2 == 0)
    assert not np.any(seen_only_by(c.fit.geometry, half))
    _, two = calibrated("targets")
    rows = two.fit.geometry.estimate.problem.rows
    own = seen_only_by(two.fit.geometry, rows.samples.target == 0)
    names = {name for name, is_own in zip(two.model.names, own, strict=True) if is_own}
    assert names == {"target_x[t0]", "target_y[t0]", "target_z[t0]"}
