"""Columns of a table by name and unit: calib's names, the mapping from the table's, checks of units."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.tables import Column, Table
from calib.basics.units import UNITS, Quantity, find_unit, is_unit, split_header, symbols
from calib.data.forms import orientations
from calib.data.forms.column_options import (
    LEROBOT,
    PERCENT,
    TICKS,
    ColumnOptions,
    ColumnsInput,
    brands_like,
    column_options,
    names_by_brand,
)
from calib.errors import MeasurementError, choices, did_you_mean

#: Columns of a position.
POINT = ("x", "y", "z")

#: Columns of the position on its board of a corner that a camera saw.
BOARD_POINT = ("board_x", "board_y", "board_z")

#: Columns of the covariance of a pose, row by row, as of ROS's PoseWithCovariance.
COVARIANCE = tuple(f"covariance_{i}" for i in range(36))

#: Columns of an orientation; they are never a joint's if the joints are not known.
ORIENTATION = (*orientations.ROTATION_VECTOR.columns, *orientations.QUATERNION.columns)

#: The column of a table of commands that says whether a row has one.
STATUS = "status"

#: Allowed words of the column ``set``.
SETS = ("estimate", "validate")

#: Word of the column ``set`` for a pose that is only driven through, so that the next one is approached from there.
VIA = "via"

#: Word of the column ``set`` for a target that stands still, in the world or on the base, measured between the poses.
REFERENCE = "reference"

#: Name of the target of rows without a column ``target``.
DEFAULT_TARGET = "target"

#: Columns of words, by the attribute of `Measurements` that holds them: the name of the column, and the word of rows
#: without one.
WORD_COLUMNS: Mapping[str, tuple[str, str]] = {
    "sets": ("set", SETS[0]),
    "kinds": ("kind", "point"),
    "targets": ("target", DEFAULT_TARGET),
    "groups": ("group", ""),
    "pairs": ("pair", ""),
    "approaches": ("approach", ""),
    "images": ("image", ""),
    "corners": ("corner", ""),
}

#: Ending of the name of the column of a joint's torque, after the joint's name.
TORQUE = ".torque"

#: Ending of the name of the column of a joint's last move, after the joint's name.
MOVE = ".move"

#: The column of numbers that sort the rows as they were measured.
ORDER = "order"

#: The name that ``--columns`` maps a column to so that it is not read.
IGNORE = "-"

#: Begins the name of a column with the predicted value, for a person to compare: see plan files.
EXPECTED = "expected "

#: The unit of each quantity that headers are proposed in, and tables written in.
COMMON: Mapping[Quantity, str] = {
    "length": "mm",
    "angle": "deg",
    "torque": "Nm",
    "force": "N",
    "pixel": "px",
}

#: Columns that are used, by calib's name of each.
Named = Mapping[str, Column]

#: Several columns, in order.
Columns = tuple[Column, ...]


def reserved() -> tuple[str, ...]:
    """Return the names of columns that no joint can have: words, noise, readings, positions."""
    noise = [*(unit.sigma_name for unit in RESIDUAL_UNITS.values()), *COVARIANCE]
    words = [column for column, _ in WORD_COLUMNS.values()]
    return ("row", "point", ORDER, *words, *noise, *registry.readings(), *POINT, *BOARD_POINT)


def list_columns(table: Table) -> str:
    """Return the sentence that lists a table's columns, for messages."""
    labels = [label for label in table.header if label]
    return f"The columns found: {choices(labels, limit=30)}."


def with_unit_elsewhere(table: Table, name: str, quantity: Quantity | None) -> str:
    """Return the sentence on a header that has its unit elsewhere than in brackets, such as ``x_mm``.

    Args:
        table: The table.
        name: The name of a column that it lacks.
        quantity: What its numbers are; None: words or numbers without a unit.

    Returns:
        The sentence with its remedy, for messages; empty if there is no such header.
    """
    for label in table.header if quantity else ():
        rest = label[len(name) :] if label.casefold().startswith(name.casefold()) else ""
        words = [word for word in re.split(r"[^\w.\N{DEGREE SIGN}]+|_", rest) if word]
        unit = find_unit(words[0]) if words and is_unit(words[0]) else None
        if unit is not None and unit.quantity == quantity:
            header = f"{name} [{unit.symbol}]"
            return (
                f" Is it '{label}'? Write the header '{header}', or --columns \"{label}={header}\"."
            )
    return ""


