"""Pages with a board, as PDF and SVG: the pattern, two rulers to check the scale of the print, and lines of text.

10 mm or the quiet zone
+------------------------------------+
|    |+--------------------------+   |
|  r ||                          |   |
|  u ||         pattern          |   |
|  l ||                          |   |
|  e |+--------------------------+   |
|  r   quiet zone                    |
|      ruler ------   text           |
+------------------------------------+

Both are true to scale, rectangles and text, no bitmap. All rectangles of a pattern are one path, so that no hairlines
appear between neighbours when it is rasterised. The PDF asks viewers not to scale it for printing (PDF 32000-1, 12.2,
PrintScaling).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from xml.sax.saxutils import escape

import numpy as np

from calib.basics.arrays import Array
from calib.basics.values import Value
from calib.boards.board import APRILGRID, Board, cells_across
from calib.boards.drawing import black_rectangles
from calib.errors import CalibError, choices, did_you_mean

# Sheets of paper

#: No particular paper: the sheet is as large as the pattern with its margins.
NO_PAPER = "none"

#: Width and height of papers in portrait [m].
PAPERS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {"a4": (0.210, 0.297), "a3": (0.297, 0.420), "letter": (0.2159, 0.2794)}
)

#: Papers on which rulers show inches too.
_INCHES = ("letter",)

#: Margin at the edges of the paper that printers leave white [m].
EDGE = 0.010

#: Width of the ruler to the left of the pattern [m].
SIDE_BAND = 0.006

#: Height of the ruler and the text below the pattern [m].
BOTTOM_BAND = 0.008

#: Smallest white margin between the pattern and anything else that is printed [m].
_LEAST_QUIET = 0.003

#: Smallest white margin around a chessboard, whose outer squares have no border of their own [m].
_CHESSBOARD_QUIET = 0.005

#: The smallest sheet without a paper: it has room for the rulers and the text [m].
_SMALLEST = (0.210, 0.140)

#: Difference of lengths that may be due to rounding [m].
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Sheet:
    """A sheet of paper with the place of the pattern on it; x to the right, y down from the upper left corner."""

    #: Width of the sheet [m].
    width: float
    #: Height of the sheet [m].
    height: float
    #: Upper left corner of the pattern on the sheet [m].
    origin: tuple[float, float]
    #: White margin around the pattern [m].
    quiet: float
    #: True if the rulers show inches besides millimetres.
    inches: bool = False


def module_size(board: Board) -> float:
    """Return the side of one bit of a board's markers [m]; 0 without markers."""
    return board.marker / cells_across(board) if board.markers else 0.0


def quiet_zone(board: Board) -> float:
    """Return the white margin that a pattern needs around it, at least one bit of its markers [m]."""
    if board.pattern == APRILGRID:
        # The small squares at the outermost corners, and as much white.
        return 2.0 * (board.square - board.marker)
    least = _LEAST_QUIET if board.markers else _CHESSBOARD_QUIET
    return max(least, module_size(board))


def sizes_of_paper(paper: str) -> tuple[tuple[float, float], ...]:
    """Return width and height of a paper, in landscape and in portrait [m].

    Raises:
        CalibError: There is no such paper.
    """
    if paper not in PAPERS:
        names = (*PAPERS, NO_PAPER)
        raise CalibError(
            f"The paper '{paper}' is not known{did_you_mean(paper, names)}; allowed are {choices(names)}."
        )
    width, height = PAPERS[paper]
    return (height, width), (width, height)


def margins(quiet: float) -> tuple[float, float]:
    """Return the parts of the width and of the height of a sheet that margins and rulers take [m].

    Args:
        quiet: White margin around the pattern [m].
    """
    outer = max(EDGE, quiet)
    return EDGE + SIDE_BAND + quiet + outer, outer + quiet + BOTTOM_BAND + EDGE


def sheet_for(board: Board, paper: str) -> Sheet | None:
    """Place a board on a paper, in landscape if it fits, otherwise in portrait, centred in what the rulers leave.

    Args:
        board: The board.
        paper: Name of the paper, of `PAPERS` or `NO_PAPER`.

    Returns:
        The sheet; None if the board does not fit.

    Raises:
        CalibError: There is no such paper.
    """
    quiet = quiet_zone(board)
    across, down = margins(quiet)
    needed = (board.size[0] + across, board.size[1] + down)
    sizes: tuple[tuple[float, float], ...]
    if paper == NO_PAPER:
        sizes = ((max(needed[0], _SMALLEST[0]), max(needed[1], _SMALLEST[1])),)
    else:
        sizes = sizes_of_paper(paper)
    for width, height in sizes:
        if needed[0] <= width + _ROUNDING and needed[1] <= height + _ROUNDING:
            x = EDGE + SIDE_BAND + quiet + (width - across - board.size[0]) / 2.0
            y = max(EDGE, quiet) + (height - down - board.size[1]) / 2.0
            return Sheet(width, height, (x, y), quiet, paper in _INCHES)
    return None


