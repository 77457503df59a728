"""A table as text and its header: separator, rows of cells, and columns by name and unit.

One reader for all tables of calib: comma, semicolon or tab between the cells, units in the header, blank lines and
those that begin with # skipped.
"""

from __future__ import annotations

import codecs
import csv
import hashlib
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

import numpy as np

import calib.data.kinds as registry
from calib.errors import CalibError, FileError, MeasurementError, choices, did_you_mean
from calib.files import read_bytes
from calib.units import (
    NUMBER,
    UNITS,
    Array,
    Quantity,
    Unit,
    find_unit,
    split_header,
    symbols,
)

SEPARATORS = (",", ";", "\t")

POINT = ("x", "y", "z")
QUATERNION = ("qx", "qy", "qz", "qw")
ROTATION_VECTOR = ("rx", "ry", "rz")
ORIENTATION = (*ROTATION_VECTOR, *QUATERNION)
ROLL_PITCH_YAW = ("roll", "pitch", "yaw")
WORDS = ("row", "set", "kind", "target", "group", "pair", "point")

#: The column of a table of commands that says whether a row has one.
STATUS = "status"

#: What the column ``set`` may say, and the name of a target that has none.
SETS = ("estimate", "validate")
DEFAULT_TARGET = "target"

#: What stands behind a joint's name in the header of its torque.
TORQUE = ".torque"

#: The name that a column is mapped to so that it is not read.
IGNORE = "-"

#: What stands before the name of a column that says what to expect there, for a person to compare: see plan_file.
EXPECTED = "expected "

#: The points of a robot cell lie between these distances from the origin of any frame in use [m].
_FAR_M, _NEAR_M = 100.0, 5e-3

#: The unit that headers are proposed in, and tables written in.
COMMON: Mapping[Quantity, str] = {"length": "mm", "angle": "deg", "torque": "Nm", "force": "N"}

#: The line before the header that tells Excel what stands between the cells.
_SEPARATOR_LINE = re.compile(r'"?sep=([,;\t])"?[\s,;]*$', re.IGNORECASE)

_EXAMPLE = "such as: set,joint_1 [deg],joint_2 [deg],x [mm],y [mm],z [mm]"


