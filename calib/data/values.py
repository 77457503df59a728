"""What the rows of a table hold, in SI units.

Cells become floats (empty: NaN; no number: infinite); rows in which nothing is measured are left out; what a row's kind
needs must be there; and values in another unit than the header says are refused.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import compress
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

import calib.data.kinds as registry
from calib.data.checks import better_unit, check_signs, implausible, to_matrices, wrong_length
from calib.data.layout import Layout
from calib.data.points_file import Points, match_points, unmeasured_points
from calib.data.table import DEFAULT_TARGET, SETS, STATUS, TORQUE, Column, Table
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


class Values(NamedTuple):
    """What the rows of a table hold: arguments of `Measurements`."""

    joints: Array
    points: Array
    sets: tuple[str, ...]
    sigma: Array | None
    targets: tuple[str, ...]
    groups: tuple[str, ...]
    rows: tuple[int, ...]
    kinds: tuple[str, ...]
    rotations: Array | None
    distances: Array | None
    readings: Mapping[str, Array]
    sigma_angle: Array | None
    pairs: tuple[str, ...]
    torques: Array | None
    unmeasured: tuple[int, ...]


def read_values(table: Table, layout: Layout, elsewhere: Points | None = None) -> Values:
    """Read every row of a table, but for those in which all cells of the measurement are empty.

    Args:
        table: the table.
        layout: what its columns are.
        elsewhere: the points of the rows, which name them (rows of others are left out), or are in its order.

    Raises:
        MeasurementError: a row, a cell or a column's values cannot be used, a point is not there or is that of
            another row, or no row is ``estimate``, or none is measured.
    """
    grid = _grid(table, layout)
    measured, kinds = _measured(table, layout, grid)
    if not any(measured):
        raise MeasurementError(_no_rows(table, layout))
    every = {name: _words(table, layout, name, measured, kinds) for name in _DEFAULTS}
    placed = {name for name in layout.kinds if registry.get(name).position}
    named = elsewhere is not None and "point" in layout.words
    if elsewhere is not None and named:
        at = [i for i in compress(range(len(kinds)), measured) if kinds[i] in placed]
        for k in unmeasured_points(elsewhere, [every["point"][i] for i in at]):
            measured[at[k]] = False
    words = {name: tuple(compress(found, measured)) for name, found in every.items()}
    if "estimate" not in words["set"]:
        raise MeasurementError(
            f"{table.source}, column 'set': no measured row is 'estimate', all {sum(measured)} are 'validate'. "
            "Mark those to estimate from, or remove the column."
        )
    numbers = _row_numbers(table, layout)
    rows, kinds = tuple(compress(numbers, measured)), list(compress(kinds, measured))
    _check_units(table, layout, np.where(np.array(measured)[:, None], grid, np.nan))
    si = grid[measured] * np.array([column.to_si for column in layout.numbers])
    blocks = {name: si[:, span] for name in layout.blocks if (span := layout.span(name))}
    points = blocks.get("points", np.full((len(si), 3), np.nan))
    if elsewhere is not None:
        at = [i for i, kind in enumerate(kinds) if kind in placed]
        names = [words["point"][i] for i in at] if named else None
        points[at] = match_points(elsewhere, table.source, [rows[i] for i in at], names)
    torques = None
    if "torques" in blocks:
        torques = np.full((len(si), len(layout.joint_names)), np.nan)
        driven = [c.name.removesuffix(TORQUE) for c in layout.blocks["torques"]]
        torques[:, [layout.joint_names.index(name) for name in driven]] = blocks["torques"]
    single = {name: block[:, 0] for name, block in blocks.items() if block.shape[1] == 1}
    readings = {name: single[name] for name in registry.readings() if name in single}
    turned = blocks.get("orientation")
    return Values(
        joints=si[:, layout.span("joints")],
        points=points,
        sets=words["set"],
        sigma=single.get("sigma"),
        targets=words["target"],
        groups=words["group"],
        rows=rows,
        kinds=tuple(kinds),
        rotations=None if turned is None else to_matrices(turned),
        distances=readings.pop("distance", None),
        readings=readings,
        sigma_angle=single.get("sigma_angle"),
        pairs=words["pair"],
        torques=torques,
        unmeasured=tuple(n for n, there in zip(numbers, measured, strict=True) if not there),
    )


def _no_rows(table: Table, layout: Layout) -> str:
    """What to say of a table without rows, or without any that is measured."""
    if not table.cells:
        return f"{table.source}: the table has a header and no rows below it"
    columns = [layout.numbers[i].label for kind in layout.kinds for i in layout.measured_by(kind)]
    listed = ", or give the instrument's list of points with --points" * ("point" in layout.kinds)
    return (
        f"{table.source}: nothing is measured yet; {choices(dict.fromkeys(columns))} are empty in all "
        f"{len(table.cells)} rows. Fill in what was measured at each pose{listed}."
    )


def _grid(table: Table, layout: Layout) -> Array:
    """The numbers as written, shape (rows, columns of numbers): NaN where empty, infinite where there is none."""
    grid = np.empty((len(table.cells), len(layout.numbers)))
    signs: dict[str, int] = {}
    for i, column in enumerate(layout.numbers):
        texts = table.column(column)
        if table.separator == ";":
            for sign in ".,":
                at = next((k for k, text in enumerate(texts) if sign in text), None)
                if at is not None:
                    signs.setdefault(sign, table.lines[at])
            texts = [text.replace(",", ".") for text in texts]
        grid[:, i] = list(map(_number, texts))
    check_signs(table.source, signs)
    return grid


def _number(text: str) -> float:
    """The number in a cell; NaN if it is empty, infinite if there is none."""
    if not text:
        return np.nan
    try:
        value = float(text)
    except ValueError:
        return np.inf
    return np.inf if np.isnan(value) or "_" in text else value


def _fail(table: Table, layout: Layout, row: int, column: Column, what: str = "") -> NoReturn:
    """Refuse a cell of a row, from 0."""
    where = table.place(row, layout.words.get("row"), column)
    text = table.cells[row][column.index][:80]
    if not what and not text:
        what = "the cell is empty. Fill in the number, or remove the row."
    elif not what and "," in text and table.separator != ";":
        what = (
            f"'{text}' has a decimal comma. Write a decimal point, or separate the columns by semicolons: then "
            "decimal commas are read."
        )
    raise MeasurementError(
        f"{where}: {what or f'{text!r} is not a finite number. Write it as 123.45; the unit is in the header.'}"
    )


def _row_numbers(table: Table, layout: Layout) -> list[int]:
    """The numbers of the rows that a person sees, each once."""
    column = layout.words.get("row")
    if column is None:
        return list(range(1, len(table.cells) + 1))
    first: dict[int, int] = {}
    for i, text in enumerate(table.column(column)):
        if not re.fullmatch(r"[+-]?[0-9]{1,18}", text):
            what = f"'{text}' is not a whole number. Number the rows, or remove the column."
            _fail(table, layout, i, column, what)
        if first.setdefault(int(text), i) != i:
            line = table.lines[first[int(text)]]
            what = f"the row number {int(text)} is also that of line {line}. Each row has its own."
            _fail(table, layout, i, column, what)
    return list(first)


def _measured(table: Table, layout: Layout, grid: Array) -> tuple[list[bool], list[str]]:
    """Whether anything is measured in each row, and its kind; in ``grid`` NaN replaces what a row's kind lacks."""
    kinds = [*layout.kinds[:1]] * len(grid)
    if "kind" in layout.words:
        kinds = table.column(layout.words["kind"])
    measured = np.ones(len(grid), dtype=np.bool_)
    if STATUS in layout.words:
        status = table.column(layout.words[STATUS])
        measured &= [not word.startswith("no command: ") for word in status]
    for kind in layout.kinds:
        of_kind = np.array([one == kind for one in kinds], dtype=np.bool_)
        own, used = layout.measured_by(kind), layout.used_by(kind)
        # One row of a pair has the measurement of both.
        shared = own if registry.get(kind).paired else []
        if own and not shared:
            measured &= ~(of_kind & np.isnan(grid[:, own]).all(axis=1))
        bad = ~np.isfinite(grid[:, used]) & (of_kind & measured)[:, None]
        bad &= ~(np.isin(used, shared) & np.isnan(grid[:, used]))
        if bad.any():
            i, k = np.argwhere(bad)[0]
            _fail(table, layout, int(i), layout.numbers[used[k]])
        for i in set(range(grid.shape[1])) - set(used):
            grid[of_kind, i] = np.nan
    return measured.tolist(), kinds


