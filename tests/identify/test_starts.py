"""Starts in closed form, exact where the problem is linear."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.identify.registration import best_fit, frames_around, linear_start, pose_start
from calib.identify.setup import rows_of
from calib.kinds import get
from calib.measure.cell import Cell


def right(make_scene, seed, **options):
    """A scene whose robot is the nominal one."""
    return make_scene(seed, length=0.0, angle=0.0, **options)


def started(scene, table, cell, start):
    rows, setup = rows_of(scene.robot, table, cell)
    found = start(setup, scene.robot.poses(rows.joints), rows)
    return rows, setup, found


def worst(scene, rows, setup, found):
    return np.abs(
        rows.residual(setup.placed(*found).seen(scene.robot.poses(rows.joints), rows.samples))[
            rows.used
        ]
    ).max()


def test_targets_and_translations_by_one_least_squares(make_scene, join):
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_rotvec([0.3, -0.4, 2.0]).as_matrix()
    moved = turned.copy()
    moved[:3, 3] = [3.0, -2.0, 1.0]
    scene = right(make_scene, 0, frames=[np.eye(4), moved], targets=2)
    table = join(scene.points(4, 0, 0), scene.points(3, 1, 1), scene.points(2, 1, 0))
    cell = Cell(
        estimate_frame=True,
        frame_directions=("x", "y", "z"),
        frames={"0": np.eye(4), "1": turned},
    )
    rows, setup, found = started(scene, table, cell, linear_start)
    assert worst(scene, rows, setup, found) < 1e-12
    np.testing.assert_allclose(found[0][1], moved, atol=1e-12)
    np.testing.assert_allclose(found[1][:, :3, 3], scene.kinematics.T_tip_target[:, :3, 3])


def test_a_target_that_is_known_stays_and_one_that_no_row_sees_too(make_scene):
    scene = right(make_scene, 1, frames=[np.eye(4)], targets=2)
    place = scene.kinematics.T_tip_target[0, :3, 3] + 0.01
    cell = Cell(target=place, estimate_target=False)
    *_, found = started(scene, scene.points(5), cell, linear_start)
    np.testing.assert_array_equal(found[1][0, :3, 3], place)


@pytest.mark.parametrize("what", ["turned", "lengths"])
def test_what_is_not_linear_has_no_linear_start(make_scene, what):
    scene = right(make_scene, 2)
    table = scene.points(5) if what == "turned" else scene.distances(9)
    assert started(scene, table, Cell(estimate_frame=True), linear_start)[2] is None


def test_best_fit_is_a_rotation_even_for_mirrored_points():
    rng = np.random.default_rng(3)
    points = rng.normal(size=(10, 3))
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec([1.0, 2.0, -0.5]).as_matrix()
    T[:3, 3] = [5.0, -3.0, 2.0]
    np.testing.assert_allclose(best_fit(points, points @ T[:3, :3].T + T[:3, 3]), T, atol=1e-12)
    mirrored = best_fit(points, points * [1.0, 1.0, -1.0])
    assert np.linalg.det(mirrored[:3, :3]) == pytest.approx(1.0)


def test_best_fit_of_points_in_a_plane_is_exact_too():
    rng = np.random.default_rng(4)
    points = rng.normal(size=(6, 3)) * [1.0, 1.0, 0.0]
    R = Rotation.from_rotvec([0.2, 2.5, -1.0]).as_matrix()
    np.testing.assert_allclose(best_fit(points, points @ R.T)[:3, :3], R, atol=1e-12)


def test_the_anchor_is_where_the_distances_meet():
    rng = np.random.default_rng(5)
    points, anchor = rng.uniform(-0.5, 0.5, (8, 3)), np.array([3.0, -2.0, 1.0])
    far = np.linalg.norm(points - anchor, axis=1, keepdims=True)
    found = get("distance").locate(points, far, np.eye(4))
    np.testing.assert_allclose(-found[:3, 3], anchor, atol=1e-10)


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -1, 0), (0.5, -0.6, 0.2)])
def test_the_plane_frame_lies_in_the_plane_and_turns_as_little_as_it_can(normal):
    rng = np.random.default_rng(6)
    n = np.array(normal) / np.linalg.norm(normal)
    along = np.linalg.svd(n[None])[2][1:]
    points = rng.normal(size=(9, 2)) @ along + 0.7 * n
    T = get("plane").locate(points, np.zeros((9, 0)), np.eye(4))
    np.testing.assert_allclose((points @ T[:3, :3].T + T[:3, 3])[:, 2], 0.0, atol=1e-12)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
    turned = Rotation.from_matrix(T[:3, :3]).magnitude()
    # Of its two sides the one that the largest component points to.
    n *= np.sign(n[np.argmax(np.abs(n))])
    assert turned == pytest.approx(np.arccos(n[2]), abs=1e-7)


def test_frames_around_known_targets(make_scene, join):
    scene = right(make_scene, 7, frames=4, reach=0.15)
    table = join(scene.points(4, 0), scene.distances(6, 1), scene.fixed(3, 2), scene.plane(6, 3))
    rows, setup = rows_of(scene.robot, table, Cell(estimate_frame=True))
    T = scene.robot.poses(rows.joints)
    found = frames_around(setup, scene.kinematics.T_tip_target, T, rows)
    assert worst(scene, rows, setup, (found, scene.kinematics.T_tip_target)) < 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_poses_tell_both_rotations_and_all_places(make_scene, join, seed):
    scene = right(make_scene, seed, frames=2, targets=2)
    table = join(scene.poses(4, 0, 0), scene.poses(4, 1, 1), scene.poses(2, 1, 0))
    rows, setup, found = started(scene, table, Cell(estimate_frame=True), pose_start)
    assert worst(scene, rows, setup, found) < 1e-9


def test_there_is_no_pose_start_without_orientations_of_all_rows(make_scene, join):
    scene = right(make_scene, 8)
    both = join(scene.poses(5), scene.points(5))
    assert started(scene, both, Cell(estimate_frame=True), pose_start)[2] is None
