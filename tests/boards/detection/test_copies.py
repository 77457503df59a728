"""Copies of pictures: what they show that the picture as it is does not, and that corners stay where they are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.boards.board import Board
from calib.boards.detection.copies import Copy, as_it_is, further_copies
from calib.boards.detection.picture import ImageFile, Picture, Search, search_picture
from tests.boards.board_views import CHARUCO_BOARD, CHESS_BOARD, TAG_BOARD, View, render

VIEW = View(tilt=(30, 20, 15), levels=(0.0, 1.0), noise=0.0)


def shares(board: Board) -> np.ndarray:
    """The share of white of each pixel, 0 to 1."""
    return render(board, replace(VIEW, levels=(0.0, 250.0))) / 250.0


def search(folder: Path, board: Board, image: np.ndarray) -> Picture:
    path = folder / "a.png"
    path.write_bytes(cv2.imencode(".png", image)[1].tobytes())
    return search_picture(Search((board,), 12), ImageFile(path, path.name))


def noisy(grey: np.ndarray, noise: float, kind: type) -> np.ndarray:
    values = grey + noise * np.random.default_rng(1).standard_normal(grey.shape)
    return np.clip(np.rint(values), 0, np.iinfo(kind).max).astype(kind)


@pytest.mark.parametrize("board", [CHARUCO_BOARD, CHESS_BOARD, TAG_BOARD], ids=lambda b: b.pattern)
@pytest.mark.parametrize(
    ("kind", "black", "white", "noise", "lamp", "code"),
    [
        (np.uint16, 200.0, 2700.0, 30.0, 0.0, ""),
        (np.uint16, 60.0, 100.0, 2.0, 0.0, ""),
        (np.uint16, 600.0, 1200.0, 20.0, 60000.0, "evened"),
        (np.uint8, 3.0, 9.0, 0.5, 0.0, "evened"),
    ],
    ids=["12 bits", "12 bits, dark", "a lamp", "8 bits, dark"],
)
def test_deep_and_dark_pictures(tmp_path, board, kind, black, white, noise, lamp, code):
    grey = black + (white - black) * shares(board)
    grey[:60, :80] += lamp
    picture = search(tmp_path, board, noisy(grey, noise, kind))
    (view,) = picture.used
    assert view.copy == code
    assert len(view.ids) == len(board.corners)
    error = view.pixels - VIEW.corners(board)
    assert np.sqrt(np.mean(error**2)) < 0.2
    # Corners of a dark picture are known less precisely, and that is said.
    assert np.sqrt(np.mean(error**2)) < 2.0 * np.median(view.sigma)


@pytest.mark.parametrize("board", [CHARUCO_BOARD, TAG_BOARD], ids=lambda b: b.pattern)
def test_a_print_that_is_white_on_black(tmp_path, board):
    picture = search(tmp_path, board, noisy(220.0 - 180.0 * shares(board), 2.0, np.uint8))
    (view,) = picture.used
    assert view.copy == "negative"
    assert np.abs(view.pixels - VIEW.corners(board)).max() < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("board", [CHARUCO_BOARD, CHESS_BOARD, TAG_BOARD], ids=lambda b: b.pattern)
def test_a_soft_picture_of_many_pixels(tmp_path, board):
    view = replace(VIEW, levels=(40.0, 200.0), blur=1.5)
    # Enlarged, a pixel's centre moves with the pixel.
    image = cv2.resize(render(board, view), None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)
    picture = search(tmp_path, board, noisy(image.astype(float), 3.0, np.uint8))
    (found,) = picture.used
    assert len(found.ids) == len(board.corners)
    error = (found.pixels + 0.5) / 4.0 - 0.5 - view.corners(board)
    assert np.sqrt(np.mean(error**2)) < 0.06
    assert found.copy == ("" if board is TAG_BOARD else "smaller")


@pytest.mark.slow
def test_small_markers_are_read_in_an_enlarged_copy(tmp_path):
    view = View(tilt=(25, 20, 15), middle=(0, 0, 1.4), size=(1280, 960))
    image = render(CHARUCO_BOARD, view)
    (found,) = search(tmp_path, CHARUCO_BOARD, image).used
    assert len(found.ids) == 24
    assert np.sqrt(np.mean((found.pixels - view.corners(CHARUCO_BOARD)) ** 2)) < 0.12


@pytest.mark.parametrize(
    ("level", "reason"), [(4.0, "flat"), (120.0, "flat"), (300.0, "overexposed")], ids=str
)
def test_reasons_of_the_light(tmp_path, level, reason):
    image = noisy(np.full((480, 640), level), 1.0, np.uint8)
    picture = search(tmp_path, CHARUCO_BOARD, image)
    assert [view.reason for view in picture.views] == [reason]


def test_pixels_of_a_smaller_copy():
    grey = np.zeros((8, 12))
    grey[4:6, 6:8] = 200.0
    copy = Copy.of("", grey[::2, ::2], 2)
    # The middle of the four pixels.
    np.testing.assert_array_equal(copy.in_picture(np.array([3.0, 2.0])), [6.5, 4.5])


def codes(side: int, *, is_seen: bool = False, has_markers: bool = True) -> list[str]:
    picture = as_it_is(np.zeros((side // 4, side), dtype=np.uint8))
    copies = further_copies(picture, is_seen=is_seen, has_markers=has_markers)
    return [copy.code for copy in copies]


def test_which_copies_there_are():
    assert codes(1280) == ["evened", "", "evened", "negative", "negative"]
    assert codes(1280, has_markers=False) == ["evened"]
    assert codes(1280, is_seen=True) == []
    # Of a large picture, those of at least a usual size.
    assert codes(2000, is_seen=True) == ["smaller"]
    assert codes(4000, is_seen=True) == ["smaller"] * 3
    # In a very large one, no marker is enlarged.
    assert codes(4000) == [*["smaller"] * 3, "evened", "negative", "negative", *["smaller"] * 3]


def test_an_evened_copy_is_as_bright_everywhere():
    board = shares(CHARUCO_BOARD)
    light = np.linspace(1.0, 20.0, board.shape[1])
    picture = as_it_is(noisy((5.0 + 5.0 * board) * light, 0.3, np.uint8))
    evened = next(further_copies(picture, is_seen=False, has_markers=False)).grey
    left, right = evened[150:330, 200:300], evened[150:330, 340:440]
    assert left.mean() == pytest.approx(right.mean(), abs=10.0)
    assert left.std() == pytest.approx(right.std(), rel=0.2)