def _words(
    table: Table, layout: Layout, name: str, measured: Sequence[bool], kinds: Sequence[str]
) -> list[str]:
    """The words of all rows: those of a column, or what stands for them without it; checked where measured."""
    column = layout.words.get(name)
    words = [_DEFAULTS[name]] * len(kinds) if column is None else table.column(column)
    if name == "group" and layout.groups:
        words = ["/".join(row[c.index] for c in layout.groups) for row in table.cells]
    own = [registry.get(kind) for kind in layout.kinds]
    needed = {k.name for k in own}
    if name in ("pair", "point"):
        needed = {k.name for k in own if (k.paired if name == "pair" else k.position)}
        words = [word if kind in needed else "" for word, kind in zip(words, kinds, strict=True)]
    if column is None or (name != "set" and name not in _MUST):
        return words
    for i in compress(range(len(words)), measured):
        if (words[i] not in SETS if name == "set" else not words[i]) and kinds[i] in needed:
            what = f"the cell is empty. {_MUST.get(name)}"
            if name == "set":
                what = (
                    f"'{words[i]}' is not a set; allowed are {choices(SETS)}. If the column means something else, "
                    f'--columns "{split_header(column.label)[0]}=-" leaves it out.'
                )
            _fail(table, layout, i, column, what)
    return words


