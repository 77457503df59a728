"""Boards on paper: margins, quiet zone, lying or upright."""

from __future__ import annotations

from dataclasses import replace

import pytest

from calib.boards.board import APRILTAG, CHARUCO, CHESSBOARD, Board
from calib.boards.paper import NO_PAPER, margins, module_size, quiet_zone, sheet_for
from calib.errors import CalibError

BOARD = Board(
    pattern=CHARUCO, columns=10, rows=7, square=0.025, marker=0.019, dictionary="DICT_5X5_100"
)


def test_a_module_is_a_bit_of_a_marker():
    assert module_size(BOARD) == pytest.approx(0.019 / 7)
    tags = replace(BOARD, pattern=APRILTAG, dictionary="DICT_APRILTAG_36h11")
    assert module_size(tags) == pytest.approx(0.019 / 8)
    assert module_size(replace(BOARD, pattern=CHESSBOARD)) == 0.0


def test_the_quiet_zone_is_a_module_or_3_mm():
    assert quiet_zone(BOARD) == 0.003
    assert quiet_zone(replace(BOARD, square=0.1, marker=0.07)) == pytest.approx(0.01)
    assert quiet_zone(replace(BOARD, pattern=CHESSBOARD)) == 0.005


def test_the_default_board_lies_on_a4_within_its_margins():
    sheet = sheet_for(BOARD, "a4")
    assert (sheet.width, sheet.height) == (0.297, 0.210)
    left, top = sheet.origin
    assert left - sheet.quiet - 0.006 >= 0.010
    assert top >= 0.010
    assert sheet.width - left - 0.25 >= 0.010
    assert sheet.height - top - 0.175 - sheet.quiet - 0.008 >= 0.010
    # What is over is shared by both sides.
    assert left - 0.019 == pytest.approx(sheet.width - left - 0.25 - 0.010)


def test_a_high_board_stands():
    sheet = sheet_for(replace(BOARD, columns=7, rows=9), "letter")
    assert (sheet.width, sheet.height) == (0.2159, 0.2794)
    assert sheet.inches


def test_what_fits_to_the_micrometre_fits():
    across, down = margins(0.003)
    square = (0.210 - down) / 7
    assert sheet_for(replace(BOARD, square=square, marker=0.019), "a4") is not None
    assert sheet_for(replace(BOARD, square=square + 1e-6, marker=0.019), "a4") is None
    assert across == pytest.approx(0.029)


def test_without_a_paper_the_sheet_is_as_large_as_needed():
    sheet = sheet_for(replace(BOARD, square=0.1, marker=0.07), NO_PAPER)
    assert sheet.width == pytest.approx(1.0 + 0.010 + 0.006 + 0.01 + 0.01)
    assert sheet.height == pytest.approx(0.7 + 0.01 + 0.01 + 0.008 + 0.010)
    assert sheet_for(replace(BOARD, columns=2, rows=2), NO_PAPER).width == 0.210


def test_an_unknown_paper():
    with pytest.raises(CalibError, match="did you mean 'a4'"):
        sheet_for(BOARD, "a44")
