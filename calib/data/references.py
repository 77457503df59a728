"""References: targets that stand still, in the world or on the robot's base, measured between the poses.

They are rows of the set ``reference`` of a table. Such a row needs no joint values, because the robot does not carry
its target; its column ``target`` names it. It is no row of a fit: what changes between two readings of a reference is
the measurement frame.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array, Integers, Mask, read_only
from calib.basics.tables import Column, Table, is_blank
from calib.basics.values import Value
from calib.data.columns import (
    DEFAULT_TARGET,
    ORDER,
    POINT,
    REFERENCE,
    Named,
    list_columns,
    name_columns,
    with_unit,
)
from calib.data.forms.column_options import ColumnsInput
from calib.data.forms.points import Points
from calib.errors import MeasurementError
from calib.numerics.geometry import FARTHEST

#: Kinds that a reference row may name: what else a pose measures is not used.
_KINDS = ("", "point", "pose")


@dataclass(frozen=True, slots=True, eq=False)
class References(Value):
    """K readings of targets that stand still.

    Raises:
        MeasurementError: A length does not fit, or a row number is not in the sequence or occurs twice.
    """

    #: Measured positions in the measurement frame, shape (K, 3) [m], in the order of measurement
    points: Array
    #: Names of the targets that stand still
    targets: tuple[str, ...]
    #: Names of the stations; ``""`` when not given
    groups: tuple[str, ...]
    #: Their row numbers as the table has them
    rows: tuple[int, ...]
    #: Row numbers of the whole table, of readings and poses, in the order of measurement
    sequence: tuple[int, ...]

    def __post_init__(self) -> None:
        """Copy the points, and check that all of it fits together."""
        points = np.array(self.points, dtype=np.float64)
        count = len(self.rows)
        if points.shape != (count, 3) or not np.all(np.abs(points) <= FARTHEST):
            raise MeasurementError(
                f"References: 'points' must be {count} positions [m], shape ({count}, 3), up to {FARTHEST:g} m away."
            )
        if len(self.targets) != count or len(self.groups) != count:
            raise MeasurementError(f"References: 'targets' and 'groups' must be {count} names.")
        if len(set(self.sequence)) < len(self.sequence) or not {*self.rows} <= {*self.sequence}:
            raise MeasurementError(
                "References: 'sequence' must have each row number of the table once, also those of the references."
            )
        object.__setattr__(self, "points", read_only(points))
        for name in ("targets", "groups", "rows", "sequence"):
            object.__setattr__(self, name, tuple(getattr(self, name)))

    def __len__(self) -> int:
        """Return the number K of readings."""
        return len(self.rows)

    def among(self, poses: Sequence[int]) -> References:
        """Return the references in a sequence of their own rows and of some of the poses, by row numbers."""
        kept = {*self.rows, *poses}
        return replace(self, sequence=tuple(n for n in self.sequence if n in kept))

    def places_of(self, rows: Sequence[int]) -> Integers:
        """Return the places of rows in the order of measurement.

        Args:
            rows: Row numbers, of readings or of poses.

        Returns:
            Their places, from 0, shape as ``rows``.
        """
        place = {number: k for k, number in enumerate(self.sequence)}
        return np.array([place[number] for number in rows], dtype=np.int_)


def split_references(
    table: Table, columns: ColumnsInput = None, joint_names: Sequence[str] = ()
) -> tuple[Table, Table | None]:
    """Part a table into its poses and its references.

    Args:
        table: The table.
        columns: What is said of its columns, as by ``--columns``; None: nothing.
        joint_names: Names of joints, which are kept as written.

    Returns:
        The rows of poses, and those of the set ``reference``; None if there are none. Both keep their row numbers: if
        the table has no column ``row``, they get one.

    Raises:
        MeasurementError: As of `name_columns`, all rows are references, or the word is written otherwise.
    """
    named, _ = name_columns(table, joint_names, columns)
    words = table.column(named["set"]) if "set" in named else []
    for i, word in enumerate(words):
        if word != REFERENCE and word.casefold() in (REFERENCE, f"{REFERENCE}s"):
            what = f"'{word}' is not a set; a target that stands still is of the set '{REFERENCE}'."
            table.fail(i, named["set"], what, named.get("row"))
    if REFERENCE not in words:
        return table, None
    numbered = table
    if "row" not in named:
        cells = tuple([*row, str(k)] for k, row in enumerate(table.cells, start=1))
        numbered = replace(table, header=(*table.header, "row"), cells=cells)
        if "row" not in name_columns(numbered, joint_names, columns)[0]:
            raise MeasurementError(
                f"{table.source}: rows of the set '{REFERENCE}' need their numbers; do not leave out the column 'row'."
            )
    of_references, of_poses = (
        [i for i, word in enumerate(words) if (word == REFERENCE) == wanted]
        for wanted in (True, False)
    )
    if not of_poses:
        raise MeasurementError(
            f"{table.source}: all rows are of the set '{REFERENCE}', which are targets that stand still. "
            "The robot's poses are measured between them, in rows of the set 'estimate'."
        )

    def rows(chosen: Sequence[int]) -> Table:
        """Return the table of chosen rows, from 0."""
        return replace(
            numbered,
            lines=tuple(numbered.lines[i] for i in chosen),
            cells=tuple(numbered.cells[i] for i in chosen),
        )

    return rows(of_poses), rows(of_references)


def read_references(
    poses: Table,
    references: Table,
    columns: ColumnsInput = None,
    joint_names: Sequence[str] = (),
    listed: Points | None = None,
) -> tuple[References | None, Points | None]:
    """Read the references of a table.

    Args:
        poses: The table's poses, as `split_references` gives them.
        references: Its references.
        columns: As of `split_references`.
        joint_names: As of `split_references`.
        listed: A list of measured points, which the rows name in the column ``point``; None: the table has them.

    Returns:
        The references, None if none was measured, in the sequence of all rows with a number; and the other points of
        the list.

    Raises:
        MeasurementError: A cell cannot be used, a column is missing, or a point is not in the list.
    """
    named, group_columns = name_columns(references, joint_names, columns)
    numbers = _row_numbers(references, named["row"])
    _check_kinds(references, named)
    is_named = [True] * len(numbers)
    if listed is not None:
        if "point" not in named:
            raise MeasurementError(
                f"{references.source}: with a list of points (--points) rows of the set '{REFERENCE}' need a column "
                "'point' with the names of their points."
            )
        names = references.column(named["point"])
        is_named = [name != "" for name in names]
        chosen = np.flatnonzero(is_named).tolist()
        found = listed.of_rows(
            references.source, [numbers[i] for i in chosen], [names[i] for i in chosen]
        )
        points = np.full((len(numbers), 3), np.nan)
        points[chosen] = listed.points[found]
        listed = listed.without(found)
    else:
        points = _points(references, named)
    # A row without a measured position is a reading that is not there.
    kept = np.flatnonzero(np.isfinite(points).all(axis=1)).tolist()
    if not kept:
        return None, listed
    of_poses = _keys(poses, columns, joint_names)
    keys = {**of_poses, **_keys(references, columns, joint_names)}
    counts = Counter([*of_poses, *numbers])
    number, times = counts.most_common(1)[0]
    if times > 1:
        raise MeasurementError(
            f"{references.source}: the row number {number} occurs more than once; each row needs its own"
        )
    targets = references.column(named["target"]) if "target" in named else [""] * len(numbers)
    groups = ["/".join(row[c.index] for c in group_columns) for row in references.cells]
    order = sorted(kept, key=lambda i: keys[numbers[i]])
    return References(
        points=points[order],
        targets=tuple(targets[i] or DEFAULT_TARGET for i in order),
        groups=tuple(groups[i] for i in order),
        rows=tuple(numbers[i] for i in order),
        sequence=tuple(sorted(keys, key=keys.__getitem__)),
    ), listed


def check_stations(references: References, groups: Sequence[str], source: str) -> None:
    """Refuse references of a station that measures no position of the robot's targets.

    Args:
        references: The references.
        groups: Stations of the rows that measure a position.
        source: The table's name, for the message.

    Raises:
        MeasurementError: There is one; the text names its row.
    """
    for row, group in zip(references.rows, references.groups, strict=True):
        if group not in groups:
            station = f"the station '{group}'" if group else "a station without a name"
            raise MeasurementError(
                f"{source}, row {row}: a reference is seen from {station}, which measures no position (x, y, z) of the "
                "robot's targets. Name in the column 'group' the station that measured it."
            )


def _row_numbers(table: Table, column: Column) -> list[int]:
    """Return the row numbers of a table by their column; MeasurementError if one is not whole."""
    numbers = []
    for i, text in enumerate(table.column(column)):
        if not text.strip().lstrip("+-").isdigit():
            table.fail(i, column, f"'{text}' is not a whole number. Number the rows.")
        numbers.append(int(text))
    return numbers


def _check_kinds(table: Table, named: Named) -> None:
    """Raise `MeasurementError` if a row names a kind that a reference cannot be."""
    if "kind" not in named:
        return
    for i, word in enumerate(table.column(named["kind"])):
        if word not in _KINDS:
            what = (
                f"a row of the set '{REFERENCE}' is the measured position of a target that stands still, and no "
                f"'{word}'. Leave the cell empty, or write 'point'."
            )
            table.fail(i, named["kind"], what, named.get("row"))


def _points(table: Table, named: Named) -> Array:
    """Return the positions, (rows, 3) [m]; NaN in rows without; MeasurementError if a part of one is missing."""
    missing = [name for name in POINT if name not in named]
    if missing:
        raise MeasurementError(
            f"{table.place}: rows of the set '{REFERENCE}' are measured positions of targets that stand still, and "
            f"need a column '{missing[0]} [mm]'. {list_columns(table)}"
        )
    columns = [with_unit(table, named[name], "length") for name in POINT]
    numbers = table.numbers(columns)
    empty = np.array([[is_blank(row[c.index]) for c in columns] for row in table.cells])
    bad: Mask = np.asarray(~np.isfinite(numbers) & ~np.all(empty, axis=1, keepdims=True))
    if bad.any():
        row, k = np.argwhere(bad)[0].tolist()
        text = table.cells[row][columns[k].index]
        what = f"'{text}' is not a finite number. Write it as 123.45; the unit is in the header."
        table.fail(row, columns[k], what, named.get("row"))
    return np.asarray(numbers * [column.to_si for column in columns])


def _keys(
    table: Table, columns: ColumnsInput, joint_names: Sequence[str]
) -> dict[int, tuple[float, int]]:
    """Return by row number what sorts the rows as they were measured: the column ``order``, then the line.

    MeasurementError if a reference has no number there.
    """
    named, _ = name_columns(table, joint_names, columns)
    texts = table.column(named["row"])
    orders = np.zeros(len(texts))
    if ORDER in named:
        orders = table.numbers([named[ORDER]])[:, 0]
        sets = table.column(named["set"])
        for i, word in enumerate(sets):
            if word == REFERENCE and not np.isfinite(orders[i]):
                what = "the cell holds no number. Fill in when the reference was measured, or remove the row."
                table.fail(i, named[ORDER], what, named["row"])
    result = {}
    for text, order, line in zip(texts, orders.tolist(), table.lines, strict=True):
        if text.strip().lstrip("+-").isdigit():
            result[int(text)] = (order, line)
    return result
