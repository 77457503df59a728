"""Boards that are told from pictures in perspective: patterns, dictionaries, layouts, mirrored, hidden, cut off."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from calib.boards.board_design import Wish, designed
from calib.boards.drawing import marker_corners
from calib.boards.identify import (
    CUT_OFF,
    HALF_TURN,
    MIRRORED,
    MISSING,
    identify,
    read_image,
    sized,
)
from calib.errors import FileError
from tests.boards.rendered import FRONTAL, photo

SIZE = (720, 540)


def drawn(**wish):
    return designed(Wish(**wish), "a4")


def assert_is(identified, board, dictionary=None):
    """The board but for its size, which no picture shows, and the size of the dictionary."""
    seen = identified.board
    assert (seen.pattern, seen.columns, seen.rows) == (board.pattern, board.columns, board.rows)
    assert (seen.first_marker, seen.legacy) == (board.first_marker, board.legacy)
    assert seen.dictionary == (dictionary or board.dictionary)
    assert seen.marker / seen.square == pytest.approx(board.marker / board.square, abs=0.015)
    assert seen.square == 0.03


@pytest.mark.parametrize("angle", [0, 1])
def test_the_default_board(angle):
    board = drawn()
    identified = identify(photo(board, size=SIZE, angle=angle)[0])
    assert_is(identified, board, "DICT_5X5_50")
    assert MIRRORED not in identified.findings
    assert MISSING not in identified.findings
    assert identified.markers == tuple(range(35))


@pytest.mark.parametrize(
    ("dictionary", "smallest"),
    [
        ("DICT_4X4_250", "DICT_4X4_50"),
        ("DICT_6X6_50", "DICT_6X6_50"),
        ("DICT_7X7_1000", "DICT_7X7_50"),
        ("DICT_APRILTAG_25h9", None),
        ("DICT_ARUCO_ORIGINAL", None),
        ("DICT_ARUCO_MIP_36h12", None),
    ],
)
def test_other_dictionaries_and_the_legacy_layout(dictionary, smallest):
    is_small = dictionary in ("DICT_4X4_250", "DICT_APRILTAG_25h9")
    board = drawn(columns=7, rows=6, dictionary=dictionary, legacy=not is_small)
    assert_is(identify(photo(board, size=SIZE)[0]), board, smallest)


@pytest.mark.slow
def test_grids_of_tags():
    board = drawn(pattern="apriltag")
    assert_is(identify(photo(board, size=SIZE)[0]), board)
    board = drawn(pattern="apriltag", columns=4, rows=5, first_marker=100)
    assert_is(identify(photo(board, size=SIZE)[0]), board)


@pytest.mark.slow
def test_ids_that_the_quick_look_does_not_know():
    board = drawn(first_marker=300, columns=6, rows=5)
    assert_is(identify(photo(board, size=SIZE)[0]), board, "DICT_5X5_1000")


def test_a_chessboard_and_one_that_looks_the_same_after_half_a_turn():
    board = drawn(pattern="chessboard", columns=9, rows=6)
    identified = identify(photo(board, size=SIZE)[0])
    assert (identified.board.columns, identified.board.rows) == (9, 6)
    assert identified.findings == ()
    board = drawn(pattern="chessboard", columns=6, rows=6)
    assert identify(photo(board, size=SIZE)[0]).findings == (HALF_TURN,)


def test_a_mirrored_print():
    board = drawn(columns=7, rows=6)
    image = photo(board, size=SIZE)[0]
    identified = identify(np.ascontiguousarray(image[:, ::-1]))
    assert_is(identified, board, "DICT_5X5_50")
    assert MIRRORED in identified.findings


def test_hidden_markers():
    board = drawn()
    image, H_image_board = photo(board, size=SIZE)
    centres = marker_corners(board)[[0, 1, 2, 3, 4, 11, 20, 34]] + board.marker / 2
    for x, y in cv2.perspectiveTransform(centres[None], H_image_board)[0]:
        cv2.circle(image, (round(x), round(y)), 15, 128, -1)
    identified = identify(image)
    assert_is(identified, board, "DICT_5X5_50")
    assert MISSING in identified.findings
    assert len(identified.markers) == 27
    assert 20 not in identified.markers


@pytest.mark.slow
def test_rows_beyond_the_picture():
    board = drawn()
    whole = identify(photo(board, FRONTAL, SIZE)[0])
    assert CUT_OFF not in whole.findings or whole.board.rows == 7
    quad = ((0.1, 0.2), (0.9, 0.2), (0.9, 1.3), (0.1, 1.3))
    identified = identify(photo(board, quad, SIZE)[0])
    assert (identified.board.columns, identified.board.rows) == (10, 5)
    assert CUT_OFF in identified.findings


@pytest.mark.slow
def test_colour_and_large_pictures():
    board = drawn(columns=5, rows=5)
    image = photo(board, size=SIZE)[0]
    colour = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    large = cv2.resize(colour, None, fx=5.0, fy=5.0)
    assert_is(identify(large), board, "DICT_5X5_50")


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is():
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 255, (480, 640)).astype(np.uint8)
    assert identify(noise).board is None
    assert identify(np.full((480, 640), 200, np.uint8)).markers == ()


@pytest.mark.slow
def test_a_charuco_board_too_far_away_is_no_chessboard():
    board = drawn()
    image = photo(board, ((0.4, 0.4), (0.62, 0.4), (0.62, 0.6), (0.4, 0.6)), (640, 480))[0]
    found = identify(image).board  # some versions of OpenCV read a few of its markers
    assert found is None or found.pattern == board.pattern


def test_too_few_markers_are_listed():
    board = drawn(pattern="apriltag", columns=2, rows=1)
    identified = identify(photo(board, size=SIZE)[0])
    assert identified.board is None
    assert identified.dictionary == "DICT_APRILTAG_36h11"
    assert identified.markers == (0, 1)


def test_the_size_is_given():
    board = identify(photo(drawn(columns=5, rows=5), size=SIZE)[0]).board
    assert sized(board, 0.025, None).marker == pytest.approx(board.marker * 25 / 30, abs=6e-5)
    assert sized(board, 0.025, 0.02).marker == 0.02
    assert sized(board, None, None) is not board
    assert sized(board, None, None).square == 0.03


def test_pictures_are_read(tmp_path):
    image = photo(drawn(columns=3, rows=3), size=(64, 48))[0]
    cv2.imwrite(str(tmp_path / "photo.png"), image)
    np.testing.assert_array_equal(read_image(tmp_path / "photo.png"), image)
    (tmp_path / "photo.jpg").write_text("no picture", encoding="utf-8")
    with pytest.raises(FileError, match="cannot be decoded"):
        read_image(tmp_path / "photo.jpg")
    (tmp_path / "empty.png").write_bytes(b"")
    with pytest.raises(FileError, match="cannot be decoded"):
        read_image(tmp_path / "empty.png")
    with pytest.raises(FileError, match="does not exist"):
        read_image(tmp_path / "none.png")
