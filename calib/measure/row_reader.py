"""One row of a table after the other into numbers and words, with messages that name the cell."""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import itemgetter

from calib.errors import MeasurementError, choices
from calib.measure.columns import DEFAULT_TARGET, SETS, Column, place
from calib.measure.kinds import POSITIONS
from calib.measure.layout import Layout
from calib.measure.table import Row, Table
from calib.units import split_header

#: The words of a row, and what stands for them in a table without the column.
DEFAULTS = {"set": SETS[0], "target": DEFAULT_TARGET, "group": "", "pair": "", "point": ""}

#: Words that are not empty, and what to do where they are.
MUST: dict[str, str] = {
    "target": "Name the target, or remove the column when there is only one.",
    "pair": "The two rows of a measured distance share a word here.",
    "point": "Name the point of the file of points that was measured here.",
}


class RowNumbers:
    """The numbers of the rows read so far, in their order, and the lines that they stand in."""

    __slots__ = ("_lines", "_where", "largest", "numbers")

    def __init__(self) -> None:
        """None yet."""
        self.numbers, self._lines = array("q"), array("q")
        self.largest = -(10**18)
        self._where: dict[int, int] = {}  # grows only where numbers do not

    def add(self, numbers: Sequence[int], lines: Sequence[int]) -> None:
        """Add some that are not there yet."""
        self.numbers.extend(numbers)
        self._lines.extend(lines)
        self.largest = max(self.largest, *numbers)

    def line_of(self, number: int) -> int | None:
        """The line of the row that has this number; None where none has."""
        if number > self.largest or not self.numbers:
            return None
        done = len(self._where)
        self._where.update(zip(self.numbers[done:], self._lines[done:], strict=True))
        return self._where.get(number)


class RowReader:
    """Reads one row after the other, with what has to be remembered between them."""

    __slots__ = ("_layout", "_measured", "_picks", "_table", "groups", "signs", "words")

    def __init__(self, table: Table, layout: Layout) -> None:
        """Prepare for the kinds of rows that there are."""
        self._table, self._layout = table, layout
        self._picks = {kind: Pick.of(layout, layout.used_by(kind)) for kind in layout.kinds}
        self._measured = {
            kind: [column.index for column in layout.measured_by(kind)] for kind in layout.kinds
        }
        if "pair" in layout.kinds:
            distance = layout.span("distance")
            rest = [i for i in layout.used_by("pair") if i not in distance]
            self._picks["other of a pair"] = Pick.of(layout, rest)
        there = {*layout.words, *(["group"] if layout.groups else [])}
        self.words = tuple(name for name in DEFAULTS if name in there)
        self.signs: dict[str, int] = {}  # decimal sign: the first line that has it
        self.groups: dict[str, tuple[str, ...]] = {}  # name: the words that it was made of

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
                self.signs.setdefault(sign, line)
        if len(self.signs) == 2:
            message = (
                f"{self._table.source}: numbers have a decimal point in line {self.signs['.']} and "
                f"a decimal comma in line {self.signs[',']}. Write all in one way, without a sign "
                "between thousands."
            )
            raise MeasurementError(message)

    def is_unmeasured(self, row: Row, kind: str) -> bool:
        """Whether all that this row should have measured is empty, a pose still to come; or it was never sent."""
        places = self._measured[kind]
        empty = bool(places) and not any(row.cells[i] for i in places)
        return empty or self._layout.has_no_command(row.cells)

    def row_number(self, row: Row, numbered: RowNumbers) -> int:
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
        before = numbered.line_of(number)
        if before is not None:
            message = f"{where}: the row number {number} is also that of line {before}. Each row has its own."
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
        if name in MUST and not text:
            message = f"{self.place(row, column)}: the cell is empty. {MUST[name]}"
            raise MeasurementError(message)
        return text

    def _group(self, row: Row) -> str:
        """The name of the set-up of a row, of one column or of several."""
        columns = self._layout.groups
        if len(columns) < 2:
            return row.cells[columns[0].index] if columns else ""
        words = tuple(row.cells[column.index] for column in columns)
        name = "/".join(words)
        if self.groups.setdefault(name, words) != words:
            message = (
                f"{self.place(row)}: the words {choices(words)} make the same group '{name}' as "
                f"{choices(self.groups[name])}. Write words without '/' in these columns."
            )
            raise MeasurementError(message)
        return name


@dataclass(frozen=True, slots=True)
class Pick:
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
    def of(cls, layout: Layout, used: list[int]) -> Pick:
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
