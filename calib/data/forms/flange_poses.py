"""Tables with poses of the flange, as a controller shows them, in place of joint values.

The columns are a position and one orientation, each named with ``flange_`` before it: ``flange_x [mm]``,
``flange_qw``, ``flange_A [deg]``. In a table of corners in pictures, which measures no pose itself, the names may stand
alone: ``x [mm]``, ``A [deg]``. They become joint values of the robot that stands for such poses
(`calib.robot.flange`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calib.basics.arrays import Array
from calib.basics.tables import Column, Table
from calib.basics.units import split_header
from calib.data.columns import POINT, cells_of, list_columns, name_columns, with_unit
from calib.data.forms.column_options import ColumnOptions, ColumnsInput, column_options
from calib.data.forms.orientation_columns import conventions_of, in_units
from calib.data.forms.orientations import CONVENTIONS, IN_ANY_CASE, find_convention
from calib.data.plausibility import implausible_length, orientation_fault
from calib.errors import MeasurementError
from calib.robot.flange import JOINTS, SLIDING

#: Begins the names of the columns of a flange's pose.
PREFIX = "flange_"

#: Columns by which a table is one of corners in pictures.
_OF_CORNERS = ("u", "v")


def has_flange_poses(table: Table, columns: ColumnsInput = None) -> bool:
    """Return True if a table has a position of the flange.

    Args:
        table: The table.
        columns: What is said of the columns; None: nothing.
    """
    return all(name in _pose_columns(table, column_options(columns)) for name in POINT)


def with_flange_joints(table: Table, columns: ColumnsInput = None) -> tuple[Table, ColumnOptions]:
    """Return a table with joint values of `calib.robot.flange` in place of the poses of the flange.

    Args:
        table: The table, with columns of a position and of an orientation.
        columns: What is said of the columns; None: nothing.

    Returns:
        The table, and what is said of its columns.

    Raises:
        MeasurementError: A column is missing, has a wrong unit or occurs twice; there are several orientations; or
            numbers are no rotation.
    """
    options = column_options(columns)
    named = _pose_columns(table, options)
    missing = [name for name in POINT if name not in named]
    if missing:
        raise MeasurementError(
            f"{table.source}: no pose of the flange. It has the columns '{PREFIX}x [mm]', '{PREFIX}y [mm]', "
            f"'{PREFIX}z [mm]' and those of one orientation, such as '{PREFIX}qx' to '{PREFIX}qw'. "
            f'{list_columns(table)} Another name is mapped by --columns "name in the table={PREFIX}{missing[0]} [mm]".'
        )
    position = [with_unit(table, named[name], "length", "the flange's position") for name in POINT]
    conventions = conventions_of(table, named, (), options)
    if len(conventions) != 1:
        found = " and ".join(c.words for c in conventions) or "none"
        forms = [
            f"{', '.join(PREFIX + name for name in c.columns)} ({c.name})"
            for c in CONVENTIONS.values()
        ]
        raise MeasurementError(
            f"{table.source}: a pose of the flange needs one orientation, and the table has {found}. "
            f"{list_columns(table)} An orientation has the columns {'; '.join(forms)}. --orientation chooses one."
        )
    orientation = in_units(table, named, conventions[0], options)

    used = [*position, *orientation.columns]
    numbers = table.numbers(used) * [column.to_si for column in used]
    for n, k in np.argwhere(~np.isfinite(numbers)).tolist():
        text = table.cells[n][used[k].index]
        if text or np.isfinite(numbers[n]).any():
            what = f"'{text}' is not a finite number; a row has the whole pose, or none."
            table.fail(n, used[k], what, named.get("row"))
    R = orientation.convention.matrices(numbers[:, 3:])
    written = table.numbers(used)
    units_of_position = [column.unit for column in position if column.unit is not None]
    faults = (
        (position, implausible_length(written[:, :3], units_of_position, near=False)),
        (orientation.columns, orientation_fault(orientation, orientation.columns, written[:, 3:])),
    )
    for columns_of_fault, fault in faults:
        if fault is not None:
            column = columns_of_fault[fault.column]
            table.fail(fault.row, column, fault.what, named.get("row"))
    values = flange_joints(numbers[:, :3], R)

    replaced = {column.index for column in used}
    kept = [i for i in range(len(table.header)) if i not in replaced]
    joint_cells = [cells_of(values[:, k], "") for k in range(len(JOINTS))]
    units = ["m"] * SLIDING + ["rad"] * (len(JOINTS) - SLIDING)
    heads = [f"{name} [{unit}]" for name, unit in zip(JOINTS, units, strict=True)]
    cells = tuple(
        [*(row[i] for i in kept), *(str(column[n]) for column in joint_cells)]
        for n, row in enumerate(table.cells)
    )
    left = {split_header(table.header[i])[0] for i in kept} | {table.header[i] for i in kept}
    names = {key: name for key, name in options.names.items() if key.strip() in left}
    header = (*(table.header[i] for i in kept), *heads)
    return replace(table, header=header, cells=cells), replace(options, names=names)


def flange_joints(position: Array, R: Array) -> Array:
    """Return the joint values of `calib.robot.flange` at poses of the flange in the base.

    Args:
        position: shape (N, 3), [m].
        R: R_base_flange, shape (N, 3, 3).

    Returns:
        shape (N, 6), [m] and [rad], in the order of `calib.robot.flange.JOINTS`; NaN where the pose is.
    """
    roll_pitch_yaw = find_convention("rpy").numbers(R)
    return np.hstack([position, roll_pitch_yaw[:, ::-1]])


def _pose_columns(table: Table, options: ColumnOptions) -> Mapping[str, Column]:
    """Return the columns of the flange's pose by the names that they have after the prefix, or without one.

    Names without the prefix count only in a table of corners in pictures that has none with it.
    """
    named, _ = name_columns(table, (), options)
    prefixed = {
        name[len(PREFIX) :]: column
        for name, column in named.items()
        if name.casefold().startswith(PREFIX)
    }
    if not prefixed and not all(name in named for name in _OF_CORNERS):
        return {}
    in_any_case = {**IN_ANY_CASE, **{name: name for name in POINT}}
    for convention in options.conventions:
        in_any_case |= {name.casefold(): name for name in convention.columns}
    source = prefixed or named
    return {in_any_case.get(name.casefold(), name): column for name, column in source.items()}
