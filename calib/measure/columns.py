"""The columns of a table by name and unit: what its header says, and what ``--columns`` makes of it."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import calib.kinds as registry
from calib.errors import CalibError, MeasurementError, choices
from calib.measure.table import Block, Row, Table
from calib.units import Quantity, Unit, find_unit, parse_header, split_header, symbols

POINT = ("x", "y", "z")
QUATERNION = ("qx", "qy", "qz", "qw")
ROTATION_VECTOR = ("rx", "ry", "rz")
ORIENTATION = (*ROTATION_VECTOR, *QUATERNION)
ROLL_PITCH_YAW = ("roll", "pitch", "yaw")

#: The column of a table of commands that says whether a row has one.
STATUS = "status"
WORDS = ("row", "set", "kind", "target", "group", "pair", "point")

#: What the column ``set`` may say, and the name of a target that has none.
SETS = ("estimate", "validate")
DEFAULT_TARGET = "target"

#: What stands behind a joint's name in the header of its torque.
TORQUE = ".torque"

#: The name that a column is mapped to so that it is not read.
IGNORE = "-"

#: What stands before the name of a column that says what to expect there, for a person to compare: see plan_file.
EXPECTED = "expected "

# Signs that people write for "no unit" in the header of a quaternion.
_NO_UNIT = (None, "", "-", "1")

#: Names of which the closest is looked for.
_MOST_COMPARED = 500

#: The unit that headers are proposed in, and tables written in.
COMMON: Mapping[Quantity, str] = {"length": "mm", "angle": "deg", "torque": "Nm", "force": "N"}


def reserved() -> tuple[str, ...]:
    """The names of columns that no joint can have: those of words, noise, positions, and of the kinds' readings."""
    return (*WORDS, "sigma", "sigma_angle", *registry.readings(), *POINT)


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


def name_columns(
    table: Table, joint_names: Sequence[str], columns: Mapping[str, str]
) -> tuple[dict[str, Column], tuple[Column, ...]]:
    """The columns by the name calib uses for them, each name once; and all that are called ``group``.

    Args:
        table: with its header.
        joint_names: names that are taken as they are, even if they mean something else.
        columns: names of the table to names of calib; `IGNORE` leaves a column out.

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
    if symbol is None:
        return Column(index, label, name, None)
    try:
        return Column(index, label, name, find_unit(symbol))
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
    """The column, which must be in a unit of this quantity.

    Args:
        table: for the message.
        column: as found.
        quantity: what it measures.
        what: in a few words, for the message.
        common: the unit to propose, where it is not the quantity's usual one.

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
    if unit not in _NO_UNIT:
        raise MeasurementError(
            f"{table.source}, column '{column.label}': '{unit}' cannot be; a quaternion has no "
            f"unit. Correct the header to '{column.name}'; for angles, to 'rx [deg]' and so on."
        )
    return replace(column, unit=None)


def list_columns(table: Table) -> str:
    """The sentence that lists a table's columns."""
    return f"The columns found: {choices((label for label in table.header if label), limit=30)}."


def close_names(name: str, candidates: Sequence[str]) -> list[str]:
    """The candidates spelt most like a name, small and capital letters alike."""
    # Comparing takes long, and a name is not much longer than what it is mistaken for.
    some = (c for c in candidates[:_MOST_COMPARED] if len(c) <= 3 * len(name) + 10)
    plain = {candidate.casefold(): candidate for candidate in some}
    return [plain[hit] for hit in difflib.get_close_matches(name.casefold(), plain, n=3)]


def place(table: Table, row: Row, numbers: Column | None, column: Column | None = None) -> str:
    """Where a cell stands, as a person sees it: file, line, row number, column.

    Args:
        table: the file.
        row: the line.
        numbers: the column ``row``, if there is one.
        column: the cell's column; None for the whole row.
    """
    number = str(row.ordinal)
    if numbers is not None and numbers.index < len(row.cells):
        number = row.cells[numbers.index] or number
    text = f"{table.source}, line {row.line} (row {number})"
    return text if column is None else f"{text}, column '{column.label}'"


def check_widths(table: Table, block: Block, numbers: Column | None) -> None:
    """Refuse a row of a block that has not as many cells as the header.

    Raises:
        MeasurementError: with the place and both counts.
    """
    for i, cells in enumerate(block.cells):
        if len(cells) != len(table.header):
            check_cells(table, block.row(i), numbers)


def check_cells(table: Table, row: Row, numbers: Column | None) -> None:
    """Refuse a row that has not as many cells as the header.

    Raises:
        MeasurementError: with the place and both counts.
    """
    count, wanted = len(row.cells), len(table.header)
    if count == wanted:
        return
    fix = "Fill in what is missing."
    if count > wanted:
        fix = "Remove what is too much."
        if table.separator == ",":
            fix += " If the numbers have a decimal comma, separate the columns by semicolons."
    raise MeasurementError(
        f"{place(table, row, numbers)}: the row has {count} cells, the header has {wanted}. {fix}"
    )
