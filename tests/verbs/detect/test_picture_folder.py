"""A folder of pictures stands for the table of its corners."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import pytest

from calib.camera.camera import Camera
from calib.errors import CalibError
from calib.verbs.detect.picture_folder import JOINTS, table_of
from tests.boards.board_views import CHARUCO_BOARD, View, render


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    """Two pictures of a board, both taken to validate with, and their joint values."""
    folder = tmp_path / "fresh"
    folder.mkdir()
    for name, tilt in (("a.png", (10, 5, 20)), ("b.png", (-20, 30, 100))):
        picture = cv2.imencode(".png", render(CHARUCO_BOARD, View(tilt=tilt)))[1]
        (folder / name).write_bytes(picture.tobytes())
    lines = ["image,j1 [deg],set", "b.png,20.0,validate", "a.png,10.0,validate", ""]
    (folder / JOINTS).write_text("\n".join(lines), encoding="utf-8")
    return folder


def test_all_pictures_are_judged_whatever_set_they_are_of(pictures: Path):
    with table_of(pictures, [CHARUCO_BOARD], [], quiet=True) as path:
        assert path.name == "fresh.csv"
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    assert not path.exists()
    assert "set" not in rows[0]
    assert {(row["image"], row["j1 [deg]"]) for row in rows} == {
        ("a.png", "10.0"),
        ("b.png", "20.0"),
    }
    assert len(rows) == 48


def test_pictures_of_another_size_are_refused(pictures: Path):
    height, width = render(CHARUCO_BOARD, View()).shape[:2]
    right, wrong = Camera(width=width, height=height), Camera(width=2 * width, height=2 * height)
    with table_of(pictures, [CHARUCO_BOARD], [wrong, right], quiet=True) as path:
        assert path.exists()
    with (
        pytest.raises(CalibError, match=f"{width} x {height}.*{2 * width} x {2 * height}"),
        table_of(pictures, [CHARUCO_BOARD], [wrong], quiet=True),
    ):
        pass


def test_a_table_is_taken_as_it_is(tmp_path: Path):
    with table_of(tmp_path / "data.csv", [], [], quiet=True) as path:
        assert path == tmp_path / "data.csv"


@pytest.mark.slow
def test_a_folder_needs_joint_values_a_board_and_corners(pictures: Path):
    with pytest.raises(CalibError, match="--board"), table_of(pictures, [], [], quiet=True):
        pass
    for name in ("a.png", "b.png"):
        (pictures / name).write_bytes(
            cv2.imencode(".png", 90 + render(CHARUCO_BOARD, View()) * 0)[1]
        )
    with (
        pytest.raises(CalibError, match="No corner can be used"),
        table_of(pictures, [CHARUCO_BOARD], [], quiet=True),
    ):
        pass
    (pictures / JOINTS).unlink()
    with (
        pytest.raises(CalibError, match=JOINTS),
        table_of(pictures, [CHARUCO_BOARD], [], quiet=True),
    ):
        pass
