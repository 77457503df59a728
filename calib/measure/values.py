"""The cells of a table into numbers in SI units."""

from __future__ import annotations

from array import array
from collections.abc import Collection, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.errors import MeasurementError, choices
from calib.measure.columns import SETS, check_cells
from calib.measure.layout import Layout
from calib.measure.orientation import to_matrices, wrong_length
from calib.measure.regular_rows import Columns, RegularRows
from calib.measure.row_reader import DEFAULTS, RowNumbers, RowReader
from calib.measure.table import Row, Table
from calib.measure.wrong_units import WrongUnits


@dataclass(frozen=True, slots=True)
class Values:
    """What the rows of a table hold; the attributes are those of `Measurements`.

    ``names`` are the words of the column ``point``, "" without one. ``unmeasured`` are the numbers of rows that are
    left out, for nothing is measured there yet.
    """

    joints: NDArray[np.float64]
    points: NDArray[np.float64]
    sets: tuple[str, ...]
    sigma: NDArray[np.float64] | None
    targets: tuple[str, ...]
    groups: tuple[str, ...]
    rows: tuple[int, ...]
    kinds: tuple[str, ...]
    rotations: NDArray[np.float64] | None
    distances: NDArray[np.float64] | None
    sigma_angle: NDArray[np.float64] | None
    pairs: tuple[str, ...]
    torques: NDArray[np.float64] | None
    names: tuple[str, ...]
    unmeasured: tuple[int, ...]

    @classmethod
    def read(cls, table: Table, layout: Layout) -> Values:
        """Read every row of a table, but for those in which all cells of the measurement are empty.

        Raises:
            MeasurementError: a row, a cell or a column's values cannot be used, or no row is
                ``estimate``, or none is measured.
        """
        found = _Found(table, layout)
        found.read()
        numbers, lines, words, unmeasured = (
            found.numbers,
            found.lines,
            found.words,
            found.unmeasured,
        )
        if not lines:
            raise MeasurementError(_no_rows(table, layout, len(unmeasured)))
        check_sets(table.source, words.get("set", SETS[:1]), len(unmeasured))
        grid = np.frombuffer(numbers, dtype=np.float64).reshape(len(lines), -1)
        rows = tuple(found.numbered.numbers)
        if unmeasured:
            left_out = set(unmeasured)
            rows = tuple(number for number in rows if number not in left_out)
        _check_quaternions(table, layout, grid, lines, rows)
        WrongUnits(table.source, layout, grid, lines, rows).check()
        si = grid * np.array([column.to_si for column in layout.numbers])

        def block(name: str) -> NDArray[np.float64] | None:
            """One column of numbers, shape (N,), if it is there."""
            at = layout.span(name)
            return si[:, at[0]] if at else None

        def word(name: str) -> tuple[str, ...]:
            """The words of one column, or what stands for them without it."""
            return tuple(words.get(name) or (DEFAULTS[name],) * len(lines))

        points, orientation = layout.span("points"), layout.span("orientation")
        return cls(
            joints=si[:, layout.span("joints")],
            points=si[:, points] if points else np.full((len(si), 3), np.nan),
            sets=word("set"),
            sigma=block("sigma"),
            targets=word("target"),
            groups=word("group"),
            rows=rows,
            kinds=tuple(found.kinds),
            rotations=to_matrices(si[:, orientation]) if orientation else None,
            distances=block("distance"),
            sigma_angle=block("sigma_angle"),
            pairs=word("pair"),
            torques=_torques(layout, si),
            names=word("point"),
            unmeasured=tuple(unmeasured),
        )

    def without(self, at: Collection[int], source: str) -> Values:
        """The values without some rows, from 0, that are not measured either.

        Raises:
            MeasurementError: no row is ``estimate`` any more.
        """
        kept = [i for i in range(len(self.rows)) if i not in at]

        def only(values: Any) -> Any:  # noqa: ANN401
            """Those of the rows that are left, of an array or a tuple, or None."""
            if isinstance(values, tuple):
                return tuple(values[i] for i in kept)
            return None if values is None else values[kept]

        by_row = [f.name for f in fields(self) if f.name != "unmeasured"]
        left = {name: only(getattr(self, name)) for name in by_row}
        unmeasured = sorted((*self.unmeasured, *(self.rows[i] for i in at)))
        check_sets(source, left["sets"], len(unmeasured))
        return Values(**left, unmeasured=tuple(unmeasured))


