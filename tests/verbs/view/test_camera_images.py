"""Cameras, boards and images of a page: as the lens, the mounts and the table have them, in scene and script."""

from __future__ import annotations

import base64
import json
import re

import numpy as np
import pytest

from calib.camera.camera import Camera
from calib.camera.lenses import LENSES
from calib.robot.robot import Robot
from calib.verbs.view.camera_images import (
    camera_images,
    displacement_factor,
    frustum,
    images_table,
)
from calib.verbs.view.robots_page import FACTORS, view_page
from calib.verbs.view.steps import rows_of_steps, seen_from_root
from calib.verbs.view.view import view_at_rows
from tests.images import BOARD, VALUES, camera, mounts
from tests.verbs.view.image_tables import CORNERS, evaluation
from tests.view_fixtures import scene_of


def images_of(first, last, cameras=None, **words):
    cameras = {"": camera()} if cameras is None else cameras
    return camera_images(first, last, rows_of_steps(first.measurements), cameras, **words)


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
    first, last = seen_from_root(evaluation(size=2.0)), seen_from_root(evaluation(size=0.5))
    seen = images_of(first, last, carries_camera=True)
    assert len(seen.carried.points) == 0
    ((board, T_base_board),) = seen.standing
    np.testing.assert_allclose(board.points, np.unique(BOARD.corners, axis=0))
    _, T_tip_board = mounts()  # of the chain from the hand, whose tip is the root
    np.testing.assert_allclose(T_base_board, [T_tip_board, T_tip_board], atol=1e-5)
    assert seen.outline.shape == (2 * (CORNERS + 2), 3)
    m = first.measurements
    for k, image in enumerate(seen.corners):
        rows = slice(k * CORNERS, (k + 1) * CORNERS)
        assert image.size == (2400, 2000)
        np.testing.assert_array_equal(image.measured[:, 0], m.reading("u")[rows])
        np.testing.assert_array_equal(image.measured[:, 1], m.reading("v")[rows])
        np.testing.assert_array_equal(image.residual[:, :, 0].T[0], [2.0 * (k + 1), 0.5 * (k + 1)])
    assert [len(one.measured) for one in seen.at(np.array([1, 3])).corners] == [CORNERS, CORNERS]
    assert seen.at(np.array([3])).corners[0] is seen.corners[3]


def test_beside_the_robot_the_camera_stands_and_the_board_is_carried():
    e = evaluation(robot=Robot.load("panda", base="panda_link8", tip="panda_link0"))
    seen = images_of(e, e, carries_camera=False)
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
    assert images_of(e, e, cameras={}, carries_camera=False) is None


# On the page


def floats(text):
    return np.frombuffer(base64.b64decode(text), dtype="<f4").reshape(-1, 2)


@pytest.fixture(scope="module")
def view():
    flagged = np.zeros(4 * CORNERS, bool)
    return view_at_rows(evaluation(size=2.0), evaluation(size=0.5), flagged, {"": camera()})


def test_the_images_of_the_script_are_those_of_the_table(view):
    table = images_table(view.measured.images, FACTORS)
    assert table["sizes"] == [[2400, 2000]] * 4
    assert table["starts"] == [0, CORNERS, 2 * CORNERS, 3 * CORNERS, 4 * CORNERS]
    m = evaluation().measurements
    expected = np.column_stack([m.reading("u"), m.reading("v")])
    np.testing.assert_allclose(floats(table["measured"]), expected, rtol=1e-6)
    np.testing.assert_allclose(floats(table["nominal"])[::CORNERS, 0], [2.0, 4.0, 6.0, 8.0])
    np.testing.assert_allclose(floats(table["calibrated"])[::CORNERS, 0], [0.5, 1.0, 1.5, 2.0])
    assert images_table(None, FACTORS) is None


def test_displacements_are_magnified_up_to_a_part_of_the_image(view):
    # The typical one is 5 px; 6 % of the width are 144 px.
    assert displacement_factor(view.measured.images, FACTORS) == 20
    assert displacement_factor(view.measured.images, (100,)) == 1


def test_each_robot_has_camera_and_board_in_the_scene(view):
    page = view_page(view)
    paths = {command["path"] for command in scene_of(page)["commands"]}
    for who in ("nominal", "calibrated"):
        assert any(re.search(f"{who}/robot/links/\\d+/sight/lines", path) for path in paths)
        assert any(path.endswith(f"{who}/standing/00/corners") for path in paths)
    assert b'id="image"' in page.html
    assert b'id="inset"' not in page.html
    table = json.loads(re.search(rb'id="table">([^<]*)<', page.html).group(1))
    assert table["labels"] == ["0.png", "1.png", "2.png", "3.png"]
    assert table["images"]["factor"] == 20
