"""Columns of an orientation in a table, and the convention that they are in."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

from calib.basics.tables import Table
from calib.data.columns import Columns, Named, list_columns, with_unit
from calib.data.forms.column_options import BRANDS, ColumnOptions
from calib.data.forms.orientations import CONVENTIONS, Convention
from calib.errors import MeasurementError


class Orientation(NamedTuple):
    """The orientation of a table's rows."""

    #: The meaning of its numbers.
    convention: Convention
    #: Its columns, in the order of the convention.
    columns: Columns
    #: Names of other conventions with these columns, if only the columns say which one it is.
    alternatives: tuple[str, ...]


def conventions_of(
    table: Table, named: Named, joint_names: Collection[str], options: ColumnOptions
) -> tuple[Convention, ...]:
    """Return the conventions whose columns a table has; of several with the same columns the one that is meant.

    If the cells of some conventions are filled in, only these count: a plan leaves columns empty.

    Args:
        table: The table.
        named: The columns by calib's names.
        joint_names: Joints; a column with a joint's name is not part of an orientation.
        options: What is said of the columns; its convention, if its columns are there, is the only one.
    """
    complete = [c for c in CONVENTIONS.values() if is_complete(c, named, joint_names)]
    for convention in options.conventions:
        if convention in complete:
            return (convention,)
    by_columns: dict[tuple[str, ...], Convention] = {}
    for convention in complete:
        by_columns.setdefault(convention.columns, convention)

    def is_filled(convention: Convention) -> bool:
        return any(any(table.column(named[name])) for name in convention.columns)

    filled = tuple(filter(is_filled, by_columns.values()))
    return filled or tuple(by_columns.values())


def find_orientation(
    table: Table, named: Named, joint_names: Collection[str], options: ColumnOptions
) -> Orientation:
    """Find the orientation of a table that must have one.

    Args:
        table: The table.
        named: Its columns by calib's names.
        joint_names: Joints; a column with a joint's name is not part of an orientation.
        options: What is said of the columns.

    Returns:
        The orientation, its columns with units that fit.

    Raises:
        MeasurementError: There is none or more than one, it is not of the convention of ``options``, or a unit does
            not fit.
    """
    conventions = conventions_of(table, named, joint_names, options)
    is_other = options.orientation not in (None, *(c.name for c in conventions))
    if len(conventions) != 1 or is_other:
        wanted = f" (--orientation {options.orientation})" if is_other else ""
        has = " and ".join(c.words for c in conventions) or "none"
        fix = 'Another name is mapped by --columns "name in the table=rx [rad]"'
        if len(conventions) > 1:
            column = conventions[-1].columns[0]
            fix = f'--columns "{column}=-" leaves one out, or --orientation {conventions[0].name} chooses'
        forms = [f"{', '.join(c.columns)} ({c.name})" for c in CONVENTIONS.values()]
        raise MeasurementError(
            f"{table.source}: rows of the kind 'pose' need one orientation{wanted}, and the table "
            f"has {has}. {list_columns(table)} An orientation has the columns {'; '.join(forms)}. "
            f"{fix}; --kind point reads none."
        )
    return in_units(table, named, conventions[0], options)


def in_units(
    table: Table, named: Named, convention: Convention, options: ColumnOptions
) -> Orientation:
    """Return the columns of a convention that a table has, checked for their unit, as its orientation.

    Args:
        table: The table, for messages.
        named: Its columns by calib's names.
        convention: The convention.
        options: What is said of the columns.

    Raises:
        MeasurementError: A column has a wrong unit, or none where one is needed.
    """
    quantity = "angle" if convention.unit else None
    columns = []
    for name in convention.columns:
        column = named[name]
        if convention.unit and column.symbol is None and convention.name in BRANDS:
            raise MeasurementError(
                f"{table.source}, column '{column.label}' ({convention.words}): the column has no unit. Give "
                f"--columns {convention.name}, whose columns are in deg and mm; or write the header "
                f"'{column.label} [deg]', or --columns \"{column.label}={column.name} [deg]\"."
            )
        column = with_unit(table, column, quantity, convention.words, convention.unit)  # type: ignore[arg-type]
        columns.append(column)
    alternatives: tuple[str, ...] = ()
    if convention not in options.conventions:
        same = [c for c in CONVENTIONS.values() if c.columns == convention.columns]
        alternatives = tuple(c.name for c in same if c is not convention)
    return Orientation(convention, tuple(columns), alternatives)


def is_complete(convention: Convention, named: Named, joint_names: Collection[str]) -> bool:
    """Return True if a table has all columns of a convention, none of them a joint's.

    Columns in a unit of angle do not count for a convention without units: q1 to q4 in deg are joints. Only qx to qw
    do, so that their unit is refused.

    Args:
        convention: The convention.
        named: The columns by calib's names.
        joint_names: Joints; a column with a joint's name is not part of an orientation.
    """
    for name in convention.columns:
        if name not in named or name in joint_names:
            return False
        if not convention.unit and named[name].is_angle and convention.name != "quaternion":
            return False
    return True
