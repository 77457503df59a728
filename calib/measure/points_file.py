"""Lists of points as laser tracker programs write them, and which row of a table each point belongs to."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.errors import FileError, MeasurementError, choices
from calib.measure.columns import close_names
from calib.measure.points_text import PARTS, parse_points
from calib.model.files import read_bytes


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
            raise MeasurementError(
                f"{self.source}: several points are called '{name}', in lines {lines}. {fix}"
            )
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
    names, points, lines = parse_points(data, unit, source)
    return Points(names, points, lines, source, hashlib.sha256(data).hexdigest())


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
    for row, name in zip(rows, names, strict=True):
        i = points.find(name)
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
    found = [points.find(name) for name in names]
    used = set(found) - {None}
    if len(used) < len(points):
        return ()
    return tuple(i for i, at in enumerate(found) if at is None)


def _last(name: str) -> str:
    """The point's own name, without collection and group."""
    return name.rpartition(PARTS)[2].strip()
