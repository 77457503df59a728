"""One picture: read, searched thoroughly where that helps, made small."""

from __future__ import annotations

import pickle
from pathlib import Path

import cv2
import numpy as np

from calib.boards.detection.image_files import ImageFile
from calib.boards.detection.picture import Search, look
from tests.boards.board_views import CHARUCO_BOARD, TAG_BOARD, View, render

SEARCH = Search((CHARUCO_BOARD,), 12)


def file_of(folder: Path, image: np.ndarray, name: str = "a.png") -> ImageFile:
    path = folder / name
    path.write_bytes(cv2.imencode(".png", image)[1].tobytes())
    return ImageFile(path, name)


def test_corners_and_a_small_copy(tmp_path: Path):
    view = View(tilt=(10, 5, 20), size=(800, 600))
    picture = look(SEARCH, file_of(tmp_path, render(CHARUCO_BOARD, view)))
    assert picture.size == (800, 600)
    assert [len(used.ids) for used in picture.used] == [24]
    small = cv2.imdecode(np.frombuffer(picture.small, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert small.shape == (360, 480)
    again = pickle.loads(pickle.dumps(picture))
    np.testing.assert_array_equal(again.used[0].pixels, picture.used[0].pixels)
    assert (
        again.markers["DICT_5X5_100"].ids.tolist() == picture.markers["DICT_5X5_100"].ids.tolist()
    )


def test_a_thorough_search_where_the_quick_one_is_not_enough(tmp_path: Path):
    view = View(tilt=(40, 60, 0), middle=(0, 0, 0.45), blur=1.2, noise=5)
    picture = look(SEARCH, file_of(tmp_path, render(CHARUCO_BOARD, view)))
    # The quick search reads two markers here.
    assert len(picture.markers["DICT_5X5_100"].ids) >= 4
    assert picture.used


def test_a_file_that_is_none(tmp_path: Path):
    path = tmp_path / "a.png"
    path.write_bytes(b"text")
    assert look(SEARCH, ImageFile(path, "a.png")).reason == "unreadable"
    assert look(SEARCH, ImageFile(tmp_path / "gone.png", "gone.png")).reason == "unreadable"


def test_of_two_boards_the_one_that_is_there(tmp_path: Path):
    search = Search((TAG_BOARD, CHARUCO_BOARD), 12)
    picture = look(search, file_of(tmp_path, render(CHARUCO_BOARD, View())))
    assert [view.reason for view in picture.views] == ["no_board", ""]
    assert [view.board for view in picture.used] == [CHARUCO_BOARD.name]


def test_the_reason_where_there_is_no_board(tmp_path: Path):
    image = render(CHARUCO_BOARD, View(mirrored=True))
    assert [view.reason for view in look(SEARCH, file_of(tmp_path, image)).views] == ["mirrored"]
