"""Single-joint sweeps: the points that one turning joint carries round, and points on the base's mounting plane.

They stand in a table whose column ``sweep`` says which sweep a row is of, or in a list of points, as laser trackers
write them, whose names do: ``plane_1``, ``joint1_03``. A sweep is called ``plane``, or by a joint's name, or
``joint 1``, ``1``. See docs/base-frame.md.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.errors import MeasurementError, choices
from calib.measure.layout import Layout
from calib.measure.points_file import PARTS, Points, match_points, read_points
from calib.measure.table import (
    ORIENTATION,
    POINT,
    Column,
    Row,
    Table,
    check_cells,
    close_names,
    list_columns,
    name_columns,
    place,
    reserved,
    with_unit,
)
from calib.measure.values import WrongUnits
from calib.model.robot import read_only

Array = NDArray[np.float64]

#: What the sweep is called that is none.
PLANE = "plane"

_PLANE_NUMBER = -1
_NUMBERED = re.compile(r"(?:joint|axis|sweep|j|a)?[ _\-.]*0*([1-9][0-9]?)", re.IGNORECASE)
_POINT_NAME = re.compile(r"(.*?)[ _\-.:]*[0-9]+")


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """The points of one sweep, in the order in which they were measured.

    Attributes:
        joint: Which joint of the chain turns, from 0; None for the plane.
        name: As the file calls it.
        points: shape (N, 3) in the tracker's frame [m].
        sigma: Standard deviation of a coordinate of each point, shape (N,) [m]; None where not given.
        joints: Values of the chain's joints, shape (N, n) [rad]; None where not given.
        rows: Their numbers in the file, for messages.
        source: The file's name, for messages.
        counted: What ``rows`` are: "row" or "line".
    """

    joint: int | None
    name: str
    points: Array
    sigma: Array | None
    joints: Array | None
    rows: tuple[int, ...]
    source: str
    counted: str = "row"

    def __len__(self) -> int:
        """The number of points, N."""
        return len(self.points)

    @property
    def where(self) -> str:
        """The sweep's place, for messages."""
        first, last = min(self.rows), max(self.rows)
        rows = f"{self.counted} {first}" if first == last else f"{self.counted}s {first} to {last}"
        return f"{self.source}, sweep '{self.name}' ({rows})"


@dataclass(frozen=True, slots=True, eq=False)
class Sweeps:
    """All sweeps of a file.

    Attributes:
        sweeps: The plane first, then the joints in the order of the chain; one of each at most.
        joint_names: The chain's joints, base to tip; empty where nobody named them.
        source: The file's name.
        sha256: Of its bytes.
    """

    sweeps: tuple[Sweep, ...]
    joint_names: tuple[str, ...]
    source: str
    sha256: str

    def find(self, joint: int | None) -> Sweep | None:
        """The sweep of a joint, from 0, or of the plane (None); None where there is none."""
        return next((sweep for sweep in self.sweeps if sweep.joint == joint), None)

    def label(self, joint: int) -> str:
        """What to call a joint, from 0: its name, or its number where it has none."""
        return self.joint_names[joint] if joint < len(self.joint_names) else f"joint {joint + 1}"


def read_sweeps(
    path: str | Path | None = None,
    joint_names: Sequence[str] | None = None,
    columns: Mapping[str, str] | None = None,
    points: str | Path | None = None,
    points_unit: str | None = None,
    words: Mapping[str, str] | None = None,
) -> Sweeps:
    """Read sweeps from a table, from a list of points, or from both.

    Args:
        path: A table with the columns ``sweep``, ``x``, ``y``, ``z``, perhaps ``sigma`` and the joints' values; None:
            all stands in the list of points.
        joint_names: Of the chain, base to tip; None: the table's columns in a unit of angle, in their order.
        columns: Names of the table to names of calib, see `Measurements.read`.
        points: A list of points. Beside a table its points are matched by the column ``point``, or in their order;
            without one, their names say which sweep they are of.
        points_unit: The unit of that list, where it names none.
        words: What the file calls sweeps, to what they are: ``{"ring_a": "joint 1"}``.

    Raises:
        MeasurementError: Something in the files cannot be used; the text names the file, the row and the remedy.
    """
    listed = None if points is None else read_points(points, points_unit)
    if path is not None:
        return _from_table(Table.read(path), joint_names, columns or {}, listed, words or {})
    if listed is None:
        raise MeasurementError(
            "No file of sweeps was given. Give a table, or a list of points (--points)."
        )
    return _from_points(listed, tuple(joint_names or ()), words or {})


