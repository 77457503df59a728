"""What the rows of a table hold, in SI units.

Cells become floats, many rows at once (empty: NaN; no number: infinite); rows in which nothing is measured are left
out; what a row's kind needs must be there; and values in another unit than the header says are refused.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, compress
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

import calib.data.kinds as registry
from calib.data.checks import better_unit, check_signs, implausible, to_matrices, wrong_length
from calib.data.layout import Layout
from calib.data.points_file import Points, match_points, unmeasured_points
from calib.data.table import (
    DEFAULT_TARGET,
    SETS,
    STATUS,
    TORQUE,
    Column,
    Table,
    check_cells,
    place,
)
from calib.errors import MeasurementError, choices
from calib.units import Unit, split_header

Array = NDArray[np.float64]

#: The words of a row, and what stands for them in a table without the column.
_DEFAULTS = {"set": SETS[0], "target": DEFAULT_TARGET, "group": "", "pair": "", "point": ""}

#: Words that are not empty, and what to do where they are.
_MUST = {
    "target": "Name the target, or remove the column when there is only one.",
    "pair": "The two rows of a measured distance share a word here.",
    "point": "Name the point of the file of points that was measured here.",
}

# Half of a column beyond this [rad]: hardly any joint turns so far, and degrees mostly do.
_TURNS_RAD = 7.0
# Rotation vectors [deg] that are all as long as those in radians, while a joint turns further than this [rad].
_VECTOR_DEG, _TURNING_RAD = (0.5, 2.0 * np.pi), float(np.radians(30.0))


@dataclass(frozen=True, slots=True)
class Values:
    """What the rows of a table hold; the attributes are those of `Measurements`.

    ``unmeasured`` are the numbers of rows that are left out: nothing is measured there yet.
    """

    joints: Array
    points: Array
    sets: tuple[str, ...]
    sigma: Array | None
    targets: tuple[str, ...]
    groups: tuple[str, ...]
    rows: tuple[int, ...]
    kinds: tuple[str, ...]
    rotations: Array | None
    readings: Mapping[str, Array]
    sigma_angle: Array | None
    pairs: tuple[str, ...]
    torques: Array | None
    unmeasured: tuple[int, ...]

    @classmethod
    def read(cls, table: Table, layout: Layout, elsewhere: Points | None = None) -> Values:
        """Read every row of a table, but for those in which all cells of the measurement are empty.

        Args:
            table: the table.
            layout: what its columns are.
            elsewhere: the points of the rows, which name them (rows of others are left out), or are in its order.

        Raises:
            MeasurementError: a row, a cell or a column's values cannot be used, a point is not there or is that of
                another row, or no row is ``estimate``, or none is measured.
        """
        cells = _Cells(table, layout)
        measured, kinds = cells.measured()
        if not any(measured):
            raise MeasurementError(_no_rows(table, layout, len(measured)))
        every = {name: cells.checked_words(name, measured, kinds) for name in _DEFAULTS}
        placed = {name for name in layout.kinds if registry.get(name).position}
        named = elsewhere is not None and "point" in layout.words
        if elsewhere is not None and named:
            at = [i for i in compress(range(len(kinds)), measured) if kinds[i] in placed]
            for k in unmeasured_points(elsewhere, [every["point"][i] for i in at]):
                measured[at[k]] = False
        words = {name: tuple(compress(found, measured)) for name, found in every.items()}
        if "estimate" not in words["set"]:
            count = len(measured) - sum(measured)
            but = f", {count} that are not measured yet aside" if count else ""
            raise MeasurementError(
                f"{table.source}, column 'set': no row is 'estimate', all {sum(measured)} are 'validate'{but}. Mark "
                "those to estimate from, or remove the column."
            )
        numbers = cells.row_numbers()
        rows, lines = tuple(compress(numbers, measured)), tuple(compress(cells.lines, measured))
        grid, kinds = cells.grid[measured], list(compress(kinds, measured))
        WrongUnits(table.source, layout, grid, lines, rows).check()
        si = grid * np.array([column.to_si for column in layout.numbers])

        def block_of(name: str) -> Array | None:
            """One column of numbers, shape (N,), if it is there."""
            span = layout.span(name)
            return si[:, span[0]] if span else None

        points = np.full((len(si), 3), np.nan)
        if elsewhere is not None:
            at = [i for i, kind in enumerate(kinds) if kind in placed]
            names = [words["point"][i] for i in at] if named else None
            points[at] = match_points(elsewhere, table.source, [rows[i] for i in at], names)
        elif layout.span("points"):
            points = si[:, layout.span("points")]
        torques = None
        if layout.span("torques"):
            at = [
                layout.joint_names.index(c.name.removesuffix(TORQUE))
                for c in layout.blocks["torques"]
            ]
            torques = np.full((len(si), len(layout.joint_names)), np.nan)
            torques[:, at] = si[:, layout.span("torques")]
        turned = layout.span("orientation")
        return cls(
            joints=si[:, layout.span("joints")],
            points=points,
            sets=words["set"],
            sigma=block_of("sigma"),
            targets=words["target"],
            groups=words["group"],
            rows=rows,
            kinds=tuple(kinds),
            rotations=to_matrices(si[:, turned]) if turned else None,
            readings={n: si[:, layout.span(n)[0]] for n in registry.readings() if layout.span(n)},
            sigma_angle=block_of("sigma_angle"),
            pairs=words["pair"],
            torques=torques,
            unmeasured=tuple(n for n, there in zip(numbers, measured, strict=True) if not there),
        )


def _no_rows(table: Table, layout: Layout, unmeasured: int) -> str:
    """What to say of a table without rows, or without any that is measured."""
    if not unmeasured:
        return f"{table.source}: the table has a header and no rows below it"
    columns = [layout.numbers[i].label for kind in layout.kinds for i in layout.measured_by(kind)]
    listed = ", or give the instrument's list of points with --points" * ("point" in layout.kinds)
    return (
        f"{table.source}: nothing is measured yet; {choices(dict.fromkeys(columns))} are empty in all {unmeasured} "
        f"rows. Fill in what was measured at each pose{listed}."
    )


class _Cells:
    """The cells of a table: numbers as written, shape (rows, columns of numbers), and words by the column's name."""

    def __init__(self, table: Table, layout: Layout) -> None:
        """Read them all, block after block."""
        self.table, self.layout = table, layout
        self.lines: list[int] = []
        words: dict[str, list[list[str]]] = {name: [] for name in (*layout.words, "group")}
        grids = [np.empty((0, len(layout.numbers)))]
        signs: dict[str, int] = {}  # decimal sign: the first line that has it
        for lines, block in table.blocks():
            if any(len(cells) != len(table.header) for cells in block):
                for row in table.rows():
                    check_cells(table, row, layout.words.get("row"))
            columns = list(zip(*block, strict=True))
            grid = np.empty((len(block), len(layout.numbers)))
            for i, column in enumerate(layout.numbers):
                grid[:, i] = self._numbers(columns[column.index], lines, signs)
            grids.append(grid)
            self.lines += lines
            for name, column in layout.words.items():
                words[name].append(_distinct(columns[column.index]))
            if layout.groups:
                parts = zip(*(_distinct(columns[c.index]) for c in layout.groups), strict=True)
                words["group"].append(_distinct([*map("/".join, parts)]))
        self.grid: Array = np.concatenate(grids)
        self.words = {name: list(chain.from_iterable(found)) for name, found in words.items()}

    def _numbers(self, texts: Sequence[str], lines: Sequence[int], signs: dict[str, int]) -> Any:  # noqa: ANN401
        """Some cells of a column as numbers, shape (n,): NaN where empty, infinite where there is no finite number."""
        joined = "".join(texts)
        if self.table.separator == ";":
            for sign in (sign for sign in ".," if sign not in signs and sign in joined):
                signs[sign] = lines[next(i for i, text in enumerate(texts) if sign in text)]
            check_signs(self.table.source, signs)
            texts = [text.replace(",", ".") for text in texts]
        try:
            values = np.array(list(map(float, texts)))
            if np.isfinite(values).all() and "_" not in joined:  # 1_000, which no table means
                return values
        except ValueError:
            pass
        return [_number(text) for text in texts]

    def _fail(self, i: int, column: Column | None, what: str) -> NoReturn:
        """Refuse a cell, or a row, from 0."""
        row = next(row for row in self.table.rows() if row.ordinal == i + 1)
        where = place(self.table, row, self.layout.words.get("row"), column)
        text = "" if column is None else row.cells[column.index]
        raise MeasurementError(f"{where}: {what or _fault(text, self.table.separator)}")

    def row_numbers(self) -> list[int]:
        """The numbers of the rows that a person sees, each once."""
        texts, column = self.words.get("row"), self.layout.words.get("row")
        if texts is None:
            return list(range(1, len(self.lines) + 1))
        is_whole = re.compile(r"[+-]?[0-9]{1,18}").fullmatch
        for i, text in enumerate(texts):
            if not is_whole(text):
                what = f"'{text}' is not a whole number. Number the rows, or remove the column."
                self._fail(i, column, what)
        numbers = list(map(int, texts))
        if len(set(numbers)) < len(numbers):
            first: dict[int, int] = {}
            i = next(i for i, n in enumerate(numbers) if first.setdefault(n, i) != i)
            line = self.lines[first[numbers[i]]]
            what = f"the row number {numbers[i]} is also that of line {line}. Each row has its own."
            self._fail(i, column, what)
        return numbers

    def measured(self) -> tuple[list[bool], list[str]]:
        """Whether anything is measured in each row, and its kind.

        In ``grid`` NaN takes the place of what a row's kind does not use.
        """
        layout, grid = self.layout, self.grid
        kinds = self.words.get("kind") or [*layout.kinds[:1]] * len(grid)
        measured = np.ones(len(grid), dtype=np.bool_)
        if STATUS in self.words:
            measured &= [not word.startswith("no command: ") for word in self.words[STATUS]]
        several = len(layout.kinds) > 1
        for kind in layout.kinds:
            of_kind = (
                np.array([one == kind for one in kinds]) if several else np.ones_like(measured)
            )
            own, used = layout.measured_by(kind), layout.used_by(kind)
            # One row of a pair has the measurement of both.
            shared = own if registry.get(kind).paired else []
            if own and not shared:
                measured &= ~(of_kind & np.isnan(grid[:, own]).all(axis=1))
            bad = ~np.isfinite(grid[:, used]) & (of_kind & measured)[:, None]
            bad &= ~(np.isin(used, shared) & np.isnan(grid[:, used]))
            if bad.any():
                i, k = np.argwhere(bad)[0]
                self._fail(int(i), layout.numbers[used[k]], "")
            for i in set(range(grid.shape[1])) - set(used):
                grid[of_kind, i] = np.nan
        return measured.tolist(), kinds

    def checked_words(self, name: str, measured: Sequence[bool], kinds: Sequence[str]) -> list[str]:
        """The words of all rows: those of a column, or what stands for them without it; checked where measured."""
        column = self.layout.words.get(name)
        words = self.words.get(name) or [_DEFAULTS[name]] * len(kinds)
        own = [registry.get(kind) for kind in self.layout.kinds]
        if name in ("pair", "point"):
            needed = {k.name for k in own if (k.paired if name == "pair" else k.position)}
            words = [
                word if kind in needed else "" for word, kind in zip(words, kinds, strict=True)
            ]
        else:
            needed = {k.name for k in own}
        wrong = set(words) - set(SETS) if name == "set" else {""} if name in _MUST else set()
        wrong &= set(words)
        if column is None or not wrong:
            return words
        for i in compress(range(len(words)), measured):
            if words[i] in wrong and kinds[i] in needed:
                what = f"the cell is empty. {_MUST.get(name)}"
                if name == "set":
                    what = (
                        f"'{words[i]}' is not a set; allowed are {choices(SETS)}. If the column means something else, "
                        f'--columns "{split_header(column.label)[0]}=-" leaves it out.'
                    )
                self._fail(i, column, what)
        return words


