"""Lists of points as laser tracker programs write them, and which row of a table each point belongs to."""

from __future__ import annotations

import codecs
import csv
import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.data.checks import better_unit, check_signs, implausible
from calib.data.table import close_names
from calib.errors import FileError, MeasurementError, choices
from calib.files import read_bytes
from calib.units import UNITS, Unit, symbols

#: Between collection, group and point.
PARTS = "::"

#: In the order in which they are tried; the last one stands for any number of blanks.
_SEPARATORS = (";", "\t", ",", " ")

_COMMENT = ("#", "//", "!", "%", ";")
_RULE = re.compile(r"[-=_*+\s]+")
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")
_WORDS = re.compile(r"[^\W\d_]+")

# Behind the name of a column.
_UNIT = re.compile(r"\s*[\[(].*")

# What the column of names is called in a header; the first two stand before the point's own.
_NAMES = (
    ("collection", "coll"),
    ("group", "pointgroup", "point group", "group name"),
    ("point", "name", "pointname", "point name", "point id", "pointid", "id", "label", "target"),
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
    """N measured points of a file.

    Attributes:
        names: with collection and group before them, ``"A::Main::P1"``, if the file has them; empty without.
        points: positions, shape (N, 3), [m], read-only.
        lines: of the file, for each point.
        source: the file's name, for messages.
        sha256: of the file's bytes.
    """

    names: tuple[str, ...]
    points: NDArray[np.float64]
    lines: tuple[int, ...]
    source: str
    sha256: str

    def __len__(self) -> int:
        """The number of points, N."""
        return len(self.points)

    def index(self) -> dict[str, list[int]]:
        """Which points, from 0, have a name: the whole of it, or its last part."""
        found: dict[str, list[int]] = {}
        for name in (_last, str):
            own: dict[str, list[int]] = {}
            for i, whole in enumerate(self.names):
                own.setdefault(name(whole), []).append(i)
            found |= own  # a whole name wins
        return found

    def find(self, names: Sequence[str]) -> list[int | None]:
        """Which point has each of these names, from 0; None where none has.

        Raises:
            MeasurementError: several have.
        """
        at = self.index()
        for name in names:
            hits = at.get(name, [])
            if len(hits) > 1:
                whole = [self.names[i] for i in hits]
                lines = ", ".join(str(self.lines[i]) for i in hits[:8])
                fix = "Give each point a name of its own."
                if len(set(whole)) == len(whole):
                    fix = f"Write the whole name: {choices(whole)}."
                raise MeasurementError(
                    f"{self.source}: several points are called '{name}', in lines {lines}. {fix}"
                )
        return [at[name][0] if name in at else None for name in names]


def read_points(path: str | Path, unit: str | None = None) -> Points:
    """Read a list of points: a name and x, y, z in each line, and what follows is not used.

    The cells are separated by blanks, tabs, commas or semicolons. Lines before the first point, and those that begin
    with #, //, !, % or ;, are remarks. A header with the cells x, y, z tells the order; without one the three
    numbers behind the name count. The unit comes from a remark (``Units: mm``), from the header (``x [mm]``) or from
    ``unit``.

    Args:
        path: a text file.
        unit: a unit of length, where the file names none.

    Raises:
        MeasurementError: no such file, no points in it, no unit or two; the text names the file and the line.
    """
    source = Path(path).name or str(path)
    try:
        data = read_bytes(path, "The list of points")
    except FileError as error:
        raise MeasurementError(str(error)) from error
    remarks, headings, separator, lines = _take_apart(_decode(data, source), source)
    named, at = _columns(headings, separator, lines, source)
    metres = _metres(lines, at, _find_unit(remarks, unit, source), source)
    sign = " " if separator == " " else PARTS
    names = tuple(sign.join(line.cells[i] for i in named) for line in lines) if named else ()
    where = tuple(line.number for line in lines)
    return Points(names, metres, where, source, hashlib.sha256(data).hexdigest())


def match_points(
    points: Points, source: str, rows: Sequence[int], names: Sequence[str] | None
) -> NDArray[np.float64]:
    """The point of each of M rows of a table, shape (M, 3), [m], by their names; by their order where names are None.

    Raises:
        MeasurementError: a row's point is not there, or is that of another row; or the counts differ.
    """
    if names is None:
        if len(points) != len(rows):
            raise MeasurementError(
                f"{points.source} has {len(points)} points and {source} {len(rows)} rows to match "
                "them with, in their order. Add a column 'point' with the points' names to the "
                "table, or remove what has no counterpart."
            )
        return points.points
    if not points.names:
        raise MeasurementError(
            f"{points.source}: the points have no names, and {source} has a column 'point' to match "
            'them by. Add names to the points, or leave the column out: --columns "point=-".'
        )
    taken: dict[int, int] = {}  # point: row
    for row, name, i in zip(rows, names, points.find(names), strict=True):
        if i is None:
            close = close_names(name, [*points.names, *map(_last, points.names)])
            hint = f"Close to it: {choices(close)}" if close else f"It has {choices(points.names)}"
            raise MeasurementError(
                f"{source}, row {row}: {points.source} has no point '{name}'. {hint}. Correct the "
                "name, or remove the row; where the points are in the order of the rows, --columns "
                '"point=-" does without names.'
            )
        if i in taken:
            raise MeasurementError(
                f"{source}: the rows {taken[i]} and {row} both name the point '{name}'. What was "
                "measured once counts once: remove one of the rows."
            )
        taken[i] = row
    return points.points[list(taken)]


def unmeasured_points(points: Points, names: Sequence[str]) -> tuple[int, ...]:
    """Which of these names, from 0, are of points that were not measured yet.

    None if the file has points that nobody names: then the names are more likely misspelt.
    """
    found = points.find(names)
    used = set(found) - {None}
    if len(used) < len(points):
        return ()
    return tuple(i for i, at in enumerate(found) if at is None)


def _last(name: str) -> str:
    """The point's own name, without collection and group."""
    return name.rpartition(PARTS)[2].strip()


class _Line(NamedTuple):
    """A line of points: its number in the file and its stripped cells."""

    number: int
    cells: tuple[str, ...]


def _decode(data: bytes, source: str) -> str:
    """Text of bytes as measuring programs write them: UTF-8, UTF-16 with its mark, else Windows' own."""
    utf16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = data.decode("utf-16" if utf16 else "utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")
    if "\0" in text:
        raise MeasurementError(
            f"{source}: this is not a text file. Export the points as text (ASCII)."
        )
    return text


def _take_apart(text: str, source: str) -> tuple[list[str], list[str], str, list[_Line]]:
    """Remarks and headers without the sign of a comment, those above the first point, the separator, and the points."""
    remarks: list[str] = []
    headings: list[str] = []
    separator = ""
    lines: list[_Line] = []
    for number, line in enumerate(text.splitlines(), 1):
        remark = _remark(line)
        if remark is None and not lines:
            separator = _separator(line)
            remark = None if separator else line.strip()
        if remark is None:
            lines.append(_Line(number, _split(line, separator)))
        elif remark:
            remarks.append(remark)
            headings += [] if lines else [remark]
    if not lines:
        raise MeasurementError(
            f"{source}: no line of it holds three numbers. A list of points has lines such as "
            "'P1 100.0 200.0 300.0', separated by blanks, tabs, commas or semicolons."
        )
    return remarks, headings, separator, lines


def _remark(line: str) -> str | None:
    """What a comment, a blank line or a ruled one says; None for any other line."""
    plain = line.strip().strip('"').strip()
    if _RULE.fullmatch(plain) or not plain.strip(",;"):
        return ""
    return plain.lstrip("".join(_COMMENT)).strip() if plain.startswith(_COMMENT) else None


def _separator(line: str) -> str:
    """The sign that leaves three numbers side by side; "" when none does."""
    if len(re.findall(r"\d+", line)) < 3:  # most lines above the points
        return ""
    for separator in _SEPARATORS:
        cells = _split(line, separator)
        if any(_has_point(cells, i) for i in range(len(cells) - 2)):
            return separator
    return ""


def _split(line: str, separator: str) -> tuple[str, ...]:
    """The stripped cells of a line, without the empty ones at its end."""
    plain = line.replace("\t", " ") if separator == " " else line
    reader = csv.reader([plain.strip(" \r\n")], delimiter=separator, skipinitialspace=True)
    try:
        cells = [cell.strip() for row in reader for cell in row]
    except csv.Error:  # a cell longer than the csv module reads: no number in any case
        return ()
    while cells and not cells[-1]:
        cells.pop()
    return tuple(cells)


def _has_point(cells: Sequence[str], start: int) -> bool:
    """Whether three numbers stand there, with a decimal point or comma."""
    three = cells[start : start + 3]
    return len(three) == 3 and all(map(_NUMBER.fullmatch, three))


def _columns(
    headings: Sequence[str], separator: str, lines: Sequence[_Line], source: str
) -> tuple[list[int], list[int]]:
    """The columns of the names, none when there are none, and those of x, y, z."""
    heading = _heading(headings, separator, lines)
    if heading:
        at = [heading.index(axis) for axis in "xyz"]
        named = [heading.index(n) for part in _NAMES for n in part if heading.count(n) == 1]
        named = named or list(range(min(at)))
        short = next((line for line in lines if len(line.cells) <= max(*named, *at)), None)
        if short is not None:
            raise MeasurementError(_no_point(short, source))
        return named, at
    start = _first_number(lines, source)
    # Whole numbers there, and three more behind, name the points, unless the names before do.
    counted = all(
        line.cells[start].isdigit() and _has_point(line.cells, start + 1) for line in lines
    )
    if counted and len({line.cells[:start] for line in lines}) < len(lines):
        rest = [cell for line in lines for cell in line.cells[start + 1 : start + 4]]
        if all(cell.lstrip("+-").isdigit() for cell in rest):
            raise MeasurementError(
                f"{source}, line {lines[0].number}: all are whole numbers, so the point's number "
                "cannot be told from x. Write a header line above the points, 'name x y z'."
            )
        start += 1
    return list(range(start)), [start, start + 1, start + 2]


def _heading(headings: Sequence[str], separator: str, lines: Sequence[_Line]) -> list[str]:
    """The names of the columns, small, from the last header with x, y and z; none without one."""
    widths = [len(line.cells) for line in lines]
    for remark in reversed(headings):
        cells = [_UNIT.sub("", cell).casefold() for cell in _split(remark, separator)]
        # Between blanks a column's name may be of two words: then the header says nothing of places.
        fits = max(widths) <= len(cells) and (separator != " " or min(widths) == len(cells))
        if fits and all(cells.count(axis) == 1 for axis in "xyz"):
            return cells
    return []


def _first_number(lines: Sequence[_Line], source: str) -> int:
    """The first column from which on every line has three numbers."""
    for start in range(min(len(line.cells) for line in lines) - 2):
        if all(_has_point(line.cells, start) for line in lines):
            return start
    cells = lines[0].cells
    start = next(i for i in range(len(cells)) if _has_point(cells, i))
    bad = next((line for line in lines if not _has_point(line.cells, start)), lines[-1])
    raise MeasurementError(_no_point(bad, source))


def _no_point(line: _Line, source: str) -> str:
    """What to say of a line that does not fit the others."""
    return (
        f"{source}, line {line.number}: '{' '.join(line.cells)[:80]}' has not its three numbers where "
        "the other lines have theirs. Correct or remove the line, or make it a comment with #."
    )


def _metres(
    lines: Sequence[_Line], at: Sequence[int], unit: Unit, source: str
) -> NDArray[np.float64]:
    """The coordinates, shape (N, 3), [m], read-only; refused when they cannot be in this unit."""
    signs: dict[str, int] = {}  # decimal sign: the first line that has it
    values = np.empty((len(lines), 3))
    for i, line in enumerate(lines):
        cells = [line.cells[j] if j < len(line.cells) else "" for j in at]
        if not _has_point(cells, 0):
            raise MeasurementError(_no_point(line, source))
        for sign in (sign for sign in ".," if any(sign in cell for cell in cells)):
            signs.setdefault(sign, line.number)
        values[i] = [float(cell.replace(",", ".")) for cell in cells]
    check_signs(source, signs)
    metres = values * unit.to_si
    row, what = implausible(metres, unit)
    if what:
        value = float(values[row][np.argmax(np.abs(values[row]))])
        better = better_unit(value, unit)
        fix = f"If it is in {better}, say so: '# Units: {better}'." if better else "Correct it."
        raise MeasurementError(
            f"{source}, line {lines[row].number}: {value:.10g} was read as "
            f"{value * unit.to_si:.6g} m, {what}. {fix}"
        )
    metres.setflags(write=False)
    return metres


def _find_unit(remarks: Sequence[str], given: str | None, source: str) -> Unit:
    """The unit of the coordinates, from the file or as given; both agree."""
    named = list(dict.fromkeys(filter(None, map(_unit_of, remarks))))
    allowed = f"allowed are {choices(symbols('length'))}"
    units = [*named, *([given] if given and given not in named else [])]
    if not units:
        raise MeasurementError(
            f"{source}: the unit of the points is not in it. Write a first line '# Units: mm', or give it "
            f"(--points-unit mm); {allowed}."
        )
    if len(units) > 1:
        raise MeasurementError(
            f"{source}: several units of length are named, {choices(units)}. Leave one, as in '# Units: mm'."
        )
    if units[0] not in symbols("length"):
        raise MeasurementError(f"{source}: '{units[0]}' is not a unit of length; {allowed}")
    return UNITS[units[0]]


def _unit_of(remark: str) -> str:
    """The unit of length that a remark names: behind the word unit, behind x, or alone; ``"ft"`` for a strange one."""
    plain = remark.casefold()
    behind = re.search(r"\bunits?\b(.*)", plain) or re.search(r"\bunit[^\W\d_]*\b(.*)", plain)
    bracket = re.search(r"\bx\s*[\[(]\s*([^\W\d_]+)\s*[\])]", plain)
    words = _WORDS.findall(behind[1]) if behind else _WORDS.findall(plain)
    if bracket:
        words = [bracket[1]]
    elif not behind and len(words) != 1:
        words = []
    known = [_UNIT_WORDS[word] for word in words if word in _UNIT_WORDS]
    return known[0] if known else "in" if words[:1] == ["in"] else ""
