"""Virtual cells of a truth that is at hand, and robots with a camera and a board."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from calib.boards.board import CHARUCO, Board
from calib.camera.camera import Camera
from calib.data.cell import Cell, Tracker
from calib.verbs.simulate.scenario import Scenario, VirtualCell
from calib.verbs.simulate.truth import Truth

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


def virtual(truth: Truth, kind: str = "point", tracker: Any = None, **more: Any) -> VirtualCell:
    """A cell that measures a truth; its tracker stands at the origin of each measurement frame, or at a place."""
    there = None if tracker is None else Tracker(tracker)
    cell = Cell(kind=kind, estimate_frame=True, tracker=there)
    return VirtualCell(Scenario(truth.nominal, cell=cell, **more), truth)


def changed(cell: VirtualCell, **more: Any) -> VirtualCell:
    """The same truth, measured otherwise."""
    return replace(cell, scenario=replace(cell.scenario, **more))
