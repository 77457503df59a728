"""Bundle adjustment of a camera: steps against the whole system, convergence, and views that do not belong."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.boards.board import Board
from calib.camera.bundle import Bundle, refine_bundle
from calib.camera.lenses import LENSES
from calib.camera.planar_pose import moved, view_system

POINTS = Board(pattern="chessboard", columns=7, rows=5, square=0.03).corners
TRUTH = {
    "pinhole": np.array([700.0, 705.0, 640.0, 355.0, -0.1, 0.05, 1e-3, -5e-4, 0.0]),
    "fisheye": np.array([420.0, 418.0, 641.0, 358.0, -0.02, 0.01, -4e-3, 6e-4]),
}


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


def bundle(name):
    std = np.array([300.0, 300.0, 100.0, 100.0, *[0.5] * (len(TRUTH[name]) - 4)])
    return Bundle(LENSES[name], TRUTH[name] * 1.01, std)


def perturbed(name, T):
    rng = np.random.default_rng(2)
    values = TRUTH[name].copy()
    values[:4] *= 1.0 + rng.uniform(-0.03, 0.03, 4)
    return values, moved(T, rng.normal(scale=3e-3, size=(len(T), 6)))


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
    np.testing.assert_allclose(refined.values[:4], TRUTH[name][:4], rtol=1e-3)
    np.testing.assert_allclose(refined.T_camera_board, truth, atol=1e-3)
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