# Pages

#: Lengths of the rulers [m]; the longest one that fits is taken.
_RULERS = (0.1, 0.05, 0.02)

#: Width of the rulers' lines [m].
_LINE = 0.0002

#: Distance between ticks [m].
_STEP = 0.005

#: Length of the ticks at every 50 mm, 10 mm and 5 mm [m]; ticks of inches are like those at 10 mm.
_TICKS = (0.003, 0.002, 0.0012)

#: Size of the font: from the top of its tallest letters to the bottom of its deepest [m].
TEXT_SIZE = 0.0023

#: Distance between lines of text [m].
_LEADING = 0.0027

#: Distance of the text from the start of the label at the end of the ruler [m].
_GAP = 0.011

#: Width of the ruler below the pattern with its text; below a small pattern they begin further left [m].
_RULER_AND_TEXT = 0.18

#: An inch [m].
_INCH = 0.0254


@dataclass(frozen=True, slots=True)
class Text:
    """A line of text."""

    #: Left end of its baseline on the page, x to the right, y down [m].
    at: tuple[float, float]
    #: The text.
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Page(Value):
    """A page to print: black rectangles and text on white."""

    #: Width of the page [m].
    width: float
    #: Height of the page [m].
    height: float
    #: x and y of the upper left corner, width and height of the pattern's rectangles, shape (n, 4) [m].
    pattern: Array
    #: x and y, width and height of the lines of the rulers, shape (n, 4) [m].
    lines: Array
    #: Texts, in a font of `TEXT_SIZE`.
    texts: tuple[Text, ...]
    #: Title of the document.
    title: str


def page_of(board: Board, sheet: Sheet, lines: Sequence[str]) -> Page:
    """Lay out the page of a board: pattern, rulers and lines of text on a sheet.

    Args:
        board: The board.
        sheet: The paper and the place of the pattern on it.
        lines: Lines of text, at most three, to print below the pattern.

    Returns:
        The page.

    Raises:
        CalibError: OpenCV, which has the markers, is not installed.
    """
    pattern = black_rectangles(board)
    pattern[:, :2] += sheet.origin
    x, y = sheet.origin
    below = y + board.size[1] + sheet.quiet

    # The ruler below the pattern, and the texts after its end.
    leftmost = max(EDGE + SIDE_BAND, min(x, sheet.width - EDGE - _RULER_AND_TEXT))
    length = _ruler_length(sheet.width - leftmost - EDGE)
    across = _ruler(length, inches=sheet.inches)
    across[:, :2] += (leftmost, below)
    end = leftmost + length + 0.001
    texts = [Text((end, below + TEXT_SIZE), f"{1e3 * length:.0f} mm")]
    if sheet.inches:
        inches = round(length / _INCH)
        texts.append(Text((leftmost + inches * _INCH + 0.001, below + 0.006), f"{inches} in"))

    # The ruler beside the pattern, its ticks pointing away; its texts stay as narrow as it is.
    left = x - sheet.quiet - SIDE_BAND
    length = _ruler_length(below - y)
    down = _ruler(length, inches=sheet.inches)[:, [1, 0, 3, 2]]
    down[:, 0] = SIDE_BAND - down[:, 0] - down[:, 2]
    down[:, :2] += (left, y)
    bottom = float(np.max(down[:, 1] + down[:, 3]))
    for k, word in enumerate((f"{1e3 * length:.0f}", "mm"), 1):
        texts.append(Text((left + 0.0015, bottom + k * _LEADING), word))

    for k, line in enumerate(lines):
        texts.append(Text((end + _GAP, below + TEXT_SIZE + k * _LEADING), line))
    return Page(
        sheet.width,
        sheet.height,
        pattern,
        np.concatenate([across, down]),
        tuple(texts),
        board.name,
    )


def _ruler_length(room: float) -> float:
    """Return the length of the longest ruler that fits into ``room`` [m], or else of the shortest [m]."""
    fitting = [length for length in _RULERS if length <= room]
    return fitting[0] if fitting else _RULERS[-1]


def _ruler(length: float, *, inches: bool) -> Array:
    """Return x, y, width and height of the lines of a ruler along x, its ticks downwards from y = 0, shape (n, 4) [m].

    The length is that between the middles of the first and the last tick. Ticks of inches hang from a second line.
    """
    half = _LINE / 2.0
    fifty, ten, five = _TICKS
    lines = [(-half, 0.0, length + _LINE, _LINE)]
    for k in range(round(length / _STEP) + 1):
        tick = five
        if k % 10 == 0:
            tick = fifty
        elif k % 2 == 0:
            tick = ten
        lines.append((k * _STEP - half, _LINE, _LINE, tick - _LINE))
    if inches:  # 4 below 100 mm, 2 below 50 mm
        count = round(length / _INCH)
        level = fifty + 0.001
        lines.append((-half, level, count * _INCH + _LINE, _LINE))
        lines += [(k * _INCH - half, level + _LINE, _LINE, ten) for k in range(count + 1)]
    return np.array(lines)


