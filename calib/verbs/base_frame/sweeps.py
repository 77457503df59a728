"""Single-joint sweeps: the points that one turning joint carries round, and points on the base's mounting plane.

They are in a table whose column ``sweep`` says which sweep a row is of, or in a list of points, as laser trackers
write them, whose names do: ``plane_1``, ``joint1_03``. A sweep is called ``plane``, or by a joint's name, or
``joint 1``, ``1``. See docs/base-frame.md.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from calib.basics.arrays import Array, read_only
from calib.basics.tables import Table
from calib.basics.values import Value
from calib.data.columns import ORIENTATION, list_columns, name_columns, reserved
from calib.data.forms.column_options import ColumnsInput
from calib.data.forms.points import PARTS
from calib.data.layout import Layout
from calib.data.measurements import Measurements
from calib.data.points_file import read_points
from calib.data.values import read_values
from calib.errors import MeasurementError, choices

#: Name of the points on the mounting plane.
PLANE = "plane"

#: Number of the plane among joints, which are numbered from 0.
_PLANE = -1

#: Words that number a joint, and names of points without their own number.
_NUMBERED = re.compile(r"(?:joint|axis|sweep|j|a)?[ _\-.]*0*([1-9][0-9]?)", re.IGNORECASE)
_POINT_NAME = re.compile(r"(.*?)[ _\-.:]*[0-9]+")


@dataclass(frozen=True, slots=True, eq=False)
class Sweep(Value):
    """Points of one sweep, in the order in which they were measured."""

    #: The joint of the chain that turns, from 0; None for the plane
    joint: int | None
    #: In the file
    name: str
    #: Shape (N, 3) in the tracker's frame [m]
    points: Array
    #: Standard deviation of a coordinate of each point, shape (N,) [m]; None if not given
    sigma: Array | None
    #: Values of the chain's joints, shape (N, n) [rad]; None if not given
    joints: Array | None
    #: Their numbers in the file, for messages
    rows: tuple[int, ...]
    #: The file's name, for messages
    source: str
    #: The noun for ``rows``: "row" or "line"
    counted: str = "row"

    @property
    def where(self) -> str:
        """The sweep's place, for messages."""
        first, last = min(self.rows), max(self.rows)
        return f"{self.source}, sweep '{self.name}' ({self.counted}s {first} to {last})"


@dataclass(frozen=True, slots=True, eq=False)
class Sweeps(Value):
    """Sweeps of a file."""

    #: The plane first, then the joints in the order of the chain; one of each at most
    sweeps: tuple[Sweep, ...]
    #: The chain's joints, base to tip; empty if they were not given
    joint_names: tuple[str, ...]
    #: The file's name
    source: str

    def label(self, joint: int) -> str:
        """Return the name of a joint, from 0, or ``joint`` and its number from 1 if it has none."""
        return self.joint_names[joint] if joint < len(self.joint_names) else f"joint {joint + 1}"


