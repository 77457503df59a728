"""Cameras and boards of virtual cells: usual ones, and true numbers beside stated ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.camera.camera import UNKNOWN, Camera
from calib.camera.lenses import LENSES
from calib.robot.robot import Robot
from calib.verbs.simulate.equipment import draw_camera, folds, usual_board, usual_camera
from tests.boards.boards import FISHEYE


def drawn(camera, count=300):
    cameras = [draw_camera(camera, np.random.default_rng(seed)) for seed in range(count)]
    return np.array([one.values for one in cameras])


def test_boards_suit_the_reach_of_the_arm():
    squares = {
        name: usual_board(Robot.load(name, base=base, tip=tip)).square
        for name, base, tip in (
            ("ur5", "base_link", "tool0"),
            ("so101", "gripper_frame_link", "base_link"),
        )
    }
    assert squares["ur5"] == pytest.approx(0.037, abs=0.003)
    assert squares["so101"] == pytest.approx(0.018, abs=0.004)
    # Whole millimetres, to the last digit.
    assert all(square == round(square, 3) for square in squares.values())


def test_true_numbers_scatter_about_the_stated_ones_as_their_sigma_says():
    sigma = np.array([2.0, 3.0, 1.0, 0.0, 0.01, 0.02, 1e-3, 1e-3, 0.0])
    camera = replace(usual_camera(), sigma=sigma)
    errors = drawn(camera) - camera.values
    np.testing.assert_allclose(errors.std(axis=0), sigma, rtol=0.15)
    np.testing.assert_array_equal(errors[:, sigma == 0.0], 0.0)


@pytest.mark.parametrize("camera", [usual_camera(), FISHEYE])
def test_without_a_sigma_the_numbers_are_a_makers(camera):
    errors = drawn(camera) - camera.values
    expected = LENSES[camera.lens].default_sigma(camera.values, camera.width)
    if camera.lens == "fisheye":
        expected = expected * [1, 1, 1, 1, 1, 0.5, 0.25, 0.125]
    np.testing.assert_allclose(errors.std(axis=0), expected, rtol=0.15)
    unknown = replace(camera, sigma=np.full(len(expected), UNKNOWN))
    np.testing.assert_allclose(drawn(unknown), drawn(camera))


def test_of_a_camera_without_numbers_any_usual_ones_are_drawn():
    values = drawn(Camera(width=640, height=480))
    assert values.shape[1] == 9
    assert 0.63 * 640 < values[:, 0].min() < 0.7 * 640
    assert 0.9 * 640 < values[:, 0].max() < 0.97 * 640
    np.testing.assert_allclose(values[:, 1], values[:, 0], rtol=0.01)
    np.testing.assert_allclose(values[:, 2:4].mean(axis=0), [319.5, 239.5], atol=1.0)
    true = draw_camera(Camera(name="left", width=640, height=480), np.random.default_rng(0))
    assert (true.name, true.width, true.lens) == ("left", 640, "pinhole")
    assert not true.sigma.any()


def test_no_lens_is_drawn_that_shows_two_points_in_one_place():
    values = np.array([420.0, 420.0, 640.0, 480.0, -0.02, 0.005, 0.0, 0.0])
    fisheye = Camera(width=1280, height=960, lens="fisheye", values=values)
    assert not folds(fisheye)
    turned = replace(fisheye, values=values - 0.03 * np.eye(8)[7])  # back from 1.2 rad on
    assert folds(turned)
    # Within a smaller image the same lens is as good as any.
    assert not folds(replace(turned, width=640, height=480))
    drawn_lenses = [draw_camera(fisheye, np.random.default_rng(seed)) for seed in range(60)]
    assert not any(map(folds, drawn_lenses))
    assert not folds(usual_camera())