def column_names(table: Table, columns: ColumnsInput = None) -> set[str] | None:
    """Return the names by which a table's columns may be called, without their units.

    Args:
        table: The table.
        columns: What is said of the columns, as by ``--columns``; None: nothing.

    Returns:
        The names in the header, and those that they are mapped to; None if a brand maps them to the joints of a
        robot, whichever these are.
    """
    options = column_options(columns)
    if options.brand is not None:
        return None
    return {split_header(label)[0] for label in (*table.header, *options.names.values())}


def name_columns(
    table: Table, joint_names: Sequence[str], columns: ColumnsInput
) -> tuple[dict[str, Column], Columns]:
    """Map the columns of a table to calib's names, by their headers, ``--columns`` and a brand.

    Args:
        table: The table.
        joint_names: Names of joints in the order of the chain, which are kept as written; names
            that mean something to calib are otherwise read in any case (``QX`` is ``qx``), but
            for single letters of orientations whose convention or brand is not given.
        columns: Mapping from names of the table to names of calib, as of ``--columns``: the
            table's name or header to calib's name, with or without a unit; to ``"-"`` for a column
            that is not read. Or all that is said of the columns: then a brand names the others.

    Returns:
        The columns by calib's names, each once; and all that are called ``group``, in the order of
        the table.

    Raises:
        MeasurementError: The table lacks a name of ``columns``, two columns have one name, or a
            brand's axes are more or fewer than the joints.
    """
    options = column_options(columns)
    # What --columns maps columns to, by their position in the table. The names in it are those written in the table,
    # so that two columns can swap theirs.
    renamed: dict[int, str] = {}
    written_names = {i: split_header(label)[0] for i, label in enumerate(table.header) if label}
    for key, new_name in options.names.items():
        hits = [i for i, name in written_names.items() if key.strip() in (name, table.header[i])]
        if not hits:
            raise MeasurementError(
                f"{table.source}: there is no column '{key}', which --columns maps to "
                f"'{new_name}'{did_you_mean(key, written_names.values())}. {list_columns(table)}"
            )
        renamed |= dict.fromkeys(hits, new_name)
    renamed = _map_by_brand(table, joint_names, options, renamed) | renamed

    in_any_case = {name: name for name in (*reserved(), STATUS)}
    in_any_case.update(orientations.IN_ANY_CASE)
    for convention in options.conventions:
        in_any_case.update({name.casefold(): name for name in convention.columns})

    named: dict[str, Column] = {}
    groups: list[Column] = []
    for index, label in enumerate(table.header):
        name, symbol = split_header(renamed.get(index, label))
        if not label or (index in renamed and name == IGNORE):
            continue
        written_symbol = split_header(label)[1]
        if symbol is not None and written_symbol is not None and symbol != written_symbol:
            raise MeasurementError(
                f"{table.source}, column '{label}': --columns gives it another unit, "
                f"'{renamed[index]}'. Correct one of them."
            )
        if name not in joint_names:
            name = in_any_case.get(name.casefold(), name)
        column = Column(index, label, name, symbol or written_symbol)
        is_group = name == "group"
        if is_group:
            groups.append(column)
        # Only groups that --columns maps are joined: two that happen to be called so were hardly
        # meant to be.
        is_joined = is_group and any(group.index in renamed for group in groups)
        if name in named and not is_joined:
            first = named[name]
            raise MeasurementError(
                f"{table.place}: two columns are called '{name}': number {first.index + 1} "
                f"('{first.label}') and number {index + 1} ('{label}'). Rename one, or leave "
                f'one out: --columns "{label}=-".'
            )
        named.setdefault(name, column)
    return named, tuple(groups)


def _map_by_brand(
    table: Table,
    joint_names: Sequence[str],
    options: ColumnOptions,
    renamed: Mapping[int, str],
) -> dict[int, str]:
    """Return the names that a brand maps columns to, by position from 0, with the brand's unit if they have none.

    Columns and joints that are renamed already, and columns that are called as their joints, are not the brand's. None
    are mapped without a brand. MeasurementError if the table has more or fewer axes than the robot has joints.
    """
    brand = options.brand_entry
    if brand is None:
        return {}
    written = {i: split_header(label)[0] for i, label in enumerate(table.header) if label}
    free_columns = {
        i: name for i, name in written.items() if i not in renamed and name not in joint_names
    }
    taken = {split_header(name)[0] for name in renamed.values()} | set(written.values())
    free_joints = [name for name in joint_names if name not in taken]
    by_brand = names_by_brand(brand, table.source, free_columns, free_joints)

    if brand.name == LEROBOT:  # whose tables are in degrees or not
        return by_brand
    # Without the robot it is not known which axes slide; they are taken as turning.
    units = dict.fromkeys(() if joint_names else by_brand.values(), COMMON["angle"])
    units |= dict.fromkeys(POINT, COMMON["length"])
    if brand.convention is not None:
        units |= dict.fromkeys(brand.orientation, brand.convention.unit)
    result = {}
    for i, name in by_brand.items():
        has_unit = split_header(table.header[i])[1] is not None or not units.get(name)
        result[i] = name if has_unit else f"{name} [{units[name]}]"
    return result


