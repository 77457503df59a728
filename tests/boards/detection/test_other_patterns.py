"""What pictures show in place of a board; `test_detect` has the whole way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.boards.board import Board
from calib.boards.detection.image_files import ImageFile
from calib.boards.detection.other_patterns import other_pattern
from calib.boards.detection.picture import Picture
from tests.boards.board_views import CHARUCO_BOARD, CHESS_BOARD, View, render
from tests.verbs.detect.test_corner_table import picture, view


def nothing(folder: Path, printed: Board | None) -> Picture:
    """A picture, of another board or of none, in which the board was not seen."""
    empty = np.full((480, 640), 90, np.uint8)
    image = empty if printed is None else render(printed, View(tilt=(10, 5, 20)))
    path = folder / "a.png"
    path.write_bytes(cv2.imencode(".png", image)[1].tobytes())
    return replace(picture("a.png", view(reason="no_board")), file=ImageFile(path, "a.png"))


@pytest.mark.slow
def test_the_smallest_dictionary_that_has_the_markers(tmp_path: Path):
    described = replace(CHARUCO_BOARD, dictionary="DICT_APRILTAG_36h11")
    (finding,) = other_pattern(described, [nothing(tmp_path, CHARUCO_BOARD)])
    assert (finding.code, finding.dictionary) == ("dictionary", "DICT_5X5_50")


@pytest.mark.parametrize("described", [CHARUCO_BOARD, CHESS_BOARD], ids=lambda b: b.pattern)
def test_nothing_is_seen(tmp_path: Path, described: Board):
    assert other_pattern(described, [nothing(tmp_path, None)]) == []


def test_most_pictures_show_the_board(tmp_path: Path):
    seen = [picture(f"{k}.png", view()) for k in range(2)]
    assert other_pattern(CHESS_BOARD, [nothing(tmp_path, CHARUCO_BOARD), *seen]) == []


def test_a_chessboard_turned_by_a_quarter_is_no_other(tmp_path: Path):
    turned = replace(CHESS_BOARD, columns=5, rows=8)
    assert other_pattern(turned, [nothing(tmp_path, CHESS_BOARD)]) == []
    wider = replace(CHESS_BOARD, columns=9)
    (finding,) = other_pattern(wider, [nothing(tmp_path, CHESS_BOARD)])
    assert finding.better is not None
    assert (finding.better.columns, finding.better.rows) == (8, 5)
