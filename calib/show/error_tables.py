"""Errors as tables: the one place of their columns."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calib.basics.channels import RESIDUAL_UNITS, Channels
from calib.numerics.errors import Errors, UnitErrors
from calib.show.blocks import EVERYWHERE, Medium
from calib.show.tables import Column, Label, Row, Table, name_column, residual_column


@dataclass(frozen=True, slots=True)
class ErrorColumn:
    """A column of the tables of errors: a figure of a set of rows, in the unit of the errors."""

    #: Its heading
    head: str
    #: The figure, in the SI unit of the errors, or [px]; NaN if a set has none
    value: Callable[[UnitErrors], float]
    #: Its meaning, for the docs
    meaning: str
    #: Heading that it shares with its neighbours
    group: str = ""
    #: Left out if no set of rows has a value; tables with several columns for a robot do not have it at all
    optional: bool = False
    #: Sentence below the table on a page
    note: str = ""

    def column(self, unit: str, group: str = "") -> Column:
        """Return the column of a table of errors in one unit.

        Args:
            unit: Symbol of the unit, of `calib.basics.channels.RESIDUAL_UNITS`.
            group: Heading above it in place of its own.
        """
        column = residual_column(self.head, unit, 9, group=group or self.group)
        return replace(column, optional=self.optional, note=self.note)


def _span(axis: int) -> Callable[[UnitErrors], float]:
    """Return the function that gives the span of errors along an axis of the measurement frame: 0, 1, 2 for x, y, z.

    It is in the unit of the errors; NaN in units whose span is not shown.
    """

    def span(errors: UnitErrors) -> float:
        shows = RESIDUAL_UNITS[errors.unit].shows_span
        return float(errors.span_axis[axis]) if shows else math.nan

    return span


_SPAN = "Span: largest minus smallest signed error along an axis of the frame."

#: The columns of every table of errors, after the number of rows. A further one is an entry here.
ERROR_COLUMNS: tuple[ErrorColumn, ...] = (
    ErrorColumn("max", lambda errors: errors.max, "largest error"),
    ErrorColumn("mean", lambda errors: errors.mean, "mean of the errors"),
    ErrorColumn("rms", lambda errors: errors.rms, "root mean square of the errors"),
    *(
        ErrorColumn(
            letter,
            _span(axis),
            f"span of position errors along {letter} of the measurement frame: largest minus smallest signed error",
            group="span",
            optional=True,
            note=_SPAN,
        )
        for axis, letter in enumerate("xyz")
    ),
)


class ErrorRow(NamedTuple):
    """A row of a table of errors."""

    label: str | Label
    errors: Errors
    #: In bold on a page
    strong: bool = False


def error_table(
    title: str,
    unit: str,
    rows: Iterable[ErrorRow | str],
    columns: Sequence[ErrorColumn] = ERROR_COLUMNS,
    *,
    names: str = "",
    note: str = "",
    on: Medium = EVERYWHERE,
) -> Table:
    """Make a table of errors in one unit.

    Args:
        title: What the errors are of, see `error_title`.
        unit: Symbol of the unit.
        rows: The rows; those without errors in this unit are left out. A text takes a row of its own.
        columns: The columns after the number of rows: largest, mean, rms and spans unless given.
        names: Heading of the labels on a page.
        note: Sentences below the table on a page.
        on: The media that draw it: all of them unless given.

    Returns:
        Number of rows, and the figures of ``columns`` of each set of rows.
    """
    cells: list[Row] = []
    strong = []
    for row in rows:
        if isinstance(row, str):
            cells.append(row)
            continue
        errors = row.errors[unit]
        if errors.n:
            if row.strong:
                strong.append(len(cells))
            cells.append((row.label, errors.n, *error_cells(errors, columns)))
    return Table(
        f"{title} [{RESIDUAL_UNITS[unit].shown}]",
        (name_column(names, 33), Column("rows", 4), *(one.column(unit) for one in columns)),
        cells,
        note,
        strong,
        on=on,
    )


def error_cells(errors: UnitErrors, columns: Sequence[ErrorColumn]) -> list[float]:
    """Return the figures of errors that columns show, in the unit of the errors: [m], [rad] or [px]; NaN for none."""
    return [column.value(errors) for column in columns]


def error_texts(errors: UnitErrors, columns: Sequence[ErrorColumn]) -> list[str]:
    """Write the figures of errors that columns show, in the unit in which they are shown, such as mm, without it.

    For tables whose rows differ in their unit.
    """
    return [column.column(errors.unit).text(column.value(errors)) for column in columns]


def sizes_of_errors(columns: Sequence[ErrorColumn]) -> list[ErrorColumn]:
    """Return the columns that tables with several columns for a robot have: those that are not optional."""
    return [column for column in columns if not column.optional]


def error_title(unit: str, *channels: Channels) -> str:
    """Return the title of a table of errors in one unit: an error of a distance is not one of a position.

    Args:
        unit: Symbol of the unit.
        channels: Units of the scalars of one or several sets of rows; see `measured_lengths`.

    Returns:
        Such as ``"Position error"``, ``"Length error"``, ``"Position or length error"`` or ``"Orientation error"``.
    """
    measured = RESIDUAL_UNITS[unit].measured
    if unit == "m":
        measured = measured_lengths(*channels).replace("coordinate", measured)
    return f"{measured.capitalize()} error"


def measured_lengths(*channels: Channels) -> str:
    """Name what measured lengths are: coordinates of points, distances, or both.

    Args:
        channels: Units of the scalars of one or several sets of rows.

    Returns:
        ``"coordinate"``, ``"length"`` if none is a coordinate of a position, or ``"coordinate or length"``.
    """
    are_vectors = set()
    for of_rows in channels:
        occurring = set(np.unique(of_rows.index).tolist())
        for c, unit in enumerate(of_rows.units):
            if unit == "m" and c in occurring:
                are_vectors.add(of_rows.vectors[c])
    names = {True: "coordinate", False: "length"}
    return (
        " or ".join(name for is_vector, name in names.items() if is_vector in are_vectors)
        or "coordinate"
    )
