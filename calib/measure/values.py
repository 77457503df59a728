"""The cells of a table into numbers in SI units; values in the wrong unit are refused."""

from __future__ import annotations

import math
import re
from array import array
from dataclasses import dataclass
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from calib.errors import MeasurementError, choices
from calib.measure.columns import Column, Layout
from calib.measure.table import Row, Table
from calib.units import UNITS, Unit

SETS = ("estimate", "validate")
DEFAULT_TARGET = "target"

# The points of a robot cell lie between these distances from the origin of any frame in use.
FAR_M = 100.0
NEAR_M = 5e-3
# Half of a column beyond this many radians: hardly any joint turns so far, and degrees mostly do.
TURNS_RAD = 7.0


@dataclass(frozen=True, slots=True)
class Values:
    """What the rows of a table hold; the attributes are those of `Measurements`."""

    joints: NDArray[np.float64]
    points: NDArray[np.float64]
    sigma: NDArray[np.float64] | None
    sets: tuple[str, ...]
    targets: tuple[str, ...]
    groups: tuple[str, ...]
    rows: tuple[int, ...]

    @classmethod
    def read(cls, table: Table, layout: Layout) -> Values:
        """Read every row of a table.

        Raises:
            MeasurementError: a row, a cell or a column's values cannot be used, or no row is
                ``estimate``.
        """
        pick = itemgetter(*(column.index for column in layout.numbers))
        numbers, lines = array("d"), array("q")
        numbered: dict[int, int] = {}  # row number: line
        words: dict[str, list[str]] = {"set": [], "target": [], "group": []}
        signs: dict[str, int] = {}  # decimal sign: the first line that has it
        for row in table.rows():
            _check_cells(table, layout, row)
            texts = pick(row.cells)
            numbers.extend(_numbers(table, layout, row, texts))
            if table.separator == ";":
                _note_signs(table, signs, row.line, "".join(texts))
            number = _row_number(table, layout, row, numbered)
            numbered[number] = row.line
            lines.append(row.line)
            for name, values in words.items():
                values.append(_word(table, layout, row, name))
        if not lines:
            message = f"{table.source}: the table has a header and no rows below it"
            raise MeasurementError(message)
        if "estimate" not in words["set"]:
            message = (
                f"{table.source}, column '{layout.words['set'].label}': no row is 'estimate', all "
                f"{len(lines)} are 'validate'. Mark those to estimate from, or remove the column."
            )
            raise MeasurementError(message)
        grid = np.array(numbers, dtype=np.float64).reshape(len(lines), -1)
        rows = tuple(numbered)
        check = _Check(table, layout, grid, tuple(lines), rows)
        check.angles()
        check.lengths()
        si = grid * np.array([_unit(column).to_si for column in layout.numbers])
        n = len(layout.joints)
        return cls(
            joints=si[:, :n],
            points=si[:, n : n + 3],
            sigma=None if layout.sigma is None else si[:, n + 3],
            sets=tuple(words["set"]),
            targets=tuple(words["target"]),
            groups=tuple(words["group"]),
            rows=rows,
        )


def _unit(column: Column) -> Unit:
    """The unit of a column of numbers, which `Layout.find` has made sure of."""
    assert column.unit is not None
    return column.unit


def _place(table: Table, layout: Layout, row: Row, column: Column | None = None) -> str:
    """Where a cell stands, as a person sees it: file, line, row number, column."""
    number = str(row.ordinal)
    if "row" in layout.words and layout.words["row"].index < len(row.cells):
        number = row.cells[layout.words["row"].index] or number
    text = f"{table.source}, line {row.line} (row {number})"
    return text if column is None else f"{text}, column '{column.label}'"


def _check_cells(table: Table, layout: Layout, row: Row) -> None:
    """Refuse a row that has not as many cells as the header."""
    count, wanted = len(row.cells), len(table.header)
    if count == wanted:
        return
    fix = "Fill in what is missing."
    if count > wanted:
        fix = "Remove what is too much."
        if table.separator == ",":
            fix += " If the numbers have a decimal comma, separate the columns by semicolons."
    message = (
        f"{_place(table, layout, row)}: the row has {count} cells, the header has {wanted}. {fix}"
    )
    raise MeasurementError(message)


def _numbers(table: Table, layout: Layout, row: Row, texts: tuple[str, ...]) -> list[float]:
    """The numbers of one row, in the order of ``layout.numbers``."""
    if table.separator == ";" and any("," in text for text in texts):
        plain = tuple(text.replace(",", ".") for text in texts)
    else:
        plain = texts
    try:
        values = [float(text) for text in plain]
    except ValueError:
        values = []
    # float() takes 1_000, which no table means; a sum is finite only if all its terms are.
    if values and math.isfinite(sum(values)) and "_" not in "".join(plain):
        if layout.sigma is None or values[-1] > 0.0:
            return values
        what = f"sigma is '{texts[-1]}'; a standard deviation is greater than zero"
        column = layout.sigma
    else:
        column, what = _bad_number(table, layout, texts, plain)
    message = f"{_place(table, layout, row, column)}: {what}"
    raise MeasurementError(message)


def _bad_number(
    table: Table, layout: Layout, texts: tuple[str, ...], plain: tuple[str, ...]
) -> tuple[Column, str]:
    """The first column of a row that does not hold a finite number, and what is wrong with it."""
    for column, text, candidate in zip(layout.numbers, texts, plain, strict=True):
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
    return layout.numbers[0], "the numbers of the row are too large"


