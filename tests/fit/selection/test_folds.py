"""Folds: each row is in one, and rows that tell of each other are in the same; residuals of rows held out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.data.cell import Cell, GroupDistance
from calib.errors import MeasurementError
from calib.fit.estimate.fitting import fit
from calib.fit.registration.registration import register
from calib.fit.selection.folds import (
    Folds,
    held_out_residual,
    residual_after_registration,
    seen_only_by,
)
from tests.fit.selection.models import task_of, task_of_case

#: Number of the kind "pose" in the registry.
POSE = 1


@pytest.mark.parametrize("rows", [1, 2, 30, 60, 61, 1000])
def test_each_row_is_held_out_once(rows):
    folds = Folds.of(np.arange(rows))
    assert folds.method == ("leave-one-out" if rows <= 60 else "10-fold")
    assert len(folds.masks) == (rows if rows <= 60 else 10)
    np.testing.assert_array_equal(np.sum(folds.masks, axis=0), np.ones(rows))


def test_along_a_path_pieces_are_held_out():
    """A tenth of 20,000 rows is ten pieces of 200, evenly over the path."""
    folds = Folds.of(np.arange(20_000), in_time=True)
    assert folds.method == "10-fold-in-time"
    np.testing.assert_array_equal(np.sum(folds.masks, axis=0), np.ones(20_000))
    for k, mask in enumerate(folds.masks):
        first = 200 * k + 2000 * np.arange(10)
        np.testing.assert_array_equal(
            np.flatnonzero(mask), np.add.outer(first, np.arange(200)).ravel()
        )


def test_repeats_are_held_out_together():
    blocks = np.array([4, 4, 7, 9, 7])
    folds = Folds.of(blocks)
    assert folds.method == "leave-one-pose-out"
    assert [np.flatnonzero(mask).tolist() for mask in folds.masks] == [[0, 1], [2, 4], [3]]


def test_of_pairs_one_row_measures():
    """Three pairs without repeats, of two rows each."""
    blocks = np.array([0, 0, 1, 1, 2, 2])
    assert Folds.of(blocks, measured_rows=3).method == "leave-one-out"
    assert Folds.of(blocks, measured_rows=6).method == "leave-one-pose-out"


@pytest.mark.parametrize("names", [[0, 1], [3, 5, 9], range(4), range(150)])
def test_from_three_stations_on_each_is_held_out_as_a_whole(names):
    stations = np.repeat(list(names), 4)
    folds = Folds.of(np.arange(len(stations)), stations)
    if len(names) < 3:
        assert folds.method == "leave-one-out"
        return
    np.testing.assert_array_equal(np.sum(folds.masks, axis=0), np.ones(len(stations)))
    for mask in folds.masks:
        assert set(stations[mask]).isdisjoint(stations[~mask])
    assert len(folds.masks) == min(len(names), 50)
    assert folds.method == ("leave-one-station-out" if len(names) < 60 else "leave-stations-out")


def test_every_row_is_held_out_once(case):
    task, rows = task_of_case(case)
    folds = Folds.of_task(task, rows)
    np.testing.assert_array_equal(np.sum(folds.masks, axis=0), np.ones(len(rows)))


def test_stations_are_held_out_whole_from_three_on(calibrated):
    task, rows = task_of_case(calibrated("set-ups"))
    folds = Folds.of_task(task, rows)
    assert folds.method == "leave-one-station-out"
    assert len(folds.masks) == 3
    for mask in folds.masks:
        assert len(set(rows.samples.frame[mask])) == 1
    two = rows.select(rows.samples.frame < 2)
    assert Folds.of_task(task, two).method != "leave-one-station-out"


def test_stations_that_see_the_same_poses_are_held_out_by_pose(calibrated):
    """Cameras beside each other: rows of one pose share the robot's error, whichever station measured them."""
    task, rows = task_of_case(calibrated("set-ups"))
    assert Folds.of_task(task, rows).method == "leave-one-station-out"
    first, second, third = (np.flatnonzero(rows.samples.frame == f) for f in range(3))
    blocks = rows.blocks.copy()
    count = min(len(first), len(second), len(third))
    blocks[second[:count]] = blocks[first[:count]]
    assert Folds.of_task(task, replace(rows, blocks=blocks)).method == "leave-one-station-out"
    blocks[third[:count]] = blocks[first[:count]]
    folds = Folds.of_task(task, replace(rows, blocks=blocks))
    assert folds.method == "leave-one-pose-out"
    for mask in folds.masks:
        assert not set(blocks[mask]) & set(blocks[~mask])


