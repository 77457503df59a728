"""Lens models against OpenCV's, and their derivatives against differences."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from calib.camera.lenses import LENSES
from tests.camera.lens_values import VALUES


def points(count=200):
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-0.9, 0.9, (2, count))
    depth = rng.uniform(0.2, 2.0, count)
    return np.column_stack([x * depth, y * depth, depth])


def by_opencv(name, P, values):
    fx, fy, cx, cy = values[:4]
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    zero = np.zeros(3)
    if name != "fisheye":
        return cv2.projectPoints(P, zero, zero, K, values[4:])[0].reshape(-1, 2)
    return cv2.fisheye.projectPoints(P.reshape(-1, 1, 3), zero, zero, K, values[4:])[0].reshape(
        -1, 2
    )


@pytest.mark.parametrize("name", LENSES)
def test_images_are_those_of_opencv(name):
    P = points()
    np.testing.assert_allclose(
        LENSES[name].project(P, VALUES[name]), by_opencv(name, P, VALUES[name]), atol=1e-9
    )


@pytest.mark.parametrize("name", LENSES)
def test_derivatives_are_those_of_differences(name):
    lens, values, P = LENSES[name], VALUES[name], points()
    by_point, by_values = lens.derivatives(P, values)
    for k in range(3):
        step = 1e-6 * np.eye(3)[k]
        difference = (lens.project(P + step, values) - lens.project(P - step, values)) / 2e-6
        np.testing.assert_allclose(by_point[:, :, k], difference, rtol=1e-7, atol=1e-5)
    for k in range(len(values)):
        step = 1e-5 * np.eye(len(values))[k]
        difference = (lens.project(P, values + step) - lens.project(P, values - step)) / 2e-5
        np.testing.assert_allclose(by_values[:, :, k], difference, rtol=1e-7, atol=1e-6)


@pytest.mark.parametrize("name", LENSES)
def test_each_point_may_have_numbers_of_its_own(name):
    lens, P = LENSES[name], points(5)
    values = VALUES[name] * np.linspace(0.9, 1.1, 5)[:, None]
    each = [lens.project(P[[i]], values[i])[0] for i in range(5)]
    np.testing.assert_allclose(lens.project(P, values), each)
    by_point, by_values = lens.derivatives(P, values)
    for i in range(5):
        of_point, of_values = lens.derivatives(P[[i]], values[i])
        np.testing.assert_allclose(by_point[[i]], of_point)
        np.testing.assert_allclose(by_values[[i]], of_values)


@pytest.mark.parametrize("name", LENSES)
def test_undistorted_images_lead_back_to_the_points(name):
    lens, P = LENSES[name], points()
    rays = lens.undistort(lens.project(P, VALUES[name]), VALUES[name])
    np.testing.assert_allclose(rays, P / P[:, 2:], atol=1e-10)


@pytest.mark.parametrize("name", LENSES)
def test_the_line_of_sight_meets_the_centre(name):
    lens = LENSES[name]
    P = np.array([[0.0, 0.0, 1.0]])
    np.testing.assert_allclose(lens.project(P, VALUES[name])[0], VALUES[name][2:4])
    by_point, _ = lens.derivatives(P, VALUES[name])
    # A tilt of the sensor scales and shears the image by its square.
    second_order = 2e-3 if name == "tilted" else 0.0
    focal = np.diag(VALUES[name][:2])
    np.testing.assert_allclose(by_point[0, :, :2], focal, atol=second_order * focal.max())
    np.testing.assert_allclose(lens.undistort(VALUES[name][None, 2:4], VALUES[name]), P)


@pytest.mark.parametrize("name", LENSES)
def test_a_point_behind_the_camera_has_a_finite_image_far_out(name):
    P = np.array([[0.1, 0.1, -1.0]])
    image = LENSES[name].project(P, VALUES[name])
    assert np.all(np.isfinite(image))
    by_point, by_values = LENSES[name].derivatives(P, VALUES[name])
    assert np.all(np.isfinite(by_point))
    assert np.all(np.isfinite(by_values))


def test_default_sigma_is_of_each_number_in_its_unit():
    sigma = LENSES["pinhole"].default_sigma(VALUES["pinhole"], 1280)
    np.testing.assert_allclose(sigma, [6.34, 6.41, 6.4, 6.4, 0.02, 0.02, 0.002, 0.002, 0.02])
    sigma = LENSES["tilted"].default_sigma(VALUES["tilted"], 1280)
    np.testing.assert_allclose(sigma[8:], [0.02] * 4 + [0.002] * 4 + [0.01] * 2)
