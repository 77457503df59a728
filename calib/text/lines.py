"""Paragraphs, lists and numbers as text: lines of 100 columns."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable

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


def wrap(text: str, indent: str = "") -> str:
    """The same with a hanging indent; long words are broken."""
    hang = indent + "  "
    return textwrap.fill(
        text, WIDTH, initial_indent=indent, subsequent_indent=hang, break_on_hyphens=False
    )


def row_ranges(rows: Iterable[int], limit: int = 12) -> str:
    """Row numbers, runs of them as one: ``4, 7 to 9``; at most ``limit`` of these, then how many rows more."""
    runs: list[list[int]] = []
    for row in sorted(rows):
        if runs and row == runs[-1][1] + 1:
            runs[-1][1] = row
        else:
            runs.append([row, row])
    shown = [
        str(a) if a == b else f"{a}{', ' if b == a + 1 else ' to '}{b}" for a, b in runs[:limit]
    ]
    rest = sum(b - a + 1 for a, b in runs[limit:])
    return ", ".join(shown) + (f" and {rest} more" if rest else "")


def number(value: float, digits: int = 3, sign: str = "-") -> str:
    """A number with digits after the point; a dash where there is none, and no minus before a zero."""
    return f"{round(value, digits) + 0.0:{sign}.{digits}f}" if math.isfinite(value) else "-"


def mm(value: float, digits: int = 3) -> str:
    """A length [m] in mm, without its unit."""
    return number(1e3 * value, digits)


def deg(value: float, digits: int = 3) -> str:
    """An angle [rad] in degrees, without its unit."""
    return number(float(math.degrees(value)), digits)
