"""The map from a board to its image: through a pinhole exactly, through a lens to a fraction of a pixel."""

from __future__ import annotations

import numpy as np
import pytest

from calib.boards.corners.planar_map import fit_planar_map
from calib.camera.lenses import LENSES
from tests.boards.board_views import CHARUCO_BOARD, View

POINTS = CHARUCO_BOARD.corners[:, :2]
SIZE = (640, 480)


def test_a_pinhole_s_map_is_exact():
    pixels = View(tilt=(50, 20, 30)).corners(CHARUCO_BOARD)
    planar_map = fit_planar_map(POINTS, pixels, SIZE)
    np.testing.assert_allclose(planar_map.project(POINTS), pixels, atol=0.01)
    np.testing.assert_allclose(planar_map.unproject(pixels), POINTS, atol=1e-5)
    assert planar_map.distortion == pytest.approx(0.0, abs=0.01)


def test_a_lens_is_one_number():
    view = View(tilt=(20, 10, 30), distortion=(-0.35, 0.12), focal=400, middle=(0, 0, 0.2))
    pixels = view.corners(CHARUCO_BOARD)
    planar_map = fit_planar_map(POINTS, pixels, SIZE)
    # A barrel: half of the diagonal is 1 in the map, 400 px in the tangent.
    assert planar_map.distortion < -0.2
    assert np.abs(planar_map.project(POINTS) - pixels).max() < 0.5
    np.testing.assert_allclose(planar_map.unproject(planar_map.project(POINTS)), POINTS, atol=1e-9)


def test_corners_that_were_not_seen_are_predicted():
    view = View(tilt=(20, 10, 30), distortion=(-0.2, 0.05), focal=400, middle=(0, 0, 0.2))
    pixels = view.corners(CHARUCO_BOARD)
    seen = np.arange(len(POINTS)) % 6 < 4
    planar_map = fit_planar_map(POINTS[seen], pixels[seen], SIZE)
    assert np.abs(planar_map.project(POINTS) - pixels).max() < 3.0


def test_weights_count():
    pixels = View(tilt=(10, 20, 0)).corners(CHARUCO_BOARD)
    wrong = pixels.copy()
    wrong[3] += 40.0
    weights = np.ones(len(pixels))
    weights[3] = 1e-9
    planar_map = fit_planar_map(POINTS, wrong, SIZE, weights)
    assert np.abs(planar_map.project(POINTS) - pixels).max() < 0.02


def test_derivatives_are_those_of_the_view():
    view = View(tilt=(40, 20, 30))
    planar_map = fit_planar_map(POINTS, view.corners(CHARUCO_BOARD), SIZE)
    jacobians = planar_map.jacobians(POINTS, 0.002)
    assert jacobians.shape == (24, 2, 2)
    # A small step along x from the first corner, seen by the camera.
    T = view.T_camera_board(CHARUCO_BOARD)
    steps = CHARUCO_BOARD.corners[0] + np.array([[-1e-4, 0, 0], [1e-4, 0, 0]])
    seen = steps @ T[:3, :3].T + T[:3, 3]
    pixels = view.focal * seen[:, :2] / seen[:, 2:]
    np.testing.assert_allclose(jacobians[0, :, 0], (pixels[1] - pixels[0]) / 2e-4, rtol=2e-3)


def test_what_is_behind_the_camera_has_no_pixel():
    view = View(tilt=(0, 80, 0), middle=(0, 0, 0.15))
    planar_map = fit_planar_map(POINTS, view.corners(CHARUCO_BOARD), SIZE)
    far = np.array([[5.0, 0.0], [-5.0, 0.0]])
    assert np.isnan(planar_map.project(far)).any(axis=1).sum() == 1


def fisheye_pixels(focal=150.0):
    """A steep board by a lens of equal angles, its axis through the middle of the image; up to 62 deg from it."""
    view = View(tilt=(50, 20, 30), middle=(0.04, 0.0, 0.11))
    T = view.T_camera_board(CHARUCO_BOARD)
    points = CHARUCO_BOARD.corners @ T[:3, :3].T + T[:3, 3]
    values = np.array([focal, focal, 319.5, 239.5, 0.0, 0.0, 0.0, 0.0])
    return LENSES["fisheye"].project(points, values)


def test_a_lens_of_equal_angles_is_mapped_exactly():
    pixels = fisheye_pixels()
    farthest = np.linalg.norm(pixels - [319.5, 239.5], axis=1).max() / 150.0
    assert farthest > 1.0  # [rad]
    planar_map = fit_planar_map(POINTS, pixels, SIZE)
    assert np.abs(planar_map.project(POINTS) - pixels).max() < 0.05
    np.testing.assert_allclose(planar_map.unproject(pixels), POINTS, atol=2e-5)
    # Half of the diagonal is 400 px: w = 400 / 150.
    assert planar_map.distortion == pytest.approx(-((400.0 / 150.0) ** 2) / 3.0, rel=0.01)


def test_a_pincushion_is_undone():
    view = View(tilt=(20, 10, 30), distortion=(0.15, 0.0), focal=400, middle=(0, 0, 0.2))
    pixels = view.corners(CHARUCO_BOARD)
    planar_map = fit_planar_map(POINTS, pixels, SIZE)
    assert 0.05 < planar_map.distortion < 0.4
    assert np.abs(planar_map.project(POINTS) - pixels).max() < 0.5
    np.testing.assert_allclose(planar_map.unproject(planar_map.project(POINTS)), POINTS, atol=1e-9)
