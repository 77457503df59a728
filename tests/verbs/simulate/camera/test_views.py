"""Views: joint values within the limits at which the whole board is seen, near, far and tilted."""

from __future__ import annotations

import numpy as np
import pytest

from calib.boards.printed import Print
from calib.errors import CalibError
from calib.robot.ranges import column_limits
from calib.robot.robot import Robot
from calib.verbs.simulate.camera.placing import draw_scene
from calib.verbs.simulate.camera.scene import CameraScene, Framing, is_framed, view
from calib.verbs.simulate.camera.views import draw_views
from tests.boards.boards import facing
from tests.verbs.simulate.camera.cells import ARMS, BOARD, CAMERA


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
    assert is_framed(scene, scene.board_poses(q)).all()
    _, tilt, fill = view(scene, scene.board_poses(q))
    assert np.ptp(np.rad2deg(tilt)) > 20.0
    assert np.ptp(fill) > 0.08
    # Joints move: pictures from one place would tell nothing of the arm.
    assert np.median(np.rad2deg(q.std(axis=0))) > 20.0


@pytest.mark.slow
def test_the_same_seed_draws_the_same_views():
    robot = Robot.load("ur5", base="tool0", tip="base_link")
    first, again = (draw_scene(robot, CAMERA, Print(BOARD), seed=1) for _ in range(2))
    np.testing.assert_array_equal(first.T_tip_board, again.T_tip_board)
    np.testing.assert_array_equal(first.T_camera_base, again.T_camera_base)
    counts = []
    q = draw_views(first, 5, seed=2, progress=lambda done, of: counts.append((done, of)))
    np.testing.assert_array_equal(q, draw_views(again, 5, seed=2))
    assert counts[-1] == (5, 5)


def test_says_that_a_board_is_seen_from_nowhere(monkeypatch):
    monkeypatch.setattr("calib.verbs.simulate.camera.views._BATCHES", 1)
    robot = Robot.load("ur5", base="tool0", tip="base_link")
    far_away = facing(BOARD, 50.0)
    scene = CameraScene(robot, CAMERA, Print(BOARD), np.eye(4), far_away)
    with pytest.raises(CalibError, match="0 of 128"):
        draw_views(scene, 3, seed=0, framing=Framing())
