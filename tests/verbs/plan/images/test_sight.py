"""Sight of a camera: edges of image, focus and tilt to a hair."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.camera.lenses import LENSES
from calib.errors import CalibError
from calib.verbs.plan.images.sight import (
    CameraSight,
    SightLimits,
    outline,
    transformed,
    widest_ray,
    with_intrinsics,
)
from tests.verbs.plan.images.views import BOARD, CAMERA, in_hand, pose, sight

WIDTH, HEIGHT = 0.27, 0.18


def centred(distance: float, turn=(0.0, 0.0, 0.0)) -> np.ndarray:
    """The board's centre straight ahead, turned about it."""
    T = pose((0.0, 0.0, distance), turn)
    T[:3, 3] -= T[:3, :3] @ BOARD.centre
    return T[None]


def test_the_usual_limits_fill_15_to_80_percent_of_the_image():
    limits = SightLimits.of(CAMERA, BOARD)
    for distance, share in ((limits.nearest, 0.8), (limits.farthest, 0.15)):
        T = centred(distance)
        u, v = sight().pixels(transformed(T, outline(BOARD))[0])
        assert np.hypot(np.ptp(u), np.ptp(v)) == pytest.approx(share * 1600.0)
    assert limits.tilt == pytest.approx(math.radians(55.0))


def test_pixels_are_the_lens_s_and_u_is_to_the_right():
    u, v = sight().pixels(np.array([[0.1, -0.05, 1.0]]))
    assert u[0] == pytest.approx(639.5 + 0.1 * 1024)
    assert v[0] == pytest.approx(479.5 - 0.05 * 1024)


@pytest.mark.parametrize(
    ("distance", "sharp"), [(0.5, True), (0.5 - 1e-9, False), (0.9, True), (0.9 + 1e-9, False)]
)
def test_the_focus_is_between_two_distances(distance, sharp):
    limited = sight(nearest=0.5, farthest=0.9)
    for direction in (np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.0, 0.8])):
        T = centred(0.0)
        T[0, :3, 3] += distance * direction * (1 + (1e-12 if distance == 0.5 else -1e-12))
        assert limited.in_focus(T).tolist() == [sharp]


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.2, 3.0])
def test_the_tilt_is_between_the_normal_and_the_line_of_sight(angle):
    for axis in ((1.0, 0.0, 0.0), (0.6, -0.8, 0.0)):
        T = centred(0.6, angle * np.array(axis))
        assert sight().tilts(T)[0] == pytest.approx(angle)
        assert sight().is_facing(T)[0] == (angle <= math.radians(55.0))
    # Turned with the line of sight the board is still seen head on.
    aside = pose((0.0, 0.0, 0.0), (0.0, 0.5, 0.0)) @ centred(0.6)
    assert sight().tilts(aside)[0] == pytest.approx(0.0, abs=1e-7)


def test_the_whole_pattern_must_be_in_the_image():
    # Its left edge is at u = 639.5 + fx (x - width / 2) / z.
    edge = (12.8 - 0.5 - 639.5) / 1024.0 * 0.6 + 0.5 * WIDTH
    whole = sight()
    for moved, seen in ((1e-6, True), (-1e-6, False)):
        T = centred(0.6)
        T[0, 0, 3] += edge + moved
        assert whole.in_image(T).tolist() == [seen]
    # Of 8 columns of corners, the first 30 mm inside the pattern, three may be cut off.
    for cut, seen in ((3.99, True), (4.01, False)):
        T = centred(0.6)
        T[0, 0, 3] += edge - cut * 0.03
        assert sight(share=0.6).in_image(T).tolist() == [seen]


def test_neither_the_back_of_the_camera_nor_a_folded_lens_sees_anything():
    assert not sight().visible(centred(-0.6), BOARD.corners).any()
    # With k1 = -0.2 the image of a ray turns back at a radius of 1.3: what is at 2.0 comes to lie at 0.4.
    values = np.array([1024.0, 1024.0, 639.5, 479.5, -0.2, 0.0, 0.0, 0.0, 0.0])
    folded = sight(camera=replace(CAMERA, values=values))
    T = np.eye(4)[None]
    point = np.array([[2.0, 0.0, 1.0]])
    assert 0.0 < LENSES["pinhole"].project(point, values)[0, 0] < 1280.0
    assert not folded.visible(T, point).any()
    assert folded.visible(T, np.array([[0.5, 0.0, 1.0]])).all()


def test_the_widest_ray_is_that_of_the_image_s_corner():
    assert widest_ray(CAMERA) == pytest.approx(math.atan(800.0 / 1024.0))


def test_a_camera_of_which_nothing_is_known_is_assumed():
    camera = with_intrinsics(Camera(width=1000, height=800))
    assert camera.values[:4] == pytest.approx([800.0, 800.0, 499.5, 399.5])
    assert not camera.values[4:].any()
    assert with_intrinsics(camera) is camera


def test_the_chain_leads_from_the_camera_to_the_board():
    robot, seen = in_hand("ur5")
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (3, 6))
    expected = seen.T_frame_base @ robot.poses(q) @ seen.T_tip_board
    np.testing.assert_allclose(seen.board_poses(robot, q), expected)


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"nearest": 0.5, "farthest": 0.5}, "500 to 500 mm"),
        ({"nearest": 0.0}, "from 0 to"),
        ({"tilt": math.pi / 2}, "90 deg"),
        ({"tilt": 0.0}, "0 deg"),
        ({"share": 0.0}, "0 of the corners"),
        ({"share": 1.1}, "1.1 of the corners"),
    ],
)
def test_limits_that_no_board_can_keep_are_refused(limits, words):
    with pytest.raises(CalibError, match=words):
        sight(**limits)


def test_a_chessboard_is_wholly_in_the_image():
    board = Board(pattern="chessboard", columns=9, rows=6, square=0.03)
    with pytest.raises(CalibError, match="chessboard"):
        CameraSight(CAMERA, board, np.eye(4), np.eye(4), SightLimits(0.3, 1.0, share=0.5))
