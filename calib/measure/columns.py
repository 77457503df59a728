"""Which column of a table of measurements is what: joints, the point's coordinates, words."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from calib.errors import CalibError, MeasurementError, choices
from calib.measure.table import Table
from calib.units import Quantity, Unit, find_unit, parse_header, split_header, symbols

WORDS: tuple[str, ...] = ("row", "set", "target", "group")
RESERVED = (*WORDS, "sigma", "x", "y", "z")
ORIENTATION = ("rx", "ry", "rz", "qx", "qy", "qz", "qw")


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


@dataclass(frozen=True, slots=True)
class Layout:
    """Which column of a table is what.

    Attributes:
        words: the columns ``row``, ``set``, ``target`` and ``group`` that there are, by name.
        joints: the joint columns, in the order asked for; else in that of the table.
        points: the columns x, y, z.
        sigma: None without such a column.
        ignored: the headers of the columns that were not used.
    """

    words: Mapping[str, Column]
    joints: tuple[Column, ...]
    points: tuple[Column, ...]
    sigma: Column | None
    ignored: tuple[str, ...]

    @property
    def numbers(self) -> tuple[Column, ...]:
        """The columns of numbers with a unit: joints, x, y, z, and sigma when there is one."""
        return (*self.joints, *self.points, *(() if self.sigma is None else (self.sigma,)))

    @property
    def prismatic(self) -> tuple[str, ...]:
        """The names of the joint columns in a unit of length."""
        return tuple(c.name for c in self.joints if c.unit and c.unit.quantity == "length")

    @classmethod
    def find(
        cls,
        table: Table,
        joint_names: Sequence[str] | None = None,
        joint_types: Mapping[str, str] | None = None,
        columns: Mapping[str, str] | None = None,
    ) -> Layout:
        """Find the columns; the arguments are those of `Measurements.read`.

        Raises:
            MeasurementError: a column is missing, there twice, without a unit or in a wrong one.
        """
        types = joint_types or {}
        named = _named(table, joint_names or (), columns or {})
        joints = (
            _guess_joints(table, named, types)
            if joint_names is None
            else _pick_joints(table, named, joint_names, types)
        )
        for joint in joints:
            _check_joint_unit(table, joint, types)
        missing = [name for name in ("x", "y", "z") if name not in named]
        if missing:
            message = (
                f"{table.source}: no column for the measured point's {choices(missing)}. "
                f"{_found(table)} The header of such a column is '{missing[0]} [mm]'; another name "
                f'is mapped by --columns "name in the table={missing[0]}".'
            )
            raise MeasurementError(message)
        points = tuple(_with_unit(table, named[name], "length") for name in ("x", "y", "z"))
        sigma = _with_unit(table, named["sigma"], "length") if "sigma" in named else None
        words = {name: named[name] for name in WORDS if name in named}
        used = {c.index for c in (*words.values(), *joints, *points, *((sigma,) if sigma else ()))}
        ignored = tuple(label for i, label in enumerate(table.header) if label and i not in used)
        return cls(words, joints, points, sigma, ignored)


def _named(
    table: Table, joint_names: Sequence[str], columns: Mapping[str, str]
) -> dict[str, Column]:
    """The columns by the name calib uses for them; each name once."""
    found = [_column(index, label) for index, label in enumerate(table.header) if label]
    for key, wanted in columns.items():
        hits = [i for i, column in enumerate(found) if key.strip() in (column.name, column.label)]
        if not hits:
            close = _close(key, [column.name for column in found])
            hint = f" Close to it: {choices(close)}." if close else ""
            message = (
                f"{table.source}: there is no column '{key}', which --columns maps to '{wanted}'."
                f"{hint} {_found(table)}"
            )
            raise MeasurementError(message)
        for i in hits:
            found[i] = _renamed(table, found[i], wanted)
    named: dict[str, Column] = {}
    for column in found:
        plain = column.name.casefold()
        reserved = plain in (*RESERVED, *ORIENTATION) and column.name not in joint_names
        name = plain if reserved else column.name
        if name in named:
            first = named[name]
            message = (
                f"{table.source}: two columns are called '{name}': number {first.index + 1} "
                f"('{first.label}') and number {column.index + 1} ('{column.label}'). "
                "Remove or rename one."
            )
            raise MeasurementError(message)
        named[name] = replace(column, name=name)
    return named


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
        message = f"{table.source}: --columns maps '{column.label}' to '{wanted}': {error}"
        raise MeasurementError(message) from error
    if unit is None:
        return replace(column, name=name)
    if column.unit not in (None, unit):
        message = (
            f"{table.source}: column '{column.label}' has its unit in the header, and --columns "
            f"gives it another, '{wanted}'. Leave the unit out of --columns, or correct the header."
        )
        raise MeasurementError(message)
    return replace(column, name=name, unit=unit, fault="")


def _guess_joints(
    table: Table, named: Mapping[str, Column], types: Mapping[str, str]
) -> tuple[Column, ...]:
    """The joint columns when no names were given: those in angles, and known prismatic ones."""
    joints = tuple(
        column
        for name, column in named.items()
        if name not in (*RESERVED, *ORIENTATION)
        and column.unit is not None
        and (column.unit.quantity == "angle" or name in types)
    )
    if not joints:
        message = (
            f"{table.source}: no column of joint angles. {_found(table)} The header of such a "
            "column is the joint's name and a unit of angle, 'elbow_joint [deg]'."
        )
        raise MeasurementError(message)
    return joints


def _pick_joints(
    table: Table,
    named: Mapping[str, Column],
    joint_names: Sequence[str],
    types: Mapping[str, str],
) -> tuple[Column, ...]:
    """The columns of the joints asked for, in that order."""
    clash = [name for name in joint_names if name in RESERVED]
    if clash:
        message = (
            f"{table.source}: a joint cannot be called {choices(clash)}, which is the name of "
            "another column of the table. Rename the joint in the URDF."
        )
        raise MeasurementError(message)
    missing = [name for name in joint_names if name not in named]
    if not missing:
        return tuple(named[name] for name in joint_names)
    free = [n for n in named if n not in joint_names and n not in (*RESERVED, *ORIENTATION)]
    # One each where many are missing: the line stays short enough to read.
    close = {name: _close(name, free)[: 3 if len(missing) < 3 else 1] for name in missing}
    hint = "".join(f" Close to '{n}': {choices(names)}." for n, names in close.items() if names)
    unit = "mm" if types.get(missing[0]) == "prismatic" else "deg"
    header = f"{missing[0]} [{unit}]"
    message = (
        f"{table.source}: no column for the joints {choices(missing)}. {_found(table)}{hint} "
        f"The header of such a column is '{header}'; another name is mapped by "
        f'--columns "name in the table={header}".'
    )
    raise MeasurementError(message)


def _check_joint_unit(table: Table, column: Column, types: Mapping[str, str]) -> None:
    """Refuse a joint column without a unit, or in a unit that is not of the joint's kind."""
    kind = types.get(column.name)
    quantity: Quantity = "length" if kind == "prismatic" else "angle"
    if kind is not None or column.unit is None:
        _with_unit(table, column, quantity, f"{kind or 'revolute'} joint '{column.name}'")


def _with_unit(table: Table, column: Column, quantity: Quantity, what: str = "") -> Column:
    """The column, which must be in a unit of this quantity."""
    if column.unit is not None and column.unit.quantity == quantity:
        return column
    allowed = symbols(quantity)
    common = "mm" if quantity == "length" else "deg"
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
    message = f"{where}: {what_is}. {fix}; allowed are {choices(allowed)}."
    raise MeasurementError(message)


def _found(table: Table) -> str:
    """The sentence that lists a table's columns."""
    return f"The columns found: {choices((label for label in table.header if label), limit=30)}."


def _close(name: str, candidates: Sequence[str]) -> list[str]:
    """The candidates spelt most like a name, small and capital letters alike."""
    plain = {candidate.casefold(): candidate for candidate in candidates}
    return [plain[hit] for hit in difflib.get_close_matches(name.casefold(), plain, n=3)]
