"""Views: how a picture frames the board, and joint values at which the whole board is seen, near, far and tilted."""

from __future__ import annotations

import numpy as np
import pytest

from calib.boards.printed import Print
from calib.boards.project import corner_pixels
from calib.errors import CalibError
from calib.instruments.camera import board_tilts
from calib.instruments.instrument import Sightline
from calib.robot.ranges import column_limits
from calib.robot.robot import Robot
from calib.verbs.simulate.mounting import draw_scene
from calib.verbs.simulate.views import (
    CameraScene,
    Framing,
    draw_views,
    filled_shares,
    is_framed,
)
from tests.boards.boards import facing
from tests.verbs.simulate.cells import ARMS, BOARD, CAMERA


@pytest.fixture(scope="module")
def scene():
    robot = Robot.load("ur5", base="tool0", tip="base_link")
    T_camera_base = facing(BOARD, 0.1, 20.0)
    T_tip_board = facing(BOARD, 0.7, -30.0)
    return CameraScene(Sightline(robot, T_camera_base, T_tip_board), CAMERA, Print(BOARD))


def test_a_view_has_tilt_and_fill(scene):
    T = facing(BOARD, 0.5, 30.0, roll=0.0, towards=0.0)[None]
    pixels, is_seen = corner_pixels(CAMERA, scene.printed.corners, T)
    assert is_seen.sum() == 24
    fill = filled_shares(CAMERA, pixels)
    assert np.rad2deg(board_tilts(BOARD, T)[0]) == pytest.approx(30.0, abs=1e-9)
    # Six squares along x, half of them nearer than the middle, half farther.
    assert fill[0] == pytest.approx(0.2 * 920.0 / 0.5 / 1280.0, rel=0.12)


@pytest.mark.parametrize(
    ("distance", "tilt", "middle", "expected"),
    [
        (0.5, 0.0, (0.0, 0.0), True),
        (0.5, 49.0, (0.0, 0.0), True),
        (0.5, 51.0, (0.0, 0.0), False),
        (0.5, 180.0, (0.0, 0.0), False),
        (1.3, 0.0, (0.0, 0.0), False),
        (0.2, 0.0, (0.0, 0.0), False),
        (0.5, 0.0, (0.3, 0.0), False),
        (-0.5, 0.0, (0.0, 0.0), False),
    ],
)
def test_pictures_frame_the_whole_board_neither_steep_nor_small(
    scene, distance, tilt, middle, expected
):
    T = facing(BOARD, distance, tilt, middle=middle)[None]
    assert is_framed(scene, T, Framing(fill=(0.18, 0.8))).tolist() == [expected]


@pytest.mark.parametrize("on_flange", ["camera", "board"])
@pytest.mark.parametrize("name", ARMS)
def test_arms_find_forty_views(name, on_flange):
    flange, foot, board = ARMS[name]
    base, tip = (flange, foot) if on_flange == "camera" else (foot, flange)
    robot = Robot.load(name, base=base, tip=tip)
    scene = draw_scene(robot, CAMERA, Print(board), seed=3)
    q = draw_views(scene, 40, seed=4)
    low, high = column_limits(robot).T
    assert q.shape == (40, len(robot.joint_names))
    assert ((q > low) & (q < high)).all()
    T = scene.sightline.target_poses(q)
    assert is_framed(scene, T).all()
    fill = filled_shares(CAMERA, corner_pixels(CAMERA, scene.printed.corners, T)[0])
    assert np.ptp(np.rad2deg(board_tilts(board, T))) > 20.0
    assert np.ptp(fill) > 0.08
    # Joints move: pictures from one place would tell nothing of the arm.
    assert np.median(np.rad2deg(q.std(axis=0))) > 20.0


@pytest.mark.slow
def test_the_same_seed_draws_the_same_views():
    robot = Robot.load("ur5", base="tool0", tip="base_link")
    first, again = (draw_scene(robot, CAMERA, Print(BOARD), seed=1) for _ in range(2))
    np.testing.assert_array_equal(first.sightline.T_tip_target, again.sightline.T_tip_target)
    np.testing.assert_array_equal(
        first.sightline.T_instrument_base, again.sightline.T_instrument_base
    )
    counts = []
    q = draw_views(first, 5, seed=2, progress=lambda done, of: counts.append((done, of)))
    np.testing.assert_array_equal(q, draw_views(again, 5, seed=2))
    assert counts[-1] == (5, 5)


def test_says_that_a_board_is_seen_from_nowhere(monkeypatch):
    monkeypatch.setattr("calib.verbs.simulate.views._BATCHES", 1)
    robot = Robot.load("ur5", base="tool0", tip="base_link")
    far_away = facing(BOARD, 50.0)
    scene = CameraScene(Sightline(robot, np.eye(4), far_away), CAMERA, Print(BOARD))
    with pytest.raises(CalibError, match="0 of 128"):
        draw_views(scene, 3, seed=0, framing=Framing())
