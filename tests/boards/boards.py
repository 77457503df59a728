"""Boards, cameras and poses that tests of pictures share."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from calib.boards.board import APRILTAG, CHARUCO, CHESSBOARD, Board
from calib.camera.camera import Camera

CHARUCO_BOARD = Board(
    pattern=CHARUCO, columns=7, rows=5, square=0.04, marker=0.03, dictionary="DICT_5X5_100"
)
OLD_BOARD = Board(
    pattern=CHARUCO,
    columns=5,
    rows=6,
    square=0.04,
    marker=0.03,
    dictionary="DICT_5X5_100",
    legacy=True,
)
CHESS_BOARD = Board(pattern=CHESSBOARD, columns=8, rows=6, square=0.03)
TAG_BOARD = Board(
    pattern=APRILTAG,
    columns=4,
    rows=3,
    square=0.06,
    marker=0.045,
    dictionary="DICT_APRILTAG_36h11",
    first_marker=10,
)

PINHOLE = Camera(
    width=1280,
    height=720,
    values=np.array([920.0, 915.0, 643.3, 355.2, -0.2, 0.08, 1e-3, -5e-4, -0.01]),
)
FISHEYE = Camera(
    width=1280,
    height=720,
    lens="fisheye",
    values=np.array([500.0, 501.0, 643.3, 355.2, -0.02, 0.005, -0.002, 1e-4]),
)


def facing(board, distance, tilt=0.0, towards=0.3, roll=0.2, middle=(0.0, 0.0)):
    """The pose of a board whose middle is before the camera, tilted by degrees towards a side [rad]."""
    axis = np.deg2rad(tilt) * np.array([np.cos(towards), np.sin(towards), 0.0])
    T = np.eye(4)
    T[:3, :3] = (Rotation.from_rotvec(axis) * Rotation.from_euler("z", roll)).as_matrix()
    T[:3, 3] = np.array([*middle, distance]) - T[:3, :3] @ board.centre
    return T
