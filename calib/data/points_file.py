"""Lists of points as laser tracker programs write them."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from itertools import pairwise, takewhile
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from calib.basics.tables import Column, Table, read_text
from calib.basics.units import UNITS, Unit, symbols
from calib.data.columns import POINT
from calib.data.forms.numerals import NUMERAL, decimal_sign_in, decimal_sign_of, plain
from calib.data.forms.points import PARTS, Points
from calib.data.plausibility import implausible_length
from calib.errors import MeasurementError, choices

#: In the order in which they are tried; the last one stands for any number of blanks.
_SEPARATORS = (";", "\t", ",", " ")

#: What a remark begins with.
_COMMENT = ("#", "//", "!", "%", ";")

#: A ruled line.
_RULE = re.compile(r"[-=_*+\s]+")

#: A coordinate after its label, and what separates it from the next.
_LABELLED = r"[=:,;\s]+([+-]?[.,]?\d[\d.,']*(?:[eE][+-]?\d+)?)(?=[\s,;)}]|$)"

#: A line with labels between the numbers: ``P1 X 1 Y 2 Z 3``, ``P1: X=1, Y=2, Z=3``; what follows is not used.
_LABELS = re.compile(
    rf"(?P<name>.*?)(?<![^\s,;:({{])X{_LABELLED}[\s,;]*Y{_LABELLED}[\s,;]*Z{_LABELLED}.*",
    re.IGNORECASE,
)

#: A number that a comma between its thousands parted in two.
_PARTED = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}(?:\.\d*)?")

#: A word of a remark.
_WORDS = re.compile(r"[^\W\d_]+")

#: Headings of the columns of names, in the order in which a whole name has its parts.
_NAMES = (
    *("collection", "coll", "group", "pointgroup", "point group", "group name"),
    *("point", "name", "pointname", "point name", "point id", "pointid", "id", "label", "target"),
)

#: Symbols of units by the words for them. "in" is also a preposition, so it only counts if no other
#: unit is named.
_UNIT_WORDS = {
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), "cm"),
    **dict.fromkeys(("um", "µm", "μm", "micron", "microns", "micrometer", "micrometers"), "um"),
    **dict.fromkeys(("inch", "inches"), "in"),
    **dict.fromkeys(("ft", "foot", "feet", "yd", "yard", "yards"), "ft"),
}


def read_points(path: str | Path, unit: str | None = None) -> Points:
    """Read a list of points: a name and x, y, z in each line; what follows is not used.

    The cells are separated by blanks, tabs, commas or semicolons; there may be labels between the numbers, ``X 1 Y 2 Z
    3``. Lines before the first point, and those that begin with #, //, !, % or ;, are remarks. A header with the cells
    x, y, z gives the order; without one the three numbers after the name count. All coordinates together, or a remark
    (``Decimal: comma``), decide whether a comma is decimal or stands between thousands. The unit comes from a remark
    (``Units: mm``), from the header (``x [mm]``) or from ``unit``.

    Args:
        path: The file.
        unit: Symbol of the unit of the coordinates, ``"mm"``; None: the file names it.

    Returns:
        The points, in metres.

    Raises:
        MeasurementError: No such file, no points in it, no unit or two; the text names the file and the line.
    """
    source, sha256, text = read_text(path, "The list of points")
    written = text.split("\n")
    plain_lines = [_without_labels(line) for line in written]
    first = _first_point(plain_lines)
    if first is None:
        raise MeasurementError(
            f"{source}: no line of it holds three numbers. A list of points has lines such as "
            "'P1 100.0 200.0 300.0', separated by blanks, tabs, commas or semicolons."
        )
    headings = []
    for line in plain_lines[:first]:
        remark = _remark(line)
        headings.append(line.strip() if remark is None else remark)
    remarks = list(headings)
    if plain_lines[first] != written[first]:  # the labels are its header
        is_named = plain_lines[first].count("\t") == 3
        headings.append("name\tx\ty\tz" if is_named else "x\ty\tz")

    separator = _separator_of(plain_lines[first])
    lines: list[int] = []
    rows: list[list[str]] = []
    for number, line in enumerate(plain_lines[first:], first + 1):
        remark = _remark(line)
        if remark is None:
            lines.append(number)
            rows.append(_split(line, separator))
        else:
            remarks.append(remark)
    width = max(map(len, rows))
    cells = tuple([*row, *[""] * (width - len(row))] for row in rows)
    table = Table(source, sha256, separator, (), tuple(lines), cells)
    name_columns, point_columns = _columns(table, headings)
    length_unit = _find_unit(remarks, unit, source)

    numerals = [
        (line, row[i]) for line, row in zip(lines, cells, strict=True) for i in point_columns
    ]
    decimal_sign = decimal_sign_of(numerals, source, decimal_sign_in(remarks))
    for row in cells:
        for i in point_columns:
            row[i] = plain(row[i], decimal_sign)
    metres = _positions(table, point_columns, length_unit)

    names: tuple[str, ...] = ()
    if name_columns:
        between = " " if separator == " " else PARTS
        names = tuple(between.join(row[i] for i in name_columns).rstrip(":") for row in cells)
    return Points(names, metres, table.lines, source, sha256)


def _without_labels(line: str) -> str:
    """Return a line with labels between its numbers as name and numbers between tabs; any other line as it is."""
    labelled = _LABELS.fullmatch(line.rstrip())
    if labelled is None or _remark(line) is not None:
        return line
    name = labelled["name"].strip(" \t,;:=({\"'")
    numbers = [number.rstrip(".,") for number in labelled.groups()[1:]]
    return "\t".join([name, *numbers] if name else numbers)


def _first_point(lines: Sequence[str]) -> int | None:
    """Return the index of the first line that holds a point; None without one."""
    for i, line in enumerate(lines):
        if _remark(line) is None and _separator_of(line):
            return i
    return None


def _separator_of(line: str) -> str:
    """Return the separator by which a line holds a point; empty if it holds none."""
    for separator in _SEPARATORS:
        cells = _split(line, separator)
        if any(_has_point(cells, i) for i in range(len(cells))):
            return separator
    return ""


def _positions(table: Table, columns: Sequence[int], unit: Unit) -> NDArray[np.float64]:
    """Return the positions of the points, shape (N, 3) [m], read-only, from the columns x, y, z of their lines."""
    named = [Column(i, axis, axis, unit.symbol) for i, axis in zip(columns, POINT, strict=True)]
    values = table.numbers(named)
    incomplete = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if incomplete.size:
        _refuse(table, int(incomplete[0]))
    fault = implausible_length(values, [unit] * 3)
    if fault is not None:
        raise MeasurementError(f"{table.source}, line {table.lines[fault.row]}: {fault.what}")
    metres = values * unit.to_si
    metres.setflags(write=False)
    return metres


def _refuse(table: Table, row: int) -> NoReturn:
    """Refuse a line, by its row from 0, that does not fit the others."""
    text = " ".join(table.cells[row]).strip()[:80]
    raise MeasurementError(
        f"{table.source}, line {table.lines[row]}: '{text}' has no three numbers in the columns "
        "where the other lines have them. Correct or remove the line, or make it a comment with #."
    )


# Lines


def _remark(line: str) -> str | None:
    """Return the text of a comment, empty for a blank or ruled line; None for any other line."""
    plain = line.strip().strip('"').strip()
    if _RULE.fullmatch(plain) or not plain.strip(",;"):
        return ""
    if not plain.startswith(_COMMENT):
        return None
    return plain.lstrip("".join(_COMMENT)).strip()


def _split(line: str, separator: str) -> list[str]:
    """Return the stripped cells of a line, without the empty ones at its end."""
    plain = line.replace("\t", " ") if separator == " " else line
    reader = csv.reader([plain.strip(" \r\n")], delimiter=separator, skipinitialspace=True)
    try:
        cells = [cell.strip() for row in reader for cell in row]
    except csv.Error:  # a cell longer than the csv module reads: no number in any case
        return []
    while cells and not cells[-1]:
        cells.pop()
    return cells


def _has_point(cells: Sequence[str], start: int) -> bool:
    """Return True if three cells from ``start`` on are numbers, with a decimal point or comma."""
    three = cells[start : start + 3]
    return len(three) == 3 and all(map(NUMERAL.fullmatch, three))


# Columns


def _columns(table: Table, headings: Sequence[str]) -> tuple[list[int], list[int]]:
    """Find the columns, from 0, of the names (none without names) and of x, y, z; a heading may be their header."""
    for remark in reversed(headings):
        columns = _columns_of_header(table, remark)
        if columns is not None:
            return columns
    x = _first_coordinate(table)
    if _is_numbered(table, x):
        x += 1
    if table.separator == ",":
        _check_no_thousands(table, x)
    return list(range(x)), [x, x + 1, x + 2]


def _check_no_thousands(table: Table, x: int) -> None:
    """Refuse numbers that a comma between their thousands, 1,992.4945, seems to have parted into two cells.

    That is so if some lines have more numbers than others, counted from the column of x, or if each has such a number.
    """
    counts, parted, parted_decimals = [], [], []
    for row in table.cells:
        numbers = list(takewhile(NUMERAL.fullmatch, row[x:]))
        pairs = [",".join(pair) for pair in pairwise(numbers[:4])]
        counts.append(len(numbers))
        parted.append(len(numbers) > 3 and any(map(_PARTED.fullmatch, pairs)))
        parted_decimals.append(parted[-1] and any("." in p for p in pairs if _PARTED.fullmatch(p)))
    if any(parted) and (len(set(counts)) > 1 or all(parted_decimals)):
        i = parted.index(True)
        raise MeasurementError(
            f"{table.source}, line {table.lines[i]}: '{','.join(table.cells[i])[:80]}' seems to have commas between "
            "thousands, and commas separate the cells too. Export it with semicolons or tabs, or with such numbers in "
            'double quotes; if all is right, write a header line above the points, "name,x,y,z" and a name for what '
            "follows."
        )


def _columns_of_header(table: Table, remark: str) -> tuple[list[int], list[int]] | None:
    """Return the columns of names and of x, y, z if a remark is a header, as `_columns` does."""
    width = len(table.cells[0])
    cells = _split(remark, table.separator)
    headings = [re.sub(r"\s*[\[(].*", "", cell).casefold() for cell in cells]
    # Between blanks a heading may be of two words: then the header says nothing of positions.
    fits = len(headings) == width if table.separator == " " else len(headings) >= width
    if not fits or any(headings.count(axis) != 1 for axis in POINT):
        return None
    point_columns = [headings.index(axis) for axis in POINT]
    name_columns = [headings.index(name) for name in _NAMES if headings.count(name) == 1]
    return name_columns or list(range(min(point_columns))), point_columns


def _first_coordinate(table: Table) -> int:
    """Return the first column from which on all lines have three numbers."""
    cells = table.cells
    width = len(cells[0])
    for start in range(width - 2):
        if all(_has_point(row, start) for row in cells):
            return start
    first = next(i for i in range(width) if _has_point(cells[0], i))
    for i, row in enumerate(cells):
        if not _has_point(row, first):
            _refuse(table, i)
    _refuse(table, -1)


def _is_numbered(table: Table, start: int) -> bool:
    """Return True if whole numbers in a column name the points, and the coordinates follow; refuse what is ambiguous.

    That is so if three more numbers follow, unless the cells before already name each point. Coordinates that are whole
    numbers too are ambiguous.
    """
    cells = table.cells
    names = set()
    only_whole_numbers = True
    for row in cells:
        if not row[start].isdigit() or not _has_point(row, start + 1):
            return False
        names.add(tuple(row[:start]))
        coordinates = row[start + 1 : start + 4]
        only_whole_numbers &= all(cell.lstrip("+-").isdigit() for cell in coordinates)
    if len(names) == len(cells):
        return False
    if only_whole_numbers:
        raise MeasurementError(
            f"{table.source}, line {table.lines[0]}: all are whole numbers, so the point's number "
            "cannot be distinguished from x. Write a header line above the points, 'name x y z'."
        )
    return True


# Units


def _find_unit(remarks: Sequence[str], given: str | None, source: str) -> Unit:
    """Return the unit of the coordinates that remarks or ``given`` name; they must agree."""
    named = dict.fromkeys(filter(None, [*map(_unit_of, remarks), given]))
    lengths = symbols("length")
    if len(named) != 1 or not {*named} <= {*lengths}:
        which = choices(named) if named else "none"
        raise MeasurementError(
            f"{source}: the points need one unit of length, and {which} is named. Write a first "
            "line '# Units: mm', or give it (--points-unit mm); allowed are "
            f"{choices(lengths)}."
        )
    return UNITS[next(iter(named))]


def _unit_of(remark: str) -> str:
    """Return the symbol of the unit of length that a remark names, empty if it names none.

    It is looked for in brackets after x, after the word unit, or alone; ``"ft"`` stands for feet
    and yards, which are refused.
    """
    plain = remark.casefold()
    bracket = re.search(r"\bx\s*[\[(]\s*([^\W\d_]+)\s*[\])]", plain)
    behind = re.search(r"\bunits?\b(.*)", plain) or re.search(r"\bunit[^\W\d_]*\b(.*)", plain)
    if bracket:
        words = [bracket[1]]
    elif behind:
        words = _WORDS.findall(behind[1])
    else:
        words = _WORDS.findall(plain)
        if len(words) != 1:
            return ""
    known = [_UNIT_WORDS[word] for word in words if word in _UNIT_WORDS]
    if known:
        return known[0]
    return "in" if words[:1] == ["in"] else ""
