"""Rules of the findings that whole runs do not reach."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.boards.board import Board, marker_outlines
from calib.boards.corners.markers import Markers
from calib.boards.detection.board_findings import (
    Finding,
    board_findings,
    explanation,
    is_wrong_description,
    measured_ratio,
    other_pattern,
    picture_findings,
    usual_sizes,
)
from calib.boards.detection.picture import ImageFile, Picture
from tests.boards.board_views import CHARUCO_BOARD, CHESS_BOARD, TAG_BOARD, View, render
from tests.boards.corners.test_markers import markers
from tests.boards.detections import picture, view

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
        markers={board.marker_kind: markers},
    )
    found = list(board_findings(board, [seen]))
    assert [finding.code for finding in found] == codes
    assert [finding.value for finding in found] == pytest.approx([0.5] * len(codes))


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


SIZE = (640, 480)
VIEWS = (View(tilt=(10, 40, 20)), View(tilt=(-20, 10, 90), distortion=(-0.2, 0.05)))

#: Six rows, in the older layout.
LEGACY_BOARD = replace(CHARUCO_BOARD, rows=6, legacy=True)


def seen(board: Board) -> Sequence[tuple[Markers, tuple[int, int]]]:
    pairs = []
    for shot in VIEWS:
        found = markers(board, shot)
        pairs.append((Markers(found.ids + board.first_marker, found.corners), SIZE))
    return pairs


@pytest.mark.parametrize(
    ("code", "described", "printed"),
    [
        ("swapped", replace(CHARUCO_BOARD, columns=5, rows=7), CHARUCO_BOARD),
        ("legacy", replace(LEGACY_BOARD, legacy=False), LEGACY_BOARD),
        ("legacy", LEGACY_BOARD, replace(LEGACY_BOARD, legacy=False)),
        ("swapped", replace(CHARUCO_BOARD, columns=6, rows=7), LEGACY_BOARD),
        # All markers but two of a row fit, shifted by a square.
        (
            "legacy",
            replace(LEGACY_BOARD, legacy=False, columns=11),
            replace(LEGACY_BOARD, columns=11),
        ),
        ("size", replace(CHARUCO_BOARD, columns=9), CHARUCO_BOARD),
        ("size", replace(CHARUCO_BOARD, columns=6, rows=8), CHARUCO_BOARD),
        ("first_marker", CHARUCO_BOARD, replace(CHARUCO_BOARD, first_marker=40)),
        ("swapped", replace(TAG_BOARD, columns=3, rows=4), TAG_BOARD),
        ("size", replace(TAG_BOARD, columns=6, rows=3), TAG_BOARD),
    ],
)
def test_a_mistake_by_name(code: str, described: Board, printed: Board):
    mistake = explanation(described, seen(printed))
    assert mistake is not None
    found, right = mistake
    assert found == code
    assert (right.columns, right.rows) == (printed.columns, printed.rows)
    assert (right.legacy, right.first_marker) == (printed.legacy, printed.first_marker)


@pytest.mark.slow
def test_no_mistake_explains_markers_in_disorder():
    mixed = []
    for found, size in seen(CHARUCO_BOARD):
        order = np.random.default_rng(3).permutation(len(found.ids))
        mixed.append((Markers(found.ids[order], found.corners), size))
    assert explanation(CHARUCO_BOARD, mixed) is None
    assert explanation(CHARUCO_BOARD, []) is None


@pytest.mark.parametrize("ratio", [0.65, 0.7333, 0.8])
def test_the_ratio_of_marker_and_square(ratio: float):
    printed = replace(CHARUCO_BOARD, marker=ratio * CHARUCO_BOARD.square)
    assert measured_ratio(CHARUCO_BOARD, seen(printed)) == pytest.approx(ratio, abs=0.005)


def test_markers_of_another_size_altogether():
    printed = replace(CHARUCO_BOARD, marker=0.5 * CHARUCO_BOARD.square)
    described = replace(CHARUCO_BOARD, marker=0.9 * CHARUCO_BOARD.square)
    mistake = explanation(described, seen(printed))
    assert mistake is not None
    code, right = mistake
    assert code == "ratio"
    assert measured_ratio(right, seen(printed)) == pytest.approx(0.5, abs=0.005)


def test_too_few_markers_tell_nothing():
    few = [(pair.of_ids(np.arange(3)), size) for pair, size in seen(CHARUCO_BOARD)]
    assert np.isnan(measured_ratio(CHARUCO_BOARD, few))
    assert explanation(replace(CHARUCO_BOARD, columns=5, rows=7), few) is None
