"""Lists of points as laser tracker programs write them, and which row of a table each point belongs to."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.errors import CalibError, FileError, MeasurementError, choices
from calib.measure.columns import close_names
from calib.measure.points_text import Line, PointsText, decode, has_point, is_number, split
from calib.measure.wrong_units import FAR_M, NEAR_M, better_unit, farthest
from calib.model.files import read_bytes
from calib.units import Unit, find_unit, symbols

#: Between collection, group and point.
PARTS = "::"

# Behind the name of a column.
_UNIT = re.compile(r"\s*[\[(].*")

# What the column of names is called in a header; the first two stand before the point's own.
_NAMES = (
    ("collection", "coll"),
    ("group", "pointgroup", "point group", "group name"),
    ("point", "name", "pointname", "point name", "point id", "pointid", "id", "label", "target"),
)


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
    _at: dict[str, list[int]] = field(init=False, repr=False)
    _at_last: dict[str, list[int]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Where each name stands, whole and by its last part, for tables of many rows."""
        for name, function in (("_at", str), ("_at_last", _last)):
            found: dict[str, list[int]] = {}
            for i, whole in enumerate(self.names):
                found.setdefault(function(whole), []).append(i)
            object.__setattr__(self, name, found)

    def __len__(self) -> int:
        """The number of points, N."""
        return len(self.points)

    def find(self, name: str) -> int | None:
        """Which point has this name, from 0: the whole of it, or its last part; None when none has.

        Raises:
            MeasurementError: several have.
        """
        hits = self._at.get(name) or self._at_last.get(name) or []
        if len(hits) > 1:
            whole = [self.names[i] for i in hits]
            lines = ", ".join(str(self.lines[i]) for i in hits[:8])
            fix = "Give each point a name of its own."
            if len(set(whole)) == len(whole):
                fix = f"Write the whole name: {choices(whole)}."
            message = f"{self.source}: several points are called '{name}', in lines {lines}. {fix}"
            raise MeasurementError(message)
        return hits[0] if hits else None


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
    text = PointsText.parse(decode(data, source), source)
    names, places = _find_columns(text, source)
    points = _numbers(text, places, source)
    metres = _in_metres(text, points, _find_unit(text, unit, source), source)
    metres.setflags(write=False)
    lines = tuple(line.number for line in text.lines)
    return Points(names, metres, lines, source, hashlib.sha256(data).hexdigest())


def match_points(
    points: Points, source: str, rows: Sequence[int], names: Sequence[str] | None
) -> NDArray[np.float64]:
    """The point of each row of a table, shape (M, 3), [m].

    Args:
        points: of a file.
        source: the table's file name.
        rows: the numbers of the rows that have a point, M of them.
        names: their points' names; None takes the points in the order of the file.

    Raises:
        MeasurementError: a row's point is not there, or is that of another row; or the counts differ.
    """
    if names is None:
        if len(points) != len(rows):
            message = (
                f"{points.source} has {len(points)} points and {source} {len(rows)} rows to match "
                "them with, in their order. Add a column 'point' with the points' names to the "
                "table, or remove what has no counterpart."
            )
            raise MeasurementError(message)
        return points.points
    if not points.names:
        message = (
            f"{points.source}: the points have no names, and {source} has a column 'point' to match "
            'them by. Add names to the points, or leave the column out: --columns "point=-".'
        )
        raise MeasurementError(message)
    taken: dict[int, int] = {}  # point: row
    for row, name in zip(rows, names, strict=True):
        i = points.find(name)
        if i is None:
            close = close_names(name, [*points.names, *map(_last, points.names)])
            hint = f"Close to it: {choices(close)}" if close else f"It has {choices(points.names)}"
            message = (
                f"{source}, row {row}: {points.source} has no point '{name}'. {hint}. Correct the "
                "name, or remove the row; where the points are in the order of the rows, --columns "
                '"point=-" does without names.'
            )
            raise MeasurementError(message)
        if i in taken:
            message = (
                f"{source}: the rows {taken[i]} and {row} both name the point '{name}'. What was "
                "measured once counts once: remove one of the rows."
            )
            raise MeasurementError(message)
        taken[i] = row
    return points.points[list(taken)]


def unmeasured_points(points: Points, names: Sequence[str]) -> tuple[int, ...]:
    """Which of these names, from 0, are of points that were not measured yet.

    None if the file has points that nobody names: then the names are more likely misspelt.
    """
    found = [points.find(name) for name in names]
    used = set(found) - {None}
    if len(used) < len(points):
        return ()
    return tuple(i for i, at in enumerate(found) if at is None)


def _last(name: str) -> str:
    """The point's own name, without collection and group."""
    return name.rpartition(PARTS)[2].strip()


def _find_columns(text: PointsText, source: str) -> tuple[tuple[str, ...], tuple[int, int, int]]:
    """The names of all points, none when there are none, and where x, y, z stand."""
    heading = _heading(text)
    if heading:
        by_header = (heading.index("x"), heading.index("y"), heading.index("z"))
        named = [heading.index(n) for part in _NAMES for n in part if heading.count(n) == 1]
        if not named and min(by_header) > 0:
            named = list(range(min(by_header)))
        _check_width(text, [*named, *by_header], source)
        return _join(text, named), by_header
    start = _first_number(text, source)
    names = _join(text, list(range(start)))
    if len(set(names)) < len(text.lines) and _is_count(text, start, source):
        return _join(text, list(range(start + 1))), (start + 1, start + 2, start + 3)
    return names, (start, start + 1, start + 2)


