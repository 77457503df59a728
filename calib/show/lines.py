"""Paragraphs, lists and numbers as text: lines of 100 columns."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Sequence

#: Columns of a line, at most: what a terminal beside an editor shows without breaking lines.
WIDTH = 100


def fill(text: str, indent: str = "", hang: str = "") -> str:
    """Break a paragraph at 100 columns, but not within a word, however long.

    Args:
        text: The paragraph.
        indent: What stands before each line.
        hang: What follows the indent of all lines except the first.

    Returns:
        The lines, joined.
    """
    return textwrap.fill(
        text,
        WIDTH,
        initial_indent=indent,
        subsequent_indent=indent + hang,
        break_on_hyphens=False,
        break_long_words=False,
    )


def wrap(text: str, indent: str = "") -> str:
    """Break a paragraph at 100 columns with a hanging indent; longer words are broken too.

    Args:
        text: The paragraph.
        indent: What stands before each line; all except the first have two spaces more.

    Returns:
        The lines, joined, none of them longer than 100 columns.
    """
    return textwrap.fill(
        text,
        WIDTH,
        initial_indent=indent,
        subsequent_indent=indent + "  ",
        break_on_hyphens=False,
    )


def plural(count: int, noun: str) -> str:
    """Write a number of things whose plural has an s: ``1 row``, ``2,000 rows``."""
    return f"{count} {noun}" if count == 1 else f"{count:,} {noun}s"


def times(fewest: int, most: int) -> str:
    """Say how often something was done: ``1 time``, ``30 times``, ``3 to 30 times``.

    Args:
        fewest: The smallest number of times.
        most: The largest.
    """
    count = str(most) if fewest == most else f"{fewest} to {most}"
    return f"{count} times" if most > 1 else f"{count} time"


def row_ranges(rows: Iterable[int], limit: int = 12) -> str:
    """Write row numbers as text, consecutive ones as a range: ``4, 7 to 9``.

    Args:
        rows: The numbers, in any order.
        limit: The most numbers and ranges that are listed.

    Returns:
        The list; rows beyond the limit are counted: ``... and 5 more``.
    """
    runs: list[list[int]] = []
    for row in sorted(rows):
        if runs and row == runs[-1][1] + 1:
            runs[-1][1] = row
        else:
            runs.append([row, row])
    ranges = []
    for first, last in runs[:limit]:
        if last <= first + 1:
            ranges.append(f"{first}, {last}" if last > first else str(first))
        else:
            ranges.append(f"{first} to {last}")
    text = ", ".join(ranges)
    more = sum(last - first + 1 for first, last in runs[limit:])
    return f"{text} and {more} more" if more else text


def listed(parts: Sequence[str]) -> str:
    """Join parts of a sentence: ``a``, ``a and b``, ``a, b and c``."""
    *first, last = parts or [""]
    return f"{', '.join(first)} and {last}" if first else last


def number(value: float, digits: int = 3, sign: str = "-") -> str:
    """Format a number with so many digits after the point.

    Args:
        value: The number.
        digits: Digits after the decimal point.
        sign: ``"+"`` also marks positive numbers.

    Returns:
        The number, without a minus before a zero; a dash if it is not finite.
    """
    if not math.isfinite(value):
        return "-"
    return f"{round(value, digits) + 0.0:{sign}.{digits}f}"


def mm(value: float, digits: int = 3) -> str:
    """Format a length [m] in mm, without its unit; see `number`."""
    return number(1e3 * value, digits)


def deg(value: float, digits: int = 3) -> str:
    """Format an angle [rad] in degrees, without its unit; see `number`."""
    return number(float(math.degrees(value)), digits)


def paragraphs(*paragraphs: Iterable[str]) -> str:
    """Join paragraphs, each of lines, with empty lines between.

    Lines are broken at 100 columns, indented ones stay as they are; paragraphs without lines are left out.
    """
    texts = []
    for paragraph in paragraphs:
        lines = [line if line.startswith("  ") else fill(line) for line in paragraph]
        if lines:
            texts.append("\n".join(lines))
    return "\n\n".join(texts)
