"""Pictures by file, folder and pattern, with names that tell them apart, and their cameras."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.boards.detection.image_files import ImageFile, find_images, read_image
from calib.errors import FileError


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


def test_grey_values_as_the_file_has_them(tmp_path: Path):
    picture = np.arange(60, dtype=np.uint8).reshape(6, 10)
    path = tmp_path / "ä picture.png"
    path.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    np.testing.assert_array_equal(read_image(ImageFile(path, path.name)), picture)
    deep = tmp_path / "deep.png"
    deep.write_bytes(cv2.imencode(".png", picture.astype(np.uint16) * 257)[1].tobytes())
    np.testing.assert_array_equal(read_image(ImageFile(deep, deep.name)), picture)


def test_no_picture_is_none(tmp_path: Path):
    for content in (b"", b"a text"):
        path = tmp_path / "x.png"
        path.write_bytes(content)
        assert read_image(ImageFile(path, path.name)) is None
    with pytest.raises(FileError, match="does not exist"):
        read_image(ImageFile(tmp_path / "gone.png", "gone.png"))