@dataclass(frozen=True, slots=True)
class Column:
    """One column: where it stands, its header as written, and the name and unit that calib takes it by."""

    index: int  #: From 0.
    label: str  #: The header cell as written, for messages.
    name: str  #: After ``--columns`` was applied.
    symbol: str | None  #: Of the unit; None without brackets.

    @property
    def unit(self) -> Unit | None:
        """The unit; None without one, and for one that is unknown: it may not matter."""
        try:
            return None if self.symbol is None else find_unit(self.symbol)
        except CalibError:
            return None

    @property
    def to_si(self) -> float:
        """What a value is multiplied by; 1 for numbers without a unit, those of a quaternion."""
        unit = self.unit
        return 1.0 if unit is None else unit.to_si


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """A text table: comma, semicolon or tab separated, one header line, blank and # lines skipped.

    A line ``sep=;`` before the header names the separator, as it does for Excel.
    """

    source: str  #: The file's name, for messages.
    sha256: str  #: Of the file's bytes.
    separator: str  #: One of `SEPARATORS`.
    header: tuple[str, ...]  #: The header's cells.
    lines: tuple[int, ...]  #: Where each row ends in the file.
    cells: tuple[list[str], ...]  #: The stripped cells of each row, as many as the header has.

    @classmethod
    def read(cls, path: str | Path) -> Table:
        """Read a file.

        Raises:
            MeasurementError: There is no such file, it is no text, has no header, or a row with other cells than it.
        """
        source, sha256, text = read_text(path, "The table")
        kept = [
            (at, line)
            for at, line in enumerate(io.StringIO(text), 1)
            if line.strip(" \t,;\n") and not line.lstrip().startswith(("#", '"#'))
        ]
        named = _SEPARATOR_LINE.match(kept[0][1]) if kept else None
        if named is not None:
            del kept[0]
        if not kept:
            message = f"{path}: the file is empty. A table begins with a header line, {_EXAMPLE}"
            raise MeasurementError(message)
        separator = max(SEPARATORS, key=kept[0][1].count)  # in a tie, the first: the comma
        if named is not None and named[1] in kept[0][1]:
            separator = named[1]
        reader = csv.reader(
            (line for _, line in kept), delimiter=separator, skipinitialspace=True, strict=True
        )
        lines, cells = [], []
        try:
            for row in reader:
                lines.append(kept[reader.line_num - 1][0])
                cells.append([cell.strip() for cell in row])
        except csv.Error as error:
            raise MeasurementError(
                f"{source}, line {kept[reader.line_num - 1][0]}: not a CSV table ({error}). Check the double quotes "
                '(") there and above.'
            ) from error
        header = tuple(cells[0])
        if all(NUMBER.fullmatch(cell) for cell in header):
            raise MeasurementError(
                f"{source}: the first line holds numbers where the header should stand, {_EXAMPLE}"
            )
        for n, (line, row) in enumerate(zip(lines, cells, strict=True)):
            if len(row) != len(header):
                comma = " A decimal comma needs semicolons between the columns." * (
                    separator == "," and len(row) > len(header)
                )
                raise MeasurementError(
                    f"{source}, line {line} (row {n}): the row has {len(row)} cells, the header has {len(header)}. "
                    f"Make them as many.{comma}"
                )
        return cls(source, sha256, separator, header, tuple(lines[1:]), tuple(cells[1:]))

    def names(self, columns: Mapping[str, str]) -> set[str]:
        """The names of the columns without their units, and those that ``--columns`` gives them."""
        return {split_header(label)[0] for label in (*self.header, *columns.values())}

    def column(self, column: Column) -> list[str]:
        """The cells of a column."""
        return [row[column.index] for row in self.cells]

    def numbers(self, columns: Sequence[Column]) -> Array:
        """The numbers of columns as written, shape (rows, columns): NaN where empty, infinite where there is none.

        Raises:
            MeasurementError: There are decimal points beside decimal commas, one of which may separate thousands.
        """
        found = np.empty((len(self.cells), len(columns)))
        signs: dict[str, int] = {}  # the line of the first of each
        for k, column in enumerate(columns):
            texts = self.column(column)
            if self.separator != ",":
                for sign in ".,":
                    at = next((i for i, text in enumerate(texts) if sign in text), None)
                    if at is not None:
                        signs.setdefault(sign, self.lines[at])
                texts = [text.replace(",", ".") for text in texts]
            try:  # the usual column at once: ten times as fast
                found[:, k] = list(map(float, texts))
                usual = np.isfinite(found[:, k]).all() and not any("_" in text for text in texts)
            except ValueError:
                usual = False
            if not usual:
                found[:, k] = [
                    float(text) if NUMBER.fullmatch(text) else np.inf if text else np.nan
                    for text in texts
                ]
        if len(signs) == 2:
            raise MeasurementError(
                f"{self.source}: numbers have a decimal point in line {signs['.']} and a decimal comma in line "
                f"{signs[',']}. Write all in one way, without a sign between thousands."
            )
        return found

    def fail(self, row: int, column: Column, what: str, numbers: Column | None = None) -> NoReturn:
        """Refuse the cell of a row, from 0, for what it is; ``numbers`` is the column of the rows' own numbers."""
        number = (self.cells[row][numbers.index] if numbers else "") or str(row + 1)
        raise MeasurementError(
            f"{self.source}, line {self.lines[row]} (row {number}), column '{column.label}': {what}"
        )


def read_text(path: str | Path, what: str) -> tuple[str, str, str]:
    r"""The name of a file for messages, its SHA-256, and its text, whose lines end in ``\n``.

    UTF-8 with or without its mark, UTF-16 with one (Excel's "Unicode text"), else Windows' own encoding.

    Raises:
        MeasurementError: There is no such file, or it is no text.
    """
    source = Path(path).name or str(path)
    try:
        data = read_bytes(path, what)
    except FileError as error:
        raise MeasurementError(str(error)) from error
    utf16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = data.decode("utf-16" if utf16 else "utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")
    if "\0" in text:
        raise MeasurementError(f"{source}: this is not a text file. Save it as text (CSV, UTF-8).")
    return source, hashlib.sha256(data).hexdigest(), text.replace("\r\n", "\n").replace("\r", "\n")


# Columns


def reserved() -> tuple[str, ...]:
    """The names of columns that no joint can have: those of words, noise, positions, and of the kinds' readings."""
    return (*WORDS, "sigma", "sigma_angle", *registry.readings(), *POINT)


def list_columns(table: Table) -> str:
    """The sentence that lists the table's columns."""
    return f"The columns found: {choices((label for label in table.header if label), limit=30)}."


