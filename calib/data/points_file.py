"""Lists of points as laser tracker programs write them, and which row of a table each point belongs to."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from calib.data.columns import POINT
from calib.data.plausibility import implausible_length as implausible
from calib.data.table import Column, Table, read_text
from calib.errors import MeasurementError, choices, did_you_mean
from calib.units import UNITS, Unit, symbols

#: Between collection, group and point.
PARTS = "::"

#: In the order in which they are tried; the last one stands for any number of blanks.
_SEPARATORS = (";", "\t", ",", " ")

_COMMENT = ("#", "//", "!", "%", ";")
_RULE = re.compile(r"[-=_*+\s]+")
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")
_WORDS = re.compile(r"[^\W\d_]+")

# What the column of names is called in a header; the first two stand before the point's own.
_NAMES = (
    *("collection", "coll", "group", "pointgroup", "point group", "group name"),
    *("point", "name", "pointname", "point name", "point id", "pointid", "id", "label", "target"),
)

# "in" is also a word, so it only counts where no other unit stands.
_UNIT_WORDS = {
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), "cm"),
    **dict.fromkeys(("um", "µm", "μm", "micron", "microns", "micrometer", "micrometers"), "um"),
    **dict.fromkeys(("inch", "inches"), "in"),
    **dict.fromkeys(("ft", "foot", "feet", "yd", "yard", "yards"), "ft"),
}


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """N measured points of a file."""

    #: With collection and group before them, ``"A::Main::P1"``, if the file has them; empty without.
    names: tuple[str, ...]
    points: NDArray[np.float64]  #: Positions, shape (N, 3), [m], read-only.
    lines: tuple[int, ...]  #: Of the file, for each point.
    source: str  #: The file's name, for messages.
    sha256: str  #: Of the file's bytes.

    def of_rows(self, source: str, rows: Sequence[int], names: Sequence[str] | None) -> list[int]:
        """Which point, from 0, each row of a table has, by its name, or in their order where names are None.

        -1 for rows whose point was not measured yet: none if the list has points that nobody names, for then a name is
        more likely misspelt.

        Raises:
            MeasurementError: A row's point is not there, is several, or is that of another row; or the counts differ.
        """
        if names is None:
            if len(self.points) != len(rows):
                raise MeasurementError(
                    f"{self.source} has {len(self.points)} points and {source} {len(rows)} rows to match them with, in "
                    "their order. Add a column 'point' with the points' names, or remove what has no counterpart."
                )
            return list(range(len(rows)))
        at: dict[str, list[int]] = {}
        for part in (_last, str):  # a whole name wins
            own: dict[str, list[int]] = {}
            for i, whole in enumerate(self.names):
                own.setdefault(part(whole), []).append(i)
            at |= own
        found = [at.get(name, []) for name in names]
        complete = {i for hits in found for i in hits} == {*range(len(self.points))}
        taken: dict[int, int] = {}  # point: row
        for row, name, hits in zip(rows, names, found, strict=True):
            fault = ""
            if len(hits) > 1:
                lines = ", ".join(str(self.lines[i]) for i in hits[:8])
                whole = choices(dict.fromkeys(self.names[i] for i in hits))
                fault = f"several points are called '{name}', in lines {lines}; write the whole name: {whole}"
            elif not hits and not complete:
                near = did_you_mean(name, [*self.names, *map(_last, self.names)][:1000])
                fault = f"there is no point '{name}'{near}; it has {choices(self.names)}"
            elif hits and taken.setdefault(hits[0], row) != row:
                fault = (
                    f"row {taken[hits[0]]} names the point '{name}' too, which was measured once"
                )
            if fault:
                raise MeasurementError(
                    f"{source}, row {row}: in {self.source} {fault}. Correct the name or remove the row; where the "
                    'points are in the order of the rows, --columns "point=-" does without names.'
                )
        return [hits[0] if hits else -1 for hits in found]


def _last(name: str) -> str:
    """The point's own name, without collection and group."""
    return name.rpartition(PARTS)[2].strip()


def read_points(path: str | Path, unit: str | None = None) -> Points:
    """Read a list of points: a name and x, y, z in each line, and what follows is not used.

    The cells are separated by blanks, tabs, commas or semicolons. Lines before the first point, and those that begin
    with #, //, !, % or ;, are remarks. A header with the cells x, y, z tells the order; without one the three
    numbers behind the name count. The unit comes from a remark (``Units: mm``), from the header (``x [mm]``) or from
    ``unit``.

    Raises:
        MeasurementError: No such file, no points in it, no unit or two; the text names the file and the line.
    """
    source, sha256, text = read_text(path, "The list of points")
    remarks: list[str] = []
    headings: list[str] = []  # the remarks above the first point
    separator = ""
    lines: list[int] = []
    cells: list[list[str]] = []
    for number, line in enumerate(text.split("\n"), 1):
        remark = _remark(line)
        if remark is None and not lines:
            tried = ((s, _split(line, s)) for s in _SEPARATORS)
            separator = next(
                (s for s, c in tried if any(_has_point(c, i) for i in range(len(c)))), ""
            )
            remark = None if separator else line.strip()
        if remark is None:
            lines.append(number)
            cells.append(_split(line, separator))
        elif remark:
            remarks.append(remark)
            headings += [] if lines else [remark]
    if not lines:
        raise MeasurementError(
            f"{source}: no line of it holds three numbers. A list of points has lines such as 'P1 100.0 200.0 300.0', "
            "separated by blanks, tabs, commas or semicolons."
        )
    width = max(map(len, cells))
    padded = tuple([*row, *[""] * (width - len(row))] for row in cells)
    table = Table(source, sha256, separator, (), tuple(lines), padded)
    named, at = _columns(table, headings)
    length = _find_unit(remarks, unit, source)
    columns = [Column(i, axis, axis, length.symbol) for i, axis in zip(at, POINT, strict=True)]
    values = table.numbers(columns)
    for i in np.flatnonzero(~np.isfinite(values).all(axis=1)):
        _refuse(table, int(i))
    fault = implausible(values, [length] * 3)
    if fault is not None:
        raise MeasurementError(f"{source}, line {lines[fault[0]]}: {fault[2]}")
    metres = values * length.to_si
    metres.setflags(write=False)
    sign = " " if separator == " " else PARTS
    names = tuple(sign.join(row[i] for i in named) for row in padded) if named else ()
    return Points(names, metres, table.lines, source, sha256)


