"""Intrinsics from views alone: random cameras of both lenses, and views that do not tell the focal length."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.camera.initial_intrinsics import initial_intrinsics
from calib.camera.lenses import LENSES
from calib.errors import MeasurementError

POINTS = Board(pattern="chessboard", columns=8, rows=6, square=0.03).corners


def camera_and_truth(lens, rng):
    camera = Camera(width=1280, height=720, lens=lens)
    truth = np.zeros(len(LENSES[lens].names))
    focal = rng.uniform(0.5, 1.5) * 1280 if lens == "pinhole" else rng.uniform(0.3, 0.6) * 1280
    truth[:4] = [
        focal,
        focal * rng.uniform(0.99, 1.01),
        640 + rng.normal() * 15,
        360 + rng.normal() * 15,
    ]
    truth[4:6] = [rng.uniform(-0.3, 0.1), 0.05] if lens == "pinhole" else rng.normal(size=2) * 0.02
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
        T[:3, 3] -= T[:3, :3] @ POINTS.mean(axis=0)
        P = POINTS @ T[:3, :3].T + T[:3, 3]
        uv = LENSES[camera.lens].project(P, truth)
        inside = np.all((uv > 0) & (uv < [camera.width, camera.height]), axis=1) & (P[:, 2] > 0.05)
        if inside.sum() >= 20:
            result.append((POINTS[inside], uv[inside] + rng.normal(size=(inside.sum(), 2)) * noise))
    return result


@pytest.mark.parametrize("lens", LENSES)
def test_random_cameras_are_found(lens):
    errors = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        camera, truth = camera_and_truth(lens, rng)
        start = initial_intrinsics(camera, views(camera, truth, rng))
        errors.append(np.abs(start[:4] / truth[:4] - 1.0))
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
        initial_intrinsics(Camera(width=640, height=480), [(POINTS[:5], np.zeros((5, 2)))])
