"""Paragraphs and lists in words: lines of 100 columns."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    pass


WIDTH = 100


def fill(text: str, indent: str = "", hang: str = "") -> str:
    """One paragraph broken at 100 columns, nowhere within a name; ``hang`` is before every line but the first."""
    return textwrap.fill(
        text,
        WIDTH,
        initial_indent=indent,
        subsequent_indent=indent + hang,
        break_on_hyphens=False,
        break_long_words=False,
    )


def row_ranges(rows: Iterable[int], limit: int = 12) -> str:
    """Row numbers in words, runs of them as one: ``4, 7 to 9``; at most ``limit`` of these, then how many rows more."""
    runs: list[list[int]] = []
    for row in sorted(rows):
        if runs and row == runs[-1][1] + 1:
            runs[-1][1] = row
        else:
            runs.append([row, row])
    said = [
        str(a) if a == b else f"{a}{', ' if b == a + 1 else ' to '}{b}" for a, b in runs[:limit]
    ]
    rest = sum(b - a + 1 for a, b in runs[limit:])
    return ", ".join(said) + (f" and {rest} more" if rest else "")


def three(value: float, sign: str = "-") -> str:
    """Three digits after the point, and no minus before a zero."""
    return f"{round(value, 3) + 0.0:{sign}.3f}"


def wrap(text: str, indent: str = "") -> str:
    """Text broken at 100 columns."""
    hang = indent + "  "
    return textwrap.fill(
        text, WIDTH, initial_indent=indent, subsequent_indent=hang, break_on_hyphens=False
    )
