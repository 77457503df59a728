"""Programs and their commands as tables: reads joint values, poses or both, and writes commands in the same columns.

A program is read as a table of measurements is (`calib.data.layout`), with two differences: no value may be missing,
and columns without a meaning here are kept for the commands. docs/compensation.md describes both tables.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from calib.basics.arrays import Array
from calib.basics.files import csv_bytes, write_atomically
from calib.basics.tables import Table
from calib.data.columns import (
    POINT,
    STATUS,
    Columns,
    Named,
    joint_with_unit,
    list_columns,
    name_columns,
    with_unit,
)
from calib.data.forms.column_options import (
    ColumnOptions,
    ColumnsInput,
    column_options,
    fix_for_brand,
)
from calib.data.forms.orientation_columns import conventions_of, in_units, is_complete
from calib.data.forms.orientations import (
    CONVENTIONS,
    ROTATION_VECTOR,
    Convention,
    find_convention,
)
from calib.data.layout import Layout
from calib.data.measurements import Measurements
from calib.data.values import read_values
from calib.errors import MeasurementError, choices
from calib.robot.robot import Robot
from calib.verbs.compensate.commands import Commands
from calib.verbs.compensate.robot_program import Program, poses_at

#: Prefix of the columns with corrections, by which a table of commands is told from a program.
_CORRECTION = "correction "

#: Column of the expected position error of each row.
_EXPECTED = "expected error"

#: By the unit of a column: its number in one SI unit, and decimals, for angles to 1e-11 rad and lengths to 1e-9 m.
_UNITS = {"deg": (math.degrees(1.0), 9), "rad": (1.0, 12), "mm": (1e3, 6), "": (1.0, 12)}


def read_program(
    path: str | Path,
    robot: Robot,
    *,
    columns: ColumnsInput = None,
    match: str | None = None,
    start: Mapping[str, float] | None = None,
) -> Program:
    """Read a table of joint values, of poses, or of both; see docs/compensation.md.

    Args:
        path: The table, a CSV file, or a sheet of an Excel file.
        robot: The nominal robot, whose joint names are looked for among the columns.
        columns: Names that calib uses by the table's names, or all that is said of the columns; its convention of
            orientations counts if the table has its columns. None: nothing is said.
        match: Part of the poses to be reached, one of `calib.verbs.compensate.inverse.MATCHES`; None: see `Program`.
        start: Joint values by name [rad] or [m] near which the first of poses alone is solved; None: mid range.

    Returns:
        The program: its rows, and the columns of the table that have no meaning here.

    Raises:
        MeasurementError: The table cannot be read; the text names file, row and column.
    """
    table = Table.read(path)
    options = column_options(columns)
    named = _name_columns(table, robot, options)
    joint_columns = _complete_columns(table, named, robot.joint_names)
    # A joint may have the name of a coordinate: then the column is the joint's.
    others = {name: column for name, column in named.items() if name not in robot.joint_names}
    point_columns = _complete_columns(table, others, POINT)
    conventions = _find_conventions(table, named, robot, options)
    if not (joint_columns or point_columns):
        raise MeasurementError(
            f"{table.source}: there are no joint values and no positions, or all their cells are empty. "
            f"{list_columns(table)} A program has '{robot.joint_names[0]} [deg]' and so on, or 'x [mm]', 'y [mm]', "
            "'z [mm]'."
        )
    if len(conventions) > 1:
        names = " and as ".join(convention.words for convention in conventions)
        raise MeasurementError(
            f"{table.source}: the orientation is there twice, as {names}. Leave one out: --columns "
            f'"{conventions[1].columns[0]}=-" and so on.'
        )

    # The numbers are read as those of measurements of the kind that has these columns.
    kind = "point" if point_columns else "fixed"
    orientation = None
    if conventions and point_columns:
        kind = "pose"
        orientation = in_units(table, named, conventions[0], options)
    in_joint_units = []
    for column in joint_columns:
        joint_type = robot.joint_types[column.name]
        in_joint_units.append(joint_with_unit(table, column, joint_type, options))
    blocks: dict[str, Columns] = {
        "joints": tuple(in_joint_units),
        "points": tuple(with_unit(table, column, "length") for column in point_columns),
        "orientation": () if orientation is None else orientation.columns,
    }
    layout = Layout({}, (), blocks, (kind,), orientation=orientation)
    rows = Measurements(**read_values(table, layout))
    if rows.unmeasured:
        raise MeasurementError(
            f"{table.source}, row {rows.unmeasured[0]}: there is no position, all its cells are "
            "empty, while other rows have one. Fill it in, or remove the row."
        )
    T_wanted: Array | None = None
    if point_columns:
        T_wanted = poses_at(rows.points)
        if rows.rotations is not None:
            T_wanted[:, :3, :3] = rows.rotations

    # Rows are called by the column `row` if it numbers them, else by their order.
    numbers = table.column(named["row"]) if "row" in named else []
    if len(set(numbers)) < len(table.cells) or "" in numbers:
        numbers = [str(i + 1) for i in range(len(table.cells))]
    return Program(
        labels=tuple(f"row {number}" for number in numbers),
        q=rows.joints if joint_columns else None,
        T_wanted=T_wanted,
        oriented=orientation is not None or not point_columns,
        match=match,
        start=start,
        kept=_kept_columns(table, named, robot),
        form=conventions[0].name if orientation is not None else "",
    )


def _name_columns(table: Table, robot: Robot, options: ColumnOptions) -> Named:
    """Return the table's columns by calib's names, as the options and the robot's joint names map them.

    A table of commands raises `MeasurementError`, and so does one whose joints are named as a brand does.
    """
    named, _ = name_columns(table, robot.joint_names, options)
    if any(name.startswith(_CORRECTION) for name in named):
        raise MeasurementError(
            f"{table.source}: these are commands of calib compensate, corrected already. Give the "
            "program itself."
        )
    of_brand = "" if options.brand else fix_for_brand(list(named))
    if of_brand and not any(name in named for name in robot.joint_names):
        raise MeasurementError(
            f"{table.source}: no column for the joints {choices(robot.joint_names)}. {list_columns(table)}{of_brand}"
        )
    return named


def _has_values(table: Table, index: int) -> bool:
    """Return whether any cell of a column, numbered from 0, is filled in."""
    return any(row[index] for row in table.cells)


def _complete_columns(table: Table, named: Named, names: Sequence[str]) -> Columns:
    """Return the columns of all names; () if none has a column, or all their cells are empty, as in an unmeasured plan.

    It raises `MeasurementError` if only some of the names have a column.
    """
    columns = [named[name] for name in names if name in named]
    if columns and len(columns) < len(names):
        missing = choices(name for name in names if name not in named)
        present = choices(column.name for column in columns)
        raise MeasurementError(
            f"{table.source}: {missing} missing beside {present}. "
            f'{list_columns(table)} Map another name with --columns "name in the '
            'table=name", hold a joint that does not move with --hold, or leave out what is '
            f'there with --columns "{columns[0].name}=-".'
        )
    has_values = any(_has_values(table, column.index) for column in columns)
    return tuple(columns) if has_values or not table.cells else ()


def _find_conventions(
    table: Table, named: Named, robot: Robot, options: ColumnOptions
) -> list[Convention]:
    """Return the conventions of orientations whose columns are all filled in.

    If only some columns of a convention are there, it raises `MeasurementError`.
    """
    others = {name: column for name, column in named.items() if name not in robot.joint_names}
    complete = conventions_of(table, named, robot.joint_names, options)
    taken = {name for convention in complete for name in convention.columns}
    for convention in CONVENTIONS.values():
        # A single letter that is not an angle means something else.
        there = [name for name in convention.columns if name in named and name not in taken]
        if any(len(name) > 1 or named[name].is_angle for name in there):
            _complete_columns(table, others, convention.columns)
    return [c for c in complete if _complete_columns(table, others, c.columns)]


def _kept_columns(
    table: Table, named: Named, robot: Robot
) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return header and cells of the columns that have no meaning in a program or its commands, in their order."""
    known = {*robot.joint_names, *POINT, _EXPECTED, STATUS}
    for convention in CONVENTIONS.values():
        if is_complete(convention, named, robot.joint_names):
            known.update(convention.columns)
    kept = {column.index for name, column in named.items() if name not in known}
    # A column without a name is kept if it has any content: separators at the ends of lines make empty ones.
    kept |= {i for i, label in enumerate(table.header) if not label and _has_values(table, i)}
    return tuple((table.header[i], tuple(row[i] for row in table.cells)) for i in sorted(kept))