# Files

#: Points, the unit of PDF, in a millimetre.
_POINTS = 72.0 / 25.4


def _mm(length: float) -> str:
    """Return a length [m] as text in millimetres, to 0.1 um, without trailing zeros."""
    return f"{1e3 * length:.4f}".rstrip("0").rstrip(".")


def svg(page: Page) -> bytes:
    """Write a page as SVG, whose unit is the millimetre.

    Args:
        page: The page.

    Returns:
        The content of the file.
    """
    width, height = _mm(page.width), _mm(page.height)
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}mm" height="{height}mm" '
        f'viewBox="0 0 {width} {height}">',
        f"<title>{escape(page.title)}</title>",
        f'<rect width="{width}" height="{height}" fill="white"/>',
        f'<path id="pattern" fill="black" d="{_svg_path(page.pattern)}"/>',
        f'<path id="rulers" fill="black" d="{_svg_path(page.lines)}"/>',
        f'<g font-family="Helvetica, Arial, sans-serif" font-size="{_mm(TEXT_SIZE)}">',
    ]
    for text in page.texts:
        x, y = map(_mm, text.at)
        lines.append(f'<text x="{x}" y="{y}">{escape(text.text)}</text>')
    return "\n".join([*lines, "</g>", "</svg>", ""]).encode()


def _svg_path(rectangles: Array) -> str:
    """Write rectangles (n, 4), x, y, width and height [m], as the data of one SVG path in millimetres."""
    return "".join(f"M{x} {y}h{w}v{h}H{x}z" for x, y, w, h in _in_mm(rectangles))


def _in_mm(rectangles: Array) -> Iterator[list[str]]:
    """Yield x, y, width and height of each rectangle (n, 4) [m] as text in millimetres."""
    for rectangle in rectangles:
        yield [_mm(length) for length in rectangle]


def pdf(page: Page) -> bytes:
    """Write a page as PDF.

    Args:
        page: The page; in its texts, characters that are not Western European become question marks.

    Returns:
        The content of the file.
    """
    # The drawing, in millimetres: x to the right, y down.
    commands = [
        f"{_POINTS:.10f} 0 0 {-_POINTS:.10f} 0 {1e3 * page.height * _POINTS:.4f} cm 0 g".encode()
    ]
    for rectangles in (page.pattern, page.lines):
        path = [f"{x} {y} {w} {h} re" for x, y, w, h in _in_mm(rectangles)]
        commands.append("\n".join([*path, "f"]).encode())
    commands.append(f"BT /F1 {_mm(TEXT_SIZE)} Tf".encode())
    for text in page.texts:
        x, y = map(_mm, text.at)
        commands.append(f"1 0 0 -1 {x} {y} Tm ".encode() + b"(%s) Tj" % _pdf_text(text.text))
    content = b"\n".join([*commands, b"ET"])

    box = f"{1e3 * page.width * _POINTS:.4f} {1e3 * page.height * _POINTS:.4f}"
    font = b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>"
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {box}] /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R >> >> >>".encode(),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
        font,
        b"<< /Title (%s) /Creator (calib) >>" % _pdf_text(page.title),
    ]

    # The objects, the catalog first and the information last; then the table of where each begins.
    parts = [b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n"]
    places = []
    for number, entry in enumerate(objects, 1):
        places.append(sum(map(len, parts)))
        parts.append(b"%d 0 obj\n%s\nendobj\n" % (number, entry))
    start = sum(map(len, parts))
    entries = b"".join(b"%010d 00000 n \n" % place for place in places)
    size = len(objects) + 1
    parts.append(b"xref\n0 %d\n0000000000 65535 f \n%s" % (size, entries))
    parts.append(b"trailer\n<< /Size %d /Root 1 0 R /Info %d 0 R >>\n" % (size, len(objects)))
    parts.append(b"startxref\n%d\n%%%%EOF\n" % start)
    return b"".join(parts)


def _pdf_text(text: str) -> bytes:
    """Encode a text as the inside of a PDF string, in Windows-1252 with brackets and backslashes escaped."""
    encoded = text.encode("cp1252", errors="replace")
    for sign in (b"\\", b"(", b")"):
        encoded = encoded.replace(sign, b"\\" + sign)
    return encoded


#: Writers of pages by the ending of the file.
WRITERS: dict[str, Callable[[Page], bytes]] = {"pdf": pdf, "svg": svg}
