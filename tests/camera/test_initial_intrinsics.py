"""Intrinsics from views alone: random cameras of both lenses, and views that do not tell the focal length."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.boards.board import Board
from calib.camera.board_pose import move_poses, view_system
from calib.camera.camera import Camera
from calib.camera.initial_intrinsics import Bundle, initial_intrinsics, refine_bundle
from calib.camera.lenses import LENSES
from calib.errors import MeasurementError

POINTS = Board(pattern="chessboard", columns=7, rows=5, square=0.03).corners
TRUTH = {
    "pinhole": np.array([700.0, 705.0, 640.0, 355.0, -0.1, 0.05, 1e-3, -5e-4, 0.0]),
    "fisheye": np.array([420.0, 418.0, 641.0, 358.0, -0.02, 0.01, -4e-3, 6e-4]),
    "rational": np.array([700.0, 705.0, 640.0, 355.0, 0.2, 0.05, 1e-3, -5e-4, 0.0, 0.3, 0.1, 0.0]),
    "tilted": np.array(
        [
            *(700.0, 705.0, 640.0, 355.0, 0.2, 0.05, 1e-3, -5e-4, 0.0, 0.3, 0.1, 0.0),
            *(1e-3, 0.0, -1e-3, 0.0, 0.01, -0.02),
        ]
    ),
}


def determined(name):
    """How many of the first numbers images determine well: with a tilted sensor, its tilt moves the centre."""
    return 2 if name == "tilted" else 4


def scene(name, count=6):
    """T_camera_board and views of a camera, without noise."""
    rng = np.random.default_rng(1)
    T = np.tile(np.eye(4), (count, 1, 1))
    for k in range(count):
        T[k, :3, :3] = Rotation.from_rotvec(rng.uniform(-0.6, 0.6, 3)).as_matrix()
        T[k, :3, 3] = [*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.3, 0.5)]
    views = []
    for k, pose in enumerate(T):
        points = POINTS[: len(POINTS) - k]  # of different sizes
        P = points @ pose[:3, :3].T + pose[:3, 3]
        views.append((points, LENSES[name].project(P, TRUTH[name])))
    return T, views


def body_views(count=20):
    """Views of a cube's tags by the pinhole camera, of two faces and of three."""
    rng = np.random.default_rng(4)
    face = np.array([[-0.03, -0.03], [0.03, -0.03], [0.03, 0.03], [-0.03, 0.03]])
    cube = np.concatenate([np.insert(face, axis, -0.04, axis=1) for axis in range(3)])
    views = []
    for k in range(count):
        towards = Rotation.align_vectors([[0.0, 0.0, 1.0]], [[1.0, 1.0, 1.0]])[0]
        R = (Rotation.from_rotvec(rng.uniform(-0.5, 0.5, 3)) * towards).as_matrix()
        points = cube[: 8 + 4 * (k % 2)]
        P = points @ R.T + [*rng.uniform(-0.15, 0.15, 2), rng.uniform(0.25, 0.5)]
        views.append((points, LENSES["pinhole"].project(P, TRUTH["pinhole"])))
    return views


def test_views_of_a_body_tell_the_intrinsics():
    found = initial_intrinsics(Camera(width=1280, height=720), body_views())
    np.testing.assert_allclose(found[:4], TRUTH["pinhole"][:4], rtol=0.02)


def bundle(name):
    std = np.array([300.0, 300.0, 100.0, 100.0, *[0.5] * (len(TRUTH[name]) - 4)])
    return Bundle(LENSES[name], TRUTH[name] * 1.01, std)


def perturbed(name, T):
    rng = np.random.default_rng(2)
    values = TRUTH[name].copy()
    values[:4] *= 1.0 + rng.uniform(-0.03, 0.03, 4)
    return values, move_poses(T, rng.normal(scale=3e-3, size=(len(T), 6)))


@pytest.mark.parametrize("name", LENSES)
def test_a_step_is_that_of_the_whole_system(name):
    T, views = scene(name)
    values, T = perturbed(name, T)
    b, m, V = bundle(name), len(values), len(views)
    residual, by_motion, by_values = view_system(T, views, b.lens, values)
    view = np.repeat(np.arange(V), [len(points) for points, _ in views])
    J = np.zeros((len(residual), 2, m + 6 * V))
    J[:, :, :m] = by_values
    for row, k in enumerate(view):
        J[row, :, m + 6 * k : m + 6 * k + 6] = by_motion[row]
    prior = np.hstack([np.diag(1.0 / b.std), np.zeros((m, 6 * V))])
    J = np.vstack([J.reshape(-1, m + 6 * V), prior])
    r = np.concatenate([residual.ravel(), (b.mean - values) / b.std])
    normal = b.normal(values, T, views)
    assert normal.cost == pytest.approx(r @ r, rel=1e-12)
    N = J.T @ J
    for damping in (1e-6, 0.5):
        expected = np.linalg.solve(N + damping * np.diag(np.diagonal(N)), J.T @ r)
        change, motions = normal.step(damping)
        found = np.concatenate([change, motions.ravel()])
        np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-7)


@pytest.mark.parametrize("name", LENSES)
def test_numbers_and_poses_are_found(name):
    truth, views = scene(name)
    values, T = perturbed(name, truth)
    wide = Bundle(LENSES[name], TRUTH[name], 1e3 * bundle(name).std)
    refined = refine_bundle(wide, values, views, list(T), 40)
    known = determined(name)
    np.testing.assert_allclose(refined.values[:known], TRUTH[name][:known], rtol=1e-3)
    np.testing.assert_allclose(refined.T_camera_board, truth, atol=1e-3 if known == 4 else 5e-3)
    assert refined.error < 1e-3


