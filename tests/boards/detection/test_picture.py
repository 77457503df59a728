"""One picture: read, searched thoroughly where that helps, made small."""

from __future__ import annotations

import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.boards.detection.picture import (
    ImageFile,
    Search,
    find_images,
    read_image,
    search_picture,
)
from calib.errors import FileError
from tests.boards.board_views import CHARUCO_BOARD, TAG_BOARD, View, render


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two folders with pictures of the same names, and a text."""
    for name in ("left/pose_10.png", "left/pose_2.PNG", "right/pose_2.png", "right/notes.txt"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.usefixtures("run")
def test_a_folder_s_pictures_by_their_numbers():
    assert [image.name for image in find_images(["left"])] == ["pose_2.PNG", "pose_10.png"]


def test_names_have_folders_where_they_need_them(run: Path):
    names = [image.name for image in find_images(["left", "right/pose_2.png", "right"])]
    assert names == ["pose_2.PNG", "pose_10.png", "pose_2.png"]
    (run / "right" / "pose_10.png").write_bytes(b"")
    names = [image.name for image in find_images(["right", run / "left/pose_10.png"])]
    assert names == ["pose_2.png", "right/pose_10.png", "left/pose_10.png"]


@pytest.mark.usefixtures("run")
def test_a_pattern_may_go_through_folders():
    assert len(find_images(["**/*.png"])) == 2
    assert len(find_images(["*/pose_?.*"])) == 2


def test_a_name_with_brackets_is_a_file_first(run: Path):
    (run / "pose[1].png").write_bytes(b"")
    assert [image.name for image in find_images(["pose[1].png"])] == ["pose[1].png"]


@pytest.mark.parametrize("word", ["nothing.png", "none_*.png", "empty"])
def test_nothing_of_a_name(run: Path, word: str):
    (run / "empty").mkdir()
    with pytest.raises(FileError, match=r"picture|No file"):
        find_images([word])


@pytest.mark.usefixtures("run")
def test_cameras_by_folder():
    images = find_images(["left", "right"], {"left": "wide", "": "tele"})
    assert [image.camera for image in images] == ["wide", "wide", "tele"]
    images = find_images(["left", "right"], {"right": "tele"})
    assert [image.camera for image in images] == ["", "", "tele"]
    with pytest.raises(FileError, match="camera 'wide'"):
        find_images(["right"], {"left": "wide"})


@pytest.mark.usefixtures("run")
def test_cameras_by_patterns_of_names():
    by_number = {"pose_1*": "wide", "left/*_2.*": "tele"}
    images = find_images(["left", "right"], by_number)
    assert [image.camera for image in images] == ["tele", "wide", ""]
    # A pattern counts before a folder.
    images = find_images(["left"], {"left": "tele", "*_10.png": "wide"})
    assert [image.camera for image in images] == ["tele", "wide"]
    with pytest.raises(FileError, match="camera 'none'"):
        find_images(["left"], {"cam*": "none"})


def test_grey_values_as_the_file_has_them(tmp_path: Path):
    picture = np.arange(60, dtype=np.uint8).reshape(6, 10)
    path = tmp_path / "ä picture.png"
    path.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    np.testing.assert_array_equal(read_image(ImageFile(path, path.name)), picture)
    deep = tmp_path / "deep.png"
    of_16_bits = picture.astype(np.uint16) * 257
    deep.write_bytes(cv2.imencode(".png", of_16_bits)[1].tobytes())
    np.testing.assert_array_equal(read_image(ImageFile(deep, deep.name)), of_16_bits)


def test_no_picture_is_none(tmp_path: Path):
    for content in (b"", b"a text"):
        path = tmp_path / "x.png"
        path.write_bytes(content)
        assert read_image(ImageFile(path, path.name)) is None
    with pytest.raises(FileError, match="does not exist"):
        read_image(ImageFile(tmp_path / "gone.png", "gone.png"))


SEARCH = Search((CHARUCO_BOARD,), 12)


def file_of(folder: Path, image: np.ndarray, name: str = "a.png") -> ImageFile:
    path = folder / name
    path.write_bytes(cv2.imencode(".png", image)[1].tobytes())
    return ImageFile(path, name)


def test_corners_and_a_small_copy(tmp_path: Path):
    view = View(tilt=(10, 5, 20), size=(800, 600))
    picture = search_picture(SEARCH, file_of(tmp_path, render(CHARUCO_BOARD, view)))
    assert picture.size == (800, 600)
    assert [len(used.ids) for used in picture.used] == [24]
    small = cv2.imdecode(np.frombuffer(picture.small, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert small.shape == (360, 480)
    again = pickle.loads(pickle.dumps(picture))
    np.testing.assert_array_equal(again.used[0].pixels, picture.used[0].pixels)
    assert (
        again.markers["DICT_5X5_100/1"].ids.tolist()
        == picture.markers["DICT_5X5_100/1"].ids.tolist()
    )


def test_a_thorough_search_where_the_quick_one_is_not_enough(tmp_path: Path):
    view = View(tilt=(40, 60, 0), middle=(0, 0, 0.45), blur=1.2, noise=5)
    picture = search_picture(SEARCH, file_of(tmp_path, render(CHARUCO_BOARD, view)))
    # The quick search reads two markers here.
    assert len(picture.markers["DICT_5X5_100/1"].ids) >= 4
    assert picture.used


def test_a_file_that_is_none(tmp_path: Path):
    path = tmp_path / "a.png"
    path.write_bytes(b"text")
    assert search_picture(SEARCH, ImageFile(path, "a.png")).reason == "unreadable"
    assert (
        search_picture(SEARCH, ImageFile(tmp_path / "gone.png", "gone.png")).reason == "unreadable"
    )


def test_of_two_boards_the_one_that_is_there(tmp_path: Path):
    search = Search((TAG_BOARD, CHARUCO_BOARD), 12)
    picture = search_picture(search, file_of(tmp_path, render(CHARUCO_BOARD, View())))
    assert [view.reason for view in picture.views] == ["no_board", ""]
    assert [view.board for view in picture.used] == [CHARUCO_BOARD.name]


def test_the_reason_where_there_is_no_board(tmp_path: Path):
    image = render(CHARUCO_BOARD, View(mirrored=True))
    assert [view.reason for view in search_picture(SEARCH, file_of(tmp_path, image)).views] == [
        "mirrored"
    ]