def _heading(text: PointsText) -> list[str]:
    """The names of the columns, small, from the last header with x, y and z; none without one."""
    for remark in reversed(text.headings):
        cells = [_UNIT.sub("", cell).casefold() for cell in split(remark, text.separator)]
        # Between blanks a column's name may be of two words: then the header says nothing of places.
        widths = [len(line.cells) for line in text.lines]
        fits = max(widths) <= len(cells) and (text.separator != " " or min(widths) == len(cells))
        if fits and all(cells.count(axis) == 1 for axis in "xyz"):
            return cells
    return []


def _first_number(text: PointsText, source: str) -> int:
    """The first column from which on every line has three numbers."""
    narrowest = min(len(line.cells) for line in text.lines)
    for start in range(narrowest - 2):
        if all(has_point(line.cells, start) for line in text.lines):
            return start
    cells = text.lines[0].cells
    start = next(i for i in range(len(cells)) if has_point(cells, i))
    bad = next((line for line in text.lines if not has_point(line.cells, start)), text.lines[-1])
    raise MeasurementError(_no_point(bad, source))


def _no_point(line: Line, source: str) -> str:
    """What to say of a line that does not fit the others."""
    return (
        f"{source}, line {line.number}: '{' '.join(line.cells)[:80]}' has not its three numbers where "
        "the other lines have theirs. Correct or remove the line, or make it a comment with #."
    )


def _is_count(text: PointsText, start: int, source: str) -> bool:
    """Whether the first column of numbers names the points: whole numbers, each once, and three more behind."""
    if not all(has_point(line.cells, start + 1) for line in text.lines):
        return False
    counts = [line.cells[start].isdigit() for line in text.lines]
    rest = [line.cells[start + 1 : start + 4] for line in text.lines]
    if not all(counts):
        return False
    if all(cell.lstrip("+-").isdigit() for cells in rest for cell in cells):
        message = (
            f"{source}, line {text.lines[0].number}: all are whole numbers, so the point's number "
            "cannot be told from x. Write a header line above the points, 'name x y z'."
        )
        raise MeasurementError(message)
    return True


def _join(text: PointsText, columns: Sequence[int]) -> tuple[str, ...]:
    """The names that stand in these columns, none without a column."""
    sign = " " if text.separator == " " else PARTS
    if not columns:
        return ()
    return tuple(sign.join(line.cells[i] for i in columns) for line in text.lines)


def _check_width(text: PointsText, columns: Sequence[int], source: str) -> None:
    """Refuse a line that ends before these columns."""
    short = next((line for line in text.lines if len(line.cells) <= max(columns)), None)
    if short is not None:
        raise MeasurementError(_no_point(short, source))


def _numbers(text: PointsText, places: tuple[int, int, int], source: str) -> NDArray[np.float64]:
    """The coordinates as written, shape (N, 3)."""
    signs: dict[str, int] = {}  # decimal sign: the first line that has it
    values = np.empty((len(text.lines), 3))
    for i, line in enumerate(text.lines):
        cells = [line.cells[j] if j < len(line.cells) else "" for j in places]
        if not all(map(is_number, cells)):
            raise MeasurementError(_no_point(line, source))
        for sign in ".,":
            if any(sign in cell for cell in cells):
                signs.setdefault(sign, line.number)
        values[i] = [float(cell.replace(",", ".")) for cell in cells]
    if len(signs) == 2:
        message = (
            f"{source}: numbers have a decimal point in line {signs['.']} and a decimal comma in line "
            f"{signs[',']}. Write all in one way, without a sign between thousands."
        )
        raise MeasurementError(message)
    return values


def _find_unit(text: PointsText, given: str | None, source: str) -> Unit:
    """The unit of the coordinates, from the file or as given; both agree."""
    named = text.units()
    if len(named) > 1:
        message = (
            f"{source}: its remarks name several units of length, {choices(named)}. Leave one, as in "
            "'# Units: mm'."
        )
        raise MeasurementError(message)
    if given is None and not named:
        message = (
            f"{source}: the unit of the points is not in it. Write a first line '# Units: mm', or give it "
            f"(--points-unit mm); allowed are {choices(symbols('length'))}."
        )
        raise MeasurementError(message)
    try:
        unit = find_unit(named[0] if given is None else given)
    except CalibError as error:
        message = f"{source}: {error}"
        raise MeasurementError(message) from error
    if unit.quantity != "length":
        message = f"{source}: '{unit.symbol}' is not a unit of length; allowed are {choices(symbols('length'))}"
        raise MeasurementError(message)
    if named and unit.symbol != named[0]:
        message = (
            f"{source}: the file says that its points are in {named[0]}, and {unit.symbol} was given. "
            "Leave the unit out, or correct the file."
        )
        raise MeasurementError(message)
    return unit


def _in_metres(
    text: PointsText, values: NDArray[np.float64], unit: Unit, source: str
) -> NDArray[np.float64]:
    """The coordinates in metres; refused when they cannot be in this unit."""
    metres = values * unit.to_si
    row, distance = farthest(metres)
    what = ""
    if not distance <= FAR_M:
        what = f"further from the origin than {FAR_M:g} m"
    elif distance < NEAR_M and unit.symbol != "m":
        what = f"and no point is further from the origin than {NEAR_M * 1e3:g} mm"
    if what:
        value = float(values[row][np.argmax(np.abs(values[row]))])
        better = better_unit(value, unit)
        fix = f"If it is in {better}, say so: '# Units: {better}'." if better else "Correct it."
        message = (
            f"{source}, line {text.lines[row].number}: {value:.10g} was read as "
            f"{value * unit.to_si:.6g} m, {what}. {fix}"
        )
        raise MeasurementError(message)
    return metres
