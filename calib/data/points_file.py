"""Lists of points as laser tracker programs write them: a name and three numbers a line, in many ways.

The decimal sign of a file may be a point or a comma, and a sign may stand between thousands. A sign with other than
three digits after it is decimal, one that occurs twice in a number stands between thousands, and of two in one number
the last is decimal. Numbers such as 1,992 and 1.992 may be either: the other numbers of the file decide.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Sequence
from itertools import pairwise, takewhile
from pathlib import Path
from typing import NoReturn

import numpy as np

from calib.basics.arrays import read_only
from calib.basics.tables import Column, Table, read_text
from calib.basics.units import UNITS, Unit, symbols
from calib.data.columns import POINT
from calib.data.forms.points import PARTS, Points
from calib.data.plausibility import implausible_length
from calib.errors import MeasurementError, choices

#: In the order in which they are tried; the last one stands for any number of blanks.
_SEPARATORS = (";", "\t", ",", " ")

#: Beginnings of remarks.
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
    return parse_points(text, source, sha256, unit)


def parse_points(text: str, source: str, sha256: str = "", unit: str | None = None) -> Points:
    r"""Read a list of points from its text, see `read_points`.

    Args:
        text: The text, with lines that end in ``\n``.
        source: The file's name, for messages.
        sha256: Hash of the file's bytes.
        unit: Symbol of the unit of the coordinates; None: the text names it.

    Returns:
        The points, in metres.

    Raises:
        MeasurementError: No points, no unit or two; the text names the file and the line.
    """
    written = text.split("\n")
    plain_lines = [_without_labels(line) for line in written]
    first = next((i for i, line in enumerate(written) if holds_point(line)), None)
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

    named = [
        Column(i, axis, axis, length_unit.symbol)
        for i, axis in zip(point_columns, POINT, strict=True)
    ]
    values = table.numbers(named)
    incomplete = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if incomplete.size:
        _refuse(table, int(incomplete[0]))
    fault = implausible_length(values, [length_unit] * 3)
    if fault is not None:
        raise MeasurementError(f"{source}, line {lines[fault.row]}: {fault.what}")
    metres = read_only(values * length_unit.to_si)

    names: tuple[str, ...] = ()
    if name_columns:
        between = " " if separator == " " else PARTS
        names = tuple(between.join(row[i] for i in name_columns).rstrip(":") for row in cells)
    return Points(names, metres, table.lines, source, sha256, length_unit.symbol)


def holds_point(line: str) -> bool:
    """Return True if a line of a list holds a point, that is three numbers."""
    plain_line = _without_labels(line)
    return _remark(plain_line) is None and bool(_separator_of(plain_line))


def _without_labels(line: str) -> str:
    """Return a line with labels between its numbers as name and numbers between tabs; any other line as it is."""
    labelled = _LABELS.fullmatch(line.rstrip())
    if labelled is None or _remark(line) is not None:
        return line
    name = labelled["name"].strip(" \t,;:=({\"'")
    numbers = [number.rstrip(".,") for number in labelled.groups()[1:]]
    return "\t".join([name, *numbers] if name else numbers)


def _separator_of(line: str) -> str:
    """Return the separator by which a line holds a point; empty if it holds none."""
    for separator in _SEPARATORS:
        cells = _split(line, separator)
        if any(_has_point(cells, i) for i in range(len(cells))):
            return separator
    return ""


def _refuse(table: Table, row: int) -> NoReturn:
    """Refuse a line, by its row from 0, that does not fit the others; always raises MeasurementError."""
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
    """Return the indices of the columns of names (none without names) and of x, y, z; a heading may be their header.

    Without one they follow from the numbers. MeasurementError if these are ambiguous, or a line has other columns.
    """
    width = len(table.cells[0])
    for heading in reversed(headings):
        words = _split(heading, table.separator)
        names = [re.sub(r"\s*[\[(].*", "", word).casefold() for word in words]
        # Between blanks a heading may be of two words: then the header says nothing of positions.
        fits = len(names) == width if table.separator == " " else len(names) >= width
        if fits and all(names.count(axis) == 1 for axis in POINT):
            point_columns = [names.index(axis) for axis in POINT]
            name_columns = [names.index(name) for name in _NAMES if names.count(name) == 1]
            return name_columns or list(range(min(point_columns))), point_columns

    x = _first_coordinate(table)
    if _is_numbered(table, x):
        x += 1
    if table.separator == ",":
        _check_no_thousands(table, x)
    return list(range(x)), [x, x + 1, x + 2]


def _check_no_thousands(table: Table, x: int) -> None:
    """Refuse, by MeasurementError, numbers that a comma between their thousands seems to have parted into two cells.

    So it seems if some lines have more numbers than others, counted from the column x on, or if each has a number such
    as 1,992.4945.
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


