"""A figure of a report: its caption, and how it is drawn and stored."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from matplotlib.figure import Figure

from calib.show.figure_base import check_kind, saved, styled


class Drawing(NamedTuple):
    """A figure of a calibration, not yet drawn."""

    #: Its file's name without the ending
    name: str
    #: Section of the report that it belongs to
    section: str
    #: Title
    title: str
    #: Caption: rows, units, and the meaning of lines and marks
    caption: str
    #: Draws it anew
    draw: Callable[[], Figure]


def rendered(drawing: Drawing, kind: str = "png") -> bytes:
    """Draw a figure and return its file; the same figure gives the same bytes.

    Args:
        drawing: The figure.
        kind: One of `calib.show.figure_base.KINDS`.

    Raises:
        FileError: Another kind.
    """
    check_kind(kind)
    with styled():
        return saved(drawing.draw(), kind, drawing.title, drawing.caption)