def name_columns(
    table: Table, joint_names: Sequence[str], columns: Mapping[str, str]
) -> tuple[dict[str, Column], tuple[Column, ...]]:
    """The columns by the name calib uses, each once, ``joint_names`` as they are; and all that are called ``group``.

    Raises:
        MeasurementError: A name of ``columns`` is not there, or two columns have one name.
    """
    written = {i: split_header(label)[0] for i, label in enumerate(table.header) if label}
    given: dict[int, str] = {}
    for key, wanted in columns.items():
        # By the names as written: two columns may swap theirs.
        hits = [i for i, name in written.items() if key.strip() in (name, table.header[i])]
        if not hits:
            raise MeasurementError(
                f"{table.source}: there is no column '{key}', which --columns maps to '{wanted}'"
                f"{did_you_mean(key, written.values())}. {list_columns(table)}"
            )
        given |= dict.fromkeys(hits, wanted)
    meant = {*reserved(), *ORIENTATION, *ROLL_PITCH_YAW, STATUS}
    named: dict[str, Column] = {}
    groups: list[Column] = []
    for i in written:
        label = table.header[i]
        name, symbol = split_header(given.get(i, label))
        if name == IGNORE and i in given:
            continue
        own = split_header(label)[1]
        if None not in (symbol, own) and symbol != own:
            raise MeasurementError(
                f"{table.source}, column '{label}': --columns gives it another unit, '{given[i]}'. Correct one of them."
            )
        column = Column(i, label, name, symbol or own)
        if column.name.casefold() in meant and column.name not in joint_names:
            column = replace(column, name=column.name.casefold())
        if column.name == "group":
            groups.append(column)
        # Columns that only happen to be called 'group' were hardly meant to be joined.
        joined = column.name == "group" and any(one.index in given for one in groups)
        if column.name in named and not joined:
            first = named[column.name]
            raise MeasurementError(
                f"{table.source}: two columns are called '{column.name}': number {first.index + 1} ('{first.label}') "
                f"and number {i + 1} ('{column.label}'). Rename one, or leave one out: --columns \"{column.label}=-\"."
            )
        named.setdefault(column.name, column)
    return named, tuple(groups)


def with_unit(
    table: Table, column: Column, quantity: Quantity | None, what: str = "", common: str = ""
) -> Column:
    """The column, which must be in a unit of this quantity, or have none; ``what`` it is, and a unit to propose.

    Raises:
        MeasurementError: It has no unit, or one of another quantity.
    """
    unit, where = column.unit, f"{table.source}, column '{column.label}'{f' ({what})' * bool(what)}"
    if quantity is None:
        if column.symbol not in (None, "", "-", "1"):
            raise MeasurementError(f"{where}: '{column.symbol}' cannot be; there is no unit here.")
        return column
    if unit is not None and unit.quantity == quantity:
        return column
    header = f"{split_header(column.label)[0]} [{common or COMMON[quantity]}]"
    fault = f"'{column.symbol}' is not a unit of {quantity}"
    raise MeasurementError(
        f"{where}: {fault if column.symbol else 'the column has no unit'}. Write the header '{header}', or --columns "
        f'"{header.replace(" [", f"={column.name} [")}"; allowed are {choices(symbols(quantity))}.'
    )


# Numbers


def implausible(
    values: Array, units: Sequence[Unit], *, near: bool = True
) -> tuple[int, int, str] | None:
    """The row and column of a length, of places (N, k) as written, that cannot be in this unit, and why; else None.

    The place furthest from the origin is further than a cell is wide, or, if ``near``, all are at the origin.
    """
    metres = np.nan_to_num(values) * [unit.to_si for unit in units]
    distance = np.hypot.reduce(metres, axis=1)  # does not square: a huge number stays one
    row = int(np.argmax(distance))
    if not distance[row] <= _FAR_M:
        what = f"further from the origin than {_FAR_M:g} m"
    elif near and distance[row] < _NEAR_M and units[0].symbol != "m":
        what = f"and none is further from the origin than {_NEAR_M * 1e3:g} mm"
    else:
        return None
    k = int(np.argmax(np.abs(metres[row])))
    fits = [u for u in ("mm", "m", "um") if 0.01 <= abs(values[row, k]) * UNITS[u].to_si <= 20.0]
    fix = "Correct the value."
    if fits and fits[0] != units[k].symbol:
        fix = f"If it is in {fits[0]}, say so in the header: [{fits[0]}]."
    return row, k, f"{values[row, k]:.10g} was read as {metres[row, k]:.6g} m, {what}. {fix}"
