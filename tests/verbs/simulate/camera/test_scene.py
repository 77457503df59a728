"""What a camera sees at joint values: the chain of poses, and how a picture frames the board."""

from __future__ import annotations

import numpy as np
import pytest

from calib.basics.arrays import rigid_inverse
from calib.boards.printed import Print
from calib.robot.robot import Robot
from calib.verbs.simulate.camera.scene import CameraScene, Framing, is_framed, view
from tests.boards.boards import facing
from tests.verbs.simulate.camera.cells import BOARD, CAMERA


@pytest.fixture(scope="module")
def scene():
    robot = Robot.load("ur5", base="tool0", tip="base_link")
    T_camera_base = facing(BOARD, 0.1, 20.0)
    T_tip_board = facing(BOARD, 0.7, -30.0)
    return CameraScene(robot, CAMERA, Print(BOARD), T_camera_base, T_tip_board)


def test_board_poses_go_from_the_camera_through_the_robot(scene):
    q = np.array([[0.3, -1.2, 1.5, -0.4, 0.9, 2.0]])
    arm = Robot.load("ur5", base="base_link", tip="tool0")
    # The columns of q are in the order of the chain, from the flange to the foot.
    T_world_camera = arm.poses(q[:, ::-1])[0] @ rigid_inverse(scene.T_camera_base)
    expected = rigid_inverse(T_world_camera) @ scene.T_tip_board
    np.testing.assert_allclose(scene.board_poses(q)[0], expected, atol=1e-12)


def test_a_view_has_tilt_and_fill(scene):
    seen, tilt, fill = view(scene, np.stack([facing(BOARD, 0.5, 30.0, roll=0.0, towards=0.0)]))
    assert seen.tolist() == [24]
    assert np.rad2deg(tilt[0]) == pytest.approx(30.0, abs=1e-9)
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
