"""The contact sheet of a detection: every picture, small, with its corners and what became of it, on one HTML page."""

from __future__ import annotations

import base64
from pathlib import Path

from calib.basics.files import write_atomically
from calib.boards.detection.detect import Detection
from calib.boards.detection.picture import Picture
from calib.show.page import check_ending, page_bytes
from calib.verbs.detect.text import findings_text, reason_text, summary


def write_contact_sheet(detection: Detection, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write the contact sheet.

    Args:
        detection: What was detected.
        path: The file, .html.
        overwrite: True to overwrite an existing file.

    Returns:
        The path.

    Raises:
        FileError: The name has another ending, or the file exists or cannot be written.
    """
    check_ending(path)
    cards = []
    for picture in detection.pictures:
        encoded = base64.b64encode(picture.small).decode("ascii")
        address = f"data:image/jpeg;base64,{encoded}" if encoded else ""
        cards.append((picture, _text(picture, detection.fewest), address))
    content = {
        "document": "Contact sheet",
        "summary": summary(detection),
        "boards": [board.name for board in detection.boards],
        "findings": findings_text(detection),
        "cards": cards,
        "not_used": len(detection.pictures) - len(detection.used),
    }
    template = Path(__file__).with_name("contact_sheet.html.j2")
    return write_atomically(path, page_bytes(template, content), overwrite=overwrite)


def _text(picture: Picture, fewest: int) -> str:
    """Write how many corners of a picture are used, or why none are."""
    if not picture.used:
        return reason_text(picture, fewest)
    several = len(picture.views) > 1
    texts = []
    for view in picture.used:
        count = f"{len(view.ids)} corners"
        texts.append(f"{view.board}: {count}" if several else count)
    return ", ".join(texts)
