"""Pictures with made-up corners, as detection gives them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.boards.board import Board
from calib.boards.detection.board_search import BoardView
from calib.boards.detection.detect import Detection
from calib.boards.detection.picture import ImageFile, Picture
from tests.boards.board_views import CHARUCO_BOARD


def picture(name: str, *views: BoardView, camera: str = "") -> Picture:
    return Picture(file=ImageFile(Path(name), name, camera), size=(640, 480), views=views)


def view(board: str = "board", reason: str = "") -> BoardView:
    return BoardView(
        board=board,
        ids=np.array([3, 7]),
        pixels=np.array([[10.25, 20.5], [300.123456, -0.25]]),
        sigma=np.array([0.02, 0.3]),
        reason=reason,
    )


def detection(*pictures: Picture, boards: Sequence[Board] = (CHARUCO_BOARD,)) -> Detection:
    return Detection(tuple(boards), pictures, (), 12)
