"""Rules of the findings that whole runs do not reach."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.boards.board import marker_outlines
from calib.boards.corners.markers import Markers
from calib.boards.detection.findings import (
    Finding,
    board_findings,
    is_wrong_description,
    picture_findings,
    usual_sizes,
)
from calib.boards.detection.picture import Picture
from tests.boards.board_views import CHARUCO_BOARD
from tests.verbs.detect.test_corner_table import picture, view

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


@pytest.mark.parametrize(("count", "codes"), [(5, []), (9, ["ratio"])])
def test_a_ratio_of_marker_and_square_is_told_where_it_can_be_measured(count, codes):
    """By five markers another ratio may fit better, but what it is they do not tell."""
    board = CHARUCO_BOARD
    outlines = marker_outlines(replace(board, marker=0.5 * board.square))[:count, :, :2]
    markers = Markers(np.arange(count), 40.0 + 2500.0 * outlines)
    seen = replace(
        picture("a.png", replace(view(board.name), misread=2)),
        markers={board.dictionary: markers},
    )
    found = list(board_findings(board, [seen]))
    assert [finding.code for finding in found] == codes
    assert [finding.value for finding in found] == pytest.approx([0.5] * len(codes))