def test_sockets_on_one_bar_are_one_station(make_scene, join):
    frames = [np.eye(4) for _ in range(4)]
    for k, T in enumerate(frames):
        T[:3, 3] = [-0.3, 0.1 * k, -0.3]
    scene = make_scene(81, frames=frames, length=3e-4, angle=3e-3, noise=2e-5)
    table = join(*(scene.fixed(10, f) for f in range(4)))
    bars = (GroupDistance("0", "1", 0.1, 1e-5), GroupDistance("2", "3", 0.1, 1e-5))
    task, rows = task_of(scene, table, Cell(distances=bars[:1]))
    folds = Folds.of_task(task, rows)
    together = [sorted(set(rows.samples.frame[m].tolist())) for m in folds.masks]
    assert together == [[0, 1], [2], [3]]
    both, rows = task_of(scene, table, Cell(distances=bars))
    assert Folds.of_task(both, rows).method == "leave-one-out"


def test_a_station_that_alone_measures_orientations_is_not_held_out_whole(calibrated):
    """The others do not determine how the target is turned."""
    case = calibrated("mixed")
    task, rows = task_of_case(case)
    assert len(set(rows.samples.frame[rows.where(lambda kind: kind.name == "pose")])) == 1
    assert Folds.of_task(task, rows).method == "10-fold"
    assert case[1].cross_validation.errors["rad"].rms < 1e-3


def test_a_station_that_alone_has_a_known_frame_is_not_held_out_whole(calibrated):
    """The others do not determine where the base stands."""
    task, rows = task_of_case(calibrated("set-ups"))
    setup = task.setup.with_fixed(np.array([True, False, False]), np.zeros(1, dtype=bool))
    assert Folds.of_task(replace(task, setup=setup), rows).method == "10-fold"


def test_rows_of_one_pose_are_refused(make_scene):
    scene = make_scene(94, frames=[np.eye(4)])
    task, rows = task_of(scene, scene.points(10), Cell())
    with pytest.raises(MeasurementError, match="rows of one pose"):
        Folds.of_task(task, rows.select(np.arange(10) == 3))


def test_residuals_of_folds_are_joined(make_scene):
    scene = make_scene(94, frames=[np.eye(4)])
    _, rows = task_of(scene, scene.points(4), Cell())
    folds = Folds("2-fold", (np.array([True, False, True, False]), np.array([0, 1, 0, 1]) > 0))
    residuals = [np.full((2, 3), 1e-3), np.array([[0.0, 3e-3, 4e-3], [0.0, 0.0, 0.0]])]
    outliers = np.array([False, True, False, False])
    joined = folds.join(rows, residuals, outliers)
    expected = np.array([[1e-3] * 3, [0.0, 3e-3, 4e-3], [1e-3] * 3, [0.0] * 3])
    np.testing.assert_array_equal(joined.residual, expected)
    assert (joined.method, joined.folds) == ("2-fold", 2)
    np.testing.assert_array_equal(joined.poses, np.arange(4))
    assert (joined.errors["m"].n, joined.errors_without_outliers["m"].n) == (4, 3)
    assert joined.errors["m"].max == pytest.approx(5e-3)
    assert joined.errors_without_outliers["m"].max == pytest.approx(np.sqrt(3.0) * 1e-3)


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
