"""Cross-validation: what is left out together, and that the linear one is the refitted one to first order."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from unittest import mock

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from calib.data.cell import Cell, GroupDistance
from calib.data.measurements import Measurements
from calib.estimate.fitting import Fitted, Task, fit
from calib.numerics.errors import CrossValidation, Errors
from calib.registration.known_distances import known_distances
from calib.registration.registration import register
from calib.registration.rows import Rows
from calib.registration.table_rows import rows_and_setup
from calib.selection import cross_validation as module
from calib.selection.cross_validation import (
    Folds,
    chance_of_fall,
    cross_validation,
    linear_cross_validation,
    nominal_cross_validation,
    only_there,
    pose_errors,
)

#: Numbers of kinds in the registry.
POSE = 1


def task_of(scene: Any, table: Measurements, cell: Cell, model: str = "dh") -> tuple[Task, Rows]:
    every, setup = rows_and_setup(scene.robot, table, cell)
    task = Task(scene.robot, cell, setup, model, known_distances(cell, setup), lenient=True)
    return task, every.select(table.estimation)


def of_case(case: Any) -> tuple[Task, Rows]:
    _, c = case
    return task_of(case[0], c.measurements, c.cell, c.model.name)


def test_every_row_is_left_out_once(case):
    task, rows = of_case(case)
    found = Folds.of_task(task, rows)
    np.testing.assert_array_equal(np.sum(found.masks, axis=0), np.ones(len(rows)))


def test_set_ups_are_left_out_whole_from_three_on(calibrated):
    task, rows = of_case(calibrated("set-ups"))
    found = Folds.of_task(task, rows)
    assert found.method == "leave-one-set-up-out"
    assert len(found.masks) == 3
    for mask in found.masks:
        assert len(set(rows.samples.frame[mask])) == 1
    two = rows.select(rows.samples.frame < 2)
    assert Folds.of_task(task, two).method != "leave-one-set-up-out"


def test_sockets_on_one_bar_are_one_set_up(make_scene, join):
    frames = [np.eye(4) for _ in range(4)]
    for k, T in enumerate(frames):
        T[:3, 3] = [-0.3, 0.1 * k, -0.3]
    scene = make_scene(81, frames=frames, length=3e-4, angle=3e-3, noise=2e-5)
    table = join(*(scene.fixed(10, f) for f in range(4)))
    bars = (GroupDistance("0", "1", 0.1, 1e-5), GroupDistance("2", "3", 0.1, 1e-5))
    task, rows = task_of(scene, table, Cell(distances=bars[:1]))
    found = Folds.of_task(task, rows)
    together = [sorted(set(rows.samples.frame[m].tolist())) for m in found.masks]
    assert together == [[0, 1], [2], [3]]
    both, rows = task_of(scene, table, Cell(distances=bars))
    assert Folds.of_task(both, rows).method == "leave-one-out"


def test_a_set_up_that_alone_measures_orientations_is_not_left_out_whole(calibrated):
    """The others do not say how the target is turned."""
    case = calibrated("mixed")
    task, rows = of_case(case)
    assert len(set(rows.samples.frame[rows.kinds == POSE])) == 1
    assert Folds.of_task(task, rows).method == "10-fold"
    assert case[1].cross_validation.errors.rms_angle < 1e-3


def test_the_linear_one_agrees_with_the_refitted_one(case):
    """For every kind; sizes and noise are not found anew, and folds move them a little."""
    _, c = case
    # Where there is a non-geometric model the geometry alone leaves outliers, which each fold judges anew.
    fitted = c.fit.non_geometric or c.fit.geometry
    refitted = c.cross_validation if c.non_geometric is None else c.non_geometric.cross_validation
    linear = linear_cross_validation(fitted)
    assert linear.method == refitted.method
    assert linear.errors.rms == pytest.approx(refitted.errors.rms, rel=0.1)
    if refitted.errors.n_angle:
        assert linear.errors.rms_angle == pytest.approx(refitted.errors.rms_angle, rel=0.1)
    good = ~fitted.estimate.outliers
    used = fitted.estimate.problem.rows.used & good[:, None]
    apart = (linear.residual - refitted.residual) / fitted.estimate.problem.scales
    assert np.sqrt(np.mean(apart[used] ** 2)) < 0.5


def test_the_nominal_robot_is_given_what_the_calibrated_one_is(calibrated):
    """Its frames and targets are registered without the fold, and its errors are those of the robot as it is."""
    scene, c = calibrated("set-ups")
    task, rows = of_case((scene, c))
    found = nominal_cross_validation(task, rows, c.fitted.estimate.outliers)
    assert found.method == c.cross_validation.method
    assert found.errors.rms > 20 * c.cross_validation.errors.rms
    frames = fit(Task(scene.robot, c.cell, task.setup, "frames"), rows)
    assert found.errors.rms >= frames.residual(rows).std() * 0.9


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


def test_parameters_that_only_the_left_out_rows_see(calibrated):
    _, c = calibrated("set-ups")
    rows = c.fitted.estimate.problem.rows
    mask = rows.samples.frame == 1
    loose = only_there(c.fitted, mask)
    names = {n for n, is_loose in zip(c.model.names, loose, strict=True) if is_loose}
    assert names == {f"frame_{d}[1]" for d in ("x", "y", "z", "rx", "ry", "rz")}
    assert not np.any(only_there(c.fitted, mask & (np.arange(len(rows)) % 2 == 0)))
    _, two = calibrated("targets")
    rows = two.fitted.estimate.problem.rows
    loose = only_there(two.fitted, rows.samples.target == 0)
    names = {n for n, is_loose in zip(two.model.names, loose, strict=True) if is_loose}
    assert names == {"target_x[t0]", "target_y[t0]", "target_z[t0]"}


def fitted_to(scene: Any, table: Measurements, cell: Cell, model: str = "dh") -> Fitted:
    every, setup = rows_and_setup(scene.robot, table, cell)
    task = Task(scene.robot, cell, setup, model, known_distances(cell, setup), lenient=True)
    return fit(task, every.select(table.estimation))


def fit_of_case(case: tuple[Any, Any]) -> Fitted:
    _, c = case
    return c.fit.non_geometric or c.fit.geometry


def rows_of_fit(fitted: Fitted) -> Rows:
    return fitted.estimate.problem.rows


def with_outliers(make_scene: Any, **given: Any) -> tuple[Any, Measurements]:
    """30 points, two of them off by millimetres."""
    usual = {"frames": [np.eye(4)], "length": 3e-4, "angle": 3e-3, "noise": 2e-5}
    scene = make_scene(91, **(usual | given))
    table = scene.points(30)
    points = table.points.copy()
    points[[4, 17]] += [[2e-3, 0.0, 1e-3], [0.0, -3e-3, 0.0]]
    return scene, replace(table, points=points)


def both(fitted: Fitted) -> tuple[Any, Any]:
    """Cross-validation on the linearised problem, and by fits from the beginning."""
    linear = cross_validation(fitted, fitted.estimate.outliers)
    with mock.patch.object(module, "_on_the_linearised", return_value={}):
        return linear, cross_validation(fitted, fitted.estimate.outliers)


def assert_refitted(fitted: Fitted) -> None:
    """Each held-out row is predicted as by a fit from the beginning, to a small share of the noise."""
    linear, refitted = both(fitted)
    assert linear.method == refitted.method
    assert linear.errors.rms == pytest.approx(refitted.errors.rms, rel=3e-4, abs=1e-9)
    assert linear.errors.max == pytest.approx(refitted.errors.max, rel=1e-3, abs=1e-9)
    used = rows_of_fit(fitted).used
    apart = (linear.residual - refitted.residual) / fitted.estimate.problem.scales
    assert np.sqrt(np.mean(apart[used] ** 2)) < 1e-2


@pytest.mark.parametrize("name", ["points", "poses", "set-ups", "distances", "pairs", "targets"])
def test_left_out_rows_are_predicted_as_by_refits(calibrated, name):
    assert_refitted(fit_of_case(calibrated(name)))


def test_outliers_are_found_in_each_fold_as_by_refits(make_scene):
    scene, table = with_outliers(make_scene)
    fitted = fitted_to(scene, table, Cell())
    assert np.flatnonzero(fitted.estimate.outliers).tolist() == [4, 17]
    assert_refitted(fitted)


@pytest.mark.parametrize(
    ("cell", "count", "solver"),
    [(Cell(bounds={"a2": (-1e-5, 1e-5)}), 12, "lm"), (Cell(), 9, "lm"), (Cell(), 14, "paper")],
    ids=["at a bound", "few rows", "the paper's solver"],
)
def test_folds_are_fitted_from_the_beginning_where_the_linearised_problem_does_not_do(
    make_scene, cell, count, solver
):
    scene = make_scene(93, frames=[np.eye(4)], length=3e-4, angle=3e-3, noise=2e-5)
    table = scene.points(count)
    every, setup = rows_and_setup(scene.robot, table, cell)
    fitted = fit(Task(scene.robot, cell, setup, "dh", solver=solver), every)
    linear, refitted = both(fitted)
    np.testing.assert_array_equal(linear.residual, refitted.residual)


def test_set_ups_that_were_not_seen_are_registered_to_their_good_rows(make_scene, join):
    scene = make_scene(5, frames=3, noise=2e-5)
    table = join(*(scene.points(20, f) for f in range(3)))
    points = table.points.copy()
    points[44] += 0.02
    outliers = np.arange(60) == 44
    fitted = fitted_to(scene, replace(table, points=points), Cell(estimate_frame=True))
    left = cross_validation(fitted, outliers).residual
    assert np.sqrt(np.mean(left[40:][~outliers[40:]] ** 2)) < 1e-4
    np.testing.assert_allclose(left[44], 0.02, atol=5e-4)


def test_the_error_of_a_pose_is_that_of_its_rows_in_units_of_the_noise():
    residual = np.array([[3e-3, 0.0, 4e-3], [0.0, 6e-3, 0.0], [9.0, 9.0, 9.0], [0.0, 0.0, 2e-3]])
    errors = Errors.of(residual)
    found = CrossValidation("", 3, np.array([5, 5, 5, 2]), residual, errors, errors)
    kept = np.array([True, True, False, True])
    scales = np.full((4, 3), 1e-3)
    expected = [2.0, np.sqrt((25.0 + 36.0) / 2.0)]
    np.testing.assert_allclose(pose_errors(found, scales, kept), expected)
    scales[:, 2] = 2e-3
    np.testing.assert_allclose(pose_errors(found, scales, kept)[0], 1.0)


def test_the_chance_of_a_fall_is_student_s_one_sided():
    rng = np.random.default_rng(5)
    falls = 0.3 + rng.normal(size=12)
    expected = ttest_1samp(falls, 0.0, alternative="greater").pvalue
    assert chance_of_fall(falls) == pytest.approx(expected, rel=1e-9)
    assert chance_of_fall(-falls) == pytest.approx(1.0 - expected, rel=1e-9)
    assert chance_of_fall(np.array([1.0])) == 1.0
    assert chance_of_fall(np.zeros(4)) == 1.0
    assert chance_of_fall(np.ones(4)) == 0.0


@pytest.mark.parametrize("rows", [1, 2, 30, 60, 61, 1000])
def test_each_row_is_left_out_once(rows):
    found = Folds.of(np.arange(rows))
    method, masks = found.method, found.masks
    assert method == ("leave-one-out" if rows <= 60 else "10-fold")
    assert len(masks) == (rows if rows <= 60 else 10)
    np.testing.assert_array_equal(np.sum(masks, axis=0), np.ones(rows))


@pytest.mark.parametrize("names", [[0, 1], [3, 5, 9], range(4), range(150)])
def test_from_three_set_ups_on_each_is_left_out_as_a_whole(names):
    setups = np.repeat(list(names), 4)
    held_out = Folds.of(np.arange(len(setups)), setups)
    if len(names) < 3:
        assert held_out.method == "leave-one-out"
        return
    np.testing.assert_array_equal(np.sum(held_out.masks, axis=0), np.ones(len(setups)))
    for mask in held_out.masks:
        assert set(setups[mask]).isdisjoint(setups[~mask])
    assert len(held_out.masks) == min(len(names), 50)
    assert held_out.method == ("leave-one-set-up-out" if len(names) < 60 else "leave-set-ups-out")