# Values in another unit than the header says


@np.errstate(over="ignore")  # what is infinite is too large as well
def _check_units(table: Table, layout: Layout, grid: Array) -> None:
    """Refuse metres read as millimetres, degrees as radians, and what must be greater than zero and is not.

    ``grid`` are the numbers as written, shape (rows, columns), NaN where a row has none.
    """
    span, columns = layout.span, layout.numbers
    orientation, vector = span("orientation"), len(span("orientation")) == 3
    for at in [*([i] for i in span("joints")), *([orientation] if vector else [])]:
        _check_degrees(table, [columns[i] for i in at], grid[:, at])
    if orientation and not vector and (wrong := wrong_length(grid[:, orientation])):
        what = f"the quaternion has the length {wrong[1]:.6g}; that of an orientation is 1."
        _fail(table, layout, wrong[0], columns[orientation[0]], what)
    read = {n: one for n, one in registry.readings().items() if span(n)}
    for name in ("sigma", "sigma_angle", *(n for n, one in read.items() if one.positive)):
        for i in span(name):
            bad = np.flatnonzero(grid[:, i] <= 0.0)
            if bad.size:
                what = f"{columns[i].name} is '{grid[bad[0], i]:.10g}'; it is greater than zero."
                _fail(table, layout, int(bad[0]), columns[i], what)
    slides = [([i], False) for i in span("joints") if _unit(columns[i]).quantity == "length"]
    lengths = [(span(n), one.positive) for n, one in read.items() if one.quantity == "length"]
    for at, near in (*slides, (span("points"), True), *lengths):
        if at:
            _check_lengths(table, layout, at, grid[:, at], near=near)


def _check_degrees(table: Table, columns: Sequence[Column], values: Array) -> None:
    """Refuse columns of angles, or of a rotation vector, in radians that look like degrees."""
    if any(_unit(column).symbol != "rad" for column in columns):
        return
    size = np.linalg.norm(values, axis=1)
    size = size[~np.isnan(size)]
    if size.size and np.median(size) > _TURNS_RAD:
        raise MeasurementError(
            f"{table.source}, column '{columns[0].label}': half of the values are beyond {np.median(size):.4g} rad, "
            f"more than a turn; they look like degrees. If they are, write '{columns[0].name} [deg]' into the header."
        )


def _check_lengths(
    table: Table, layout: Layout, at: list[int], values: Array, *, near: bool
) -> None:
    """Refuse a place further away than a cell is wide; if ``near``, also places that are all at the origin."""
    columns = [layout.numbers[i] for i in at]
    metres = np.nan_to_num(values) * [column.to_si for column in columns]
    row, what = implausible(metres, _unit(columns[0]), near=near)
    if not what:
        return
    k = int(np.argmax(np.abs(metres[row])))
    column, value = columns[k], float(values[row, k])
    better = better_unit(value, _unit(column))
    fix = "Correct the value."
    if better:
        fix = f"If it is in {better}, write '{column.name} [{better}]' into the header."
    what = f"{value:.10g} was read as {value * column.to_si:.6g} m, {what}. {fix}"
    _fail(table, layout, row, column, what)


def _unit(column: Column) -> Unit:
    """The unit of a column of lengths or angles, which `Layout.find` has made sure of."""
    assert column.unit is not None
    return column.unit