@dataclass(frozen=True, slots=True)
class _Names:
    """What sweeps may be called in one file: by the joints' names or numbers, or by the user's own words."""

    joint_names: tuple[str, ...]
    words: Mapping[str, str]

    def __post_init__(self) -> None:
        """Refuse words of the user's that stand for no sweep."""
        for word, wanted in self.words.items():
            if self._meant(wanted) is None:
                raise MeasurementError(self.refusal(f"--sweep maps '{word}'", wanted))

    def number(self, word: str) -> int | None:
        """The joint that a word names, from 0; -1 for the plane; None for any other word."""
        return self._meant(self.words.get(word, word))

    def _meant(self, word: str) -> int | None:
        """The same of a word that is no user's own."""
        plain = word.strip()
        if plain.casefold() == PLANE:
            return _PLANE_NUMBER
        if plain in self.joint_names:
            return self.joint_names.index(plain)
        match = _NUMBERED.fullmatch(plain)
        if match is None or (self.joint_names and int(match[1]) > len(self.joint_names)):
            return None
        return int(match[1]) - 1

    def refusal(self, where: str, word: str) -> str:
        """What to say of a word that names no sweep."""
        close = close_names(word, [PLANE, *self.joint_names])
        hint = f" Close to it: {choices(close)}." if close else ""
        count = len(self.joint_names)
        joints = f"a joint's name ({choices(self.joint_names)}), or " if count else ""
        last = f" to 'joint {count}'" if count > 1 else ""
        names = (
            ""
            if count
            else " Joints go by their names where --robot or columns of joint values tell them."
        )
        return (
            f"{where}: '{word}' is not a sweep; allowed are '{PLANE}', {joints}a joint's number, 'joint 1'{last}."
            f'{hint}{names} Correct it, or map it: --sweep "{word}=joint 1".'
        )


def _from_points(points: Points, joint_names: tuple[str, ...], words: Mapping[str, str]) -> Sweeps:
    """The sweeps of a list of points by their names."""
    if not points.names:
        raise MeasurementError(
            f"{points.source}: the points have no names, which would say what sweep they are of. Name them 'plane_1', "
            "'joint1_01' and so on, or give a table with a column 'sweep'."
        )
    names = _Names(joint_names, words)
    found = []
    for name, line in zip(points.names, points.lines, strict=True):
        parts = [part.strip() for part in name.split(PARTS)]
        match = _POINT_NAME.fullmatch(parts[-1])
        # The point's own name without its number; else the group that it stands in.
        candidates = [*([match[1]] if match else []), *parts[-2:-1]]
        word = next((word for word in candidates if names.number(word) is not None), None)
        if word is None:
            where = f"{points.source}, line {line}: the point '{name}'"
            raise MeasurementError(names.refusal(where, candidates[0] if candidates else name))
        found.append(word)
    sweeps = _split(names, found, points.points, None, None, points.lines, points.source, "line")
    return Sweeps(sweeps, joint_names, points.source, points.sha256)


