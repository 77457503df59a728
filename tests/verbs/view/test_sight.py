"""Cameras, boards and images of a page against the lens, the mounts and the table."""

from __future__ import annotations

import numpy as np
import pytest

from calib.camera.camera import Camera
from calib.camera.lenses import LENSES
from calib.robot.robot import Robot
from calib.verbs.view.sight import frustum, sight_of
from calib.verbs.view.standing import standing
from calib.verbs.view.steps import steps_of
from tests.images import BOARD, VALUES, camera, mounts
from tests.verbs.view.image_tables import CORNERS, evaluation


def sight(first, last, cameras=None, **words):
    steps = steps_of(first, last, np.zeros(len(first.measurements), bool))
    cameras = {"": camera()} if cameras is None else cameras
    return sight_of(first, last, steps, cameras, **words)


@pytest.mark.parametrize("lens", LENSES)
def test_the_edges_of_a_frustum_are_seen_at_the_edges_of_the_image(lens):
    values = VALUES[lens].copy()
    values[2:4] = [300.0, 195.0]
    one = camera(lens, width=600, height=400, values=values)
    shape = frustum(one, 0.3)
    starts, ends = shape.lines[:4, 0], shape.lines[:4, 1]
    np.testing.assert_array_equal(starts, 0.0)
    np.testing.assert_allclose(ends[:, 2], 0.3)
    right, lower = one.width - 0.5, one.height - 0.5
    corners = [[-0.5, -0.5], [right, -0.5], [right, lower], [-0.5, lower]]
    np.testing.assert_allclose(LENSES[lens].project(ends, one.values), corners, atol=1e-6)
    border = LENSES[lens].project(shape.lines[4:, 0], one.values)
    on_edge = np.abs(border - [-0.5, -0.5]).min(axis=1) < 1e-6
    on_edge |= np.abs(border - [right, lower]).min(axis=1) < 1e-6
    assert np.all(on_edge)
    # The body lies behind the optical centre.
    assert shape.T_shape_body[2, 3] + 0.5 * shape.edges[2] == pytest.approx(0.0)


def test_a_camera_of_which_only_the_size_is_known_has_a_usual_lens():
    shape = frustum(Camera(width=800, height=400), 1.0)
    np.testing.assert_allclose(shape.lines[0, 1], [-0.625, -0.3125, 1.0])


def test_where_a_distortion_has_no_inverse_the_edges_are_those_of_a_straight_lens():
    values = np.array([700.0, 700.0, 639.5, 359.5, -0.6, 0.0, 0.0, 0.0, 0.0])
    shape = frustum(camera(width=1280, height=720, values=values), 1.0)
    np.testing.assert_allclose(shape.lines[0, 1], [-640.0 / 700.0, -360.0 / 700.0, 1.0])


def test_what_a_lens_sees_beside_the_camera_is_drawn_at_an_angle_of_60_degrees():
    shape = frustum(camera("fisheye"), 1.0)
    ends = shape.lines[:4, 1]
    np.testing.assert_allclose(np.linalg.norm(ends[:, :2], axis=1), 1.7)
    assert np.all(np.sign(ends[:, :2]) == [[-1, -1], [1, -1], [1, 1], [-1, 1]])


def test_on_the_hand_the_robot_carries_the_camera_and_the_board_stands():
    first, last = standing(evaluation(size=2.0)), standing(evaluation(size=0.5))
    seen = sight(first, last, carries_camera=True)
    assert len(seen.carried.points) == 0
    ((board, T_base_board),) = seen.standing
    np.testing.assert_allclose(board.points, np.unique(BOARD.corners, axis=0))
    _, T_tip_board = mounts()  # of the chain from the hand, whose tip is the root
    np.testing.assert_allclose(T_base_board, [T_tip_board, T_tip_board], atol=1e-5)
    assert seen.outline.shape == (2 * (CORNERS + 2), 3)
    m = first.measurements
    for k, image in enumerate(seen.images):
        rows = slice(k * CORNERS, (k + 1) * CORNERS)
        assert image.size == (2400, 2000)
        np.testing.assert_array_equal(image.measured[:, 0], m.reading("u")[rows])
        np.testing.assert_array_equal(image.measured[:, 1], m.reading("v")[rows])
        np.testing.assert_array_equal(image.residual[:, :, 0].T[0], [2.0 * (k + 1), 0.5 * (k + 1)])
    assert [len(one.measured) for one in seen.at(np.array([1, 3])).images] == [CORNERS, CORNERS]
    assert seen.at(np.array([3])).images[0] is seen.images[3]


def test_beside_the_robot_the_camera_stands_and_the_board_is_carried():
    e = evaluation(robot=Robot.load("panda", base="panda_link8", tip="panda_link0"))
    seen = sight(e, e, carries_camera=False)
    np.testing.assert_allclose(seen.carried.points, np.unique(BOARD.corners, axis=0))
    ((shape, T_base_camera),) = seen.standing
    T_camera_base, _ = mounts()
    np.testing.assert_allclose(T_base_camera[0], np.linalg.inv(T_camera_base), atol=1e-5)
    assert len(shape.points) == 0
    # A plate one square wider than the corners, right below them.
    np.testing.assert_allclose(seen.carried.edges[:2], np.ptp(BOARD.corners, axis=0)[:2] + 0.06)
    assert seen.carried.T_shape_body[2, 3] - 0.5 * seen.carried.edges[2] > 0.0


def test_without_cameras_or_images_nothing_is_seen():
    e = evaluation()
    assert sight(e, e, cameras={}, carries_camera=False) is None
