"""Pose of a board from one view: exact, against OpenCV's, on both sides of the line of sight, and its covariance."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.boards.board import Board
from calib.camera.board_pose import board_pose, homography, points_in_plane
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


def cube_corners():
    """Tags on three faces of a cube, (12, 3), that a camera sees at once from along (1, 1, 1)."""
    face = np.array([[-0.03, -0.03], [0.03, -0.03], [0.03, 0.03], [-0.03, 0.03]])
    return np.concatenate([np.insert(face, axis, -0.04, axis=1) for axis in range(3)])


def turned_to(direction, seed):
    """T_camera_board that has a direction of the board away from the camera, rolled by any angle."""
    rng = np.random.default_rng(seed)
    R = Rotation.align_vectors([[0.0, 0.0, 1.0]], [direction])[0]
    T = np.eye(4)
    T[:3, :3] = (Rotation.from_rotvec([0, 0, rng.uniform(-3, 3)]) * R).as_matrix()
    return T


@pytest.mark.parametrize("name", LENSES)
@pytest.mark.parametrize("place", [(0.0, 0.0, 0.2), (0.1, -0.15, 0.25), (0.1, 0.0, 3.0)])
def test_pose_of_a_body_is_exact_without_noise(name, place):
    points = cube_corners()
    for seed in range(5):
        T = turned_to([1.0, 1.1, 0.8], seed)
        T[:3, 3] = place
        pixels = LENSES[name].project(points @ T[:3, :3].T + T[:3, 3], VALUES[name])
        found = board_pose(points, pixels, LENSES[name], VALUES[name])
        np.testing.assert_allclose(found.T_camera_board, T, atol=1e-8)


def test_pose_of_one_face_of_a_body():
    """Its plane is not the x-y plane of the body."""
    points = cube_corners()[:4]
    T = turned_to([1.0, 0.2, -0.3], 0)
    T[:3, 3] = [0.02, -0.03, 0.4]
    pixels = LENSES["pinhole"].project(points @ T[:3, :3].T + T[:3, 3], VALUES["pinhole"])
    found = board_pose(points, pixels, LENSES["pinhole"], VALUES["pinhole"])
    np.testing.assert_allclose(found.T_camera_board, T, atol=1e-8)


@pytest.mark.parametrize("faces", [8, 12])
def test_pose_of_a_body_with_noise_is_that_of_opencv(faces):
    rng = np.random.default_rng(3)
    v = VALUES["pinhole"]
    K = np.array([[v[0], 0, v[2]], [0, v[1], v[3]], [0, 0, 1]])
    points = cube_corners()[:faces]
    for seed in range(10):
        T = turned_to([1.0, 1.1, 0.8], seed)
        T[:3, 3] = [*rng.uniform(-0.1, 0.1, 2), rng.uniform(0.3, 0.8)]
        pixels = LENSES["pinhole"].project(points @ T[:3, :3].T + T[:3, 3], v)
        pixels += rng.normal(scale=0.3, size=pixels.shape)
        ok, r, t = cv2.solvePnP(points, pixels, K, v[4:], flags=cv2.SOLVEPNP_SQPNP)
        r, t = cv2.solvePnPRefineLM(points, pixels, K, v[4:], r, t)
        found = board_pose(points, pixels, LENSES["pinhole"], v).T_camera_board
        assert ok
        np.testing.assert_allclose(found[:3, 3], t[:, 0], atol=5e-5)
        np.testing.assert_allclose(found[:3, :3], cv2.Rodrigues(r)[0], atol=3e-4)


def test_points_of_a_sagging_board_are_in_a_plane_and_those_of_two_faces_are_not():
    sagging = POINTS.copy()
    sagging[:, 2] = 1e-3 * (1.0 - (POINTS[:, 0] / 0.1 - 1.0) ** 2)
    T, in_plane = points_in_plane(sagging)
    np.testing.assert_array_equal(T, np.eye(4))
    np.testing.assert_array_equal(in_plane, POINTS[:, :2])
    assert points_in_plane(cube_corners()[:8]) is None
    T, in_plane = points_in_plane(cube_corners()[:4])
    in_frame = cube_corners()[:4] @ T[:3, :3].T + T[:3, 3]
    np.testing.assert_allclose(in_frame, np.c_[in_plane, np.zeros(4)], atol=1e-15)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