def write_commands(
    commands: Commands,
    path: str | Path,
    *,
    send: Literal["both", "joints", "poses"] = "both",
    orientation: str | None = None,
    overwrite: bool = False,
) -> Path:
    """Write commands as a CSV table in deg and mm; docs/compensation.md describes it.

    First the other columns of the program, then joint values and poses to send, then the corrections, then with a
    result the expected position error, then ``ok``, or the codes of warnings, or the code of the reason why a row has
    no command and its cells are empty.

    Args:
        commands: The commands.
        path: The file.
        send: The forms to write: joint values, poses to send, or both.
        orientation: Convention of the orientations, one of `calib.data.forms.orientations.CONVENTIONS`; None: that of
            the program, or of one without orientations rotation vectors.
        overwrite: Whether an existing file is replaced.

    Returns:
        The file.

    Raises:
        FileError: The file exists and ``overwrite`` is False, or it cannot be written.
        MeasurementError: No such convention.
    """
    convention = find_convention(orientation or commands.program.form or ROTATION_VECTOR.name)
    robot, reached = commands.nominal, commands.reached
    joints = robot.joint_names
    joint_units = ["mm" if robot.joint_types[name] == "prismatic" else "deg" for name in joints]
    columns: list[Sequence[str]] = [(label, *cells) for label, cells in commands.program.kept]
    if send != "poses":
        columns += _number_columns(joints, joint_units, commands.q)
    if send != "joints":
        columns += _number_columns(POINT, ["mm"] * 3, commands.T_send[:, :3, 3])
        names = list(convention.columns)
        orientations = np.full((len(commands), len(names)), np.nan)
        orientations[reached] = convention.numbers(commands.T_send[reached, :3, :3])
        columns += _number_columns(names, [convention.unit] * len(names), orientations)
    if send != "poses":
        names = [_CORRECTION + name for name in joints]
        columns += _number_columns(names, joint_units, commands.joint_corrections)
    names = [f"{_CORRECTION}position", f"{_CORRECTION}angle"]
    columns += _number_columns(names, ["mm", "deg"], commands.pose_corrections)
    if commands.expected is not None:
        columns += _number_columns([_EXPECTED], ["mm"], commands.expected_errors[:, :1])
    status = []
    for reason, warnings in zip(commands.reasons, commands.warnings, strict=True):
        codes = "; ".join(dict.fromkeys(warning.code for warning in warnings))
        text = f"warning: {codes}" if codes else "ok"
        status.append(f"no command: {reason.code}" if reason else text)
    columns.append((STATUS, *status))
    rows = zip(*columns, strict=True)
    return write_atomically(path, csv_bytes(rows), overwrite=overwrite)


def _number_columns(
    names: Sequence[str], units: Sequence[str], values: Array
) -> Iterator[Sequence[str]]:
    """Yield header and cells, in the units named, of each column of values (N, columns) in SI units; NaN is empty."""
    for name, symbol, column in zip(names, units, values.T, strict=True):
        scale, digits = _UNITS[symbol]
        cells = []
        for value in (scale * column).tolist():
            # Adding 0.0 makes 0.0 of -0.0.
            text = "" if math.isnan(value) else f"{round(value, digits) + 0.0:.{digits}f}"
            cells.append(text)
        yield (f"{name} [{symbol}]" if symbol else name), *cells