def _first_coordinate(table: Table) -> int:
    """Return the first column, from 0, from which on all lines have three numbers; MeasurementError if none is."""
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
    """Return True if whole numbers in a column, by its index, name the points, and the coordinates follow.

    That is so if three more numbers follow, unless the cells before already name each point. Coordinates that are whole
    numbers too are ambiguous: MeasurementError.
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
    """Return the unit of length that remarks or ``given`` name; MeasurementError if none does, or they differ."""
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
    after = re.search(r"\bunits?\b(.*)", plain) or re.search(r"\bunit[^\W\d_]*\b(.*)", plain)
    if bracket:
        words = [bracket[1]]
    elif after:
        words = _WORDS.findall(after[1])
    else:
        words = _WORDS.findall(plain)
        if len(words) != 1:
            return ""
    known = [_UNIT_WORDS[word] for word in words if word in _UNIT_WORDS]
    if known:
        return known[0]
    return "in" if words[:1] == ["in"] else ""


# Numbers

#: Between thousands, and never decimal: the apostrophe, and blanks at which no line is broken.
_BETWEEN_THOUSANDS = "'\N{NO-BREAK SPACE}\N{NARROW NO-BREAK SPACE}"

#: A number in any of the ways.
NUMERAL = re.compile(
    r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+"
    r"|\d{1,3}(?:,\d{3})+(?:\.\d*)?|\d{1,3}(?:\.\d{3})+(?:,\d*)?"
    rf"|\d{{1,3}}(?:[{_BETWEEN_THOUSANDS}]\d{{3}})+(?:[.,]\d*)?)(?:[eE][+-]?\d+)?"
)

#: A number whose one sign is decimal or stands between thousands.
_EITHER = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")

#: A remark that says which sign is decimal: ``Decimal: comma``.
_REMARK = re.compile(
    r"\bdecimals?\b[^.,\w]*(?:sign|separator)?[^.,\w]*(comma\b|point\b|[.,])", re.IGNORECASE
)

#: Signs by what remarks call them.
_SIGNS = {"comma": ",", "point": ".", ",": ",", ".": "."}


def decimal_sign_in(remarks: Iterable[str]) -> str | None:
    """Return the decimal sign that a remark names; None if none does."""
    for remark in remarks:
        found = _REMARK.search(remark)
        if found:
            return _SIGNS[found[1].casefold()]
    return None


def decimal_sign_of(
    numerals: Iterable[tuple[int, str]], source: str, stated: str | None = None
) -> str:
    """Determine the decimal sign of the numbers of a file from all of them together.

    Args:
        numerals: Line of each number, from 1, and the number as written; anything else is ignored.
        source: The file's name, for messages.
        stated: The sign that the file states; None: it states none.

    Returns:
        ``"."`` or ``","``; ``"."`` if nothing decides and no number has a comma: 1.992 alone is less than 2.

    Raises:
        MeasurementError: Numbers contradict each other or what is stated, or there are commas, each with three digits
            after it, and nothing decides what they are.
    """
    # The first line with each meaning of each sign.
    decimal: dict[str, int] = {}
    thousands: dict[str, int] = {}
    either: dict[str, int] = {}
    for line, text in numerals:
        signs = [character for character in text if character in ".,"]
        if not signs or not NUMERAL.fullmatch(text):
            continue
        if _EITHER.fullmatch(text):
            either.setdefault(signs[0], line)
        elif len(signs) == 1:
            decimal.setdefault(signs[0], line)
        else:
            thousands.setdefault(signs[0], line)
            if signs[-1] != signs[0]:
                decimal.setdefault(signs[-1], line)
    if stated is not None:
        decimal.setdefault(stated, 1)

    fault = ""
    if len(decimal) == 2:
        fault = f"a decimal point in line {decimal['.']} and a decimal comma in line {decimal[',']}"
    elif len(thousands) == 2:
        fault = (
            f"points between thousands in line {thousands['.']} and commas in line {thousands[',']}"
        )
    elif decimal.keys() & thousands.keys():
        sign = next(iter(decimal))
        fault = f"'{sign}' as the decimal sign in line {decimal[sign]} and between thousands in line {thousands[sign]}"
    if fault:
        raise MeasurementError(
            f"{source}: numbers have {fault}. Write all in one way, without thousands separators."
        )

    if decimal:
        return next(iter(decimal))
    if thousands:
        return "." if "," in thousands else ","
    if "," in either:
        raise MeasurementError(
            f"{source}, line {either[',']}: a comma may be decimal or stand between thousands: three digits follow "
            "each, and nothing else decides. Write a first line '# Decimal: comma' or '# Decimal: point'."
        )
    return "."


def plain(text: str, decimal_sign: str) -> str:
    """Return a number with a decimal point and nothing between thousands; anything else stays as it is.

    Args:
        text: As written.
        decimal_sign: Which of ``"."`` and ``","`` is decimal; the other stands between thousands.
    """
    if not NUMERAL.fullmatch(text):
        return text
    between = "," if decimal_sign == "." else "."
    for character in (between, *_BETWEEN_THOUSANDS):
        text = text.replace(character, "")
    return text.replace(",", ".")
