"""Robots that carry a camera or a board, and where the other one stands."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import rigid_inverse
from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.robot.robot import Robot
from calib.verbs.plan.images.sight import CameraSight, SightLimits, with_intrinsics

BOARD = Board(
    pattern="charuco",
    columns=9,
    rows=6,
    square=0.03,
    marker=0.022,
    dictionary="DICT_5X5_100",
)
CAMERA = with_intrinsics(Camera(width=1280, height=960))


def pose(position, turn=(0.0, 0.0, 0.0)) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = position
    T[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    return T


def sight(T_frame_base=None, T_tip_board=None, camera=CAMERA, **limits) -> CameraSight:
    """A camera and the board, both at their links unless placed, with the usual limits or others."""
    usual = SightLimits.of(camera, BOARD)
    chosen = {
        "nearest": usual.nearest,
        "farthest": usual.farthest,
        "margin": usual.margin,
        **limits,
    }
    return CameraSight(
        camera,
        BOARD,
        np.eye(4) if T_frame_base is None else T_frame_base,
        np.eye(4) if T_tip_board is None else T_tip_board,
        SightLimits(**chosen),
    )


#: Base, tool and the board in front of the robot, for a camera in the hand.
ARMS = {
    "panda": ("panda_link0", "panda_link8", (0.4, 0.1, 0.02)),
    "ur5": ("base_link", "tool0", (-0.5, 0.1, 0.02)),
}


@cache
def in_hand(name: str) -> tuple[Robot, CameraSight]:
    """The camera beside the flange, the board on the table, face up."""
    base, tool, place = ARMS[name]
    T_tool_camera = pose((0.06, 0.0, 0.05))
    robot = Robot.load(name, base=tool, tip=base)
    return robot, sight(rigid_inverse(T_tool_camera), pose(place, (np.pi, 0.0, 0.0)))


@cache
def standing(name: str) -> tuple[Robot, CameraSight]:
    """The camera stands in front of the robot and looks at it, the board is on the flange."""
    base, tool, _ = ARMS[name]
    T_base_camera = pose((1.4, 0.0, 0.5))
    # Its columns: the image's right is the robot's y, down is -z, the line of sight -x.
    T_base_camera[:3, :3] = [[0, 0, -1], [1, 0, 0], [0, -1, 0]]
    T_tool_board = pose((-0.13, 0.09, 0.15), (np.pi, 0.0, 0.0))
    return Robot.load(name, base=base, tip=tool), sight(rigid_inverse(T_base_camera), T_tool_board)
