"""Columns of an orientation in a table, and the convention that they are in."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

from calib.basics.tables import Column, Table
from calib.data.columns import Columns, Named, list_columns, with_unit
from calib.data.forms.brands import BRANDS
from calib.data.forms.column_options import ColumnOptions
from calib.data.forms.orientations import CONVENTIONS, Convention
from calib.errors import MeasurementError


class Orientation(NamedTuple):
    """The orientation of a table's rows."""

    #: What its numbers mean.
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
        joint_names: Joints, whose columns are no orientation.
        options: What is said of the columns; its convention, if its columns are there, is the only one.
    """
    complete = [c for c in CONVENTIONS.values() if is_complete(c, named, joint_names)]
    for convention in options.conventions:
        if convention in complete:
            return (convention,)
    by_columns: dict[tuple[str, ...], Convention] = {}
    for convention in complete:
        by_columns.setdefault(convention.columns, convention)
    filled = [c for c in by_columns.values() if _is_filled(c, table, named)]
    return tuple(filled or by_columns.values())


def find_orientation(
    table: Table, named: Named, joint_names: Collection[str], options: ColumnOptions
) -> Orientation:
    """Find the orientation of a table that must have one.

    Args:
        table: The table.
        named: Its columns by calib's names.
        joint_names: Joints, whose columns are no orientation.
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
        forms = [f"{', '.join(c.columns)} ({c.name})" for c in CONVENTIONS.values()]
        raise MeasurementError(
            f"{table.source}: rows of the kind 'pose' need one orientation{wanted}, and the table "
            f"has {_counted(conventions)}. {list_columns(table)} An orientation has the columns {'; '.join(forms)}. "
            f"{_fix(conventions)}; --kind point reads none."
        )
    return in_units(table, named, conventions[0], options)


def in_units(
    table: Table, named: Named, convention: Convention, options: ColumnOptions
) -> Orientation:
    """Return the orientation of a convention, whose columns a table has; raises `MeasurementError` for a wrong unit.

    Args:
        table: The table, for messages.
        named: Its columns by calib's names.
        convention: The convention.
        options: What is said of the columns.
    """
    quantity = "angle" if convention.unit else None
    columns = []
    for name in convention.columns:
        _check_unit(table, named[name], convention)
        column = with_unit(table, named[name], quantity, convention.words, convention.unit)  # type: ignore[arg-type]
        columns.append(column)
    alternatives: tuple[str, ...] = ()
    if convention not in options.conventions:
        same = [c for c in CONVENTIONS.values() if c.columns == convention.columns]
        alternatives = tuple(c.name for c in same if c is not convention)
    return Orientation(convention, tuple(columns), alternatives)


def _check_unit(table: Table, column: Column, convention: Convention) -> None:
    """Refuse a column without unit of a brand's angles, with the option that gives it one."""
    if convention.unit and column.symbol is None and convention.name in BRANDS:
        raise MeasurementError(
            f"{table.source}, column '{column.label}' ({convention.words}): the column has no unit. Give "
            f"--columns {convention.name}, whose columns are in deg and mm; or write the header "
            f"'{column.label} [deg]', or --columns \"{column.label}={column.name} [deg]\"."
        )


def is_complete(convention: Convention, named: Named, joint_names: Collection[str]) -> bool:
    """Return True if a table has all columns of a convention, none of them a joint's.

    Columns in a unit of angle do not count for a convention without units: q1 to q4 in deg are joints. Only qx to qw
    do, so that their unit is refused.

    Args:
        convention: The convention.
        named: The columns by calib's names.
        joint_names: Joints, whose columns are no orientation.
    """
    for name in convention.columns:
        if name not in named or name in joint_names:
            return False
        if not convention.unit and named[name].is_angle and convention.name != "quaternion":
            return False
    return True


def _is_filled(convention: Convention, table: Table, named: Named) -> bool:
    """Return True if any cell of a convention's columns is filled in."""
    return any(any(table.column(named[name])) for name in convention.columns)


def _counted(conventions: Collection[Convention]) -> str:
    """Return the orientations that a table has in words, for the message."""
    return " and ".join(c.words for c in conventions) or "none"


def _fix(conventions: tuple[Convention, ...]) -> str:
    """Return the remedy for a table with no orientation, or with more than one."""
    if len(conventions) < 2:
        return 'Another name is mapped by --columns "name in the table=rx [rad]"'
    column = conventions[-1].columns[0]
    return f'--columns "{column}=-" leaves one out, or --orientation {conventions[0].name} chooses'
