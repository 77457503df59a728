"""The columns that a reading of a session has, and what is wrong with those that were given."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from numbers import Real

import numpy as np

import calib.data.kinds as kinds
from calib.basics.units import UNITS, split_header
from calib.data.columns import COMMON, POINT
from calib.data.forms.column_options import ColumnOptions
from calib.data.forms.orientations import find_convention
from calib.data.plausibility import implausible_length

#: Columns of an orientation by default.
_ROTATION = ("rx", "ry", "rz")

#: Units in which a place may have been read, the likeliest first.
_UNITS = ("m", "mm", "in")


def headers_of(kind: str, unit: str, columns: ColumnOptions | None = None) -> Iterator[str]:
    """Yield the headers of what is read of one target.

    Args:
        kind: The kind of the readings; pictures have none.
        unit: Unit of lengths, such as ``"mm"``.
        columns: What is said of the columns; None: nothing.
    """
    of_kind = kinds.get(kind)
    if of_kind.is_image:
        return
    if of_kind.position:
        yield from (f"{axis} [{unit}]" for axis in POINT)
    if of_kind.orientation:
        convention = None if columns is None else columns.orientation
        names = _ROTATION if convention is None else find_convention(convention).columns
        angle = len(names) == 3
        yield from (f"{name} [deg]" if angle else name for name in names)
    for reading in of_kind.readings:
        common = COMMON[reading.quantity]
        yield f"{reading.name} [{unit if reading.quantity == 'length' else common}]"


def quoted(headers: Sequence[str]) -> str:
    """Write headers in a sentence: ``'x [mm]', 'y [mm]', 'z [mm]'``."""
    return ", ".join(f"'{header}'" for header in headers)


def column_fault(
    row: Mapping[str, object], headers: Sequence[str], joints: Sequence[str], frame: str
) -> str | None:
    """Say which column of a reading is missing, has no unit, or has another unit than was meant.

    Args:
        row: The reading, numbers by header.
        headers: The headers that it may have, from `headers_of`.
        joints: Headers of the joint values, which it has all or none of.
        frame: What places are measured from, for the message: ``"the instrument"``.

    Returns:
        The fault, and the columns to give; None if there is none of these.
    """
    names = {split_header(header)[0]: header for header in row}
    give = f"Give the columns {quoted(headers)}, in these or other units."
    for header in headers:
        name, unit = split_header(header)
        given = names.get(name)
        if name in _ROTATION or not unit:  # orientations have other columns too
            continue
        if given is None:
            return f"The reading has no column '{header}'. {give}"
        symbol = split_header(given)[1]
        if not symbol:
            return f"The column '{given}' has no unit. {give}"
        if symbol not in UNITS or UNITS[symbol].quantity != UNITS[unit].quantity:
            return f"The column '{given}' is not in a unit such as '{unit}'. {give}"
    given_joints = [name for name in joints if split_header(name)[0] in names]
    if 0 < len(given_joints) < len(joints):
        return (
            f"The reading has some joint values: give all, {quoted(joints)}, or none if the robot stands at the "
            "proposed pose."
        )
    misread = misread_place(row, frame)
    if misread is None:
        return None
    fault, unit = misread
    return f"{fault} Then give {quoted([f'{axis} [{unit}]' for axis in POINT])}."


def misread_place(row: Mapping[str, object], frame: str) -> tuple[str, str] | None:
    """Find a place that cannot be in its unit, such as one in metres that was read as millimetres.

    Args:
        row: One reading, numbers by header, or lists of several targets, of which the first decides.
        frame: What it is measured from, for the message: ``"the instrument"``.

    Returns:
        What is wrong with it, as a sentence and a question, and the unit in which it may have been; None if it can be
        where it is, or has no place.
    """
    units, place = [], []
    for axis in POINT:
        for header, cell in row.items():
            value = cell[0] if isinstance(cell, (list, tuple)) and cell else cell
            name, symbol = split_header(header)
            if name == axis and symbol and isinstance(value, Real):
                units.append(symbol)
                place.append(float(value))
    if len(place) != len(POINT) or len({*units}) > 1 or units[0] not in UNITS:
        return None
    values, unit = np.array([place]), UNITS[units[0]]
    if unit.quantity != "length" or implausible_length(values, [unit] * 3) is None:
        return None
    for symbol in _UNITS:
        other = UNITS[symbol]
        if symbol != unit.symbol and implausible_length(values, [other] * 3) is None:
            wrong = "near" if other.to_si > unit.to_si else "far"
            size = f"{np.linalg.norm(values):.4g} {unit.symbol}"
            return f"{size} from {frame} is too {wrong}. Was it in {symbol}?", symbol
    return None
