"""All pictures of a run: corners, reasons, findings; a wrong description takes all corners of its board out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.boards.board import Board
from calib.boards.detection.board_findings import Finding
from calib.boards.detection.detect import Detection, check_boards, detect
from calib.boards.detection.picture import find_images
from calib.errors import CalibError
from tests.boards.board_views import CHARUCO_BOARD, CHESS_BOARD, TAG_BOARD, View, render

VIEWS = {
    "1.png": View(tilt=(10, 5, 20)),
    "2.png": View(tilt=(-20, 30, 100)),
    "3.png": View(tilt=(30, -10, 200)),
}

Detect = Callable[..., Detection]


def findings(detection: Detection) -> Mapping[str, Finding]:
    return {finding.code: finding for finding in detection.findings}


@pytest.fixture
def detected(tmp_path: Path) -> Detect:
    """A function of the board as described and as printed, and of further pictures by name."""

    def run(described: Board, printed: Board, **further: np.ndarray | bytes) -> Detection:
        for name, view in VIEWS.items():
            picture = cv2.imencode(".png", render(printed, view))[1]
            (tmp_path / name).write_bytes(picture.tobytes())
        for name, image in further.items():
            data = image if isinstance(image, bytes) else cv2.imencode(".png", image)[1].tobytes()
            (tmp_path / f"{name}.png").write_bytes(data)
        return detect(find_images([tmp_path]), [described])

    return run


def test_every_picture_has_corners_or_a_reason(detected: Detect):
    small = cv2.resize(render(CHARUCO_BOARD, VIEWS["1.png"]), (320, 240))
    empty = np.full((480, 640), 90, np.uint8)
    copy = render(CHARUCO_BOARD, VIEWS["2.png"])
    further = {"copy": copy, "empty": empty, "small": small, "text": b"no picture"}
    detection = detected(CHARUCO_BOARD, CHARUCO_BOARD, **further)
    reasons = {
        picture.file.name: picture.reason or "/".join(view.reason for view in picture.views)
        for picture in detection.pictures
    }
    assert reasons == {
        "1.png": "",
        "2.png": "",
        "3.png": "",
        "copy.png": "",
        "empty.png": "flat",
        "small.png": "other_size",
        "text.png": "unreadable",
    }
    assert detection.corner_count == 4 * 24
    assert [picture.file.name for picture in detection.used] == [
        "1.png",
        "2.png",
        "3.png",
        "copy.png",
    ]
    assert {code: finding.pictures for code, finding in findings(detection).items()} == {
        "other_size": ("small.png",),
        "same_picture": ("2.png", "copy.png"),
    }


@pytest.mark.slow
def test_a_chessboard_of_another_size(detected: Detect):
    detection = detected(replace(CHESS_BOARD, columns=6), CHESS_BOARD)
    better = findings(detection)["size"].better
    assert better is not None
    assert (better.columns, better.rows) == (8, 5)
    assert detection.corner_count == 0


def test_pictures_by_their_folder(tmp_path: Path):
    (tmp_path / "a.png").write_bytes(b"")
    assert [picture.file.name for picture in detect([tmp_path], [CHARUCO_BOARD]).pictures] == [
        "a.png"
    ]


def test_progress_is_told(tmp_path: Path):
    (tmp_path / "a.png").write_bytes(b"")
    steps = []
    files = find_images([tmp_path])
    detect(files, [CHARUCO_BOARD], progress=lambda done, total: steps.append((done, total)))
    assert steps == [(1, 1)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "described"),
    [
        ("swapped", replace(CHARUCO_BOARD, columns=5, rows=7)),
        ("size", replace(CHARUCO_BOARD, columns=9)),
        ("dictionary", replace(CHARUCO_BOARD, dictionary="DICT_6X6_100")),
        ("first_marker", replace(CHARUCO_BOARD, first_marker=1)),
    ],
)
def test_a_wrong_description_leaves_no_corner(detected: Detect, code: str, described: Board):
    detection = detected(described, CHARUCO_BOARD)
    assert detection.corner_count == 0
    finding = findings(detection)[code]
    assert finding.pictures == tuple(VIEWS)
    if code == "dictionary":
        assert finding.dictionary == "DICT_5X5_50"
    else:
        assert finding.better is not None
        assert (finding.better.columns, finding.better.rows) == (7, 5)


@pytest.mark.slow
def test_the_other_layout(detected: Detect):
    printed = replace(CHARUCO_BOARD, columns=9, rows=6, legacy=True)
    detection = detected(replace(printed, legacy=False), printed)
    assert detection.corner_count == 0
    # Of a picture that shows a part of it, the markers fit both layouts.
    assert len(findings(detection)["legacy"].pictures) == 2
    assert detected(printed, printed).findings == ()


def test_markers_of_another_size_are_said_and_corners_kept(detected: Detect):
    printed = replace(CHARUCO_BOARD, marker=0.02)
    detection = detected(CHARUCO_BOARD, printed)
    assert findings(detection)["ratio"].value == pytest.approx(20 / 30, abs=0.03)
    assert detection.corner_count == 3 * 24


@pytest.mark.slow
def test_more_rows_and_fewer(detected: Detect):
    fewer = replace(CHARUCO_BOARD, rows=4)
    assert set(findings(detected(fewer, CHARUCO_BOARD))) == {"more_markers"}
    more = replace(CHARUCO_BOARD, rows=7)
    detection = detected(more, CHARUCO_BOARD)
    assert set(findings(detection)) == {"unseen_row"}
    assert detection.corner_count == 3 * 24


def test_a_mirrored_print(detected: Detect):
    mirrored = {"m": render(CHARUCO_BOARD, View(tilt=(10, 5, 0), mirrored=True))}
    detection = detected(CHARUCO_BOARD, CHARUCO_BOARD, **mirrored)
    assert findings(detection)["mirrored"].pictures == ("m.png",)


@pytest.mark.slow
def test_a_chessboard_that_looks_the_same_after_half_a_turn(detected: Detect):
    even = replace(CHESS_BOARD, rows=6)
    assert set(findings(detected(even, even))) == {"ambiguous"}
    assert detected(CHESS_BOARD, CHESS_BOARD).findings == ()


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (CHARUCO_BOARD, TAG_BOARD),
        (replace(CHARUCO_BOARD, name="a"), CHARUCO_BOARD),
        (replace(CHARUCO_BOARD, name="a", dictionary="DICT_5X5_250"), CHARUCO_BOARD),
        (replace(CHESS_BOARD, name="a", columns=5, rows=8), CHESS_BOARD),
    ],
    ids=["names", "markers", "dictionaries", "chessboards"],
)
def test_boards_that_cannot_be_told_apart(first: Board, second: Board):
    with pytest.raises(CalibError, match="board"):
        check_boards([first, second])


def test_boards_that_can():
    other = replace(CHARUCO_BOARD, name="a", first_marker=17)
    check_boards(
        [CHARUCO_BOARD, other, replace(TAG_BOARD, name="b"), replace(CHESS_BOARD, name="c")]
    )


@pytest.mark.slow
def test_markers_of_which_none_has_a_described_id(detected: Detect):
    detection = detected(replace(CHARUCO_BOARD, first_marker=40), CHARUCO_BOARD)
    finding = findings(detection)["first_marker"]
    assert finding.pictures == tuple(VIEWS)
    assert finding.better is not None
    assert finding.better.first_marker == 0


@pytest.mark.slow
def test_markers_of_another_board_are_no_mistake(tmp_path: Path):
    missing = replace(CHARUCO_BOARD, name="missing", first_marker=40)
    for name, view in VIEWS.items():
        cv2.imwrite(str(tmp_path / name), render(CHARUCO_BOARD, view))
    detection = detect(find_images([tmp_path]), [CHARUCO_BOARD, missing])
    assert detection.findings == ()
    assert detection.corner_count == 3 * 24


@pytest.mark.slow
@pytest.mark.parametrize(
    ("described", "printed", "code"),
    [
        (replace(CHESS_BOARD, columns=6), CHESS_BOARD, "size"),
        (replace(CHARUCO_BOARD, dictionary="DICT_6X6_100"), CHARUCO_BOARD, "dictionary"),
        (CHARUCO_BOARD, CHARUCO_BOARD, ""),
    ],
)
def test_some_pictures_of_many_are_searched_first(
    tmp_path: Path, described: Board, printed: Board, code: str
):
    """What is found, and said, is the same as of pictures that are all searched at once."""
    names = [f"{k}.png" for k in range(1, 13)]
    for k, name in enumerate(names):
        view = list(VIEWS.values())[k % len(VIEWS)]
        image = render(printed, replace(view, tilt=(view.tilt[0], view.tilt[1], 30.0 * k)))
        # One is dark: only a copy shows its board.
        image = image // 12 if k == 3 else image
        cv2.imwrite(str(tmp_path / name), image)
    steps = []
    detection = detect(
        find_images([tmp_path]),
        [described],
        progress=lambda done, total: steps.append((done, total)),
    )
    assert steps[-1] == (12, 12)
    assert [done for done, _ in steps] == sorted({done for done, _ in steps})
    if code:
        assert findings(detection)[code].pictures == tuple(names)
        assert detection.corner_count == 0
    else:
        # That of 4.png has bright and dark as they are nowhere else: it was found in a copy.
        assert {one.code: one.pictures for one in detection.findings} == {"evened": ("4.png",)}
        assert detection.corner_count == 12 * 24
