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

from calib.data.columns import ORIENTATION, list_columns, name_columns, reserved
from calib.data.layout import Layout
from calib.data.measurements import Measurements
from calib.data.points_file import PARTS, Points, read_points
from calib.data.table import Table
from calib.data.values import read_values
from calib.errors import MeasurementError, choices
from calib.robot.robot import read_only
from calib.units import Array

#: What the sweep is called that is none, and its number.
PLANE, _PLANE = "plane", -1

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

    @property
    def where(self) -> str:
        """The sweep's place, for messages."""
        first, last = min(self.rows), max(self.rows)
        return f"{self.source}, sweep '{self.name}' ({self.counted}s {first} to {last})"


@dataclass(frozen=True, slots=True, eq=False)
class Sweeps:
    """All sweeps of a file."""

    #: The plane first, then the joints in the order of the chain; one of each at most
    sweeps: tuple[Sweep, ...]
    joint_names: tuple[str, ...]  #: The chain's joints, base to tip; empty where nobody named them
    source: str  #: The file's name

    def label(self, joint: int) -> str:
        """What to call a joint, from 0: its name, or its number where it has none."""
        return self.joint_names[joint] if joint < len(self.joint_names) else f"joint {joint + 1}"


def read_sweeps(
    path: str | Path | None = None,
    joint_names: Sequence[str] | None = None,
    columns: Mapping[str, str] | None = None,
    points: str | Path | None = None,
    points_unit: str | None = None,
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

    Raises:
        MeasurementError: Something in the files cannot be used; the text names the file, the row and the remedy.
    """
    listed = None if points is None else read_points(points, points_unit)
    if path is not None:
        return _from_table(Table.read(path), joint_names, columns or {}, listed)
    if listed is None:
        raise MeasurementError("Give a table of sweeps, or a list of points (--points).")
    return _from_points(listed, tuple(joint_names or ()))


def _number(word: str, joint_names: Sequence[str]) -> int | None:
    """The joint that a word names, from 0, by its name or number; -1 for the plane; None for any other word."""
    plain = word.strip()
    if plain.casefold() == PLANE:
        return _PLANE
    if plain in joint_names:
        return joint_names.index(plain)
    match = _NUMBERED.fullmatch(plain)
    if match is None or (joint_names and int(match[1]) > len(joint_names)):
        return None
    return int(match[1]) - 1


def _split(
    words: Sequence[str],
    points: Array,
    rows: Sequence[int],
    source: str,
    joint_names: tuple[str, ...],
    *,
    counted: str = "row",
    sigma: Array | None = None,
    joints: Array | None = None,
) -> Sweeps:
    """All points of a file by the words that name their sweeps, the plane first."""
    by_number: dict[int, list[int]] = {}
    for i, word in enumerate(words):
        number = _number(word, joint_names)
        if number is None:
            named = f"a joint's name ({choices(joint_names)}), or " * bool(joint_names)
            raise MeasurementError(
                f"{source}, {counted} {rows[i]}: '{word}' is not a sweep; allowed are '{PLANE}', {named}a joint's "
                "number, 'joint 1'."
            )
        by_number.setdefault(number, []).append(i)
    sweeps = tuple(
        Sweep(
            None if number == _PLANE else number,
            words[at[0]],
            read_only(points[at]),
            None if sigma is None else read_only(sigma[at]),
            None if joints is None or number == _PLANE else read_only(joints[at]),
            tuple(rows[i] for i in at),
            source,
            counted,
        )
        for number, at in sorted(by_number.items())
    )
    return Sweeps(sweeps, joint_names, source)


def _from_points(points: Points, joint_names: tuple[str, ...]) -> Sweeps:
    """The sweeps of a list of points by their names."""
    if not points.names:
        raise MeasurementError(
            f"{points.source}: the points have no names, which would say what sweep they are of. Name them 'plane_1', "
            "'joint1_01' and so on, or give a table with a column 'sweep'."
        )
    words = []
    for name in points.names:
        parts = [part.strip() for part in name.split(PARTS)]
        match = _POINT_NAME.fullmatch(parts[-1])
        # The point's own name without its number; else the group that it stands in.
        candidates = [match[1] if match else parts[-1], *parts[-2:-1]]
        known = (word for word in candidates if _number(word, joint_names) is not None)
        words.append(next(known, candidates[0]))
    return _split(words, points.points, points.lines, points.source, joint_names, counted="line")


def _from_table(
    table: Table,
    joint_names: Sequence[str] | None,
    columns: Mapping[str, str],
    points: Points | None,
) -> Sweeps:
    """The sweeps of a table, whose points may stand in a list of their own."""
    named, _ = name_columns(table, joint_names or (), columns)
    sweep = next((column for name, column in named.items() if name.casefold() == "sweep"), None)
    if sweep is None:
        raise MeasurementError(
            f"{table.source}: no column 'sweep', which says for each row what was measured: 'plane', or the joint that "
            f'turned. {list_columns(table)} Another name is mapped by --columns "name in the table=sweep".'
        )
    if joint_names is None:
        taken = (*reserved(), *ORIENTATION)
        units = {name: column.unit for name, column in named.items() if name not in taken}
        joint_names = [name for name, unit in units.items() if unit and unit.quantity == "angle"]
    names = tuple(joint_names)
    there = names if any(name in named for name in names) else ()
    types = dict.fromkeys(there, "revolute")
    apart = points is not None
    layout = Layout.find(table, there, types, columns, "point", points_elsewhere=apart)
    at = {column.index for column in layout.blocks["joints"]}
    # Rows of the plane may leave their joint values empty.
    cells = tuple(
        [cell or "0" if k in at else cell for k, cell in enumerate(row)]
        if _number(row[sweep.index], names) == _PLANE
        else row
        for row in table.cells
    )
    layout = replace(layout, groups=(sweep,))
    values = Measurements(**read_values(replace(table, cells=cells), layout, points))
    found = (values.groups, values.points, values.rows)
    joints = values.joints if there else None
    return _split(*found, table.source, names, sigma=values.sigma, joints=joints)