# Words that hardly any two rows have in common.
_OWN = ("pair", "point")


class _Found:
    """What was found in the rows of a table; numbers one row after the other."""

    __slots__ = (
        "_layout",
        "_shared",
        "_table",
        "kinds",
        "lines",
        "numbered",
        "numbers",
        "unmeasured",
        "words",
    )

    def __init__(self, table: Table, layout: Layout) -> None:
        """Nothing yet."""
        self._table, self._layout = table, layout
        self.numbers, self.lines, self.numbered = array("d"), array("q"), RowNumbers()
        self.unmeasured: list[int] = []
        self.kinds: list[str] = []
        self.words: dict[str, list[str]] = {}
        self._shared: dict[str, str] = {}  # a word: one object for all rows that have it

    def read(self) -> None:
        """Read all rows, many at once where nothing is unusual in them."""
        reader = RowReader(self._table, self._layout)
        regular = RegularRows(self._table, self._layout, reader)
        self.words = {name: [] for name in reader.words}
        for block in self._table.blocks():
            columns = regular.read(block, self.numbered)
            if columns is not None:
                self._add(columns, block.lines)
                continue
            for row in block.rows():
                self._add_row(row, reader)

    def _add(self, columns: Columns, lines: Sequence[int]) -> None:
        """Add rows that are all of one kind and measured."""
        self.numbers.frombytes(columns.numbers.tobytes())
        self.numbered.add(columns.rows, lines)
        self.lines.extend(lines)
        self.kinds += self._layout.kinds * len(lines)
        for name, values in self.words.items():
            values += columns.words[name]

    def _add_row(self, row: Row, reader: RowReader) -> None:
        """Read and add a row."""
        check_cells(self._table, row, self._layout.words.get("row"))
        kind = reader.kind(row)
        number = reader.row_number(row, self.numbered)
        self.numbered.add([number], [row.line])
        if reader.is_unmeasured(row, kind):
            self.unmeasured.append(number)
            return
        share = self._shared.setdefault
        self.kinds.append(share(kind, kind))
        self.numbers.extend(reader.numbers(row, kind))
        self.lines.append(row.line)
        for name, values in self.words.items():
            word = reader.word(row, name, kind)
            values.append(word if name in _OWN else share(word, word))


def check_sets(source: str, sets: Sequence[str], unmeasured: int) -> None:
    """Refuse a table of which no row is to be estimated from.

    Raises:
        MeasurementError: there is none.
    """
    if "estimate" in sets:
        return
    but = f", {unmeasured} that are not measured yet aside" if unmeasured else ""
    message = (
        f"{source}, column 'set': no row is 'estimate', all {len(sets)} are 'validate'{but}. Mark those to estimate "
        "from, or remove the column."
    )
    raise MeasurementError(message)


def _no_rows(table: Table, layout: Layout, unmeasured: int) -> str:
    """What to say of a table without rows, or without any that is measured."""
    if not unmeasured:
        return f"{table.source}: the table has a header and no rows below it"
    columns = [c.label for kind in layout.kinds for c in layout.measured_by(kind)]
    listed = ", or give the instrument's list of points with --points" * ("point" in layout.kinds)
    return (
        f"{table.source}: nothing is measured yet; {choices(dict.fromkeys(columns))} are empty in all {unmeasured} "
        f"rows. Fill in what was measured at each pose{listed}."
    )


def _check_quaternions(
    table: Table,
    layout: Layout,
    grid: NDArray[np.float64],
    lines: Sequence[int],
    rows: Sequence[int],
) -> None:
    """Refuse quaternions that have not length one."""
    at = layout.span("orientation")
    wrong = wrong_length(grid[:, at]) if len(at) == 4 else None
    if wrong:
        i, length = wrong
        message = (
            f"{table.source}, line {lines[i]} (row {rows[i]}), columns qx, qy, qz, qw: the quaternion "
            f"has the length {length:.6g}; that of an orientation is 1. Correct it, or leave the "
            "orientation out with --kind point."
        )
        raise MeasurementError(message)


def _torques(layout: Layout, si: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """The torques of all joints, shape (N, n), NaN for a joint without a column; None without any."""
    at = layout.span("torques")
    if not at:
        return None
    torques = np.full((len(si), len(layout.blocks["joints"])), np.nan)
    torques[:, list(layout.torque_joints)] = si[:, at]
    return torques
