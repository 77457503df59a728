"""One picture as it is taken: its corners, or why it cannot be used."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.boards.board import Board
from calib.boards.render import write_png
from calib.errors import MeasurementError
from calib.verbs.detect.one_picture import find_corners

BOARD = Board(pattern="chessboard", columns=6, rows=5, square=0.03)


def test_the_corners_of_a_picture(tmp_path: Path):
    # Squares of 60 px, on white.
    dark = np.indices((5, 6)).sum(axis=0) % 2 == 0
    image = np.full((480, 640), 255, np.uint8)
    image[90:390, 140:500] = np.kron(np.where(dark, 0, 255), np.ones((60, 60), np.uint8))
    write_png(image, tmp_path / "a.png")
    picture = find_corners(tmp_path / "a.png", [BOARD])
    (view,) = picture.used
    assert len(view.ids) == 20
    assert picture.size == (640, 480)
    assert view.pixels.mean(axis=0) == pytest.approx([319.5, 239.5], abs=0.2)


def test_a_picture_without_a_board_is_refused_with_its_reason(tmp_path: Path):
    write_png(np.full((480, 640), 128, np.uint8), tmp_path / "wall.png")
    with pytest.raises(MeasurementError, match=r"'wall\.png' cannot be used: hardly any contrast"):
        find_corners(tmp_path / "wall.png", [BOARD])
    with pytest.raises(MeasurementError, match="not a picture"):
        find_corners(tmp_path / "none.png", [BOARD])
