"""Rules of the findings that whole runs do not reach."""

from __future__ import annotations

from dataclasses import replace

from calib.vision.detection.findings import (
    Finding,
    is_wrong_description,
    picture_findings,
    usual_sizes,
)
from calib.vision.detection.picture import Picture
from tests.vision.board_views import CHARUCO_BOARD
from tests.vision.detection.test_corner_table import picture, view

SIX = [picture(f"{k}.png", view()) for k in range(6)]


def test_the_usual_size_is_a_camera_s_own():
    sizes = [
        ("l", (640, 480)),
        ("l", (640, 480)),
        ("l", (320, 240)),
        ("r", (320, 240)),
        ("r", (0, 0)),
    ]
    pictures = [
        replace(picture(f"{k}.png", view(), camera=camera), size=size)
        for k, (camera, size) in enumerate(sizes)
    ]
    assert usual_sizes(pictures) == {"l": (640, 480), "r": (320, 240)}


def test_the_same_picture_of_two_cameras_is_no_finding():
    def same(camera: str) -> Picture:
        return replace(picture(f"{camera}.png", view(), camera=camera), sha256="x")

    assert not list(picture_findings([same("l"), same("r")]))
    assert [f.code for f in picture_findings([same("l"), same("l")])] == ["same_picture"]


def test_a_description_is_wrong_if_no_fewer_pictures_say_so():
    def wrong(code: str, *numbers: int, board: str = "board") -> bool:
        names = tuple(f"{k}.png" for k in numbers)
        finding = Finding(code=code, board=board, pictures=names)
        return is_wrong_description(finding, SIX, CHARUCO_BOARD)

    assert wrong("legacy", 0, 1, 2)
    assert not wrong("legacy", 0, 1)
    assert not wrong("legacy", 0, 1, 2, board="another")
    assert not wrong("two_boards", 0, 1, 2)
    # Where the corners are does not hang on the size of the markers.
    assert not wrong("ratio", 0, 1, 2, 3, 4, 5)
    assert not wrong("unseen_row")