def _note_signs(table: Table, signs: dict[str, int], line: int, text: str) -> None:
    """Refuse decimal points beside decimal commas: one of them may separate thousands."""
    for sign in ".,":
        if sign in text:
            signs.setdefault(sign, line)
    if len(signs) == 2:
        message = (
            f"{table.source}: numbers have a decimal point in line {signs['.']} and a decimal "
            f"comma in line {signs[',']}. Write all in one way, without a sign between thousands."
        )
        raise MeasurementError(message)


def _row_number(table: Table, layout: Layout, row: Row, numbered: dict[int, int]) -> int:
    """The number of the row a person sees; ``numbered`` holds those before it, with their lines."""
    column = layout.words.get("row")
    if column is None:
        return row.ordinal
    text = row.cells[column.index]
    if not re.fullmatch(r"[+-]?[0-9]{1,18}", text):
        message = (
            f"{table.source}, line {row.line}, column '{column.label}': '{text}' is not a whole "
            "number. Number the rows, or remove the column."
        )
        raise MeasurementError(message)
    number = int(text)
    if number in numbered:
        message = (
            f"{table.source}, line {row.line}, column '{column.label}': the row number {number} is "
            f"also that of line {numbered[number]}. Each row has its own."
        )
        raise MeasurementError(message)
    return number


def _word(table: Table, layout: Layout, row: Row, name: str) -> str:
    """The set, target or group of a row."""
    column = layout.words.get(name)
    if column is None:
        return {"set": SETS[0], "target": DEFAULT_TARGET, "group": ""}[name]
    text = row.cells[column.index]
    if name == "set" and text not in SETS:
        place = _place(table, layout, row, column)
        message = f"{place}: '{text}' is not a set; allowed are {choices(SETS)}"
        raise MeasurementError(message)
    if name == "target" and not text:
        message = (
            f"{_place(table, layout, row, column)}: the cell is empty. Name the target, or remove "
            "the column when there is only one."
        )
        raise MeasurementError(message)
    return text


@dataclass(frozen=True, slots=True)
class _Check:
    """Looks at the numbers as read, shape (N, columns), for values that belong to another unit."""

    table: Table
    layout: Layout
    grid: NDArray[np.float64]
    lines: tuple[int, ...]
    rows: tuple[int, ...]

    def angles(self) -> None:
        """Refuse a column in radians that looks like degrees."""
        for i, column in enumerate(self.layout.joints):
            if _unit(column).symbol != "rad":
                continue
            median = float(np.median(np.abs(self.grid[:, i])))
            if median > TURNS_RAD:
                message = (
                    f"{self.table.source}, column '{column.label}': half of the values are beyond "
                    f"{median:.4g} rad, more than a turn; they look like degrees. If they are, "
                    f"write '{column.name} [deg]' into the header."
                )
                raise MeasurementError(message)

    def lengths(self) -> None:
        """Refuse points, or values of a prismatic joint, that are too far away or all too near."""
        n = len(self.layout.joints)
        for i, column in enumerate(self.layout.joints):
            if _unit(column).quantity == "length":
                self._far([i])
        self._far([n, n + 1, n + 2])
        self._near([n, n + 1, n + 2])

    def _metres(self, columns: list[int]) -> NDArray[np.float64]:
        """Columns of lengths in metres, shape (N, len(columns))."""
        to_si = np.array([_unit(self.layout.numbers[i]).to_si for i in columns])
        return np.asarray(self.grid[:, columns] * to_si)

    def _far(self, columns: list[int]) -> None:
        """Refuse a row further from the origin than any robot cell is wide."""
        distance = np.linalg.norm(self._metres(columns), axis=1)
        worst = int(np.argmax(distance))
        if distance[worst] > FAR_M:
            largest = columns[int(np.argmax(np.abs(self._metres(columns)[worst])))]
            self._refuse(worst, largest, f"further from the origin than {FAR_M:g} m")

    def _near(self, columns: list[int]) -> None:
        """Refuse points that all lie nearer to the origin than a robot moves."""
        metres = self._metres(columns)
        farthest = int(np.argmax(np.linalg.norm(metres, axis=1)))
        largest = columns[int(np.argmax(np.abs(metres[farthest])))]
        in_metres = _unit(self.layout.numbers[largest]).symbol == "m"  # no unit is larger
        if np.linalg.norm(metres[farthest]) < NEAR_M and not in_metres:
            what = f"and no point is further from the origin than {NEAR_M * 1e3:g} mm"
            self._refuse(farthest, largest, what)

    def _refuse(self, i: int, j: int, what: str) -> None:
        """Say what was read and which unit would make sense of it."""
        column = self.layout.numbers[j]
        value = float(self.grid[i, j])
        fits = [u for u in ("mm", "m", "um") if 0.01 <= abs(value) * UNITS[u].to_si <= 20.0]
        fix = "Correct the value."
        if fits and fits[0] != _unit(column).symbol:
            fix = f"If it is in {fits[0]}, write '{column.name} [{fits[0]}]' into the header."
        place = f"{self.table.source}, line {self.lines[i]} (row {self.rows[i]})"
        message = (
            f"{place}, column '{column.label}': "
            f"{value:.10g} was read as {value * _unit(column).to_si:.6g} m, {what}. {fix}"
        )
        raise MeasurementError(message)
