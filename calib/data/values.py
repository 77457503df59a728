"""Values of a table of measurements: what its rows hold, in SI units, as arguments of `Measurements`."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from itertools import compress
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

import calib.data.kinds as registry
from calib.basics.arrays import Array, Mask
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.tables import Column, Table, is_blank
from calib.data.columns import (
    MOVE,
    POINT,
    REFERENCE,
    SETS,
    STATUS,
    TORQUE,
    VIA,
    WORD_COLUMNS,
)
from calib.data.forms.points import Points
from calib.data.kinds import Kind
from calib.data.layout import Layout, slides
from calib.data.plausibility import check_units
from calib.errors import MeasurementError, choices
from calib.numerics.moves import last_moves

#: Numbers of a layout's blocks by name, shape (rows, columns) each.
Blocks = Mapping[str, Array]

#: A word a row.
Words = NDArray[np.str_]

#: A whole number in a cell.
_WHOLE = re.compile(r"[+-]?[0-9]{1,18}")

#: A date as Excel writes it into a CSV file: ``5-Jan``, ``May-01``, ``1. Mai``, ``2026-05-01``, ``1.5.2026``.
_DATE = re.compile(
    r"\d{1,2}[-. ]+[^\W\d_]{3,9}\.?(?:[-. ]+\d{2,4})?|[^\W\d_]{3,9}[-. ]+\d{1,4}"
    r"|\d{1,4}([-/.])\d{1,2}\1\d{1,4}(?: \d{1,2}:\d\d(?::\d\d)?)?|\d{1,2}/\d{1,2}"
)

#: A number with a sign between its thousands; one comma alone may be decimal.
_THOUSANDS = re.compile(
    r"[+-]?\d{1,3}(?:(?:['\u2019 \xa0\u2009\u202f]\d{3})+(?:[.,]\d*)?|(?:,\d{3})+\.\d*|(?:\.\d{3})+,\d*|(?:,\d{3}){2,})"
)

#: Begins the status of a row of a table of commands that has none.
_NO_COMMAND = "no command: "

#: Longest text of a cell that a message quotes.
_QUOTED = 80

#: Blocks that tell where the robot was, and when, also in rows of no kind, which measure nothing.
_OF_POSE = ("joints", "order")

#: Blocks of any number of columns; the others have one.
_WIDE = (
    "joints",
    "torques",
    "moves",
    "order",
    "points",
    "board_points",
    "orientation",
    "covariances",
)


def read_values(
    table: Table,
    layout: Layout,
    elsewhere: Points | None = None,
    *,
    as_measured: bool = False,
    needs_all_joints: bool = True,
) -> dict[str, Any]:
    """Read what the rows of a table hold.

    Rows in which all cells of the measurement, or the point's name, are empty, that have no kind, or whose status says
    that there is no command, and poses that are only driven through are left out; the joints' last moves know them.

    Args:
        table: The table.
        layout: Its columns.
        elsewhere: A list of measured points, which the rows name in the column ``point`` or are in
            the order of; rows whose point is not in it are left out. None: the table has them.
        as_measured: Whether the rows are sorted as they were measured, by the column ``order`` if there is one, and
            those of no set that measure nothing but joint values are left out; else the table is one of poses, and its
            rows are as they are.
        needs_all_joints: Whether each row must have a value of each joint.

    Returns:
        Arguments of `Measurements`, in SI units.

    Raises:
        MeasurementError: A cell or a column's values cannot be used, a point is not there or is
            that of another row, or nothing is measured.
    """
    kinds = np.full(len(table.cells), layout.kinds[0])
    if "kind" in layout.words:
        kinds = np.array(table.column(layout.words["kind"]), dtype=np.str_)
    blocks = _used_numbers(table, layout, kinds)
    without_joint: Mask | None = None
    if not needs_all_joints and "joints" in blocks:
        columns = layout.blocks["joints"]
        is_empty = [[is_blank(row[column.index]) for column in columns] for row in table.cells]
        without_joint = np.array(is_empty, dtype=np.bool_).reshape(-1, len(columns))
        blocks["joints"] = _filled(blocks["joints"], without_joint)
    measured = _measured_rows(table, layout, blocks, kinds)
    if as_measured:
        measures_number = [name for name in layout.kinds if registry.get(name).size]
        measured &= _has_word(table, layout, "set") | np.isin(kinds, measures_number)

    count = len(table.cells)
    if not count:
        raise MeasurementError(f"{table.source}: there is a header, but no row below it.")
    if not measured.any():
        listed = ""
        if "point" in layout.kinds:
            listed = ", or give the instrument's list of points (--points)"
        raise MeasurementError(
            f"{table.source}: nothing is measured yet in its {count} rows. Fill in what was measured "
            f"at each pose{listed}."
        )

    words = {name: table.column(column) for name, column in layout.words.items()}
    if layout.groups:
        words["group"] = ["/".join(row[c.index] for c in layout.groups) for row in table.cells]
    _check_words(table, layout, words, kinds, measured)
    row_numbers = list(range(1, count + 1))
    if "row" in words:
        row_numbers = [int(text) if text else 0 for text in words["row"]]

    points: Array | None = None
    if elsewhere is not None:
        needs_point = measured & _of_kinds(layout, kinds, "position")
        numbers = list(compress(row_numbers, needs_point))
        names = list(compress(words["point"], needs_point)) if "point" in words else None
        indices = np.array(elsewhere.of_rows(table.source, numbers, names), dtype=np.intp)
        is_listed = indices >= 0
        points = np.full((count, 3), np.nan)
        points[np.flatnonzero(needs_point)[is_listed]] = elsewhere.points[indices[is_listed]]
        measured = measured & (~needs_point | np.isfinite(points[:, 0]))
    _check_sets(table, layout, words.get("set", ()), measured)
    of_measured = {}
    for name, block in blocks.items():
        of_measured[name] = np.where(measured[:, None], block, np.nan)
    check_units(table, layout, of_measured)

    # All rows as the robot went to them; those without an order, which are not measured, come last, where no move of
    # another row begins.
    sequence = np.arange(count)
    if "order" in blocks:
        sequence = np.argsort(blocks["order"][:, 0], kind="stable")
    kept = sequence[measured[sequence]] if as_measured else np.flatnonzero(measured)

    # Numbers of these rows, in SI units.
    si = {}
    for name, block in blocks.items():
        to_si = [column.to_si for column in layout.blocks[name]]
        si[name] = block[kept] * to_si
    if points is not None:
        si["points"] = points[kept]
    moves: Array | None = None
    if "joints" in blocks:
        # The robot was at unmeasured rows too: a move is from the row before, measured or not.
        visited = blocks["joints"] * [column.to_si for column in layout.blocks["joints"]]
        of_all = np.empty(visited.shape)
        of_all[sequence] = last_moves(visited[sequence])
        moves = of_all[kept]
    if moves is not None and "moves" in si:  # what the table states counts
        stated = [column.name.removesuffix(MOVE) for column in layout.blocks["moves"]]
        moves[:, [_joint_names(layout).index(name) for name in stated]] = si["moves"]
    words_of_rows = {}
    for attribute, (column_name, _) in WORD_COLUMNS.items():
        cells = words.get(column_name, ())
        words_of_rows[attribute] = [cells[i] for i in kept] if cells else []
    files = (table,) if elsewhere is None else (table, elsewhere)
    is_missing = ~measured & ~_driven_through(table, layout) & _has_word(table, layout, "row")
    return {
        "source": " + ".join(file.source for file in files),
        "sha256": " + ".join(file.sha256 for file in files),
        **_arrays(layout, si, len(kept)),
        "units": _units(layout, elsewhere),
        **words_of_rows,
        "moves": moves,
        "without_joint": None if without_joint is None else without_joint[kept],
        "ignored": layout.ignored,
        "kinds": kinds[kept].tolist(),
        "rows": [row_numbers[i] for i in kept],
        "unmeasured": list(compress(row_numbers, is_missing)),
    }


def with_joints_missing(
    values: Mapping[str, Any], joint_names: Sequence[str], joint_types: Mapping[str, str]
) -> dict[str, Any]:
    """Return those of the arguments of `Measurements` that change if joints without a column stand still at zero.

    Args:
        values: As `read_values` returns them, of n joints that have a column and N rows.
        joint_names: The m >= n joints of the robot.
        joint_types: URDF types of joints by name.

    Returns:
        Arguments of m joints in the order of ``joint_names``; no row has those without a column.
    """
    given = list(values["joint_names"])
    missing = [name for name in joint_names if name not in given]
    order = [[*given, *missing].index(name) for name in joint_names]
    count = len(values["joints"])

    def widened(name: str, blank: float) -> Array | None:
        """Return an array of the given joints, (N, n), with a value for each missing one, (N, m); None for None."""
        if values[name] is None:
            return None
        both: Array = np.hstack([values[name], np.full((count, len(missing)), blank)])
        return both[:, order]

    without_joint = values["without_joint"]
    if without_joint is None:
        without_joint = np.zeros((count, len(given)), dtype=np.bool_)
    absent = np.ones((count, len(missing)), dtype=np.bool_)
    sliding = [name for name in missing if joint_types.get(name) == "prismatic"]
    return {
        "joint_names": list(joint_names),
        "joints": widened("joints", 0.0),
        "moves": widened("moves", 0.0),
        "torques": widened("torques", np.nan),
        "without_joint": np.hstack([without_joint, absent])[:, order],
        "prismatic": [*values["prismatic"], *sliding],
    }


def _of_kinds(layout: Layout, kinds: Words, attribute: str) -> Mask:
    """Mark the rows whose kind has a true attribute of `Kind`, such as ``"paired"``, shape (rows,)."""
    chosen = [name for name in layout.kinds if getattr(registry.get(name), attribute)]
    return np.isin(kinds, chosen)


# Numbers


def _measured_blocks(kind: Kind, blocks: Collection[str]) -> list[str]:
    """Return which blocks rows of a kind measure; none if their target is held, or their points are in a list."""
    names = ["points"] * kind.position + ["orientation"] * kind.orientation
    names += [reading.name for reading in kind.readings]
    return [name for name in names if name in blocks]


def _used_blocks(kind: Kind, blocks: Collection[str]) -> set[str]:
    """Return the names of the blocks that rows of a kind use, be they there or not: measured ones, joints and noise.

    Noise is the covariance if the kind may have one and the table has it, else standard deviations.
    """
    noise = {RESIDUAL_UNITS[symbol].sigma_name for symbol in kind.units}
    if kind.may_have_covariance and "covariances" in blocks:
        noise = {"covariances"}
    designed = {"board_points"} if kind.is_image else set()
    return {
        "joints",
        "torques",
        "moves",
        "order",
        *designed,
        *noise,
        *_measured_blocks(kind, blocks),
    }


def _used_numbers(table: Table, layout: Layout, kinds: Words) -> dict[str, Array]:
    """Return the numbers of each block that has columns, as written; NaN in rows whose kind does not use it."""
    present = {name: columns for name, columns in layout.blocks.items() if columns}
    numbers = table.numbers([column for columns in present.values() for column in columns])
    used = {name: _used_blocks(registry.get(name), present) for name in layout.kinds}
    blocks = {}
    start = 0
    for name, columns in present.items():
        block = numbers[:, start : start + len(columns)]
        start += len(columns)
        is_used = np.isin(kinds, [kind for kind, names in used.items() if name in names])
        is_used |= (kinds == "") & (name in _OF_POSE)
        blocks[name] = np.where(is_used[:, None], block, np.nan)
    return blocks


def _filled(values: Array, is_empty: Mask) -> Array:
    """Return numbers of rows, (N, k), with empty cells as in the row before that has one; as the first, or 0, if none.

    A joint that a row does not need is taken to stand where it stood.
    """
    row = np.arange(len(values))[:, None]
    first = np.argmin(is_empty, axis=0)
    source = np.maximum.accumulate(np.where(is_empty, first, row), axis=0)
    filled = np.take_along_axis(values, source, axis=0)
    return np.where(is_empty.all(axis=0), 0.0, filled)


def _driven_through(table: Table, layout: Layout) -> Mask:
    """Mark the rows of poses that are not measured but only driven through, shape (rows,)."""
    if "set" not in layout.words:
        return np.zeros(len(table.cells), dtype=np.bool_)
    return np.asarray(np.array(table.column(layout.words["set"]), dtype=np.str_) == VIA)


def _measured_rows(table: Table, layout: Layout, blocks: Blocks, kinds: Words) -> Mask:
    """Mark the rows that hold a measurement, shape (rows,), of numbers as written in the cells.

    MeasurementError if such a row lacks a number that its kind uses, or has one that is not finite; of a pair one row
    may lack what is measured.
    """
    measured = ~_driven_through(table, layout)
    if STATUS in layout.words:
        status = table.column(layout.words[STATUS])
        measured &= [not word.startswith(_NO_COMMAND) for word in status]
    # Where the robot only drove by, names of a point, of a pair or of a kind may be empty.
    of_positions = _of_kinds(layout, kinds, "position")
    measured &= (kinds != "") & (_has_word(table, layout, "point") | ~of_positions)
    _check_kinds(table, layout, kinds)
    for kind in map(registry.get, layout.kinds):
        of_kind = kinds == kind.name
        of_measurement = _measured_blocks(kind, blocks)
        if of_measurement:
            cells = np.hstack([blocks[name] for name in of_measurement])
            without = of_kind & np.isnan(cells).all(axis=1)
            # One row of a pair has the measurement of both.
            measured &= ~(without & ~_has_word(table, layout, "pair") if kind.paired else without)
        used = _used_blocks(kind, blocks)
        for name, block in blocks.items():
            if name not in used:
                continue
            bad = ~np.isfinite(block) & (of_kind & measured)[:, None]
            if kind.paired and name in of_measurement:
                bad &= ~np.isnan(block)
            if bad.any():
                row, k = np.argwhere(bad)[0].tolist()
                _fail_on_number(table, layout, row, layout.blocks[name][k])
    return measured


def _has_word(table: Table, layout: Layout, name: str) -> Mask:
    """Mark the rows with a word in a column of words, (rows,); all rows if the table has no such column."""
    if name not in layout.words:
        return np.ones(len(table.cells), dtype=np.bool_)
    return np.array([cell != "" for cell in table.column(layout.words[name])], dtype=np.bool_)


def _check_kinds(table: Table, layout: Layout, kinds: Words) -> None:
    """Raise `MeasurementError` if a row without a kind has a number in a column of a measurement."""
    names = {
        n for kind in layout.kinds for n in _measured_blocks(registry.get(kind), layout.blocks)
    }
    columns = [column for name in names for column in layout.blocks[name]]
    for i in np.flatnonzero(kinds == "").tolist():
        if not all(is_blank(table.cells[i][column.index]) for column in columns):
            what = (
                "the cell is empty, and the row has a measurement. Fill in of what kind it is: "
                f"{choices(layout.kinds)}."
            )
            table.fail(i, layout.words["kind"], what, layout.words.get("row"))


def _fail_on_number(table: Table, layout: Layout, row: int, column: Column) -> NoReturn:
    """Raise `MeasurementError` on a cell, of a row from 0, that should hold a finite number, with what it holds."""
    text = table.cells[row][column.index][:_QUOTED]
    if text.startswith("#"):
        what = f"'{text}' is an error of a formula. Mend the formula, or remove the row."
    elif is_blank(text):
        written = f"holds no number ('{text}')" if text else "is empty"
        what = f"the cell {written}. Fill in the number, or remove the row."
    elif text.startswith("date ") or _DATE.fullmatch(text):
        date = text.removeprefix("date ")
        what = (
            f"the cell is the date '{date}'. Write the number; Excel turns entries such as 1.5 or "
            "1/5 into dates."
        )
    elif _THOUSANDS.fullmatch(text):
        what = f"'{text}' has a sign between thousands. Write the number without it."
    elif "," in text:
        what = (
            f"'{text}' has a decimal comma. Write a point, or put semicolons between the columns."
        )
    else:
        unit_is_there = "; the unit is in the header" if column.unit is not None else ""
        what = f"'{text}' is not a finite number. Write it as 123.45{unit_is_there}."
    table.fail(row, column, what, layout.words.get("row"))


# Words


def _check_words(
    table: Table,
    layout: Layout,
    words: Mapping[str, Sequence[str]],
    kinds: Words,
    measured: Mask,
) -> None:
    """Raise `MeasurementError` if a row number is not whole, or a word is empty in a measured row that needs one."""
    for i, text in enumerate(words.get("row", ())):
        if not _WHOLE.fullmatch(text) and (text or measured[i]):
            what = f"'{text}' is not a whole number. Number the rows."
            table.fail(i, layout.words["row"], what)
    needed = {
        "target": measured,
        "pair": measured & _of_kinds(layout, kinds, "paired"),
        "point": measured & _of_kinds(layout, kinds, "position"),
    }
    for name, rows in needed.items():
        if name not in words:
            continue
        for i in np.flatnonzero(rows).tolist():
            if not words[name][i]:
                what = "the cell is empty. Fill it in, or remove the row."
                table.fail(i, layout.words[name], what, layout.words.get("row"))


def _check_sets(table: Table, layout: Layout, sets: Sequence[str], measured: Mask) -> None:
    """Raise `MeasurementError` if a measured row has a word in the column ``set`` that does not name a set."""
    for word in set(sets) - set(SETS):
        column = layout.words["set"]
        what = (
            f"'{word}' is not a set; allowed are {choices((*SETS, REFERENCE, VIA))}. Correct it; if the column means "
            f'something else, --columns "{column.label}=-" leaves it out.'
        )
        for i in np.flatnonzero(measured).tolist():
            if sets[i] == word:
                table.fail(i, column, what, layout.words.get("row"))


def _joint_names(layout: Layout) -> list[str]:
    """Return the names of the joints, in the order of their columns."""
    return [column.name for column in layout.blocks["joints"]]


def _units(layout: Layout, elsewhere: Points | None) -> dict[str, str]:
    """Return the symbols of the units of joint values and of points, in the table or a list, by the column's name."""
    columns = (*layout.blocks["joints"], *layout.blocks.get("points", ()))
    units = {column.name: column.unit.symbol for column in columns if column.unit}
    if elsewhere is not None:
        units |= dict.fromkeys(POINT, elsewhere.unit)
    return units


