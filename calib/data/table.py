"""A table as text and its header: separator, rows of cells, and columns by name and unit.

One reader for all tables of calib: comma, semicolon or tab between the cells, units in the header, blank lines and
those that begin with # skipped.
"""

from __future__ import annotations

import codecs
import csv
import difflib
import hashlib
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import calib.data.kinds as registry
from calib.errors import CalibError, FileError, MeasurementError, choices
from calib.files import read_bytes
from calib.units import NUMBER, Quantity, Unit, find_unit, parse_header, split_header, symbols

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

#: The unit that headers are proposed in, and tables written in.
COMMON: Mapping[Quantity, str] = {"length": "mm", "angle": "deg", "torque": "Nm", "force": "N"}

_EXAMPLE = "such as: set,joint_1 [deg],joint_2 [deg],x [mm],y [mm],z [mm]"


class Row(NamedTuple):
    """One data row: its line in the file, its number among the data rows (from 1), its cells."""

    line: int
    ordinal: int
    cells: list[str]


@dataclass(frozen=True, slots=True)
class Column:
    """One column: where it stands, its header as written, its name and its unit.

    Attributes:
        index: from 0.
        label: the header cell as written, for messages.
        name: the name calib uses, after ``columns`` was applied.
        unit: None without brackets or when the unit is unknown.
        fault: why the unit is unknown; "" otherwise.
    """

    index: int
    label: str
    name: str
    unit: Unit | None
    fault: str = ""

    @property
    def to_si(self) -> float:
        """What a value is multiplied by; 1 for numbers without a unit, those of a quaternion."""
        return 1.0 if self.unit is None else self.unit.to_si


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """A text table: comma, semicolon or tab separated, one header line, blank and # lines skipped.

    Attributes:
        source: the file's name, for messages.
        sha256: of the file's bytes.
        separator: one of `SEPARATORS`.
        header: the header's cells.
        lines: where each row ends in the file.
        cells: the stripped cells of each row, as many as the header has.
    """

    source: str
    sha256: str
    separator: str
    header: tuple[str, ...]
    lines: tuple[int, ...]
    cells: tuple[list[str], ...]

    @classmethod
    def read(cls, path: str | Path) -> Table:
        """Read a file.

        Raises:
            MeasurementError: there is no such file, it is no text, has no header, or a row with other cells than it.
        """
        source = Path(path).name or str(path)
        try:
            data = read_bytes(path, "The table")
        except FileError as error:
            raise MeasurementError(str(error)) from error
        kept = [
            (at, line)
            for at, line in enumerate(io.StringIO(_decode(data, source)), 1)
            if line.strip(" \t,;\n") and not line.lstrip().startswith(("#", '"#'))
        ]
        if not kept:
            raise MeasurementError(
                f"{path}: the file is empty. A table begins with a header line, {_EXAMPLE}"
            )
        separator = max(SEPARATORS, key=kept[0][1].count)  # in a tie, the first: the comma
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
                f"{source}: the first line holds numbers where the header should stand (a line "
                f"that begins with # is a comment). A table begins with a header line, {_EXAMPLE}"
            )
        for n, (line, row) in enumerate(zip(lines, cells, strict=True)):
            if len(row) != len(header):
                fix = "Fill in what is missing."
                if len(row) > len(header):
                    fix = "Remove what is too much."
                    if separator == ",":
                        fix += " If the numbers have a decimal comma, separate the columns by semicolons."
                raise MeasurementError(
                    f"{source}, line {line} (row {n}): the row has {len(row)} cells, the header has {len(header)}. "
                    f"{fix}"
                )
        sha256 = hashlib.sha256(data).hexdigest()
        return cls(source, sha256, separator, header, tuple(lines[1:]), tuple(cells[1:]))

    def names(self, columns: Mapping[str, str]) -> set[str]:
        """The names of the columns without their units, and those that ``--columns`` gives them."""
        return {split_header(label)[0] for label in (*self.header, *columns.values())}

    def rows(self) -> Iterator[Row]:
        """The data rows, in order."""
        for number, (line, cells) in enumerate(zip(self.lines, self.cells, strict=True), 1):
            yield Row(line, number, cells)

    def column(self, column: Column) -> list[str]:
        """The cells of a column."""
        return [row[column.index] for row in self.cells]

    def place(self, row: int, numbers: Column | None = None, column: Column | None = None) -> str:
        """Where a row, from 0, or a cell stands as a person sees it: file, line, row number, column."""
        number = (self.cells[row][numbers.index] if numbers else "") or str(row + 1)
        text = f"{self.source}, line {self.lines[row]} (row {number})"
        return text if column is None else f"{text}, column '{column.label}'"


def _decode(data: bytes, source: str) -> str:
    r"""Text of UTF-8 bytes, with or without a byte order mark, or of UTF-16 with one; lines end in ``\n``."""
    try:
        # UTF-16 is what Excel calls "Unicode text".
        utf16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        text = data.decode("utf-16" if utf16 else "utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise MeasurementError(
            f"{source}, line {line}: this is not UTF-8 text. Save the table as CSV (UTF-8)."
        ) from error
    if "\0" in text:
        raise MeasurementError(f"{source}: this is not a text file. Save the table as CSV (UTF-8).")
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


# Columns


def reserved() -> tuple[str, ...]:
    """The names of columns that no joint can have: those of words, noise, positions, and of the kinds' readings."""
    return (*WORDS, "sigma", "sigma_angle", *registry.readings(), *POINT)


