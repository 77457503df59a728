"""The contact sheet of a detection: every picture, small, with its corners and what became of it, on one HTML page."""

from __future__ import annotations

from pathlib import Path

from calib.basics.files import write_atomically
from calib.boards.detection.detect import Detection
from calib.boards.detection.picture import Picture
from calib.show.as_html import check_ending, page_bytes
from calib.show.blocks import (
    HTML,
    Bullets,
    Gallery,
    GalleryPicture,
    Page,
    Paragraph,
    Section,
    report_date,
)
from calib.verbs.detect.text import findings_text, reason_text, summary

_KEY = (
    "Circles: the corners found, in the order of the line; the first is yellow, and the line goes along the board's x "
    "first. Red ones are not used."
)


def write_contact_sheet(detection: Detection, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write the contact sheet, an HTML page with findings and with every picture and its corners.

    Args:
        detection: The corners, and the pictures that they are in.
        path: The file, .html.
        overwrite: True to overwrite an existing file.

    Returns:
        The path.

    Raises:
        FileError: The name has another ending, or the file exists or cannot be written.
    """
    check_ending(path)
    return write_atomically(path, page_bytes(contact_sheet(detection)), overwrite=overwrite)


def contact_sheet(detection: Detection) -> Page:
    """Lay out the contact sheet of a detection: findings, then every picture with its corners."""
    names = [board.name for board in detection.boards]
    date = report_date()
    made = f"By calib detect, {date}; {'board' if len(names) == 1 else 'boards'} {', '.join(names)}"
    findings = Bullets(findings_text(detection))
    pictures = [_gallery_picture(picture, detection.fewest) for picture in detection.pictures]
    sections = [
        Section(lambda: [Paragraph(made)], on=HTML),
        Section(lambda: [findings] if findings.items else [], "Findings", on=HTML),
        Section(lambda: [Gallery(pictures, _KEY)], on=HTML),
    ]
    return Page("Contact sheet", summary(detection), sections, date, is_sheet=True)


def _gallery_picture(picture: Picture, fewest: int) -> GalleryPicture:
    """Return a picture with its corners, and the text of how many are used of each board, or of why none are.

    ``fewest`` is the number of corners below which a board was not used.
    """
    several = len(picture.views) > 1
    counts = []
    for view in picture.used:
        count = f"{len(view.ids)} corners"
        counts.append(f"{view.board}: {count}" if several else count)
    return GalleryPicture(
        name=picture.file.name,
        camera=picture.file.camera,
        is_used=bool(picture.used),
        text=", ".join(counts) if picture.used else reason_text(picture, fewest),
        size=picture.size,
        jpeg=picture.small,
        marks=[
            (view.is_used and not picture.reason, view.pixels.tolist())
            for view in picture.views
            if len(view.ids)
        ],
    )
