"""Robots with a camera and a board, as tests of simulated cameras take them."""

from __future__ import annotations

import numpy as np

from calib.boards.board import CHARUCO, Board
from calib.camera.camera import Camera

CAMERA = Camera(
    width=1280,
    height=720,
    values=np.array([920.0, 915.0, 643.3, 355.2, -0.1, 0.05, 1e-3, -5e-4, 0.0]),
)
BOARD = Board(
    pattern=CHARUCO, columns=7, rows=5, square=0.04, marker=0.03, dictionary="DICT_5X5_100"
)
SMALL_BOARD = Board(
    pattern=CHARUCO, columns=7, rows=5, square=0.02, marker=0.015, dictionary="DICT_5X5_100"
)

#: Robot, flange, link that does not move, board.
ARMS = {
    "panda": ("panda_link8", "panda_link0", BOARD),
    "ur5": ("tool0", "base_link", BOARD),
    "so101": ("gripper_frame_link", "base_link", SMALL_BOARD),
}
