"""Single-joint sweeps: the points that one turning joint carries round, and points on the base's mounting plane.

They stand in a table whose column ``sweep`` says which sweep a row is of, or in a list of points, as laser trackers
write them, whose names do: ``plane_1``, ``joint1_03``. A sweep is called ``plane``, or by a joint's name, or
``joint 1``, ``1``. See docs/base-frame.md.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.data.layout import Layout
from calib.data.points_file import PARTS, Points, read_points
from calib.data.table import (
    ORIENTATION,
    Table,
    close_names,
    list_columns,
    name_columns,
    reserved,
)
from calib.data.values import Values
from calib.errors import MeasurementError, choices
from calib.robot.robot import read_only

Array = NDArray[np.float64]

#: What the sweep is called that is none.
PLANE = "plane"

_PLANE_NUMBER = -1
_NUMBERED = re.compile(r"(?:joint|axis|sweep|j|a)?[ _\-.]*0*([1-9][0-9]?)", re.IGNORECASE)
_POINT_NAME = re.compile(r"(.*?)[ _\-.:]*[0-9]+")


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """The points of one sweep, in the order in which they were measured."""

    joint: int | None  #: Which joint of the chain turns, from 0; None for the plane
    name: str  #: As the file calls it
    points: Array  #: shape (N, 3) in the tracker's frame [m]
    #: Standard deviation of a coordinate of each point, shape (N,) [m]; None where not given
    sigma: Array | None
    joints: Array | None  #: Values of the chain's joints, shape (N, n) [rad]; None where not given
    rows: tuple[int, ...]  #: Their numbers in the file, for messages
    source: str  #: The file's name, for messages
    counted: str = "row"  #: What ``rows`` are: "row" or "line"

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
    """All sweeps of a file."""

    #: The plane first, then the joints in the order of the chain; one of each at most
    sweeps: tuple[Sweep, ...]
    joint_names: tuple[str, ...]  #: The chain's joints, base to tip; empty where nobody named them
    source: str  #: The file's name
    sha256: str  #: Of its bytes

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
    return _from_points(listed, _Names(tuple(joint_names or ()), words or {}))


@dataclass(frozen=True, slots=True)
class _Names:
    """What sweeps may be called in one file: by the joints' names or numbers, or by the user's own words."""

    joint_names: tuple[str, ...]
    words: Mapping[str, str]

    def __post_init__(self) -> None:
        """Refuse words of the user's that stand for no sweep."""
        for word, wanted in self.words.items():
            if self.number(wanted) is None:
                raise self.refused(f"--sweep maps '{word}'", wanted)

    def number(self, word: str) -> int | None:
        """The joint that a word names, from 0; -1 for the plane; None for any other word."""
        plain = self.words.get(word, word).strip()
        if plain.casefold() == PLANE:
            return _PLANE_NUMBER
        if plain in self.joint_names:
            return self.joint_names.index(plain)
        match = _NUMBERED.fullmatch(plain)
        if match is None or (self.joint_names and int(match[1]) > len(self.joint_names)):
            return None
        return int(match[1]) - 1

    def refused(self, where: str, word: str) -> MeasurementError:
        """The error of a word that names no sweep."""
        close = close_names(word, [PLANE, *self.joint_names])
        hint = f" Close to it: {choices(close)}." if close else ""
        joints = f"a joint's name ({choices(self.joint_names)}), or " if self.joint_names else ""
        return MeasurementError(
            f"{where}: '{word}' is not a sweep; allowed are '{PLANE}', {joints}a joint's number, 'joint 1'.{hint} "
            f'Correct it, or map it: --sweep "{word}=joint 1".'
        )

    def split(
        self,
        found: Sequence[str],
        points: Array,
        rows: Sequence[int],
        source: str,
        counted: str,
        sigma: Array | None = None,
        joints: Array | None = None,
    ) -> tuple[Sweep, ...]:
        """The rows by the words found there, the plane first."""
        numbers = np.array([self.number(word) for word in found])
        sweeps = []
        for number in sorted(set(numbers.tolist())):
            at = np.flatnonzero(numbers == number).tolist()
            plane = number == _PLANE_NUMBER
            sweeps.append(
                Sweep(
                    None if plane else number,
                    found[at[0]],
                    read_only(points[at]),
                    None if sigma is None else read_only(sigma[at]),
                    None if joints is None or plane else read_only(joints[at]),
                    tuple(rows[i] for i in at),
                    source,
                    counted,
                )
            )
        return tuple(sweeps)


def _from_points(points: Points, names: _Names) -> Sweeps:
    """The sweeps of a list of points by their names."""
    if not points.names:
        raise MeasurementError(
            f"{points.source}: the points have no names, which would say what sweep they are of. Name them 'plane_1', "
            "'joint1_01' and so on, or give a table with a column 'sweep'."
        )
    found = []
    for name, line in zip(points.names, points.lines, strict=True):
        parts = [part.strip() for part in name.split(PARTS)]
        match = _POINT_NAME.fullmatch(parts[-1])
        # The point's own name without its number; else the group that it stands in.
        candidates = [*([match[1]] if match else []), *parts[-2:-1]]
        word = next((word for word in candidates if names.number(word) is not None), None)
        if word is None:
            where = f"{points.source}, line {line}: the point '{name}'"
            raise names.refused(where, candidates[0] if candidates else name)
        found.append(word)
    sweeps = names.split(found, points.points, points.lines, points.source, "line")
    return Sweeps(sweeps, names.joint_names, points.source, points.sha256)


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
    taken = (*reserved(), *ORIENTATION)
    angles = {n: c for n, c in named.items() if n not in taken and c.unit}
    joint_names = tuple(
        joint_names
        if joint_names is not None
        else (n for n, c in angles.items() if c.unit and c.unit.quantity == "angle")
    )
    there = joint_names if any(name in named for name in joint_names) else ()
    types = dict.fromkeys(there, "revolute")
    apart = points is not None
    layout = Layout.find(table, there, types, columns, "point", points_elsewhere=apart)
    layout = replace(layout, groups=(sweep,))
    names = _Names(joint_names, words)
    at = {column.index for column in layout.blocks["joints"]}
    # Rows of the plane may leave their joint values empty.
    cells = tuple(
        [cell or "0" if k in at else cell for k, cell in enumerate(row)]
        if names.number(row[sweep.index]) == _PLANE_NUMBER
        else row
        for row in table.cells
    )
    values = Values.read(replace(table, cells=cells), layout, points)
    for row, word in zip(values.rows, values.groups, strict=True):
        if names.number(word) is None:
            raise names.refused(f"{table.source}, row {row}, column '{sweep.label}'", word)
    sha256 = table.sha256 if points is None else f"{table.sha256} + {points.sha256}"
    sweeps = names.split(
        values.groups,
        values.points,
        values.rows,
        table.source,
        "row",
        values.sigma,
        values.joints if there else None,
    )
    return Sweeps(sweeps, joint_names, table.source, sha256)
