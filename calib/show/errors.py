"""Errors as tables: the one place of their columns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from calib.basics.channels import RESIDUAL_UNITS, Channels
from calib.numerics.errors import Errors, UnitErrors
from calib.show.sizes import shown
from calib.show.tables import Column, name_column, table_lines


def error_title(unit: str, *channels: Channels) -> str:
    """Title of a table of errors in one unit: an error of a distance is none of a position.

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


def error_table(title: str, unit: str, rows: Iterable[tuple[str, Errors] | str]) -> list[str]:
    """Write a table of errors in one unit.

    Args:
        title: Heading of the labels; see `error_title`.
        unit: Symbol of the unit.
        rows: Label and errors of each row; a text is a line of its own.

    Returns:
        Its lines: rows, maximum, mean, rms, and of positions the span of the error along each axis.
    """
    listed = list(rows)
    of_errors = [row[1][unit] for row in listed if not isinstance(row, str)]
    has_span = any(np.isfinite(figures.span_axis).any() for figures in of_errors)
    count, *heads = error_heads(unit)
    if not has_span:
        heads = heads[:_WITHOUT_SPAN]
    columns = [name_column(f"{title} [{RESIDUAL_UNITS[unit].shown}]", 33), Column(count, 4)]
    columns += [Column(head, 9) for head in heads]
    cells: list[Sequence[str] | str] = []
    for row in listed:
        if isinstance(row, str):
            cells.append(row)
            continue
        label, errors = row
        cells.append((label, *error_cells(errors[unit])[: len(heads) + 1]))
    return table_lines(columns, cells)


def error_heads(unit: str) -> tuple[str, ...]:
    """Return the heads of the columns of a table of errors in one unit, but for the first."""
    spans = ("span x", "y", "z") if RESIDUAL_UNITS[unit].shows_span else ()
    return ("rows", "max", "mean", "rms", *spans)


def error_cells(figures: UnitErrors) -> list[str]:
    """Return a cell for each of `error_heads` of the unit of some errors."""
    values = [figures.max, figures.mean, figures.rms]
    if RESIDUAL_UNITS[figures.unit].shows_span:
        values += figures.span_axis.tolist()
    return [str(figures.n), *(shown(value, figures.unit) for value in values)]


#: Columns of a table of errors besides the count, without those of the span: maximum, mean, rms.
_WITHOUT_SPAN = 3


def measured_lengths(*channels: Channels) -> str:
    """Name what measured lengths are: coordinates of points, distances, or both.

    Args:
        channels: Units of the scalars of one or several sets of rows.

    Returns:
        ``"coordinate"``, ``"length"`` where these are no coordinates of a position, or ``"coordinate or length"``.
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
