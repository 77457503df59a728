"""The usual mistakes in a description, each named by the markers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calib.boards.board import Board
from calib.boards.corners.markers import Markers
from calib.boards.detection.other_boards import explanation, measured_ratio
from tests.boards.board_views import CHARUCO_BOARD, TAG_BOARD, View
from tests.boards.corners.test_placing import markers

SIZE = (640, 480)
VIEWS = (View(tilt=(10, 40, 20)), View(tilt=(-20, 10, 90), distortion=(-0.2, 0.05)))

#: Six rows, in the older layout.
LEGACY_BOARD = replace(CHARUCO_BOARD, rows=6, legacy=True)


def seen(board: Board) -> Sequence[tuple[Markers, tuple[int, int]]]:
    pairs = []
    for view in VIEWS:
        found = markers(board, view)
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
    few = [(pair.of_ids(0, 3), size) for pair, size in seen(CHARUCO_BOARD)]
    assert np.isnan(measured_ratio(CHARUCO_BOARD, few))
    assert explanation(replace(CHARUCO_BOARD, columns=5, rows=7), few) is None
