"""What a picture says about its board, in words."""

from __future__ import annotations

from dataclasses import replace

import pytest

import calib.boards.identify as codes
from calib.boards.board_design import Wish, designed
from calib.boards.identify import Identified
from calib.verbs.board.identified_text import (
    _FINDINGS,
    described,
    identified_text,
    next_lines,
    nothing_text,
)

BOARD = replace(designed(Wish(columns=7, rows=5), "none"), dictionary="DICT_5X5_50")
ALL = (codes.MIRRORED, codes.BOTTOM_UP, codes.CUT_OFF, codes.MISSING, codes.HALF_TURN)


def test_every_finding_has_a_sentence():
    assert set(_FINDINGS) == set(ALL)


@pytest.mark.parametrize("pattern", ["charuco", "chessboard", "apriltag"])
def test_the_board_and_its_findings(pattern):
    board = BOARD if pattern == "charuco" else designed(Wish(pattern=pattern), "none")
    identified = Identified(board, ALL, board.dictionary, tuple(range(11)))
    lines = identified_text(identified, board, "photo.png", is_sized=False)
    assert max(len(part) for line in lines for part in line.splitlines()) <= 100
    text = " ".join(" ".join(lines).split())
    assert text.startswith("photo.png: ")
    for sentence in _FINDINGS.values():
        assert sentence in text
    assert "30 mm squares are assumed" in text
    assert ("11 of 17 markers" in text) == (pattern == "charuco")
    assert ("DICT_5X5_100, DICT_5X5_250, DICT_5X5_1000" in text) == (pattern == "charuco")
    sized = identified_text(identified, board, "photo.png", is_sized=True)
    assert "assumed" not in " ".join(sized)


def test_the_description_and_the_next_step():
    assert "columns = 7" in described(BOARD)
    assert next_lines(BOARD, "b.toml")[-1] == '  calib board b.toml --measured "210 mm / 7"'


def test_no_board():
    assert "no board is found" in nothing_text(Identified(None), "a.png")
    few = Identified(None, (), "DICT_4X4_50", (3, 8))
    assert "DICT_4X4_50 are found (ids 3, 8)" in nothing_text(few, "a.png")
    many = Identified(None, (), "DICT_4X4_50", tuple(range(30)))
    assert "11, ...)" in nothing_text(many, "a.png")
