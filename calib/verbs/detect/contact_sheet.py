"""The contact sheet of a detection: every picture, small, with its corners and what became of it, on one HTML page."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from calib.basics.files import write_atomically
from calib.boards.detection.board_search import BoardView
from calib.boards.detection.detect import Detection
from calib.boards.detection.picture import Picture
from calib.show.page import check_ending, page_bytes
from calib.verbs.detect.text import findings_text, reason_text, summary


@dataclass(frozen=True, slots=True)
class Mark:
    """The corners of a board in a picture, as SVG."""

    #: The board's name.
    board: str
    #: Whether they are used.
    used: bool
    #: u and v of each corner, in the order of their ids, as text [px].
    corners: tuple[tuple[str, str], ...]
    #: The line through them, in the order of their ids.
    line: str


@dataclass(frozen=True, slots=True)
class Card:
    """A picture on the sheet."""

    name: str
    #: Name of the camera; "" without.
    camera: str
    used: bool
    #: What was found, or the reason why nothing is used.
    text: str
    width: int
    height: int
    #: Radius of the circle around a corner [px].
    radius: float
    #: The small picture as a data address; "" without one.
    address: str
    marks: tuple[Mark, ...]


def write_contact_sheet(detection: Detection, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write the contact sheet.

    Args:
        detection: What was detected.
        path: The file, .html.
        overwrite: Whether an existing file is overwritten.

    Returns:
        The path.

    Raises:
        FileError: The name has another ending, or the file exists or cannot be written.
    """
    check_ending(path)
    cards = tuple(cards_of(detection))
    content = {
        "document": "Contact sheet",
        "summary": summary(detection),
        "boards": [board.name for board in detection.boards],
        "findings": findings_text(detection),
        "cards": cards,
        "left_out": [card for card in cards if not card.used],
    }
    return write_atomically(
        path,
        page_bytes(Path(__file__).with_name("contact_sheet.html.j2"), content),
        overwrite=overwrite,
    )


def cards_of(detection: Detection) -> Iterator[Card]:
    """Yield a card for each picture, in their order."""
    for picture in detection.pictures:
        width, height = picture.size
        encoded = base64.b64encode(picture.small).decode("ascii")
        yield Card(
            name=picture.file.name,
            camera=picture.file.camera,
            used=bool(picture.used),
            text=_text(picture, detection.fewest),
            width=width,
            height=height,
            radius=max(width, height) / 130.0,
            address=f"data:image/jpeg;base64,{encoded}" if encoded else "",
            marks=tuple(_mark(picture, view) for view in picture.views if len(view.ids)),
        )


def _text(picture: Picture, fewest: int) -> str:
    """Write how many corners a picture has, or why none is used."""
    if not picture.used:
        return reason_text(picture, fewest)
    several = len(picture.views) > 1
    texts = []
    for view in picture.used:
        count = f"{len(view.ids)} corners"
        texts.append(f"{view.board}: {count}" if several else count)
    return ", ".join(texts)


def _mark(picture: Picture, view: BoardView) -> Mark:
    """Return the corners of a board as SVG."""
    corners = tuple((f"{u:.1f}", f"{v:.1f}") for u, v in view.pixels)
    return Mark(
        board=view.board,
        used=view.is_used and not picture.reason,
        corners=corners,
        line=" ".join(f"{u},{v}" for u, v in corners),
    )
