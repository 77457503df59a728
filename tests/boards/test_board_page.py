"""Pages: the pattern in its place, rulers of exact length; SVG and PDF, read back and rasterised, show every corner."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from xml.etree import ElementTree as ET

import cv2
import numpy as np
import pytest

from calib.boards.board import APRILTAG, CHARUCO, CHESSBOARD, Board
from calib.boards.board_design import design
from calib.boards.board_page import (
    NO_PAPER,
    PAPERS,
    TEXT_SIZE,
    margins,
    module_size,
    page_of,
    pdf,
    quiet_zone,
    sheet_for,
    svg,
)
from calib.boards.drawing import black_rectangles
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


#: Widest letters of Helvetica are nearly a font size wide; on average they are not wider than this.
LETTER = 0.62 * TEXT_SIZE

LINES = ["board: 10 x 7 squares of 25 mm", "<Text> & (\\ more)", "größer: Print at 100 %"]


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


SVG = "{http://www.w3.org/2000/svg}"

#: Dots per inch of the rasterised page, and per millimetre.
DPI = 300
PER_MM = DPI / 25.4


def test_the_svg_is_in_millimetres():
    _, _, drawn = page()
    root = ET.fromstring(svg(drawn))
    assert (root.get("width"), root.get("height")) == ("297mm", "210mm")
    assert root.get("viewBox") == "0 0 297 210"
    pattern = next(path for path in root.iter(f"{SVG}path") if path.get("id") == "pattern")
    rows = re.findall(r"M(\S+) (\S+)h(\S+?)v(\S+?)H(\S+?)z", pattern.get("d"))
    read = np.array(rows, dtype=float)
    np.testing.assert_allclose(read[:, :4], 1e3 * drawn.pattern, atol=1e-4)
    np.testing.assert_allclose(read[:, 4], read[:, 0])
    texts = [text.text for text in root.iter(f"{SVG}text")]
    assert texts[-2:] == LINES[-2:]


def test_the_pdf_is_in_points_with_a_table_of_its_objects():
    _, _, drawn = page()
    data = pdf(drawn)
    box = re.search(rb"/MediaBox \[0 0 (\S+) (\S+)\]", data)
    np.testing.assert_allclose([float(x) for x in box.groups()], [841.8898, 595.2756], atol=1e-3)
    assert b"/PrintScaling /None" in data
    read = np.array(re.findall(rb"(\S+) (\S+) (\S+) (\S+) re", data), dtype=float)
    expected = 1e3 * np.concatenate([drawn.pattern, drawn.lines])
    np.testing.assert_allclose(read, expected, atol=1e-4)
    assert rb"(<Text> & \(\\ more\)) Tj" in data
    assert "(größer: Print at 100 %) Tj".encode("cp1252") in data
    places = [int(x) for x in re.findall(rb"\n(\d{10}) 00000 n ", data)]
    for number, place in enumerate(places, 1):
        assert data[place:].startswith(b"%d 0 obj" % number)
    start = int(data.split()[-2])
    assert data[start:].startswith(b"xref")
    length = int(re.search(rb"/Length (\d+)", data)[1])
    stream = re.search(rb"stream\n(.*)\nendstream", data, re.DOTALL)[1]
    assert len(stream) == length


def rasterised(drawn, folder):
    """The PDF as a picture; whole pixels of it are a little larger than the page."""
    path = folder / "page.pdf"
    path.write_bytes(pdf(drawn))
    subprocess.run(
        ["pdftoppm", "-r", str(DPI), "-gray", "-singlefile", "-png", path, folder / "page"],
        check=True,
        timeout=60,
    )
    return cv2.imread(str(folder / "page.png"), cv2.IMREAD_GRAYSCALE)


def expected_pixels(board, sheet):
    """The corners in the picture of a page [px], pixel (0, 0) at the middle of the upper left one."""
    return 1e3 * (board.corners[:, :2] + sheet.origin) * PER_MM - 0.5


def assert_squares_are_true(image, board, sheet):
    """Edges along a line through the first row of squares are where the drawing says, to 0.05 mm."""
    y = round(1e3 * (sheet.origin[1] + 0.04 * board.square) * PER_MM)
    first = round(1e3 * (sheet.origin[0] - sheet.quiet / 2) * PER_MM)
    last = round(1e3 * (sheet.origin[0] + board.size[0] + sheet.quiet / 2) * PER_MM)
    darkness = 1.0 - image[y, first:last] / 255.0
    black = darkness.sum() / PER_MM
    squares = (board.columns + 1) // 2
    assert black == pytest.approx(1e3 * squares * board.square, abs=0.05)
    inked = first + np.flatnonzero(darkness > 0.02)
    begin = inked[0] + 1 - darkness[inked[0] - first]
    assert begin / PER_MM == pytest.approx(1e3 * sheet.origin[0], abs=0.05)


needs_pdftoppm = pytest.mark.skipif(not shutil.which("pdftoppm"), reason="pdftoppm is missing")


@needs_pdftoppm
@pytest.mark.parametrize(("paper", "legacy", "rows"), [("a4", False, 7), ("letter", True, 6)])
def test_all_charuco_corners_of_the_printed_page(paper, legacy, rows, tmp_path):
    board, sheet, drawn = page(paper=paper, legacy=legacy, rows=rows)
    image = rasterised(drawn, tmp_path)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    size = (board.columns, board.rows)
    theirs = cv2.aruco.CharucoBoard(size, board.square, board.marker, dictionary)
    theirs.setLegacyPattern(board.legacy)
    corners, ids, _, markers = cv2.aruco.CharucoDetector(theirs).detectBoard(image)
    assert sorted(markers.ravel()) == list(range(board.markers))
    assert list(ids.ravel()) == list(board.corner_ids())
    # Before version 5 OpenCV gives the corners of ChArUco boards half a pixel further right and down.
    shift = 0.5 if int(cv2.__version__.split(".")[0]) < 5 else 0.0
    difference = corners.reshape(-1, 2) - shift - expected_pixels(board, sheet)
    assert np.abs(difference).max() < 0.05 * PER_MM
    if not legacy:
        assert_squares_are_true(image, board, sheet)


@pytest.mark.slow
@needs_pdftoppm
def test_all_chessboard_corners_of_the_printed_page(tmp_path):
    board, sheet, drawn = page("chessboard")
    image = rasterised(drawn, tmp_path)
    is_found, corners = cv2.findChessboardCornersSB(image, (board.columns - 1, board.rows - 1))
    assert is_found
    # OpenCV begins at the other end.
    difference = corners.reshape(-1, 2)[::-1] - expected_pixels(board, sheet)
    assert np.abs(difference).max() < 0.05 * PER_MM
    assert_squares_are_true(image, board, sheet)


@needs_pdftoppm
def test_all_tag_corners_of_the_printed_page(tmp_path):
    board, sheet, drawn = page("apriltag")
    image = rasterised(drawn, tmp_path)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(image)
    order = np.argsort(ids.ravel())
    assert list(ids.ravel()[order]) == list(range(24))
    found = np.array(corners)[order].reshape(-1, 2)
    assert np.abs(found - expected_pixels(board, sheet)).max() < 0.1 * PER_MM
