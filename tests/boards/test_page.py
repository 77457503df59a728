"""Pages: the pattern in its place, rulers of exact length, nothing in the quiet zone."""

from __future__ import annotations

import numpy as np
import pytest

from calib.boards.board_design import design
from calib.boards.drawing import black_rectangles
from calib.boards.page import TEXT_SIZE, page_of
from calib.boards.paper import PAPERS, sheet_for

#: Widest letters of Helvetica are nearly a font size wide; on average they are not wider than this.
LETTER = 0.62 * TEXT_SIZE

LINES = ["board: 10 x 7 squares of 25 mm", "markers", "Print at 100 %"]


def page(pattern="charuco", paper="a4", **wish):
    board = design(paper, pattern=pattern, **wish)
    sheet = sheet_for(board, paper)
    return board, sheet, page_of(board, sheet, LINES)


def test_the_pattern_is_moved_to_its_place():
    board, sheet, drawn = page()
    expected = black_rectangles(board)
    np.testing.assert_allclose(drawn.pattern[:, :2], expected[:, :2] + sheet.origin)
    np.testing.assert_allclose(drawn.pattern[:, 2:], expected[:, 2:])
    assert drawn.title == "board"


@pytest.mark.parametrize("paper", ["a4", "letter", "none"])
def test_both_rulers_are_100_mm_between_the_middles_of_their_last_ticks(paper):
    _, sheet, drawn = page(paper=paper)
    x, y, w, h = drawn.lines.T
    across = np.isclose(w, 0.0002) & np.isclose(h, 0.0028)  # long ticks stand
    middles = np.sort(x[across] + w[across] / 2)
    np.testing.assert_allclose(middles - middles[0], [0, 0.05, 0.1], atol=1e-12)
    down = np.isclose(h, 0.0002) & np.isclose(w, 0.0028)
    middles = np.sort(y[down] + h[down] / 2)
    np.testing.assert_allclose(middles - sheet.origin[1], [0, 0.05, 0.1], atol=1e-12)


def test_letter_has_inches_too():
    _, _, drawn = page(paper="letter")
    x, _, w, h = drawn.lines.T
    level = drawn.lines[:, 1].max()
    inches = np.isclose(drawn.lines[:, 1], level) & np.isclose(h, 0.002)
    middles = np.sort(x[inches] + w[inches] / 2)
    np.testing.assert_allclose(middles - middles[0], 0.0254 * np.arange(5), atol=1e-12)
    assert "4 in" in [text.text for text in drawn.texts]


@pytest.mark.parametrize("pattern", ["charuco", "chessboard", "apriltag"])
@pytest.mark.parametrize("paper", [*PAPERS, "none"])
def test_nothing_is_in_the_quiet_zone_or_at_the_edge(pattern, paper):
    board, sheet, drawn = page(pattern, paper)
    boxes = [tuple(line) for line in drawn.lines]
    for text in drawn.texts:
        x, y = text.at
        boxes.append((x, y - 0.75 * TEXT_SIZE, LETTER * len(text.text), TEXT_SIZE))
    left, top = sheet.origin[0] - sheet.quiet, sheet.origin[1] - sheet.quiet
    right = sheet.origin[0] + board.size[0] + sheet.quiet
    bottom = sheet.origin[1] + board.size[1] + sheet.quiet
    for x, y, w, h in boxes:
        is_outside = x + w <= left or x >= right or y + h <= top or y >= bottom - 2e-4
        assert is_outside, (x, y, w, h)
        assert x > 0.009
        assert x + w < sheet.width - 0.009
        assert y > 0.009
        assert y + h < sheet.height - 0.009


def test_a_small_board_has_room_for_ruler_and_text():
    _, sheet, drawn = page(paper="none", columns=3, rows=3, square=0.01)
    assert [text.text for text in drawn.texts[:3]] == ["100 mm", "20", "mm"]
    assert drawn.texts[3].at[0] < sheet.width - 0.07
    _, sheet, drawn = page(columns=3, rows=3, square=0.01)
    assert drawn.texts[3].at[0] < sheet.width - 0.07
