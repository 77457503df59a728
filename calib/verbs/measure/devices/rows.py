"""Rows of a text that grows: what is new in a table or in a list of points, and lines that are none.

A text that another program writes is read again as a whole when it has changed, by the readers of tables and of lists,
which know separators, decimal signs and units. New are the rows that it did not have before, however often it was
written anew: of equal rows as many as there are more than ever.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile

import numpy as np

from calib.basics.table_header import BLANK, cells_of
from calib.basics.tables import Column, Table, has_header
from calib.basics.units import split_header
from calib.data.columns import POINT
from calib.data.forms.points import Points
from calib.data.points_file import holds_point, parse_points
from calib.errors import MeasurementError
from calib.verbs.measure.devices.reading import Cells, Context

#: Signs that begin a remark.
_REMARK = ("#", "%", "//", "!")

#: Separators of a line without a header, in the order in which they are tried: a comma may be decimal.
_OF_BARE_LINES = (";", "\t", "|", ",", BLANK)

#: Nothing in a cell is so far from an instrument [m].
_FAR = 100.0

#: Most characters of a line that a message shows.
_SHOWN = 80


@dataclass(frozen=True, slots=True)
class FoundRow:
    """A row of a text."""

    #: Its line, from 1.
    line: int
    #: Its cells by header.
    cells: Cells


def rows_of(text: str, source: str, context: Context) -> list[FoundRow]:
    r"""Read all rows of a text: of a table with a header, of bare numbers if their columns are known, or of a list.

    Args:
        text: The text, with lines that end in ``\n``.
        source: Its name, for messages.
        context: Says the columns of bare numbers, the unit of a list, and the names of targets.

    Raises:
        MeasurementError: A line is malformed; the text names it.
    """
    if has_header(text):
        return _table_rows(Table.parse(text, source))
    lines = [(n, line) for n, line in enumerate(text.split("\n"), start=1) if has_content(line)]
    if not lines:
        return []
    if not context.columns:
        return _listed(text, source, context)
    try:
        return [bare_row(line, n, source, context.columns) for n, line in lines]
    except MeasurementError as error:
        try:
            return _listed(text, source, context)  # with names, or below a title
        except MeasurementError:
            raise error from None


def _listed(text: str, source: str, context: Context) -> list[FoundRow]:
    """Read the rows of a list of points; MeasurementError if it is malformed."""
    points = _points_of(text, source, context.points_unit)
    rows = []
    for i, line in enumerate(points.lines):
        cells: dict[str, str | float] = {}
        if points.names:
            is_target = points.names[i] in context.targets
            cells["target" if is_target else "point"] = points.names[i]
        cells |= {f"{axis} [m]": float(x) for axis, x in zip(POINT, points.points[i], strict=True)}
        rows.append(FoundRow(line, cells))
    return rows


def _points_of(text: str, source: str, unit: str | None) -> Points:
    """Read a list of points; MeasurementError if it is malformed.

    One point alone may leave open what its commas are, as in ``512,250 -30,500 800,125``. They are decimal if the point
    would be far out of any cell otherwise: 512 m away.
    """
    try:
        return parse_points(text, source, unit=unit)
    except MeasurementError:
        read = {}
        for sign in ("comma", "point"):
            with contextlib.suppress(MeasurementError):
                read[sign] = parse_points(f"{text}\n# Decimal: {sign}", source, unit=unit)
        is_near = "point" in read and np.abs(read["point"].points).max() < _FAR
        if is_near or "comma" not in read:
            raise
        return read["comma"]


def has_content(line: str) -> bool:
    """Return True if a line is neither blank nor a remark."""
    text = line.strip()
    return bool(text) and not text.startswith(_REMARK)


def row_below(header: str, line: str, number: int, source: str) -> FoundRow:
    """Read one line below the header of a table.

    Args:
        header: The line with the header.
        line: The line.
        number: Its number, from 1.
        source: Where it came from, for messages.

    Raises:
        MeasurementError: It does not fit the header, or has a word where a number should be.
    """
    try:
        rows = _table_rows(Table.parse(f"{header}\n{line}\n", source))
    except MeasurementError:
        rows = []
    if len(rows) != 1:
        raise refused(line, number, source, f"does not fit the header '{header.strip()}'")
    return FoundRow(number, rows[0].cells)


def bare_row(line: str, number: int, source: str, columns: Sequence[str]) -> FoundRow:
    """Read a line of numbers without a header.

    Args:
        line: The line.
        number: Its number, from 1.
        source: Where it came from, for messages.
        columns: Headers of its cells, with units.

    Raises:
        MeasurementError: It has more or fewer cells, or a word where a number should be.
    """
    for separator in _OF_BARE_LINES:
        cells = cells_of(line, separator, is_header=False)
        while len(cells) > len(columns) and not cells[-1]:  # a separator at the end
            cells.pop()
        if len(cells) != len(columns):
            continue
        table = Table(source, "", separator, tuple(columns), (number,), (cells,))
        try:
            (row,) = _table_rows(table)
        except MeasurementError:
            continue
        return row
    wanted = "; ".join(columns)
    raise refused(line, number, source, f"is not a row of the columns '{wanted}'")


def refused(line: str, number: int, source: str, fault: str) -> MeasurementError:
    """Return the error of a malformed line; ``fault`` says what is wrong, after the line."""
    return MeasurementError(
        f"{source}, line {number}: '{line.strip()[:_SHOWN]}' {fault}. It is left out; measure this point again."
    )


def _table_rows(table: Table) -> list[FoundRow]:
    """Return the rows of a table, with the cells of columns with a unit as numbers; MeasurementError for a word there.

    A row without any number is malformed too.
    """
    columns = []
    for i, label in enumerate(table.header):
        name, symbol = split_header(label)
        if symbol:
            columns.append(Column(i, label, name, symbol))
    values = table.numbers(columns)
    rows = []
    for row, (line, cells) in enumerate(zip(table.lines, table.cells, strict=True)):
        named = zip(table.header, cells, strict=True)
        found: dict[str, str | float] = {label: cell for label, cell in named if label}
        for column, value in zip(columns, values[row].tolist(), strict=True):
            if np.isinf(value):
                table.fail(row, column, f"'{cells[column.index][:_SHOWN]}' is not a number.")
            if np.isfinite(value):
                found[column.label] = value
        if columns and not np.isfinite(values[row]).any():
            raise refused(" ".join(cells), line, table.source, "has no number")
        rows.append(FoundRow(line, found))
    return rows


class GrowingText:
    """A text that grows: each time it is read, its new part."""

    def __init__(self, source: str, context: Context) -> None:
        self._source = source
        self._context = context
        #: The most equal rows that the text had at a time.
        self._known: Counter[tuple[tuple[str, str | float], ...]] = Counter()
        #: The lines that were read last, the malformed ones blank.
        self._lines: list[str] = []
        #: Malformed lines, which are left out wherever they stand.
        self._malformed: set[str] = set()
        #: What was said last, which is not said again.
        self._said = ""

    def update(self, text: str) -> tuple[list[FoundRow], list[MeasurementError]]:
        r"""Read the text as it is now.

        Args:
            text: All of it, with lines that end in ``\n``, the last one complete.

        Returns:
            The rows that are new, and an error for each new line that is malformed.
        """
        lines = ["" if line in self._malformed else line for line in text.split("\n")]
        faults: list[MeasurementError] = []
        try:
            rows = self._rows(lines)
        except MeasurementError:
            faults = self._leave_out(lines)
            rows = self._rows_if_any(lines)
        self._lines = lines
        return self._new(rows), faults

    def _rows(self, lines: Sequence[str]) -> list[FoundRow]:
        """Return the rows of lines; MeasurementError if one is malformed."""
        return rows_of("\n".join(lines), self._source, self._context)

    def _rows_if_any(self, lines: Sequence[str]) -> list[FoundRow]:
        """Return the rows of lines without malformed ones; none of a title alone, which is no list of points yet."""
        try:
            return self._rows(lines)
        except MeasurementError:
            return []

    def _leave_out(self, lines: list[str]) -> list[MeasurementError]:
        """Make malformed lines blank, one after the other, and return an error for each of them."""
        pairs = zip(lines, self._lines, strict=False)
        read_before = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))
        has_rows = bool(self._rows_if_any(lines[:read_before]))
        faults = []
        for end in range(read_before, len(lines)):
            if not has_content(lines[end]):
                continue
            try:
                has_rows = bool(self._rows(lines[: end + 1]))
            except MeasurementError as error:
                if not has_rows and self._is_title(lines, end):
                    continue
                self._malformed.add(lines[end])
                lines[end] = ""
                if str(error) != self._said:
                    faults.append(error)
                    self._said = str(error)
        return faults

    def _is_title(self, lines: Sequence[str], end: int) -> bool:
        """Return True if a line may stand above a list of points, which begins with its first point."""
        return not has_header("\n".join(lines[:end])) and not holds_point(lines[end])

    def _new(self, rows: Sequence[FoundRow]) -> list[FoundRow]:
        """Return the rows that the text did not have before, and know them from here on."""
        now: Counter[tuple[tuple[str, str | float], ...]] = Counter()
        new = []
        for row in rows:
            key = tuple(row.cells.items())
            now[key] += 1
            if now[key] > self._known[key]:
                new.append(row)
        self._known |= now
        return new
