"""The cells of a table into numbers and words: column by column, many rows at once.

Only where a column does not convert is it looked through, for the first cell that is wrong.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

import calib.kinds as registry
from calib.errors import MeasurementError, choices
from calib.measure.columns import DEFAULT_TARGET, SETS, Column, check_widths, place
from calib.measure.layout import Layout
from calib.measure.table import Block, Table, distinct
from calib.units import split_header

Array = NDArray[np.float64]

#: The words of a row, and what stands for them in a table without the column.
_DEFAULTS = {"set": SETS[0], "target": DEFAULT_TARGET, "group": "", "pair": "", "point": ""}

#: Words that are not empty, and what to do where they are.
_MUST = {
    "target": "Name the target, or remove the column when there is only one.",
    "pair": "The two rows of a measured distance share a word here.",
    "point": "Name the point of the file of points that was measured here.",
}

#: The cell of a table of commands whose row was never sent.
_NO_COMMAND = "no command: "

_WHOLE = re.compile(r"[+-]?[0-9]{1,18}").fullmatch


@dataclass(slots=True, eq=False)
class Cells:
    """What was found in the cells of a table so far, but for rows in which nothing is measured yet.

    Attributes:
        table: the table.
        layout: which column is what.
        grids: numbers as written, shape (rows, columns of numbers) each, NaN where a row's kind has none.
        lines: of the file, for each row.
        rows: the row numbers.
        kinds: the kind of each row.
        words: the words of each row, by ``set``, ``target``, ``group``, ``pair`` and ``point``.
        unmeasured: the numbers of the rows that are left out.
    """

    table: Table
    layout: Layout
    grids: list[Array] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)
    rows: list[int] = field(default_factory=list)
    kinds: list[str] = field(default_factory=list)
    words: dict[str, list[str]] = field(default_factory=dict)
    unmeasured: list[int] = field(default_factory=list)
    _numbered: dict[int, int] = field(default_factory=dict)  # row number: its line
    _signs: dict[str, int] = field(default_factory=dict)  # decimal sign: the first line that has it
    _groups: dict[str, tuple[str, ...]] = field(default_factory=dict)  # name: the words it is of

    def add(self, block: Block) -> None:
        """Read some rows."""
        check_widths(self.table, block, self.layout.words.get("row"))
        cells = list(zip(*block.cells, strict=True))
        numbers = self._row_numbers(block, cells)
        kinds = self._words_of("kind", cells) or self.layout.kinds * len(block.lines)
        grid = np.full((len(block.lines), len(self.layout.numbers)), np.nan)
        measured = np.ones(len(block.lines), dtype=bool)
        if "status" in self.layout.words:
            sent = [not word.startswith(_NO_COMMAND) for word in self._words_of("status", cells)]
            measured &= sent
        for kind in self.layout.kinds:
            of_kind = (
                np.array([one == kind for one in kinds]) if len(self.layout.kinds) > 1 else measured
            )
            measured &= ~(of_kind & self._is_empty(kind, cells))
            own = np.flatnonzero(of_kind & measured)
            if len(own):
                self._add_numbers(block, kind, cells, own, grid)
        kept = np.flatnonzero(measured).tolist()
        for name in _DEFAULTS:
            self._add_words(block, name, cells, kinds, kept)
        whole = len(kept) == len(measured)
        self.grids.append(grid if whole else grid[kept])
        self.lines += block.lines if whole else [block.lines[i] for i in kept]
        self.rows += numbers if whole else [numbers[i] for i in kept]
        self.kinds += kinds if whole else [kinds[i] for i in kept]
        if not whole:
            self.unmeasured += [number for i, number in enumerate(numbers) if not measured[i]]

    def _fail(self, block: Block, i: int, column: Column | None, what: str) -> None:
        """Refuse a cell, or a row.

        Raises:
            MeasurementError: with the place.
        """
        where = place(self.table, block.row(i), self.layout.words.get("row"), column)
        raise MeasurementError(f"{where}: {what}")

    def _row_numbers(self, block: Block, cells: Sequence[Sequence[str]]) -> list[int]:
        """The numbers of the rows that a person sees, each once."""
        column = self.layout.words.get("row")
        if column is None:
            return list(range(block.first, block.first + len(block.lines)))
        texts = [text.strip() for text in cells[column.index]]
        for i, text in enumerate(texts):
            if not _WHOLE(text):
                what = f"'{text}' is not a whole number. Number the rows, or remove the column."
                self._fail(block, i, column, what)
        found = list(map(int, texts))
        for i, (number, line) in enumerate(zip(found, block.lines, strict=True)):
            before = self._numbered.setdefault(number, line)
            if before != line:
                what = (
                    f"the row number {number} is also that of line {before}. Each row has its own."
                )
                self._fail(block, i, column, what)
        return found

    def _is_empty(self, kind: str, cells: Sequence[Sequence[str]]) -> NDArray[np.bool_]:
        """Whether rows of a kind hold nothing that was measured; one row of a pair does, and nothing follows."""
        columns = [self.layout.numbers[i].index for i in self.layout.measured_by(kind)]
        empty = np.full(len(cells[0]), bool(columns) and not registry.get(kind).paired)
        for index in columns if empty.any() else ():
            empty &= [not text or text.isspace() for text in cells[index]]
            if not empty.any():
                break
        return empty

    def _add_numbers(
        self,
        block: Block,
        kind: str,
        cells: Sequence[Sequence[str]],
        own: NDArray[np.intp],
        grid: Array,
    ) -> None:
        """The numbers of the rows of one kind."""
        whole = len(own) == len(block.lines)
        maybe = set(self.layout.measured_by(kind)) if registry.get(kind).paired else set()
        for i in self.layout.used_by(kind):
            column = self.layout.numbers[i]
            texts = cells[column.index]
            chosen = texts if whole else [texts[k] for k in own]
            at = own
            if i in maybe:  # the other row of the pair has it
                filled = np.array([bool(text.strip()) for text in chosen])
                at = own[filled]
                chosen = [texts[k] for k in at]
            grid[at, i] = self._numbers(block, column, chosen, at)

    def _numbers(
        self, block: Block, column: Column, texts: Sequence[str], at: NDArray[np.intp]
    ) -> Array:
        """The finite numbers of some cells of a column."""
        comma = self.table.separator == ";"
        if comma:
            self._note_signs(block, texts, at)
            texts = [text.replace(",", ".") for text in texts]
        try:
            values = np.array(list(map(float, texts)), dtype=np.float64)
        except ValueError:
            values = np.full(len(texts), np.nan)
        # float() takes 1_000, which no table means.
        if np.all(np.isfinite(values)) and "_" not in "".join(texts):
            return values
        for i in at.tolist():
            text = block.cells[i][column.index].strip()
            fault = _fault(text, self.table.separator)
            if fault:
                self._fail(block, i, column, fault)
        return values

    def _note_signs(self, block: Block, texts: Sequence[str], at: NDArray[np.intp]) -> None:
        """Refuse decimal points beside decimal commas: one of them may separate thousands."""
        for sign in ".,":
            if sign not in self._signs and sign in "".join(texts):
                i = next(i for i, text in zip(at.tolist(), texts, strict=True) if sign in text)
                self._signs[sign] = block.lines[i]
        if len(self._signs) == 2:
            raise MeasurementError(
                f"{self.table.source}: numbers have a decimal point in line {self._signs['.']} and "
                f"a decimal comma in line {self._signs[',']}. Write all in one way, without a sign "
                "between thousands."
            )

    def _words_of(self, name: str, cells: Sequence[Sequence[str]]) -> list[str]:
        """The words of a column; none without it."""
        column = self.layout.words.get(name)
        return [] if column is None else distinct(cells[column.index])

    def _add_words(
        self,
        block: Block,
        name: str,
        cells: Sequence[Sequence[str]],
        kinds: Sequence[str],
        kept: list[int],
    ) -> None:
        """The words of the rows that are kept: those of a column, or what stands for them without it."""
        column = self.layout.words.get(name)
        words = self._names(block, cells, kept) if name == "group" else self._words_of(name, cells)
        words = words or [_DEFAULTS[name]] * len(kinds)
        needs = [True] * len(words)
        if name in ("pair", "point"):
            told = {k: _is_told(name, k) for k in self.layout.kinds}
            needs = [told[kind] for kind in kinds]
            words = [word if need else "" for word, need in zip(words, needs, strict=True)]
        if column is not None:
            for i in kept:
                if name == "set" and words[i] not in SETS:
                    what = (
                        f"'{words[i]}' is not a set; allowed are {choices(SETS)}. If the column means something else, "
                        f'--columns "{split_header(column.label)[0]}=-" leaves it out.'
                    )
                    self._fail(block, i, column, what)
                if name in _MUST and needs[i] and not words[i]:
                    self._fail(block, i, column, f"the cell is empty. {_MUST[name]}")
        self.words.setdefault(name, []).extend(
            words if len(kept) == len(words) else [words[i] for i in kept]
        )

    def _names(self, block: Block, cells: Sequence[Sequence[str]], kept: list[int]) -> list[str]:
        """The names of the set-ups, of one column or of several; none without one."""
        parts = [distinct(cells[column.index]) for column in self.layout.groups]
        if len(parts) < 2:
            return parts[0] if parts else []
        whole = list(zip(*parts, strict=True))
        names = {words: "/".join(words) for words in set(whole)}
        for i in kept:
            words = whole[i]
            other = self._groups.setdefault(names[words], words)
            if other != words:
                what = (
                    f"the words {choices(words)} make the same group '{names[words]}' as {choices(other)}. Write words "
                    "without '/' in these columns."
                )
                self._fail(block, i, None, what)
        return [names[words] for words in whole]


def _is_told(name: str, kind: str) -> bool:
    """Whether rows of a kind have a word in the column ``pair``, or ``point``."""
    own = registry.get(kind)
    return own.paired if name == "pair" else own.position


def _fault(text: str, separator: str) -> str:
    """What is wrong with the cell of a number; "" if nothing is."""
    if text == "":
        return "the cell is empty. Fill in the number, or remove the row."
    try:
        value = float(text.replace(",", ".") if separator == ";" else text)
    except ValueError:
        value = None
    if value is None or "_" in text:
        if "," in text and separator != ";":
            return (
                f"'{text}' has a decimal comma. Write a decimal point, or separate the columns by semicolons: then "
                "decimal commas are read."
            )
        return f"'{text}' is not a number. Write it as 123.45; the unit is in the header."
    return (
        ""
        if np.isfinite(value)
        else f"'{text}' is not a finite number. Correct it, or remove the row."
    )
