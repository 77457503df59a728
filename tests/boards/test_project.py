"""Pixels of corners, by formulas written out here, and what is seen."""

from __future__ import annotations

import numpy as np
import pytest

from calib.boards.project import Sight, corner_pixels, in_image, project, rays
from calib.camera.camera import Camera
from calib.errors import CalibError
from tests.boards.boards import CHESS_BOARD, FISHEYE, PINHOLE, facing

POINTS = np.array([[0.1, -0.05, 0.5], [-0.2, 0.1, 0.9], [0.0, 0.0, 0.3]])


def test_pinhole_is_the_model_of_brown_and_conrady():
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = PINHOLE.values
    x, y = (POINTS[:, :2] / POINTS[:, 2:]).T
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = fx * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)) + cx
    v = fy * (y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y) + cy
    np.testing.assert_allclose(project(PINHOLE, POINTS), np.column_stack([u, v]), atol=1e-9)


def test_fisheye_is_the_model_of_kannala_and_brandt():
    fx, fy, cx, cy, *k = FISHEYE.values
    x, y = (POINTS[:2, :2] / POINTS[:2, 2:]).T
    r = np.hypot(x, y)
    theta = np.arctan(r)
    distorted = theta * (1 + sum(k[i] * theta ** (2 * i + 2) for i in range(4)))
    expected = np.column_stack([fx * x * distorted / r + cx, fy * y * distorted / r + cy])
    np.testing.assert_allclose(project(FISHEYE, POINTS[:2]), expected, atol=1e-9)


def test_what_is_behind_the_camera_has_no_pixel():
    pixels = project(PINHOLE, np.array([[[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]]))
    assert pixels.shape == (1, 2, 2)
    np.testing.assert_allclose(pixels[0, 0], PINHOLE.values[2:4])
    assert np.isnan(pixels[0, 1]).all()
    assert np.isnan(project(FISHEYE, np.array([[0.0, 0.0, -1.0]]))).all()


@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE])
def test_rays_lead_back_to_their_pixels(camera):
    pixels = np.array([[200.0, 100.0], [640.0, 360.0], [1100.0, 650.0]])
    back = rays(camera, pixels)
    np.testing.assert_array_equal(back[:, 2], 1.0)
    np.testing.assert_allclose(project(camera, 0.7 * back), pixels, atol=1e-4)


def test_a_camera_without_numbers_projects_nothing():
    with pytest.raises(CalibError, match="left"):
        project(Camera(name="left", width=640, height=480), POINTS)


def test_pixels_inside():
    pixels = np.array([[2.0, 2.0], [1.9, 5.0], [637.0, 477.0], [637.1, 3.0], [np.nan, 3.0]])
    assert in_image(pixels, (640, 480), 2.5).tolist() == [True, False, True, False, False]


def test_corners_are_seen_in_the_image_with_its_margin():
    T = facing(CHESS_BOARD, 0.4)
    pixels, seen = corner_pixels(PINHOLE, CHESS_BOARD.corners, T[None])
    assert seen.all()
    highest = pixels[0, :, 1].min()
    _, seen = corner_pixels(
        PINHOLE, CHESS_BOARD.corners, T[None], Sight(margin=highest + 0.5 + 1e-6)
    )
    assert (~seen).sum() >= 1
    assert not seen[0, np.argmin(pixels[0, :, 1])]


@pytest.mark.parametrize(
    ("tilt", "is_seen"), [(0.0, True), (49.0, True), (51.0, False), (180.0, False)]
)
def test_a_board_is_seen_from_its_face_up_to_a_tilt(tilt, is_seen):
    T = facing(CHESS_BOARD, 5.0, tilt)
    sight = Sight(tilt=np.deg2rad(50.0))
    middle = CHESS_BOARD.centre[None]
    _, seen = corner_pixels(PINHOLE, middle, T[None], sight)
    assert seen.tolist() == [[is_seen]]


def test_several_poses_at_once_are_those_one_by_one():
    poses = np.stack([facing(CHESS_BOARD, 0.4, 20.0), facing(CHESS_BOARD, 0.7, -30.0)])
    together, _ = corner_pixels(PINHOLE, CHESS_BOARD.corners, poses)
    for pose, pixels in zip(poses, together, strict=True):
        alone, _ = corner_pixels(PINHOLE, CHESS_BOARD.corners, pose[None])
        np.testing.assert_allclose(alone[0], pixels, rtol=1e-12)
