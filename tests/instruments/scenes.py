"""Robots that carry a camera or a board, and where the other one stands."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import rigid_inverse
from calib.boards.board import Board
from calib.camera.camera import Camera
from calib.data.cell import Cell
from calib.instruments.camera import CameraInstrument, SightLimits, assumed_intrinsics
from calib.instruments.instrument import Sightline
from calib.robot.robot import Robot

BOARD = Board(
    pattern="charuco",
    columns=9,
    rows=6,
    square=0.03,
    marker=0.022,
    dictionary="DICT_5X5_100",
)
SIZE = Camera(width=1280, height=960)
CAMERA = replace(SIZE, values=assumed_intrinsics(SIZE))


def pose(position, turn=(0.0, 0.0, 0.0)) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = position
    T[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    return T


def at_places(cell: Cell, T_camera_base=None, T_tip_board=None) -> Cell:
    """A cell with its camera and its board there; at their links unless placed."""
    T_tip_board = np.eye(4) if T_tip_board is None else T_tip_board
    return replace(
        cell,
        T_frame_base=np.eye(4) if T_camera_base is None else T_camera_base,
        target=T_tip_board[:3, 3],
        target_rotation=T_tip_board[:3, :3],
    )


def camera_of(camera=CAMERA, board=BOARD, **limits) -> CameraInstrument:
    """The camera, with usual limits of where the board is or others."""
    cell = Cell(cameras={"": camera}, boards={"": board})
    return CameraInstrument.of(at_places(cell), SightLimits(**limits))


#: Base, tool and the board in front of the robot, for a camera in the hand.
ARMS = {
    "panda": ("panda_link0", "panda_link8", (0.4, 0.1, 0.02)),
    "ur5": ("base_link", "tool0", (-0.5, 0.1, 0.02)),
}


@cache
def in_hand(name: str) -> Sightline:
    """The camera beside the flange, the board on the table, face up."""
    base, tool, place = ARMS[name]
    T_tool_camera = pose((0.06, 0.0, 0.05))
    robot = Robot.load(name, base=tool, tip=base)
    return Sightline(robot, rigid_inverse(T_tool_camera), pose(place, (np.pi, 0.0, 0.0)))


@cache
def standing(name: str) -> Sightline:
    """The camera stands in front of the robot and looks at it, the board is on the flange."""
    base, tool, _ = ARMS[name]
    T_base_camera = pose((1.4, 0.0, 0.5))
    # Its columns: the image's right is the robot's y, down is -z, the line of sight -x.
    T_base_camera[:3, :3] = [[0, 0, -1], [1, 0, 0], [0, -1, 0]]
    T_tool_board = pose((-0.13, 0.09, 0.15), (np.pi, 0.0, 0.0))
    robot = Robot.load(name, base=base, tip=tool)
    return Sightline(robot, rigid_inverse(T_base_camera), T_tool_board)