def _refuse(table: Table, row: int) -> NoReturn:
    """Refuse a line that does not fit the others."""
    raise MeasurementError(
        f"{table.source}, line {table.lines[row]}: '{' '.join(table.cells[row]).strip()[:80]}' has not its three "
        "numbers where the other lines have theirs. Correct or remove the line, or make it a comment with #."
    )


def _remark(line: str) -> str | None:
    """What a comment, a blank line or a ruled one says; None for any other line."""
    plain = line.strip().strip('"').strip()
    if _RULE.fullmatch(plain) or not plain.strip(",;"):
        return ""
    return plain.lstrip("".join(_COMMENT)).strip() if plain.startswith(_COMMENT) else None


def _split(line: str, separator: str) -> list[str]:
    """The stripped cells of a line, without the empty ones at its end."""
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
    """Whether three numbers stand there, with a decimal point or comma."""
    three = cells[start : start + 3]
    return len(three) == 3 and all(map(_NUMBER.fullmatch, three))


def _columns(table: Table, headings: Sequence[str]) -> tuple[list[int], list[int]]:
    """The columns of the names, none when there are none, and those of x, y, z: by the last header that has these."""
    cells = table.cells
    width = len(cells[0])
    for remark in reversed(headings):
        names = _split(remark, table.separator)
        names = [re.sub(r"\s*[\[(].*", "", name).casefold() for name in names]
        # Between blanks a column's name may be of two words: then the header says nothing of places.
        fits = len(names) >= width if table.separator != " " else len(names) == width
        if fits and all(names.count(axis) == 1 for axis in POINT):
            at = [names.index(axis) for axis in POINT]
            named = [names.index(name) for name in _NAMES if names.count(name) == 1]
            return named or list(range(min(at))), at
    first = next(i for i in range(width) if _has_point(cells[0], i))
    here = (i for i in range(width - 2) if all(_has_point(row, i) for row in cells))
    start = next(here, None)
    if start is None:
        _refuse(table, next((i for i, row in enumerate(cells) if not _has_point(row, first)), -1))
    # Whole numbers there, and three more behind, name the points, unless the names before do.
    counted = all(row[start].isdigit() and _has_point(row, start + 1) for row in cells)
    if counted and len({tuple(row[:start]) for row in cells}) < len(cells):
        rest = [cell for row in cells for cell in row[start + 1 : start + 4]]
        if all(cell.lstrip("+-").isdigit() for cell in rest):
            raise MeasurementError(
                f"{table.source}, line {table.lines[0]}: all are whole numbers, so the point's number cannot be told "
                "from x. Write a header line above the points, 'name x y z'."
            )
        start += 1
    return list(range(start)), [start, start + 1, start + 2]


def _find_unit(remarks: Sequence[str], given: str | None, source: str) -> Unit:
    """The unit of the coordinates, from the file or as given; both agree."""
    named = dict.fromkeys(filter(None, [*map(_unit_of, remarks), given]))
    if len(named) != 1 or not {*named} <= {*symbols("length")}:
        raise MeasurementError(
            f"{source}: the points need one unit of length, and {choices(named) if named else 'none'} is named. Write "
            f"a first line '# Units: mm', or give it (--points-unit mm); allowed are {choices(symbols('length'))}."
        )
    return UNITS[next(iter(named))]


def _unit_of(remark: str) -> str:
    """The unit of length that a remark names: behind the word unit, behind x, or alone; ``"ft"`` for a strange one."""
    plain = remark.casefold()
    behind = re.search(r"\bunits?\b(.*)", plain) or re.search(r"\bunit[^\W\d_]*\b(.*)", plain)
    bracket = re.search(r"\bx\s*[\[(]\s*([^\W\d_]+)\s*[\])]", plain)
    words = _WORDS.findall(behind[1] if behind else plain)
    if bracket:
        words = [bracket[1]]
    elif not behind and len(words) != 1:
        words = []
    known = [_UNIT_WORDS[word] for word in words if word in _UNIT_WORDS]
    return known[0] if known else "in" if words[:1] == ["in"] else ""