def _from_table(
    table: Table,
    joint_names: Sequence[str] | None,
    columns: Mapping[str, str],
    points: Points | None,
    words: Mapping[str, str],
) -> Sweeps:
    """The sweeps of a table, whose points may stand in a list of their own."""
    named, _ = name_columns(table, joint_names or (), columns)
    sweep = next((column for name, column in named.items() if name.casefold() == "sweep"), None)
    if sweep is None:
        raise MeasurementError(
            f"{table.source}: no column 'sweep', which says for each row what was measured: 'plane', or the joint that "
            f'turned. {list_columns(table)} Another name is mapped by --columns "name in the table=sweep".'
        )
    joints = _joint_columns(table, named, joint_names)
    xyz = () if points is not None else _point_columns(table, named)
    sigma = (with_unit(table, named["sigma"], "length"),) if "sigma" in named else ()
    none = dict.fromkeys(("orientation", "distance", "sigma_angle"), ())
    blocks = {"joints": joints, "points": xyz, "sigma": sigma, **none}
    layout = Layout({}, (), blocks, ("point",), ())
    joint_names = tuple(joint_names) if joint_names is not None else layout.joint_names
    names, numbers = _Names(joint_names, words), named.get("row")
    grid, found, rows, labels, lines = [], [], [], [], []
    for row in table.rows():
        check_cells(table, row, numbers)
        word = row.cells[sweep.index]
        number = names.number(word)
        if number is None:
            raise MeasurementError(names.refusal(place(table, row, numbers, sweep), word))
        free = joints if number == _PLANE_NUMBER else ()
        grid.append([_number(table, row, c, numbers, free=c in free) for c in layout.numbers])
        found.append(word)
        lines.append(row.line)
        rows.append(_row_number(row, numbers))
        labels.append(row.cells[named["point"].index] if "point" in named else "")
    if not grid:
        raise MeasurementError(f"{table.source}: the table has a header and no rows below it")
    values = np.array(grid, dtype=np.float64).reshape(len(grid), -1)
    WrongUnits(table.source, layout, values, tuple(lines), tuple(rows)).check()
    values = values * np.array([column.to_si for column in layout.numbers])
    if points is None:
        where, sha256 = values[:, layout.span("points")], table.sha256
    else:
        where = match_points(points, table.source, rows, labels if "point" in named else None)
        sha256 = f"{table.sha256} + {points.sha256}"
    noise = values[:, layout.span("sigma")[0]] if sigma else None
    turned = values[:, layout.span("joints")] if joints else None
    sweeps = _split(names, found, where, noise, turned, rows, table.source, "row")
    return Sweeps(sweeps, joint_names, table.source, sha256)


def _joint_columns(
    table: Table, named: Mapping[str, Column], joint_names: Sequence[str] | None
) -> tuple[Column, ...]:
    """The columns of joint values: of all joints named, or of none."""
    if joint_names is None:
        taken = (*reserved(), *ORIENTATION)
        return tuple(
            c for n, c in named.items() if n not in taken and c.unit and c.unit.quantity == "angle"
        )
    there = [name for name in joint_names if name in named]
    if there and len(there) < len(joint_names):
        missing = [name for name in joint_names if name not in named]
        raise MeasurementError(
            f"{table.source}: there are columns for the joints {choices(there)} and none for {choices(missing)}. Give "
            'the values of all joints of the chain, or of none (--columns "name=-" leaves a column out).'
        )
    return tuple(with_unit(table, named[n], "angle", f"revolute joint '{n}'") for n in there)


def _point_columns(table: Table, named: Mapping[str, Column]) -> tuple[Column, ...]:
    """The columns x, y, z."""
    missing = [name for name in POINT if name not in named]
    if missing:
        raise MeasurementError(
            f"{table.source}: no column for the measured point's {choices(missing)}. {list_columns(table)} The header "
            f"of such a column is '{missing[0]} [mm]'; another name is mapped by --columns \"name in the "
            f'table={missing[0]}".'
        )
    return tuple(with_unit(table, named[name], "length") for name in POINT)


def _row_number(row: Row, numbers: Column | None) -> int:
    """The row's number: the user's own, if it is one."""
    text = "" if numbers is None else row.cells[numbers.index]
    return int(text) if text.isdecimal() and len(text) < 19 else row.ordinal


def _number(table: Table, row: Row, column: Column, numbers: Column | None, *, free: bool) -> float:
    """The number in a cell; NaN for an empty one that need not be filled in."""
    text = row.cells[column.index]
    if text == "" and free:
        return math.nan
    try:
        value = float(text.replace(",", ".") if table.separator == ";" else text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or "_" in text:
        said = "the cell is empty" if text == "" else f"'{text}' is not a finite number"
        raise MeasurementError(
            f"{place(table, row, numbers, column)}: {said}. Correct it, or remove the row."
        )
    return value


def _split(
    names: _Names,
    found: Sequence[str],
    points: Array,
    sigma: Array | None,
    joints: Array | None,
    rows: Sequence[int],
    source: str,
    counted: str,
) -> tuple[Sweep, ...]:
    """The rows by their sweeps, the plane first."""
    numbers = [names.number(word) for word in found]
    sweeps = []
    for number in sorted({n for n in numbers if n is not None}):
        at = [i for i, n in enumerate(numbers) if n == number]
        joint = None if number == _PLANE_NUMBER else number
        values = None if joints is None or joint is None else read_only(joints[at])
        noise = None if sigma is None else read_only(sigma[at])
        own = tuple(rows[i] for i in at)
        sweeps.append(
            Sweep(joint, found[at[0]], read_only(points[at]), noise, values, own, source, counted)
        )
    return tuple(sweeps)
