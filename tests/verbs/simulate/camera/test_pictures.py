"""Pictures: pixels by the equations written out, noise, encoder, repeatability and what is not seen."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calib.data.cell import TrackerNoise
from calib.errors import CalibError
from calib.robot.robot import Robot
from calib.verbs.simulate.camera.cell import draw_camera_cell
from calib.verbs.simulate.camera.equipment import usual_camera
from calib.verbs.simulate.camera.pictures import take_pictures
from calib.verbs.simulate.disturbances import Encoder
from calib.verbs.simulate.scenario import Scenario
from tests.verbs.simulate.camera.cells import BOARD


def with_scenario(cell, **changes):
    return replace(cell, scenario=replace(cell.scenario, **changes))


@pytest.fixture(scope="module")
def exact():
    """A cell in which all is exact but robot, camera and print."""
    robot = Robot.load("ur5", base="tool0", tip="base_link")
    scenario = Scenario(robot, noise=None)
    return draw_camera_cell(scenario, usual_camera(), BOARD, seed=7)


@pytest.fixture(scope="module")
def views(exact):
    return exact.views(12, seed=1)


def test_pixels_follow_from_robot_mounts_print_and_lens(exact, views):
    pictures = take_pictures(exact, views)
    np.testing.assert_array_equal(pictures.readings, views)
    k, row = 5, np.flatnonzero(pictures.picture == 5)[3]
    T_camera_base = exact.truth.T_frame_base[0]
    T_base_tip = exact.truth.robot.poses(views[k])[0]
    T = T_camera_base @ T_base_tip @ exact.truth.T_tip_target[0]
    board = BOARD.corners[pictures.corner[row]]
    xi, eta = 2.0 * board[:2] / BOARD.size - 1.0
    corner = board * [*exact.printed.scale, 0.0] + exact.printed.offsets[pictures.corner[row]]
    corner[2] += exact.printed.warp[0] * (1 - xi**2) + exact.printed.warp[1] * (1 - eta**2)
    fx, fy, cx, cy, *distortion = exact.camera.values
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    expected, _ = cv2.projectPoints(
        corner, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], K, np.array(distortion)
    )
    np.testing.assert_allclose(pictures.true_pixels[row], expected.ravel(), atol=1e-6)
    np.testing.assert_array_equal(pictures.pixels, pictures.true_pixels)


def test_noise_is_as_large_as_it_is_stated(exact, views):
    noisy = with_scenario(exact, sigma={"px": 0.3})
    pictures = take_pictures(noisy, views, seed=2)
    assert (pictures.pixels - pictures.true_pixels).std() == pytest.approx(0.3, rel=0.1)
    again = take_pictures(noisy, views, seed=2)
    np.testing.assert_array_equal(again.pixels, pictures.pixels)


def test_encoders_and_repeatability_show(exact, views):
    step = 1e-3
    coarse = take_pictures(with_scenario(exact, encoder=Encoder(angle=step)), views)
    assert 0.2 * step < np.abs(coarse.readings - coarse.q).max() <= 0.5 * step + 1e-12
    np.testing.assert_allclose(np.round(coarse.readings / step) * step, coarse.readings)
    noise = TrackerNoise(0.0, 0.0, repeatability=1e-4)
    moved = take_pictures(with_scenario(exact, noise=noise), views)
    still = take_pictures(exact, views)
    shift = moved.T_camera_board[:, :3, 3] - still.T_camera_board[:, :3, 3]
    assert shift.std() == pytest.approx(1e-4, rel=0.4)


def test_pictures_have_names_and_sets(exact, views):
    sets = ["estimate"] * 11 + ["validate"]
    pictures = take_pictures(exact, views, sets=sets)
    assert pictures.images[0] == "picture_01.png"
    assert pictures.images[-1] == "picture_12.png"
    assert pictures.sets[-1] == "validate"
    assert set(pictures.picture) == set(range(12))
    assert pictures.corner.max() == 23


def test_poses_from_which_nothing_is_seen_are_refused(exact):
    turned_away = np.add(exact.views(1, seed=1), [np.pi, np.pi / 2, np.pi, 0, 0, 0])
    with pytest.raises(CalibError, match="1 poses"):
        take_pictures(exact, turned_away)
