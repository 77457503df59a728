"""Boards in words: what the page says, and what to do with the print."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from calib.boards.board_design import design
from calib.boards.board_page import sheet_for
from calib.boards.printed import print_scale, rescaled
from calib.verbs.board.text import description, drawn_text, measured_text, page_lines

BOARD = design("a4")


def printed(paragraphs):
    """The lines, none too long, and all of it without breaks."""
    lines = "\n".join(paragraphs).splitlines()
    assert max(map(len, lines)) <= 100
    return lines, " ".join(" ".join(lines).split())


def drawn(board, paper="a4"):
    files = [Path(f"b/left.{ending}") for ending in ("pdf", "svg", "toml")]
    return printed(drawn_text(board, sheet_for(board, paper), paper, files))


def test_a_board_is_described_with_its_markers():
    text = description(BOARD)
    assert "10 x 7 squares of 25 mm" in text
    assert "markers of 19 mm, DICT_5X5_100, ids 0 to 34" in text
    legacy = description(replace(BOARD, rows=6, legacy=True, first_marker=5))
    assert "legacy" in legacy
    assert "ids 5 to 34" in legacy
    assert "legacy" not in description(replace(BOARD, legacy=True))
    tags = design("a4", pattern="apriltag")
    assert "6 x 4 tags of 36 mm every 46 mm" in description(tags)
    assert "marker" not in description(design("a4", pattern="chessboard"))


@pytest.mark.parametrize("pattern", ["charuco", "chessboard", "apriltag"])
def test_the_page_has_at_most_three_short_lines(pattern):
    board = replace(design("a4", pattern=pattern), name="a long name " * 5)
    lines = page_lines(board)
    assert len(lines) <= 3
    assert max(map(len, lines)) <= 66


@pytest.mark.parametrize("pattern", ["charuco", "chessboard", "apriltag"])
def test_the_console_says_what_to_print_and_to_measure(pattern):
    board = design("a4", pattern=pattern)
    lines, text = drawn(board)
    assert "Written: b/left.svg" in text
    assert "100 %" in text
    assert "A4 paper, landscape" in text
    width = f"{1e3 * board.size[0]:g} mm"
    assert lines[-1] == f'     calib board b/left.toml --measured "{width}"'
    print_scale(board, width)  # is what the option takes
    assert "Note" not in text


def test_boards_that_are_not_unique_come_with_a_note():
    assert "half a turn" in drawn(design("a4", pattern="chessboard", rows=8))[1]
    assert "before 4.6" in drawn(design("a4", rows=6))[1]
    assert "4.6 or newer" in drawn(design("a4", rows=6, legacy=True))[1]


def test_other_papers():
    upright = design("letter", columns=5, rows=7)
    assert "letter paper, portrait" in drawn(upright, "letter")[1]
    assert "on a sheet of" in drawn(design("none"), "none")[1]


@pytest.mark.parametrize(
    ("measured", "expected", "is_noted"),
    [
        ("249.3 mm", "squares of 24.93 mm, -0.28 %", False),
        ("240 mm", "squares of 24 mm, -4.00 %", True),
        ("60 mm / 2", "squares of 30 mm, +20.00 %", False),
    ],
)
def test_what_a_measurement_changes(measured, expected, is_noted):
    scale = print_scale(BOARD, measured)
    lines, text = printed(measured_text(BOARD, rescaled(BOARD, scale), scale, Path("board.toml")))
    assert expected in text
    assert ("fit the page" in text) == is_noted
    assert lines[-1] == "Written: board.toml"
