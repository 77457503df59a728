"""Pose of a board from one view: exact, against OpenCV's, on both sides of the line of sight, and its covariance."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.boards.board import Board
from calib.camera.board_pose import board_pose, homography
from calib.camera.lenses import LENSES
from tests.camera.lens_values import VALUES

POINTS = Board(pattern="chessboard", columns=7, rows=5, square=0.03).corners


def pose(tilt, seed=0):
    rng = np.random.default_rng(seed)
    about = rng.normal(size=2)
    about *= tilt / np.linalg.norm(about)
    R = Rotation.from_rotvec([*about, 0.0]) * Rotation.from_rotvec([0, 0, rng.uniform(-3, 3)])
    T = np.eye(4)
    T[:3, :3] = R.as_matrix()
    T[:3, 3] = np.array([*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.3, 0.6)])
    T[:3, 3] -= T[:3, :3] @ POINTS.mean(axis=0) * [1, 1, 0]
    return T


def images(name, T, values=None):
    P = POINTS @ T[:3, :3].T + T[:3, 3]
    return LENSES[name].project(P, VALUES[name] if values is None else values)


@pytest.mark.parametrize("name", LENSES)
@pytest.mark.parametrize("tilt", [0.0, 0.02, 0.5, 1.1])
def test_pose_is_exact_without_noise(name, tilt):
    for seed in range(5):
        T = pose(tilt, seed)
        found = board_pose(POINTS, images(name, T), LENSES[name], VALUES[name])
        np.testing.assert_allclose(found.T_camera_board, T, atol=1e-8)
        assert found.rms < 1e-6


def test_pose_is_that_of_opencv_with_noise():
    rng = np.random.default_rng(2)
    v = VALUES["pinhole"]
    K = np.array([[v[0], 0, v[2]], [0, v[1], v[3]], [0, 0, 1]])
    for seed in range(20):
        pixels = images("pinhole", pose(0.6, seed)) + rng.normal(scale=0.3, size=(len(POINTS), 2))
        ok, r, t = cv2.solvePnP(POINTS, pixels, K, v[4:])
        found = board_pose(POINTS, pixels, LENSES["pinhole"], v).T_camera_board
        assert ok
        np.testing.assert_allclose(found[:3, 3], t[:, 0], atol=2e-5)
        np.testing.assert_allclose(found[:3, :3], cv2.Rodrigues(r)[0], atol=1e-4)


@pytest.mark.parametrize("name", LENSES)
def test_a_board_whose_origin_is_behind_the_camera_is_in_front_of_it(name):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec([0.0, -1.0, 0.0]).as_matrix()
    T[:3, 3] = [-0.05, -0.05, -0.01]
    points = POINTS[POINTS[:, 0] > 0.08]
    P = points @ T[:3, :3].T + T[:3, 3]
    assert P[:, 2].min() > 0.05
    pixels = LENSES[name].project(P, VALUES[name])
    found = board_pose(points, pixels, LENSES[name], VALUES[name])
    np.testing.assert_allclose(found.T_camera_board, T, atol=1e-8)


@pytest.mark.parametrize(
    "pixels", [np.ones((24, 2)), np.full((24, 2), np.nan), np.arange(48.0).reshape(24, 2)]
)
def test_images_at_one_place_or_on_a_line_tell_no_pose(pixels):
    assert board_pose(POINTS, pixels, LENSES["pinhole"], VALUES["pinhole"]) is None


def test_the_other_pose_is_tilted_the_other_way():
    T = pose(0.3)
    T[2, 3] += 2.0  # so far away that both tilts fit
    result = board_pose(POINTS, images("pinhole", T), LENSES["pinhole"], VALUES["pinhole"])
    sight = T[:3, :3] @ POINTS.mean(axis=0) + T[:3, 3]
    sight /= np.linalg.norm(sight)
    normal = T[:3, 2]
    mirrored = 2.0 * (normal @ sight) * sight - normal
    np.testing.assert_allclose(result.T_camera_board_other[:3, 2], mirrored, atol=0.1)
    assert 0.01 < result.rms_other < 1.0
    assert result.rms < 1e-6


@pytest.mark.slow
def test_covariance_is_that_of_monte_carlo():
    rng = np.random.default_rng(5)
    T = pose(0.5, 3)
    exact = images("pinhole", T)
    lens, values = LENSES["pinhole"], VALUES["pinhole"]
    errors = []
    for _ in range(300):
        noisy = exact + rng.normal(scale=0.2, size=exact.shape)
        found = board_pose(POINTS, noisy, lens, values).T_camera_board
        turn = Rotation.from_matrix(found[:3, :3] @ T[:3, :3].T).as_rotvec()
        errors.append(np.concatenate([found[:3, 3] - T[:3, 3], turn]))
    expected = 0.04 * board_pose(POINTS, exact, lens, values).covariance
    ratio = np.var(errors, axis=0) / np.diagonal(expected)
    np.testing.assert_allclose(ratio, 1.0, atol=0.3)
    whitened = np.linalg.solve(np.linalg.cholesky(expected), np.transpose(errors))
    np.testing.assert_allclose(np.cov(whitened), np.eye(6), atol=0.35)


@pytest.mark.parametrize("points", [POINTS[:3], POINTS[:6], np.zeros((5, 3))])
def test_too_few_points_or_points_on_a_line_tell_no_pose(points):
    pixels = np.random.default_rng(0).uniform(0, 500, (len(points), 2))
    assert board_pose(points, pixels, LENSES["pinhole"], VALUES["pinhole"]) is None


def test_homography_takes_points_to_their_images():
    H = np.array([[1.1, 0.2, 30.0], [-0.1, 0.9, 20.0], [1e-3, 2e-3, 1.0]])
    points = np.random.default_rng(1).uniform(-50, 50, (9, 2))
    homogeneous = np.column_stack([points, np.ones(9)]) @ H.T
    result = homography(points, homogeneous[:, :2] / homogeneous[:, 2:])
    np.testing.assert_allclose(result / result[2, 2], H, atol=1e-9)