def read_sweeps(
    path: str | Path | None = None,
    joint_names: Sequence[str] | None = None,
    columns: ColumnsInput = None,
    points: str | Path | None = None,
    points_unit: str | None = None,
) -> Sweeps:
    """Read sweeps from a table, from a list of points, or from both.

    Args:
        path: A table with the columns ``sweep``, ``x``, ``y``, ``z``, perhaps ``sigma`` and the joints' values; None:
            all is in the list of points.
        joint_names: Of the chain, base to tip; None: the table's columns in a unit of angle, in their order.
        columns: Names that calib uses by the table's names, or all that is said of the columns; None: nothing is said.
        points: A list of points. Beside a table its points are matched by the column ``point``, or in their order;
            without one, their names say which sweep they are of.
        points_unit: The unit of that list; None: it names one.

    Returns:
        The sweeps.

    Raises:
        MeasurementError: Something in the files cannot be used; the text names the file, the row and the remedy.
    """
    listed = None if points is None else read_points(points, points_unit)
    if path is None:
        if listed is None:
            raise MeasurementError("Give a table of sweeps, or a list of points (--points).")
        if not listed.names:
            raise MeasurementError(
                f"{listed.source}: the points have no names, which would say what sweep they are of. Name them "
                "'plane_1', 'joint1_01' and so on, or give a table with a column 'sweep'."
            )
        names = tuple(joint_names or ())
        words = [_sweep_word(name, names) for name in listed.names]
        return _split(words, listed.points, listed.lines, listed.source, names, counted="line")

    table = Table.read(path)
    named, _ = name_columns(table, joint_names or (), columns)
    sweep_column = next((c for name, c in named.items() if name.casefold() == "sweep"), None)
    if sweep_column is None:
        raise MeasurementError(
            f"{table.source}: no column 'sweep', which names what was measured in each row: 'plane', or "
            f"the joint that turned. {list_columns(table)} Another name is mapped by --columns "
            '"name in the table=sweep".'
        )
    if joint_names is None:
        # The columns in a unit of angle that are not orientations.
        reserved_names = (*reserved(), *ORIENTATION)
        angles = []
        for name, column in named.items():
            if name not in reserved_names and column.unit and column.unit.quantity == "angle":
                angles.append(name)
        names = tuple(angles)
    else:
        names = tuple(joint_names)
    has_joints = any(name in named for name in names)
    measured_joints = names if has_joints else ()
    layout = Layout.find(
        table,
        measured_joints,
        dict.fromkeys(measured_joints, "revolute"),
        columns,
        "point",
        points_elsewhere=listed is not None,
    )
    layout = replace(layout, groups=(sweep_column,))

    # Rows of the plane need no joint values: they are read as zeros, which nothing uses.
    joint_columns = {column.index for column in layout.blocks["joints"]}
    rows = []
    for row in table.cells:
        cells = list(row)
        if _number(row[sweep_column.index], names) == _PLANE:
            for k in joint_columns:
                cells[k] = cells[k] or "0"
        rows.append(cells)
    filled = replace(table, cells=tuple(rows))
    values = Measurements(**read_values(filled, layout, listed, as_measured=True))
    return _split(
        words=values.groups,
        points=values.points,
        numbers=values.rows,
        source=table.source,
        joint_names=names,
        sigma=values.sigma.get("m"),
        joints=values.joints if has_joints else None,
    )


def _number(word: str, joint_names: Sequence[str]) -> int | None:
    """Return the joint of a word, from 0, by its name or number from 1; -1 for the plane; None for any other word."""
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
    numbers: Sequence[int],
    source: str,
    joint_names: tuple[str, ...],
    *,
    counted: str = "row",
    sigma: Array | None = None,
    joints: Array | None = None,
) -> Sweeps:
    """Split the N points of a file into sweeps by the word of each, the plane first; raises `MeasurementError`.

    Their numbers in the file count what ``counted`` says; the other arguments are as in `Sweep`.
    """
    by_number: dict[int, list[int]] = {}
    for i, word in enumerate(words):
        number = _number(word, joint_names)
        if number is None:
            names = ""
            if joint_names:
                names = f"a joint's name ({choices(joint_names)}), or "
            raise MeasurementError(
                f"{source}, {counted} {numbers[i]}: '{word}' is not a sweep; "
                f"allowed are '{PLANE}', {names}a joint's number, 'joint 1'."
            )
        by_number.setdefault(number, []).append(i)
    sweeps = []
    for number, members in sorted(by_number.items()):
        is_plane = number == _PLANE
        sweep = Sweep(
            joint=None if is_plane else number,
            name=words[members[0]],
            points=read_only(points[members]),
            sigma=None if sigma is None else read_only(sigma[members]),
            joints=read_only(joints[members]) if joints is not None and not is_plane else None,
            rows=tuple(numbers[i] for i in members),
            source=source,
            counted=counted,
        )
        sweeps.append(sweep)
    return Sweeps(tuple(sweeps), joint_names, source)


def _sweep_word(name: str, joint_names: tuple[str, ...]) -> str:
    """Return the word of a point's name for its sweep: its last part without its number, else the part before it."""
    parts = [part.strip() for part in name.split(PARTS)]
    last = parts[-1]
    numbered = _POINT_NAME.fullmatch(last)
    without_number = numbered[1] if numbered else last
    candidates = [without_number, *parts[-2:-1]]
    for word in candidates:
        if _number(word, joint_names) is not None:
            return word
    return candidates[0]
