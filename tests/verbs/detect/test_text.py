"""What a detection says, picture by picture and finding by finding."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import calib.verbs.detect.text as text_module
from calib.boards.board import PATTERNS
from calib.boards.detection import (
    board_findings as findings,
    board_search,
    copies,
    picture as pictures,
)
from calib.boards.detection.board_findings import Finding
from calib.verbs.detect.matching import match
from calib.verbs.detect.text import detection_text, findings_text, not_used, reason_text
from tests.boards.board_views import CHARUCO_BOARD
from tests.boards.detections import detection, picture, view
from tests.verbs.detect.test_corner_table import joints_of

SIX_ROWS = replace(CHARUCO_BOARD, rows=6)
OLD = replace(SIX_ROWS, legacy=True)


def test_what_was_found_and_what_was_not(tmp_path: Path):
    joints = joints_of(tmp_path, "image,j1 [deg]\n1.png,1\n2.png,2\n9.png,2\n")
    found = detection(picture("1.png", view()), picture("2.png", view(reason="cut")))
    lines = detection_text(found, joints, match(joints, [p.file for p in found.pictures]))
    assert lines[:2] == [
        "2 corners in 1 of 2 pictures.",
        "  board: 2 of 24 corners in 1 picture, sigma 0.160 px (median).",
    ]
    text = " ".join(lines)
    assert "2.png: 2 of the 12 corners" in text
    assert "9.png (line 4)" in text
    assert "Findings" not in text


def test_of_two_boards_each_has_its_reason():
    both = picture("1.png", view("a", "no_board"), view("b", "cut"))
    text = reason_text(both, 12)
    assert text.startswith("a: no board in it; b: 2 of the 12")
    assert not_used(detection(both)) == [("1.png", text)]


def test_another_size_is_said_in_pixels():
    other = replace(picture("1.png", view()), reason="other_size")
    assert reason_text(other, 12).startswith("640 x 480 pixels")


@pytest.mark.parametrize(
    ("finding", "words"),
    [
        (
            Finding(code="swapped", board="board", better=replace(CHARUCO_BOARD, rows=6)),
            "7 columns and 6 rows, in the new layout",
        ),
        (
            Finding(
                code="legacy", board="board", better=replace(CHARUCO_BOARD, rows=6, legacy=True)
            ),
            'layout = "legacy"',
        ),
        (
            Finding(code="ratio", board="board", value=0.5),
            "0.500 of a square, the description says 0.733",
        ),
        (Finding(code="dictionary", board="board", dictionary="DICT_4X4_50"), "DICT_4X4_50"),
        (
            Finding(
                code="first_marker", board="board", better=replace(CHARUCO_BOARD, first_marker=40)
            ),
            "the id 40",
        ),
        (Finding(code="same_picture", pictures=tuple("abcdefgh")), "(a, b, c, d, e, f and 2 more)"),
    ],
    ids=lambda value: value.code if isinstance(value, Finding) else "",
)
def test_a_finding_says_what_is_right(finding: Finding, words: str):
    (text,) = findings_text(replace(detection(), findings=(finding,)))
    assert words in text
    assert "{" not in text


def codes(*modules: object) -> set[str]:
    """The values of the modules' constants that are codes."""
    values = set()
    for module in modules:
        names = [name for name in vars(module) if name.isupper() and not name.startswith("_")]
        values |= {value for name in names if isinstance(value := getattr(module, name), str)}
    return {value for value in values if value.islower()}


def test_every_code_has_its_sentence():
    known = set(text_module._FINDINGS) | set(text_module._REASONS) | set(text_module._VIEW_REASONS)
    boards = set(PATTERNS)
    assert codes(board_search, copies, findings, pictures) - boards == known