def with_unit(
    table: Table,
    column: Column,
    quantity: Quantity | None,
    what: str = "",
    proposed: str = "",
    also: str = "",
) -> Column:
    """Return a column unchanged if its unit is of the right quantity; raise `MeasurementError` otherwise.

    Args:
        table: The column's table, for messages.
        column: The column.
        quantity: What its numbers are; None: numbers without a unit.
        what: What the column holds, for messages: ``"a quaternion"``.
        proposed: Unit to propose in the message; empty: that of `COMMON`.
        also: Another remedy for a column without unit, for the message: ``"--joint-unit deg"``.

    Returns:
        The column.

    Raises:
        MeasurementError: It has no unit, one of another quantity, or a unit although it must not have one.
    """
    kind_of_column = f" ({what})" if what else ""
    where = f"{table.place}, column '{column.label}'{kind_of_column}"
    if quantity is None:
        if column.symbol not in (None, "", "-", "1"):
            raise MeasurementError(f"{where}: '{column.symbol}' cannot be; there is no unit here.")
        return column
    unit = column.unit
    if unit is not None and unit.quantity == quantity:
        return column
    fault = "the column has no unit"
    if column.symbol:
        fault = f"'{column.symbol}' is not a unit of {quantity}"
        also = ""
    header = f"{split_header(column.label)[0]} [{proposed or COMMON[quantity]}]"
    mapping = header.replace(" [", f"={column.name} [")
    raise MeasurementError(
        f"{where}: {fault}. Write the header '{header}', or --columns \"{mapping}\""
        f"{f', or {also}' if also else ''}; allowed are {choices(symbols(quantity))}."
    )


def joint_with_unit(
    table: Table, column: Column, joint_type: str | None, options: ColumnOptions
) -> Column:
    """Return a joint's column in a unit that fits the joint, which ``options`` may say if the column has none.

    Args:
        table: The column's table, for messages.
        column: The column, by the joint's name.
        joint_type: The joint's URDF type; None: not known, any unit of its own is right.
        options: What is said of the table's columns.

    Returns:
        The column.

    Raises:
        MeasurementError: It has no unit, or one that does not fit.
    """
    quantity: Quantity = "length" if joint_type == "prismatic" else "angle"
    if not column.symbol:
        column = replace(column, symbol=options.joint_unit_of(quantity) or column.symbol)
    if joint_type is None and column.unit is not None:
        return column
    what = f"{joint_type or 'revolute'} joint '{column.name}'"
    names = [split_header(label)[0] for label in table.header]
    remedies = [f"--columns {brand.name}" for brand in brands_like(names) if not options.brand]
    remedies.append(f"--joint-unit {COMMON[quantity]}")
    if column.symbol in (TICKS, PERCENT):
        raise MeasurementError(
            f"{table.source}, column '{column.label}': '{column.symbol}' says nothing without the servo. Give "
            "LeRobot's calibration file as --motors FILE, or the ticks in a turn and the tick of the joints' zero, "
            "such as --motors 4096@2048."
        )
    return with_unit(table, column, quantity, what, also=" or ".join(remedies))


def cells_of(values: Array, unit: str) -> list[object]:
    """Return the cells of a column of numbers, empty if nothing was measured.

    Args:
        values: Numbers in SI units, shape (N,), NaN where nothing was measured.
        unit: Symbol of the unit to write them in; empty: none.
    """
    to_si = UNITS[unit].to_si if unit else 1.0
    exact = values / to_si
    # Fifteen digits, as a table had them, if they give the number back to the last bit.
    short = np.array([float(f"{number:.15g}") for number in exact])
    written = np.where(short * to_si == values, short, exact).tolist()
    return ["" if math.isnan(number) else number for number in written]
