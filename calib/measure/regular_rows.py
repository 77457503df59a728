"""Many rows of a table at once, column by column, where nothing is unusual in them: a million in two seconds.

Whatever is unusual is left to `calib.measure.row_reader`, which reads to the same bits and says what is wrong.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.measure.columns import SETS
from calib.measure.kinds import POSITIONS
from calib.measure.layout import Layout
from calib.measure.row_reader import MUST, RowNumbers, RowReader
from calib.measure.table import Block, Table

_WHOLE = re.compile(r"[+-]?[0-9]{1,18}").fullmatch

# Sums of numbers below it are finite.
_HUGE = 1e300


@dataclass(frozen=True, slots=True)
class Columns:
    """What a block of rows holds: shape (N, numbers) as written, row numbers, and words by column."""

    numbers: NDArray[np.float64]
    rows: Sequence[int]
    words: Mapping[str, list[str]]


class RegularRows:
    """Reads blocks of rows of one kind, in which all cells are filled in."""

    __slots__ = ("_kind", "_layout", "_reader", "_shared", "_table")

    def __init__(self, table: Table, layout: Layout, reader: RowReader) -> None:
        """Share ``reader``'s memory of what rows must agree in."""
        self._table, self._layout, self._reader = table, layout, reader
        self._kind = layout.kinds[0]
        self._shared: dict[str, str] = {}  # cell: its word, one object for all rows

    def read(self, block: Block, numbered: RowNumbers) -> Columns | None:
        """The block's rows; None if they are not all regular, or not surely so."""
        layout = self._layout
        if len(layout.kinds) > 1 or "status" in layout.words:
            return None
        columns = block.columns()
        if columns is None:
            return None
        rows = self._rows(block, columns, numbered)
        words = None if rows is None else self._words(columns)
        numbers = None if words is None else self._numbers(block, columns)
        if rows is None or words is None or numbers is None:
            return None
        return Columns(numbers, rows, words)

    def _rows(
        self, block: Block, columns: list[Sequence[str]], numbered: RowNumbers
    ) -> Sequence[int] | None:
        """The row numbers, where they increase."""
        column = self._layout.words.get("row")
        if column is None:
            return range(block.first, block.first + len(block.lines))
        texts = [text.strip() for text in columns[column.index]]
        if not all(map(_WHOLE, texts)):
            return None
        rows = np.array(list(map(int, texts)))
        increasing = rows[0] > numbered.largest and bool(np.all(np.diff(rows) > 0))
        return rows.tolist() if increasing else None

    def _numbers(self, block: Block, columns: list[Sequence[str]]) -> NDArray[np.float64] | None:
        """The numbers of all columns of numbers, shape (N, numbers)."""
        used = written = [columns[column.index] for column in self._layout.numbers]
        text = block.text or "".join(map("".join, used))
        if "_" in text and any("_" in cell for cells in used for cell in cells):
            return None  # float() takes 1_000, which no table means
        signs: set[str] = set()
        if self._table.separator == ";":
            joined = list(map("".join, used))
            signs = {sign for sign in ".," if any(sign in cells for cells in joined)}
            if len(signs | self._reader.signs.keys()) > 1:
                return None
            if "," in signs:
                used = [[cell.replace(",", ".") for cell in cells] for cells in used]
        values = np.empty((len(block.lines), len(used)))
        try:
            for i, texts in enumerate(used):
                values[:, i] = list(map(float, texts))
        except ValueError:
            return None
        if not np.all(np.abs(values) < _HUGE):
            return None
        for sign in signs - self._reader.signs.keys():
            self._reader.signs[sign] = next(
                line
                for line, *cells in zip(block.lines, *written, strict=True)
                if any(sign in cell for cell in cells)
            )
        return values

    def _words(self, columns: list[Sequence[str]]) -> dict[str, list[str]] | None:
        """The words of all columns of words."""
        count = len(columns[0])
        found: dict[str, list[str]] = {}
        for name in self._reader.words:
            idle = (name == "pair" and self._kind != "pair") or (
                name == "point" and self._kind not in POSITIONS
            )
            if idle:
                found[name] = [""] * count
                continue
            words = (
                self._groups(columns)
                if name == "group"
                else self._stripped(columns[self._layout.words[name].index])
            )
            if words is None or (name in MUST and "" in words):
                return None
            if name == "set" and not set(words) <= set(SETS):
                return None
            found[name] = words
        return found

    def _stripped(self, cells: Sequence[str]) -> list[str]:
        """The words of a column, those that are the same as the same object."""
        shared = self._shared
        different = set(cells)
        if len(different) > len(cells) // 2:  # hardly any word comes again
            return [cell.strip() for cell in cells]
        for cell in different:
            shared.setdefault(cell, cell.strip())
        return [shared[cell] for cell in cells]

    def _groups(self, columns: list[Sequence[str]]) -> list[str] | None:
        """The names of the set-ups; None where two of them cannot be told apart."""
        parts = [self._stripped(columns[column.index]) for column in self._layout.groups]
        if len(parts) == 1:
            return parts[0]
        whole = list(zip(*parts, strict=True))
        names = {words: "/".join(words) for words in dict.fromkeys(whole)}
        if any(
            self._reader.groups.setdefault(name, words) != words for words, name in names.items()
        ):
            return None
        return [names[words] for words in whole]