def _distinct(cells: Sequence[str]) -> list[str]:
    """Cells without the blanks around them, those that are the same as the same object: columns of words are long."""
    stripped = {cell: cell.strip() for cell in set(cells)}
    return [stripped[cell] for cell in cells]


def _number(text: str) -> float:
    """The number in a cell; NaN if it is empty, infinite if there is none."""
    if not text or text.isspace():
        return np.nan
    try:
        value = float(text)
    except ValueError:
        return np.inf
    return np.inf if np.isnan(value) or "_" in text else value


def _fault(text: str, separator: str) -> str:
    """What is wrong with the cell of a number."""
    if text == "":
        return "the cell is empty. Fill in the number, or remove the row."
    try:
        float(text.replace(",", ".") if separator == ";" else text)
        infinite = "_" not in text
    except ValueError:
        infinite = False
    if infinite:
        return f"'{text}' is not a finite number. Correct it, or remove the row."
    if "," in text and separator != ";":
        return (
            f"'{text}' has a decimal comma. Write a decimal point, or separate the columns by semicolons: then "
            "decimal commas are read."
        )
    return f"'{text}' is not a number. Write it as 123.45; the unit is in the header."


@dataclass(frozen=True, slots=True)
class WrongUnits:
    """Numbers as written, shape (N, columns), NaN where a row has none; they may be in another unit than said."""

    source: str
    layout: Layout
    grid: Array
    lines: Sequence[int]
    rows: Sequence[int]

    @np.errstate(over="ignore")  # what is infinite is too large as well
    def check(self) -> None:
        """Refuse metres read as millimetres, degrees as radians, and what must be greater than zero and is not.

        Raises:
            MeasurementError: with the place, and the unit that would make sense.
        """
        span, columns = self.layout.span, self.layout.numbers
        orientation = span("orientation")
        vector = orientation if len(orientation) == 3 else []
        for at in [*([i] for i in span("joints")), *([vector] if vector else [])]:
            self._degrees(at)
        if vector:
            self._radians(vector)
        elif orientation:
            self._quaternions(orientation)
        read = {n: one for n, one in registry.readings().items() if span(n)}
        for name in ("sigma", "sigma_angle", *(n for n, one in read.items() if one.positive)):
            for i in span(name):
                self._positive(i)
        slides = [([i], False) for i in span("joints") if _unit(columns[i]).quantity == "length"]
        lengths = [(span(n), one.positive) for n, one in read.items() if one.quantity == "length"]
        for at, near in (*slides, (span("points"), True), *lengths):
            if at:
                self._lengths(at, near=near)
        for i in span("sigma_angle"):
            # No instrument is so bad [rad], and sigmas in degrees mostly look so in radians.
            vague = np.flatnonzero(self.grid[:, i] * columns[i].to_si > 1.0)
            if vague.size:
                what = "which says nothing of an orientation"
                self._refuse(int(vague[0]), i, "rad", what, "deg")

    def _angles(self, at: list[int], unit: str) -> Array:
        """The sizes of angles or rotation vectors as written, where all columns have this unit; else none."""
        if any(_unit(self.layout.numbers[i]).symbol != unit for i in at):
            return np.empty(0)
        size = np.linalg.norm(self.grid[:, at], axis=1)
        return np.asarray(size[~np.isnan(size)])

    def _degrees(self, at: list[int]) -> None:
        """Refuse columns in radians that look like degrees."""
        size, column = self._angles(at, "rad"), self.layout.numbers[at[0]]
        median = float(np.median(size)) if size.size else 0.0
        if median > _TURNS_RAD:
            raise MeasurementError(
                f"{self.source}, column '{column.label}': half of the values are beyond "
                f"{median:.4g} rad, more than a turn; they look like degrees. If they are, "
                f"write '{column.name} [deg]' into the header."
            )

    def _radians(self, at: list[int]) -> None:
        """Refuse rotation vectors in degrees that look like radians: the robot turns, they hardly do."""
        size, column = self._angles(at, "deg"), self.layout.numbers[at[0]]
        if not size.size or not (np.median(size) > _VECTOR_DEG[0] and size.max() < _VECTOR_DEG[1]):
            return
        for i in self.layout.span("joints"):
            joint = self.layout.numbers[i]
            turned = float(np.ptp(self.grid[:, i])) * joint.to_si
            if _unit(joint).quantity == "angle" and turned > _TURNING_RAD:
                raise MeasurementError(
                    f"{self.source}, column '{column.label}': no rotation vector is longer than "
                    f"{size.max():.4g} deg, while '{joint.name}' turns by {np.degrees(turned):.4g} deg; "
                    f"they look like radians. If they are, write '{column.name} [rad]' into the "
                    "header; if not, give them in radians."
                )

    def _quaternions(self, at: list[int]) -> None:
        """Refuse quaternions that have not length one."""
        wrong = wrong_length(self.grid[:, at])
        if wrong:
            raise MeasurementError(
                f"{self._place(wrong[0])}, columns qx, qy, qz, qw: the quaternion has the length "
                f"{wrong[1]:.6g}; that of an orientation is 1. Correct it, or leave the "
                'orientation out with --columns "qx=-" and so on.'
            )

    def _positive(self, i: int) -> None:
        """Refuse a standard deviation or a distance that is not greater than zero."""
        column = self.layout.numbers[i]
        wrong = np.flatnonzero(self.grid[:, i] <= 0.0)
        if wrong.size:
            raise MeasurementError(
                f"{self._place(wrong[0])}, column '{column.label}': {column.name} is "
                f"'{self.grid[wrong[0], i]:.10g}'; it is greater than zero. Correct it, or leave the column out: "
                "noise is found from the data."
            )

    def _lengths(self, at: list[int], *, near: bool) -> None:
        """Refuse a place further away than a cell is wide; if ``near``, also places that are all at the origin."""
        metres = np.nan_to_num(self.grid[:, at]) * [self.layout.numbers[i].to_si for i in at]
        row, what = implausible(metres, _unit(self.layout.numbers[at[0]]), near=near)
        if what:
            self._refuse(row, at[int(np.argmax(np.abs(metres[row])))], "m", what)

    def _refuse(self, row: int, i: int, si: str, what: str, better: str = "") -> NoReturn:
        """Say what was read and which unit would make sense of it."""
        column, value = self.layout.numbers[i], float(self.grid[row, i])
        better = better or better_unit(value, _unit(column))
        fix = "Correct the value."
        if better:
            fix = f"If it is in {better}, write '{column.name} [{better}]' into the header."
        raise MeasurementError(
            f"{self._place(row)}, column '{column.label}': {value:.10g} was read as {value * column.to_si:.6g} {si}, "
            f"{what}. {fix}"
        )

    def _place(self, row: int) -> str:
        return f"{self.source}, line {self.lines[row]} (row {self.rows[row]})"


def _unit(column: Column) -> Unit:
    """The unit of a column of lengths or angles, which `Layout.find` has made sure of."""
    assert column.unit is not None
    return column.unit
