"""Checks of numbers against their units: metres read as millimetres, degrees read as radians."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date, timedelta
from typing import NamedTuple

import numpy as np

import calib.data.kinds as registry
from calib.basics.arrays import Array
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.tables import Column, Table
from calib.basics.units import UNITS, Unit
from calib.data.forms.orientation_columns import Orientation
from calib.data.layout import Layout
from calib.errors import MeasurementError

#: No point of a robot cell is farther from the origin of a frame in use [m].
_FARTHEST_M = 100.0

#: Not all points of a table are nearer to the origin than this [m].
_NEAREST_M = 5e-3

#: Units to propose for a length, and the range in metres of what one would measure.
_PROPOSED_UNITS = ("mm", "m", "um")
_PROPOSED_RANGE_M = (0.01, 20.0)

#: Median of the values of a joint, or of rotation vectors, beyond which radians are taken for
#: degrees [rad]: hardly any joint turns so far, and degrees mostly do.
_TURNS_RAD = 7.0

#: Twice that of a quaternion, as entries of R^T R are squares.
_MATRIX_TOLERANCE = 2e-3

#: Half a turn, and a little for digits that were not written [rad].
_HALF_TURN_RAD = np.pi + 0.01

#: A quaternion written with four digits has length one to half of this.
_LENGTH_TOLERANCE = 1e-3


#: Days from the origin of Excel's dates to 2000-01-01 and 2050-01-01: what Excel makes of 1.5 or 1/5 is a day of a
#: year of today.
_EXCEL_DAYS = (36_526, 54_789)
_EXCEL_ORIGIN = date(1899, 12, 30)

#: A number is taken for a date only if it is this many times the largest of the others in its column.
_FAR_LARGER = 10.0


class Fault(NamedTuple):
    """A number that cannot be in its unit."""

    #: From 0.
    row: int
    #: Among the columns that were checked, from 0.
    column: int
    #: The fault and how to mend it, for the message.
    what: str


def implausible_length(values: Array, units: Sequence[Unit], *, near: bool = True) -> Fault | None:
    """Find a position or a length that cannot be in its unit.

    The row farthest from the origin decides: it is farther than a cell is wide or, if ``near``,
    so close that all rows are at the origin.

    Args:
        values: Positions or lengths as written, shape (N, k); NaN where nothing is measured.
        units: Unit of each of the k columns.
        near: Whether rows that are all close to the origin are a fault too, unless they are in m.

    Returns:
        The number to blame; None if all are plausible.
    """
    metres = np.nan_to_num(values) * [unit.to_si for unit in units]
    distance = np.hypot.reduce(metres, axis=1)  # does not square: a huge number stays one
    row = int(np.argmax(distance))
    if not distance[row] <= _FARTHEST_M:
        what = f"further from the origin than {_FARTHEST_M:g} m"
    elif near and distance[row] < _NEAREST_M and units[0].symbol != "m":
        what = f"and none is further from the origin than {_NEAREST_M * 1e3:g} mm"
    else:
        return None
    k = int(np.argmax(np.abs(metres[row])))
    number = values[row, k]
    # The first unit in which it is a length as one would measure, unless that is the one it was read in.
    fix = "Correct the value."
    least, largest = _PROPOSED_RANGE_M
    likely = [s for s in _PROPOSED_UNITS if least <= abs(number) * UNITS[s].to_si <= largest]
    if likely and likely[0] != units[k].symbol:
        fix = f"If it is in {likely[0]}, say so in the header: [{likely[0]}]."
    return Fault(row, k, f"{number:.10g} was read as {metres[row, k]:.6g} m, {what}. {fix}")


@np.errstate(over="ignore")  # an infinite length is too large as well
def check_units(table: Table, layout: Layout, numbers: Mapping[str, Array]) -> None:
    """Refuse numbers that cannot be in their units: metres read as millimetres, degrees as radians.

    Args:
        table: The table, for messages.
        layout: Its columns.
        numbers: Numbers of the columns of each block of ``layout`` as written, shape (N, columns);
            NaN where a row has none.

    Raises:
        MeasurementError: A length, an angle or a quaternion is implausible; the message names the
            column, the row if a single one is to blame, and the unit that is likely meant.
    """
    for name, block in numbers.items():
        columns = layout.blocks[name]
        if name in ("joints", "points"):
            for k, column in enumerate(columns):
                _check_no_dates(table, layout, column, block[:, k])
        if name == "joints":  # each by its own column, anything else by all columns of a row
            for k, column in enumerate(columns):
                _check_block(table, layout, name, [column], block[:, [k]])
        elif name == "covariances":
            # Half of them must not imply positions that are measured worse than by any camera.
            complete = block[np.isfinite(block).all(axis=1)]
            if not len(complete):
                continue
            variances = np.diagonal(complete.reshape(-1, 6, 6), axis1=1, axis2=2)[:, :3]
            std = np.sqrt(np.maximum(np.median(np.mean(variances, axis=1)), 0.0))
            if std > RESIDUAL_UNITS["m"].absurd:
                raise MeasurementError(
                    f"{table.source}: half of the covariances imply a standard deviation of {std:.2g} m or more for a "
                    "coordinate. They are variances, in m^2, m rad and rad^2. If lengths are in mm, divide the "
                    "first three rows by 1000 and then the first three columns; if these are standard deviations, "
                    "square them."
                )
        else:
            _check_block(table, layout, name, columns, block)


def _check_no_dates(table: Table, layout: Layout, column: Column, values: Array) -> None:
    """Raise MeasurementError if Excel has made dates of numbers of a column, (N,) as written: days since 1900.

    They are whole numbers of these years, and far larger than all others of the column.
    """
    first, last = _EXCEL_DAYS
    is_date = (values >= first) & (values <= last) & (values == np.round(values))
    others = np.abs(values[~is_date & np.isfinite(values)])
    if not np.any(is_date) or not len(others) or first < _FAR_LARGER * np.max(others):
        return
    row = int(np.flatnonzero(is_date)[0])
    day = _EXCEL_ORIGIN + timedelta(days=int(values[row]))
    what = (
        f"{values[row]:.0f} is how Excel stores the date {day}. It was made of an entry such as "
        f"{day.day}.{day.month} or {day.month}.{day.day}: format the column as a number, and write that number."
    )
    table.fail(row, column, what, layout.words.get("row"))


def _check_block(
    table: Table,
    layout: Layout,
    name: str,
    columns: Sequence[Column],
    values: Array,
) -> None:
    """Raise MeasurementError if numbers, (N, columns) as written, of a block cannot be in the units of its columns."""
    complete = np.isfinite(values).all(axis=1)
    if not complete.any():
        return
    units = [column.unit for column in columns if column.unit]
    fault: Fault | None = None
    if name == "orientation" and not units:
        fault = orientation_fault(layout.orientation, columns, values)
    elif name in ("orientation", "joints") and {unit.symbol for unit in units} == {"rad"}:
        # Angles, or the lengths of rotation vectors.
        median = np.median(np.linalg.norm(values[complete], axis=1))
        if median > _TURNS_RAD:
            raise MeasurementError(
                f"{table.source}, column '{columns[0].label}': half of the values are beyond "
                f"{median:.4g} rad, more than a turn; they look like degrees. If they are, write "
                f"'{columns[0].name} [deg]' into the header."
            )
    elif name == "orientation":
        fault = orientation_fault(layout.orientation, columns, values)
    elif name == "points":
        fault = implausible_length(values, units)
    elif name == "joints" and units[0].quantity == "length":
        fault = implausible_length(values, units, near=False)
    elif name in registry.readings():
        reading = registry.readings()[name]
        if reading.quantity == "length":
            fault = implausible_length(values, units, near=reading.positive)
    if fault is not None:
        table.fail(fault.row, columns[fault.column], fault.what, layout.words.get("row"))


def orientation_fault(
    orientation: Orientation | None, columns: Sequence[Column], values: Array
) -> Fault | None:
    """Find an orientation that is none.

    Args:
        orientation: Its convention, and whether that was named; None: not known.
        columns: Its k columns.
        values: Numbers of N orientations as written, shape (N, k); NaN where nothing is measured.

    Returns:
        The first quaternion whose length is not one, matrix that is no rotation, or rotation vector of more than half a
        turn that may be of another convention; None if there is none.
    """
    # The length of quaternions is one.
    if len(columns) == 4:
        lengths = np.linalg.norm(values, axis=1)
        wrong = np.flatnonzero(np.abs(lengths - 1.0) > _LENGTH_TOLERANCE)
        if not wrong.size:
            return None
        length = lengths[wrong[0]]
        what = f"the quaternion has the length {length:.6g}; that of an orientation is 1."
        return Fault(int(wrong[0]), 0, what)

    # R^T R = 1 and det R = 1.
    if len(columns) == 9:
        R = values.reshape(-1, 3, 3)
        squares = R.transpose(0, 2, 1) @ R - np.eye(3)
        is_wrong = np.abs(squares).max(axis=(1, 2)) > _MATRIX_TOLERANCE
        wrong = np.flatnonzero(is_wrong | (np.linalg.det(R) < 0.0))
        if not wrong.size:
            return None
        what = (
            "the matrix is not a rotation: its columns r11 r21 r31 and so on are perpendicular unit vectors, and its "
            f"determinant is 1, here {np.linalg.det(R[wrong[0]]):.6g}."
        )
        return Fault(int(wrong[0]), 0, what)

    # Rotation vectors are no longer than half a turn; longer ones may be angles of another convention, if none was
    # named.
    if orientation is None or not orientation.alternatives:
        return None
    angles = np.linalg.norm(values * [column.to_si for column in columns], axis=1)
    wrong = np.flatnonzero(angles > _HALF_TURN_RAD)
    if not wrong.size:
        return None
    others = " or ".join(f"--orientation {name}" for name in orientation.alternatives)
    what = (
        f"{orientation.convention.words} of {np.degrees(angles[wrong[0]]):.4g} deg, more than half a turn. If these "
        f"are three angles, name their convention: {others}; else --orientation {orientation.convention.name}."
    )
    return Fault(int(wrong[0]), 0, what)
