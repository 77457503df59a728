"""Where the header of a table is: below titles, above a row of units, or in a comment; and what separates the cells.

People write titles above their tables, units in a row of their own below the names, and programs such as NumPy put the
header into a comment. A header is found by its units: nothing else in a table has several.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from typing import NamedTuple

from calib.basics.units import NUMBER, is_unit, split_header

#: Separators of cells; if several are equally frequent in the header, the first of them does. A blank separates them
#: only if none of the others is there; several blanks are one.
SEPARATORS = (",", ";", "\t", "|")
BLANK = " "

#: Separators that may stand at the ends of lines too, where they separate nothing.
FRAMED = ("|", BLANK)

#: A line of a text that is looked at: its number, from 1, and its text.
Line = tuple[int, str]

#: Most lines above the rows that are titles, names and units.
_MOST_ABOVE = 40

#: A cell that holds a number, in one of the ways in which people write it.
_NUMBER = re.compile(r"[-+\N{MINUS SIGN}\N{EN DASH}]?(?:\d[\d.,']*|[.,]\d+)(?:[eE][+-]?\d+)?")

#: A cell of a header between blanks: a name, and the unit in brackets after it.
_NAME = re.compile(r'(?:"[^"]*"|[^\s"]+)(?:\s*\[[^\]]*\]|\s+\([^)]*\))?')

#: Begin a row of units, and stand in it for none.
_OF_UNITS = ("unit", "units", "unit:", "units:")
_NO_UNIT = ("", "-", "--", "1", "[]", "[-]")


class Header(NamedTuple):
    """The header of a table."""

    #: What separates the cells of the table: one of `SEPARATORS`, or `BLANK`.
    separator: str
    #: The header and the lines below it.
    lines: list[Line]
    #: True if the line below the header holds the units.
    has_units_below: bool


def find_header(content: Sequence[Line], comments: Sequence[Line]) -> Header:
    """Find the header of a table.

    Args:
        content: The lines of the table that are not blank and no comments, at least one.
        comments: Its comments above the first of them, without the sign that begins a comment.

    Returns:
        The header, and what is below it.
    """
    above = []  # cells of the lines that may be titles, names and units
    for _, line in content[:_MOST_ABOVE]:
        cells = cells_of(line)
        if line.count('"') % 2 or _holds_numbers(cells):  # a cell of several lines begins a header
            break
        above.append(cells)
    if not above:
        return _commented(content, comments)
    place, has_units_below = _place(above)
    lines = list(content[place:])
    return Header(separator_of(lines), lines, has_units_below)


def _place(above: Sequence[Sequence[str]]) -> tuple[int, bool]:
    """Return the place of the header among lines without numbers, from 0, and True if units are in the next line."""
    filled = [sum(map(bool, cells)) for cells in above]
    for i, cells in enumerate(above):
        if i and filled[i - 1] > 1 and _is_row_of_units(cells, above[i - 1]):
            return i - 1, True
        with_unit = sum(is_unit(split_header(cell)[1] or "") for cell in cells)
        is_title = filled[i] == 1 and i + 1 < len(above) and filled[i + 1] > 1
        if not is_title and with_unit >= (2 if i else 1):
            return i, False
    # No unit tells: a title stands alone in its line.
    place = 0
    while place + 1 < len(above) and filled[place] == 1 < filled[place + 1]:
        place += 1
    return place, False


def _is_row_of_units(cells: Sequence[str], names: Sequence[str]) -> bool:
    """Return True if cells are units of the names above them, with or without brackets, at least two of them."""
    if len(cells) > len(names):
        return False
    units = cells[1:] if cells[0].casefold() in _OF_UNITS else cells
    given = [cell for cell in units if cell not in _NO_UNIT]
    return len(given) > 1 and all(is_unit(unit_in(cell)) for cell in given)


def unit_in(cell: str) -> str:
    """Return the symbol of a unit that stands alone in a cell, with or without brackets; empty if none stands there."""
    if cell in _NO_UNIT or cell.casefold() in _OF_UNITS:
        return ""
    name, symbol = split_header(cell)
    return cell if symbol is None else symbol if not name else ""


def _commented(content: Sequence[Line], comments: Sequence[Line]) -> Header:
    """Return the header of a table whose first line holds numbers: the last comment above, if it has as many cells."""
    lines = list(content)
    if comments:
        header = comments[-1]
        separator = separator_of([header, *lines])
        names = cells_of(header[1], separator)
        has_unit = any(split_header(name)[1] for name in names)
        if has_unit and len(names) == len(cells_of(lines[0][1], separator, is_header=False)):
            return Header(separator, [header, *lines], False)
    return Header(separator_of(lines), lines, False)


def separator_of(lines: Sequence[Line]) -> str:
    """Return what separates the cells of a table with this header and these rows."""
    header = lines[0][1]
    separator = max(SEPARATORS, key=header.count)
    if header.count(separator):
        return separator
    below = lines[1][1] if len(lines) > 1 else header
    several = len(cells_of(header, BLANK)) > 1 and len(below.split()) > 1
    return BLANK if several else SEPARATORS[0]


def cells_of(line: str, separator: str | None = None, *, is_header: bool = True) -> list[str]:
    """Return the stripped cells of one line.

    Args:
        line: The line.
        separator: One of `SEPARATORS`, or `BLANK`; None: as the line looks by itself.
        is_header: Whether a name and the unit in brackets after it are one cell between blanks.
    """
    if separator is None:
        separator = separator_of([(1, line)])
    if separator == BLANK and is_header:
        return [name.replace('"', "") for name in _NAME.findall(line)]
    plain = trimmed(line, separator)
    try:
        rows = list(csv.reader([plain], delimiter=separator, skipinitialspace=True))
    except csv.Error:  # a cell longer than the csv module reads
        return [line]
    return [cell.strip() for row in rows for cell in row]


def trimmed(line: str, separator: str) -> str:
    """Return a line without what stands at its ends and separates nothing: blanks, and the bars of a frame."""
    if separator == BLANK:
        return " ".join(line.replace("\t", " ").split()) if '"' not in line else line.strip()
    if separator == "|":
        return line.strip().removeprefix("|").removesuffix("|")
    return line


def _holds_numbers(cells: Sequence[str]) -> bool:
    """Return True if more than half of the cells that are not empty hold numbers, and not a title alone in its line."""
    filled = [cell for cell in cells if cell]
    numbers = [cell for cell in filled if _NUMBER.fullmatch(cell)]
    return len(numbers) > 1 and 2 * len(numbers) > len(filled)


def is_row(cells: Sequence[str]) -> bool:
    """Return True if cells are no header: numbers, some of which are no names of columns as 1, 2 and 3 may be."""
    if all(map(NUMBER.fullmatch, cells)):
        return True
    return _holds_numbers(cells) and any(
        _NUMBER.fullmatch(cell) and not cell.isdigit() for cell in cells
    )
