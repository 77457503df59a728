"""Pages as SVG and as PDF, true to scale: rectangles and text, no bitmap.

All rectangles of a pattern are one path, so that no hairlines appear between neighbours when it is rasterised. The PDF
asks viewers not to scale it for printing (PDF 32000-1, 12.2, PrintScaling).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from xml.sax.saxutils import escape

from calib.basics.arrays import Array
from calib.boards.page import TEXT_SIZE, Page

#: Points, the unit of PDF, in a millimetre.
_POINTS = 72.0 / 25.4


def _mm(length: float) -> str:
    """Write a length in millimetres, to 0.1 um."""
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
    """Write rectangles as the data of one path."""
    return "".join(f"M{x} {y}h{w}v{h}H{x}z" for x, y, w, h in _in_mm(rectangles))


def _in_mm(rectangles: Array) -> Iterator[list[str]]:
    """Yield x, y, width and height of each rectangle as text in millimetres."""
    for rectangle in rectangles:
        yield [_mm(length) for length in rectangle]


def pdf(page: Page) -> bytes:
    """Write a page as PDF.

    Args:
        page: The page; in its texts, characters that are not Western European become question marks.

    Returns:
        The content of the file.
    """
    content = _pdf_content(page)
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


def _pdf_content(page: Page) -> bytes:
    """Write the drawing: in millimetres, x to the right, y down."""
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
    return b"\n".join([*commands, b"ET"])


def _pdf_text(text: str) -> bytes:
    """Write a text as the inside of a PDF string."""
    encoded = text.encode("cp1252", errors="replace")
    for sign in (b"\\", b"(", b")"):
        encoded = encoded.replace(sign, b"\\" + sign)
    return encoded


#: Writers of pages by the ending of the file.
WRITERS: dict[str, Callable[[Page], bytes]] = {"pdf": pdf, "svg": svg}
