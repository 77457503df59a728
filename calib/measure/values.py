"""The cells of a table into numbers in SI units."""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, fields
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.errors import MeasurementError, choices
from calib.measure.columns import Column, check_cells, place
from calib.measure.kinds import DEFAULT_TARGET, POSITIONS, SETS
from calib.measure.layout import Layout
from calib.measure.orientation import to_matrices, wrong_length
from calib.measure.table import Row, Table
from calib.measure.wrong_units import WrongUnits
from calib.units import split_header


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
        reader = _Reader(table, layout)
        numbers, lines = array("d"), array("q")
        numbered: dict[int, int] = {}  # row number: line
        unmeasured: list[int] = []
        kinds: list[str] = []
        words: dict[str, list[str]] = {name: [] for name in reader.words}
        for row in table.rows():
            check_cells(table, row, layout.words.get("row"))
            kind = reader.kind(row)
            number = reader.row_number(row, numbered)
            numbered[number] = row.line
            if reader.is_unmeasured(row, kind):
                unmeasured.append(number)
                continue
            kinds.append(kind)
            numbers.extend(reader.numbers(row, kind))
            lines.append(row.line)
            for name, values in words.items():
                values.append(reader.word(row, name, kind))
        if not lines:
            raise MeasurementError(_no_rows(table, layout, len(unmeasured)))
        check_sets(table.source, words.get("set", SETS[:1]), len(unmeasured))
        grid = np.array(numbers, dtype=np.float64).reshape(len(lines), -1)
        left_out = set(unmeasured)
        rows = tuple(number for number in numbered if number not in left_out)
        _check_quaternions(table, layout, grid, tuple(lines), rows)
        WrongUnits(table.source, layout, grid, tuple(lines), rows).check()
        si = grid * np.array([column.to_si for column in layout.numbers])

        def block(name: str) -> NDArray[np.float64] | None:
            """One column of numbers, shape (N,), if it is there."""
            at = layout.span(name)
            return si[:, at[0]] if at else None

        def word(name: str) -> tuple[str, ...]:
            """The words of one column, or what stands for them without it."""
            return tuple(words.get(name) or [_DEFAULTS[name]] * len(lines))

        points, orientation = layout.span("points"), layout.span("orientation")
        return cls(
            joints=si[:, layout.span("joints")],
            points=si[:, points] if points else np.full((len(si), 3), np.nan),
            sets=word("set"),
            sigma=block("sigma"),
            targets=word("target"),
            groups=word("group"),
            rows=rows,
            kinds=tuple(kinds),
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


_DEFAULTS = {"set": SETS[0], "target": DEFAULT_TARGET, "group": "", "pair": "", "point": ""}

_MUST: dict[str, str] = {
    "target": "Name the target, or remove the column when there is only one.",
    "pair": "The two rows of a measured distance share a word here.",
    "point": "Name the point of the file of points that was measured here.",
}


class _Reader:
    """Reads one row after the other, with what has to be remembered between them."""

    __slots__ = ("_groups", "_layout", "_measured", "_picks", "_signs", "_table", "words")

    def __init__(self, table: Table, layout: Layout) -> None:
        """Prepare for the kinds of rows that there are."""
        self._table, self._layout = table, layout
        self._picks = {kind: _Pick.of(layout, layout.used_by(kind)) for kind in layout.kinds}
        self._measured = {
            kind: [column.index for column in layout.measured_by(kind)] for kind in layout.kinds
        }
        if "pair" in layout.kinds:
            distance = layout.span("distance")
            rest = [i for i in layout.used_by("pair") if i not in distance]
            self._picks["other of a pair"] = _Pick.of(layout, rest)
        there = {*layout.words, *(["group"] if layout.groups else [])}
        self.words = tuple(name for name in _DEFAULTS if name in there)
        self._signs: dict[str, int] = {}  # decimal sign: the first line that has it
        self._groups: dict[str, tuple[str, ...]] = {}

    def place(self, row: Row, column: Column | None = None) -> str:
        """Where a cell stands."""
        return place(self._table, row, self._layout.words.get("row"), column)

    def numbers(self, row: Row, kind: str) -> list[float]:
        """The numbers of one row, in the order of ``layout.numbers``; NaN where its kind has none."""
        pick = self._picks[kind]
        if kind == "pair" and row.cells[pick.columns[pick.distance].index] == "":
            pick = self._picks["other of a pair"]
        texts = pick.cells(row.cells)
        values = self._convert(row, pick.columns, texts)
        if self._table.separator == ";":
            self._note_signs(row.line, "".join(texts))
        if pick.places is None:
            return values
        wide = [math.nan] * pick.width
        for i, value in zip(pick.places, values, strict=True):
            wide[i] = value
        return wide

    def _convert(
        self, row: Row, columns: tuple[Column, ...], texts: tuple[str, ...]
    ) -> list[float]:
        """Finite numbers of texts."""
        if self._table.separator == ";" and any("," in text for text in texts):
            plain = tuple(text.replace(",", ".") for text in texts)
        else:
            plain = texts
        try:
            values = [float(text) for text in plain]
        except ValueError:
            values = []
        # float() takes 1_000, which no table means; a sum is finite only if all its terms are.
        if values and math.isfinite(sum(values)) and "_" not in "".join(plain):
            return values
        column, what = _bad_number(self._table, columns, texts, plain)
        message = f"{self.place(row, column)}: {what}"
        raise MeasurementError(message)

    def _note_signs(self, line: int, text: str) -> None:
        """Refuse decimal points beside decimal commas: one of them may separate thousands."""
        for sign in ".,":
            if sign in text:
                self._signs.setdefault(sign, line)
        if len(self._signs) == 2:
            message = (
                f"{self._table.source}: numbers have a decimal point in line {self._signs['.']} and "
                f"a decimal comma in line {self._signs[',']}. Write all in one way, without a sign "
                "between thousands."
            )
            raise MeasurementError(message)

    def is_unmeasured(self, row: Row, kind: str) -> bool:
        """Whether all that this row should have measured is empty, a pose still to come; or it was never sent."""
        places = self._measured[kind]
        empty = bool(places) and not any(row.cells[i] for i in places)
        return empty or self._layout.has_no_command(row.cells)

    def row_number(self, row: Row, numbered: dict[int, int]) -> int:
        """The number of the row a person sees; ``numbered`` holds those before it, with their lines."""
        column = self._layout.words.get("row")
        if column is None:
            return row.ordinal
        text = row.cells[column.index]
        where = f"{self._table.source}, line {row.line}, column '{column.label}'"
        if not re.fullmatch(r"[+-]?[0-9]{1,18}", text):
            message = (
                f"{where}: '{text}' is not a whole number. Number the rows, or remove the column."
            )
            raise MeasurementError(message)
        number = int(text)
        if number in numbered:
            message = (
                f"{where}: the row number {number} is also that of line {numbered[number]}. Each "
                "row has its own."
            )
            raise MeasurementError(message)
        return number

    def kind(self, row: Row) -> str:
        """The kind of a row, which `Layout.find` has looked at."""
        column = self._layout.words.get("kind")
        return self._layout.kinds[0] if column is None else row.cells[column.index]

    def word(self, row: Row, name: str, kind: str) -> str:
        """A word of a row; "" where its kind has no such word."""
        if name == "group":
            return self._group(row)
        if (name == "pair" and kind != "pair") or (name == "point" and kind not in POSITIONS):
            return ""
        column = self._layout.words[name]
        text = row.cells[column.index]
        if name == "set" and text not in SETS:
            message = (
                f"{self.place(row, column)}: '{text}' is not a set; allowed are {choices(SETS)}. If "
                "the column means something else, "
                f'--columns "{split_header(column.label)[0]}=-" leaves it out.'
            )
            raise MeasurementError(message)
        if name in _MUST and not text:
            message = f"{self.place(row, column)}: the cell is empty. {_MUST[name]}"
            raise MeasurementError(message)
        return text

    def _group(self, row: Row) -> str:
        """The name of the set-up of a row, of one column or of several."""
        columns = self._layout.groups
        if len(columns) < 2:
            return row.cells[columns[0].index] if columns else ""
        words = tuple(row.cells[column.index] for column in columns)
        name = "/".join(words)
        if self._groups.setdefault(name, words) != words:
            message = (
                f"{self.place(row)}: the words {choices(words)} make the same group '{name}' as "
                f"{choices(self._groups[name])}. Write words without '/' in these columns."
            )
            raise MeasurementError(message)
        return name


@dataclass(frozen=True, slots=True)
class _Pick:
    """The number columns that rows of one kind use.

    Attributes:
        columns: those used.
        cells: gives their texts out of a row's cells.
        places: where they stand among all number columns; None when all are used.
        width: the number of all number columns.
        distance: the position of the distance among ``columns``; -1 when it is not there.
    """

    columns: tuple[Column, ...]
    cells: Callable[[list[str]], tuple[str, ...]]
    places: list[int] | None
    width: int
    distance: int

    @classmethod
    def of(cls, layout: Layout, used: list[int]) -> _Pick:
        """The columns ``used`` among ``layout.numbers``."""
        every = layout.numbers
        columns = tuple(every[i] for i in used)
        get = itemgetter(*(column.index for column in columns))
        distance = layout.span("distance")
        return cls(
            columns,
            get if len(columns) > 1 else lambda cells: (get(cells),),
            None if len(used) == len(every) else used,
            len(every),
            used.index(distance[0]) if distance and distance[0] in used else -1,
        )


def _bad_number(
    table: Table, columns: tuple[Column, ...], texts: tuple[str, ...], plain: tuple[str, ...]
) -> tuple[Column, str]:
    """The first column of a row that does not hold a finite number, and what is wrong with it."""
    for column, text, candidate in zip(columns, texts, plain, strict=True):
        if text == "":
            return column, "the cell is empty. Fill in the number, or remove the row."
        try:
            value = math.nan if "_" in candidate else float(candidate)
            number = "_" not in candidate
        except ValueError:
            number = False
        if number and math.isfinite(value):
            continue
        if number:
            return column, f"'{text}' is not a finite number. Correct it, or remove the row."
        if "," in text and table.separator != ";":
            return column, (
                f"'{text}' has a decimal comma. Write a decimal point, or separate the columns by "
                "semicolons: then decimal commas are read."
            )
        return column, f"'{text}' is not a number. Write it as 123.45; the unit is in the header."
    return columns[0], "the numbers of the row are too large"


def _check_quaternions(
    table: Table,
    layout: Layout,
    grid: NDArray[np.float64],
    lines: tuple[int, ...],
    rows: tuple[int, ...],
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