def list_columns(table: Table) -> str:
    """The sentence that lists the table's columns."""
    return f"The columns found: {choices((label for label in table.header if label), limit=30)}."


def close_names(name: str, candidates: Sequence[str]) -> list[str]:
    """The candidates, of the first 500, that are spelt most like a name, small and capital letters alike."""
    plain = {candidate.casefold(): candidate for candidate in candidates[:500]}
    return [plain[hit] for hit in difflib.get_close_matches(name.casefold(), plain, n=3)]


def name_columns(
    table: Table, joint_names: Sequence[str], columns: Mapping[str, str]
) -> tuple[dict[str, Column], tuple[Column, ...]]:
    """The columns by the name calib uses, each once, ``joint_names`` as they are; and all that are called ``group``.

    Raises:
        MeasurementError: a name of ``columns`` is not there, or two columns have one name.
    """
    found, mapped = _map_columns(table, columns)
    meant = (*reserved(), *ORIENTATION, *ROLL_PITCH_YAW, STATUS)
    named: dict[str, Column] = {}
    groups: list[Column] = []
    for column in found:
        if column.name == IGNORE and column.index in mapped:
            continue
        plain = column.name.casefold()
        name = plain if plain in meant and column.name not in joint_names else column.name
        if name == "group":
            groups.append(column)
        if name in named:
            # Columns that only happen to be called 'group' were hardly meant to be joined.
            if name == "group" and any(c.index in mapped for c in groups):
                continue
            first = named[name]
            leave = ""
            if first.label != column.label:
                leave = f', or leave one out: --columns "{column.label}=-"'
            raise MeasurementError(
                f"{table.source}: two columns are called '{name}': number {first.index + 1} "
                f"('{first.label}') and number {column.index + 1} ('{column.label}'). "
                f"Remove or rename one{leave}."
            )
        named[name] = replace(column, name=name)
    return named, tuple(groups)


def _map_columns(
    table: Table, columns: Mapping[str, str]
) -> tuple[list[Column], Mapping[int, str]]:
    """All columns under the names that ``columns`` gives them, and which of them it names, by their index."""
    written = [_column(index, label) for index, label in enumerate(table.header) if label]
    found = list(written)
    mapped: dict[int, str] = {}  # index: key
    for key, wanted in columns.items():
        # By the names as written: two columns may swap theirs.
        hits = [i for i, column in enumerate(written) if key.strip() in (column.name, column.label)]
        if not hits:
            close = close_names(key, [column.name for column in written])
            hint = f" Close to it: {choices(close)}." if close else ""
            raise MeasurementError(
                f"{table.source}: there is no column '{key}', which --columns maps to '{wanted}'."
                f"{hint} {list_columns(table)}"
            )
        for i in hits:
            other = mapped.setdefault(found[i].index, key)
            if other != key:
                raise MeasurementError(
                    f"{table.source}: --columns maps the column '{found[i].label}' twice, as '{other}' "
                    f"and as '{key}'. Leave one out."
                )
            found[i] = _renamed(table, found[i], wanted)
    return found, mapped


def _column(index: int, label: str) -> Column:
    """The column of a header cell; an unknown unit is kept as a fault, for it may not matter."""
    name, symbol = split_header(label)
    try:
        return Column(index, label, name, None if symbol is None else find_unit(symbol))
    except CalibError as error:
        return Column(index, label, name, None, str(error))


def _renamed(table: Table, column: Column, wanted: str) -> Column:
    """The column under the name, and with the unit, that ``columns`` gives it."""
    try:
        name, unit = parse_header(wanted)
    except CalibError as error:
        raise MeasurementError(
            f"{table.source}: --columns maps '{column.label}' to '{wanted}': {error}"
        ) from error
    if unit is None:
        return replace(column, name=name)
    if column.unit not in (None, unit):
        raise MeasurementError(
            f"{table.source}: column '{column.label}' has its unit in the header, and --columns "
            f"gives it another, '{wanted}'. Leave the unit out of --columns, or correct the header."
        )
    return replace(column, name=name, unit=unit, fault="")


def with_unit(
    table: Table, column: Column, quantity: Quantity, what: str = "", common: str = ""
) -> Column:
    """The column, which must be in a unit of this quantity; ``what`` it is, and the ``common`` unit to propose.

    Raises:
        MeasurementError: it has no unit, or one of another quantity.
    """
    if column.unit is not None and column.unit.quantity == quantity:
        return column
    common = common or COMMON[quantity]
    where = f"{table.source}, column '{column.label}'" + (f" ({what})" if what else "")
    written = split_header(column.label)[0]
    if column.unit is not None:
        what_is = f"'{column.unit.symbol}' is not a unit of {quantity}"
        fix = f"Correct the header to '{written} [{common}]'"
    else:
        what_is = column.fault or "the column has no unit"
        fix = (
            f"Write the unit into the header, '{written} [{common}]', or give it with "
            f'--columns "{written}={column.name} [{common}]"'
        )
    raise MeasurementError(f"{where}: {what_is}. {fix}; allowed are {choices(symbols(quantity))}.")


def without_unit(table: Table, column: Column) -> Column:
    """The column of a quaternion's number, which has no unit.

    Raises:
        MeasurementError: it has one.
    """
    unit = column.unit.symbol if column.unit else split_header(column.label)[1]
    if unit not in (None, "", "-", "1"):
        raise MeasurementError(
            f"{table.source}, column '{column.label}': '{unit}' cannot be; a quaternion has no "
            f"unit. Correct the header to '{column.name}'; for angles, to 'rx [deg]' and so on."
        )
    return replace(column, unit=None)