def test_views_without_a_pose_and_those_far_off_are_left_out():
    truth, views = scene("pinhole")
    rng = np.random.default_rng(3)
    views[2] = (views[2][0], rng.permutation(views[2][1]))
    values, T = perturbed("pinhole", truth)
    poses = [None, *T[1:]]
    wide = Bundle(LENSES["pinhole"], TRUTH["pinhole"], 1e3 * bundle("pinhole").std)
    refined = refine_bundle(wide, TRUTH["pinhole"], views, poses, 40)
    assert len(refined.T_camera_board) == 4
    np.testing.assert_allclose(refined.T_camera_board, truth[[1, 3, 4, 5]], atol=1e-3)
    assert refine_bundle(bundle("pinhole"), values, views, [None] * 6, 40) is None


LARGER = Board(pattern="chessboard", columns=8, rows=6, square=0.03).corners


def camera_and_truth(lens, rng):
    camera = Camera(width=1280, height=720, lens=lens)
    truth = np.zeros(len(LENSES[lens].names))
    focal = rng.uniform(0.5, 1.5) * 1280 if lens != "fisheye" else rng.uniform(0.3, 0.6) * 1280
    truth[:4] = [
        focal,
        focal * rng.uniform(0.99, 1.01),
        640 + rng.normal() * 15,
        360 + rng.normal() * 15,
    ]
    truth[4:6] = [rng.uniform(-0.3, 0.1), 0.05] if lens != "fisheye" else rng.normal(size=2) * 0.02
    return camera, truth


def views(camera, truth, rng, count=12, tilt=0.6, noise=0.2):
    result = []
    while len(result) < count:
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(
            [*rng.uniform(-tilt, tilt, 2), rng.uniform(-3, 3)]
        ).as_matrix()
        depth = truth[0] / camera.width * rng.uniform(0.3, 0.6)
        T[:3, 3] = [*rng.uniform(-0.3, 0.3, 2) * depth, depth]
        T[:3, 3] -= T[:3, :3] @ LARGER.mean(axis=0)
        P = LARGER @ T[:3, :3].T + T[:3, 3]
        uv = LENSES[camera.lens].project(P, truth)
        inside = np.all((uv > 0) & (uv < [camera.width, camera.height]), axis=1) & (P[:, 2] > 0.05)
        if inside.sum() >= 20:
            result.append((LARGER[inside], uv[inside] + rng.normal(size=(inside.sum(), 2)) * noise))
    return result


@pytest.mark.parametrize("lens", LENSES)
def test_random_cameras_are_found(lens):
    errors = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        camera, truth = camera_and_truth(lens, rng)
        start = initial_intrinsics(camera, views(camera, truth, rng))
        known = determined(lens)
        errors.append(np.abs(start[:known] / truth[:known] - 1.0))
    assert np.max(errors) < 0.03


def test_strong_distortion_is_found_where_the_closed_form_is_far_off():
    for seed in range(6):
        rng = np.random.default_rng(seed)
        camera = Camera(width=1280, height=720)
        truth = np.array([660.0, 662.0, 640.0, 355.0, -0.34, 0.084, 1e-3, 0.0, 0.0])
        seen = views(camera, truth, rng, count=20, noise=0.3)
        np.testing.assert_allclose(initial_intrinsics(camera, seen)[:2], truth[:2], rtol=0.02)


@pytest.mark.parametrize("lens", LENSES)
def test_views_with_corners_mixed_up_do_no_harm(lens):
    rng = np.random.default_rng(4)
    camera, truth = camera_and_truth(lens, rng)
    seen = views(camera, truth, rng, count=20)
    for k in (0, 7):
        points, pixels = seen[k]
        seen[k] = (points, rng.permutation(pixels))
    np.testing.assert_allclose(initial_intrinsics(camera, seen)[:2], truth[:2], rtol=0.02)


@pytest.mark.parametrize("lens", LENSES)
def test_views_that_tell_little_give_something_finite(lens):
    rng = np.random.default_rng(1)
    camera, truth = camera_and_truth(lens, rng)
    (points, pixels), *_ = seen = views(camera, truth, rng, count=3)
    row = points[:, 1] == points[0, 1]
    on_line = (points[row], pixels[row])
    one_place = (points, np.ones_like(pixels))
    undefined = (points, np.full_like(pixels, np.nan))
    scattered = (points, rng.uniform(0, 700, pixels.shape))
    mirrored = (points, camera.width - pixels[:, ::-1])
    for several in (
        [seen[0]],
        [seen[0]] * 5,
        [on_line, one_place, undefined, *seen],
        [scattered, *seen],
        [scattered],
        [mirrored, scattered],
    ):
        start = initial_intrinsics(camera, several)
        assert np.all(np.isfinite(start))
        assert np.all(start[:2] > 0.0)
    with pytest.raises(MeasurementError, match="not on a line"):
        initial_intrinsics(camera, [on_line, one_place, undefined])


def test_views_head_on_give_something_finite():
    rng = np.random.default_rng(0)
    camera, truth = camera_and_truth("pinhole", rng)
    start = initial_intrinsics(camera, views(camera, truth, rng, tilt=0.0))
    assert np.all(np.isfinite(start))
    assert 0.1 * 1280 < start[0] < 10 * 1280


def test_too_few_corners_are_refused():
    with pytest.raises(MeasurementError, match="6 corners"):
        initial_intrinsics(Camera(width=640, height=480), [(LARGER[:5], np.zeros((5, 2)))])