def _arrays(layout: Layout, si: Blocks, count: int) -> dict[str, Any]:
    """Return joints and arrays as arguments of `Measurements`, from blocks of ``count`` measured rows (SI units)."""
    joint_names = _joint_names(layout)
    torques: Array | None = None
    if "torques" in si:  # NaN of joints without a column
        driven = [column.name.removesuffix(TORQUE) for column in layout.blocks["torques"]]
        torques = np.full((count, len(joint_names)), np.nan)
        torques[:, [joint_names.index(name) for name in driven]] = si["torques"]
    rotations: Array | None = None
    if layout.orientation is not None and "orientation" in si:
        rotations = layout.orientation.convention.matrices(si["orientation"])
    single = {name: block[:, 0] for name, block in si.items() if name not in _WIDE}
    readings = {name: single[name] for name in registry.readings() if name in single}
    sigma = {}
    for symbol, unit in RESIDUAL_UNITS.items():
        if unit.sigma_name in single:
            sigma[symbol] = single[unit.sigma_name]
    return {
        "joint_names": joint_names,
        "prismatic": [column.name for column in layout.blocks["joints"] if slides(column)],
        "joints": si.get("joints", np.empty((count, 0))),
        "points": si.get("points", np.full((count, 3), np.nan)),
        "board_points": si.get("board_points"),
        "covariances": si["covariances"].reshape(-1, 6, 6) if "covariances" in si else None,
        "rotations": rotations,
        "orientation": "" if layout.orientation is None else layout.orientation.convention.name,
        "torques": torques,
        "distances": readings.pop("distance", None),
        "readings": readings,
        "sigma": sigma,
    }
