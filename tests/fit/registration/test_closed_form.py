"""Closed forms against the truth of a scene without noise, on the true poses of the tip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.data.cell import Cell
from calib.fit.registration.closed_form import (
    linear_setup,
    nearest_rotation,
    orientation_setup,
    with_frames_fitted,
    with_held_axes,
    with_measured_target_rotations,
)
from calib.fit.registration.registration import register
from calib.fit.registration.table_rows import rows_and_setup
from tests.fit.registration.tables import as_kind


def measured(scene, table, cell):
    """True poses of the tip, the setup as given, and the rows."""
    rows, setup = rows_and_setup(scene.robot, table, cell)
    return scene.tip(rows.joints), setup, rows


def test_a_target_and_a_translation_are_the_least_squares_solution(make_scene):
    scene = make_scene(0)
    cell = Cell(estimate_frame=True, frame_directions=("x", "y", "z"))
    T_base_tip, setup, rows = measured(scene, scene.points(12), cell)
    T_frame_base = scene.kinematics.T_frame_base.copy()
    T_frame_base[0, :3, 3] += (0.3, -0.2, 0.1)
    found = linear_setup(setup.with_poses(T_frame_base, setup.T_tip_target), T_base_tip, rows)
    assert found is not None
    np.testing.assert_allclose(found.T_frame_base, scene.kinematics.T_frame_base, atol=1e-10)
    target = scene.kinematics.T_tip_target[0, :3, 3]
    np.testing.assert_allclose(found.T_tip_target[0, :3, 3], target, atol=1e-10)


def test_frames_shift_along_their_estimated_axes_alone(make_scene, join):
    scene = make_scene(3, frames=2)
    table = join(scene.points(12), scene.points(12, 1))
    T_base_tip, setup, rows = measured(scene, table, Cell(estimate_frame=True))
    T_frame_base = scene.kinematics.T_frame_base.copy()
    T_frame_base[0, 1, 3] += 0.3
    T_frame_base[1, 2, 3] -= 0.2
    start = replace(setup, T_frame_base=T_frame_base, unknown=(("y",), ("z",)))
    found = linear_setup(start, T_base_tip, rows)
    assert found is not None
    np.testing.assert_allclose(found.T_frame_base, scene.kinematics.T_frame_base, atol=1e-10)


def test_a_known_target_stays_and_so_does_one_that_no_row_sees(make_scene, join):
    scene = make_scene(4, targets=2)
    cell = Cell(estimate_frame=True, frame_directions=("x", "y", "z"))
    table = join(scene.points(12), scene.points(12, target=1))
    T_base_tip, setup, rows = measured(scene, table, cell)
    T_tip_target = scene.kinematics.T_tip_target.copy()
    T_tip_target[0, :3, 3] += 0.01
    start = setup.with_poses(scene.kinematics.T_frame_base, T_tip_target)
    start = start.with_fixed(np.array([False]), np.array([False, True]))
    found = linear_setup(start, T_base_tip, rows)
    assert found is not None
    place = scene.kinematics.T_tip_target[0, :3, 3]
    np.testing.assert_allclose(found.T_tip_target[0, :3, 3], place, atol=1e-10)
    np.testing.assert_array_equal(found.T_tip_target[1], T_tip_target[1])
    of_known = rows.samples.target == 1
    found = linear_setup(start, T_base_tip[of_known], rows.select(of_known))
    assert found is not None
    np.testing.assert_array_equal(found.T_tip_target, T_tip_target)


@pytest.mark.parametrize("kind", ["rotation", "distance"])
def test_rotations_and_other_kinds_are_not_linear(make_scene, kind):
    scene = make_scene(1)
    if kind == "rotation":
        table, cell = scene.points(12), Cell(estimate_frame=True)
    else:
        table, cell = scene.distances(12), Cell()
    T_base_tip, setup, rows = measured(scene, table, cell)
    assert linear_setup(setup, T_base_tip, rows) is None


def test_orientations_determine_frame_and_target(make_scene):
    scene = make_scene(2)
    T_base_tip, setup, rows = measured(scene, scene.poses(8), Cell(estimate_frame=True))
    found = orientation_setup(setup, T_base_tip, rows)
    assert found is not None
    np.testing.assert_allclose(found.T_frame_base, scene.kinematics.T_frame_base, atol=1e-8)
    np.testing.assert_allclose(found.T_tip_target, scene.kinematics.T_tip_target, atol=1e-8)
    assert found.unknown == setup.unknown
    points = measured(scene, scene.points(8), Cell(estimate_frame=True))
    assert orientation_setup(points[1], points[0], points[2]) is None


@pytest.mark.parametrize(("frame", "target"), [(True, False), (False, True), (True, True)])
def test_orientations_of_a_known_frame_or_target_need_no_start(make_scene, frame, target):
    scene = make_scene(2)
    T_base_tip, setup, rows = measured(scene, scene.poses(8), Cell(estimate_frame=True))
    fixed = setup.with_fixed(np.array([frame]), np.array([target]))
    assert orientation_setup(fixed, T_base_tip, rows) is None


def test_a_known_frame_stays_and_so_does_one_that_no_row_sees(make_scene, join):
    scene = make_scene(3, frames=2)
    table = join(scene.points(6), scene.points(6, 1))
    T_base_tip, setup, rows = measured(scene, table, Cell(estimate_frame=True))
    T_frame_base = scene.kinematics.T_frame_base.copy()
    T_frame_base[:, :3, 3] += 0.01
    start = setup.with_poses(T_frame_base, scene.kinematics.T_tip_target)
    known = start.with_fixed(np.array([False, True]), np.array([False]))
    found = with_frames_fitted(known, T_base_tip, rows).T_frame_base
    np.testing.assert_allclose(found[0], scene.kinematics.T_frame_base[0], atol=1e-9)
    np.testing.assert_array_equal(found[1], T_frame_base[1])
    of_first = rows.samples.frame == 0
    found = with_frames_fitted(start, T_base_tip[of_first], rows.select(of_first)).T_frame_base
    np.testing.assert_allclose(found[0], scene.kinematics.T_frame_base[0], atol=1e-9)
    np.testing.assert_array_equal(found[1], T_frame_base[1])


def test_a_frame_is_fitted_to_points_of_known_targets(make_scene):
    scene = make_scene(3)
    T_base_tip, setup, rows = measured(scene, scene.points(3), Cell(estimate_frame=True))
    start = setup.with_poses(setup.T_frame_base, scene.kinematics.T_tip_target)
    found = with_frames_fitted(start, T_base_tip, rows)
    np.testing.assert_allclose(found.T_frame_base, scene.kinematics.T_frame_base, atol=1e-9)


def test_a_frame_that_is_estimated_along_one_axis_moves_by_the_mean_shift_along_it(make_scene):
    scene = make_scene(3)
    T_base_tip, setup, rows = measured(scene, scene.points(3), Cell(estimate_frame=True))
    T_frame_base = scene.kinematics.T_frame_base.copy()
    T_frame_base[0, :3, 3] += (0.1, -0.3, 0.2)
    start = setup.with_poses(T_frame_base, scene.kinematics.T_tip_target)
    noisy = rows.measured.copy()
    noisy[:, 1] += (0.0, 0.01, 0.05)
    one_axis = replace(start, unknown=(("y",),))
    found = with_frames_fitted(one_axis, T_base_tip, replace(rows, measured=noisy))
    T_frame_base[0, 1, 3] += 0.32
    np.testing.assert_allclose(found.T_frame_base, T_frame_base, atol=1e-9)


def test_targets_turn_as_they_were_measured(make_scene):
    scene = make_scene(4)
    T_base_tip, setup, rows = measured(scene, scene.poses(5), Cell())
    start = setup.with_poses(scene.kinematics.T_frame_base, setup.T_tip_target)
    found = with_measured_target_rotations(start, T_base_tip, rows)
    true = scene.kinematics.T_tip_target[0, :3, :3]
    np.testing.assert_allclose(found.T_tip_target[0, :3, :3], true, atol=1e-9)
    np.testing.assert_array_equal(found.T_tip_target[0, :3, 3], setup.T_tip_target[0, :3, 3])


def test_the_nearest_rotation_is_right_handed():
    R = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()
    np.testing.assert_allclose(nearest_rotation(2.5 * R), R, atol=1e-12)
    assert np.linalg.det(nearest_rotation(np.diag([1.0, 1.0, -0.1]))) == pytest.approx(1.0)


def on_planes(rng, T_tip_target, planes):
    """Poses of a tip, (N, 4, 4), whose face lies on planes, T_frame_base each, six times, turned and moved anyhow."""
    T_base_tip = []
    for T_frame_base in planes:
        for _ in range(6):
            T = np.eye(4)
            T[:3, :3] = Rotation.from_euler("z", rng.uniform(-2.0, 2.0)).as_matrix()
            T[:2, 3] = rng.uniform(-0.5, 0.5, 2)
            T_base_tip.append(np.linalg.inv(T_frame_base) @ T @ np.linalg.inv(T_tip_target))
    return np.array(T_base_tip)


def random_pose(rng):
    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
    T[:3, 3] = rng.uniform(-0.3, 0.3, 3)
    return T


@pytest.mark.parametrize("count", [1, 2])
def test_the_axis_of_a_face_is_that_which_turns_least(scene, join, count):
    rng = np.random.default_rng(count)
    T_tip_target = random_pose(rng)
    T_base_tip = on_planes(rng, T_tip_target, [random_pose(rng) for _ in range(count)])
    tables = [replace(as_kind(scene.points(6), "face"), groups=(str(k),) * 6) for k in range(count)]
    rows, setup = rows_and_setup(scene.robot, join(*tables), Cell())
    found = with_held_axes(setup, T_base_tip, rows).T_tip_target[0, :3, 2]
    assert abs(found @ T_tip_target[:3, 2]) == pytest.approx(1.0, abs=1e-12)
    assert found[2] >= 0.0  # by the least angle from where it was
    points = as_kind(scene.points(6), "plane")
    rows, setup = rows_and_setup(scene.robot, points, Cell())
    assert with_held_axes(setup, T_base_tip[:6], rows) is setup


@pytest.mark.parametrize("seed", range(4))
def test_planes_and_the_faces_of_two_hands_are_registered(scene, join, seed):
    """Two hands on two planes, of which nothing is known: their tilts, and one height against the other."""
    rng = np.random.default_rng(seed)
    hands, planes = [random_pose(rng) for _ in range(2)], [random_pose(rng) for _ in range(2)]
    names = [("0", "a"), ("1", "a"), ("0", "b"), ("1", "b")]
    tables = [
        replace(as_kind(scene.points(6), "face"), groups=(plane,) * 6, targets=(hand,) * 6)
        for plane, hand in names
    ]
    rows, setup = rows_and_setup(scene.robot, join(*tables), Cell())
    T_base_tip = np.concatenate([on_planes(rng, hand, planes) for hand in hands])
    found = register(T_base_tip, setup, rows)
    residual = rows.residual(found.target_poses(T_base_tip, rows.samples))
    np.testing.assert_allclose(residual, 0.0, atol=1e-9)
    for hand, T in zip(hands, found.T_tip_target, strict=True):
        assert abs(T[:3, 2] @ hand[:3, 2]) == pytest.approx(1.0, abs=1e-12)
    # The plane is as far away as the first hand's face is from its tip.
    assert found.T_tip_target[0, :3, 3] == pytest.approx(np.zeros(3), abs=1e-12)
