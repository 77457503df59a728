"""A program as a file: a table of joint values, of poses, or of both.

It is read as a table of measurements is (`calib.data.layout`). What is different: nothing may be missing, and columns
that have no meaning here are kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from calib.basics.arrays import Array
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
from calib.data.forms.brands import fix_for_brand
from calib.data.forms.column_options import ColumnOptions, ColumnsInput, column_options
from calib.data.forms.orientation_columns import Orientation, conventions_of, in_units, is_complete
from calib.data.forms.orientations import CONVENTIONS, Convention
from calib.data.layout import Layout
from calib.data.measurements import Measurements
from calib.data.values import read_values
from calib.errors import MeasurementError, choices
from calib.robot.robot import Robot
from calib.verbs.compensate.program import CORRECTION, EXPECTED, Program, poses_at


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
            orientations counts where the table has its columns. None: nothing is said.
        match: What of the poses is to be reached, one of `calib.verbs.compensate.inverse.MATCHES`; None: see `Program`.
        start: Joint values by name [rad] or [m] near which the first of poses alone is solved; None: mid range.

    Returns:
        The program: its rows, and the columns of the table that have no meaning here.

    Raises:
        MeasurementError: The table cannot be read; the text names file, row and column.
    """
    table = Table.read(path)
    header = _read_header(table, robot.joint_names, column_options(columns))
    blocks = _blocks(header)
    q, T_wanted = _numbers(header, robot, blocks)
    convention = blocks.convention
    return Program(
        labels=_labels(header),
        q=q,
        T_wanted=T_wanted,
        oriented=convention is not None or not blocks.points,
        match=match,
        start=start,
        kept=_kept(header),
        form="" if convention is None else convention.name,
    )


@dataclass(frozen=True, slots=True)
class _Header:
    """Columns of a table."""

    #: The table.
    table: Table
    #: Names of the measured joints.
    joint_names: Sequence[str]
    #: What is said of the columns besides.
    options: ColumnOptions
    #: Columns by the names that calib uses.
    named: Named
    #: Columns, from 0, in which any cell is filled in.
    filled: set[int]

    def block(self, names: Sequence[str]) -> Columns:
        """Return the table's columns of these names, all or none; none if no cell is filled in, as in a plan of poses.

        A joint may have the name of a coordinate: then the column is the joint's.

        Args:
            names: The names that calib uses; `joint_names` itself for the columns of joint values.

        Raises:
            MeasurementError: Some of them are missing.
        """
        available = set(self.named)
        if names is not self.joint_names:
            available -= set(self.joint_names)
        columns = [self.named[name] for name in names if name in available]
        if columns and len(columns) < len(names):
            missing = choices(name for name in names if name not in self.named)
            present = choices(column.name for column in columns)
            raise MeasurementError(
                f"{self.table.source}: {missing} missing beside {present}. "
                f'{list_columns(self.table)} Map another name with --columns "name in the '
                'table=name", hold a joint that does not move with --hold, or leave out what is '
                f'there with --columns "{columns[0].name}=-".'
            )
        has_values = {column.index for column in columns} & self.filled
        return tuple(columns) if has_values or not self.table.cells else ()

    def conventions(self) -> tuple[Convention, ...]:
        """Return the conventions of orientations that have their columns and are filled in.

        Raises:
            MeasurementError: Some columns of one are missing; a single letter that is no angle means something else.
        """
        complete = conventions_of(self.table, self.named, self.joint_names, self.options)
        taken = {name for row in complete for name in row.columns}
        for row in CONVENTIONS.values():
            there = [name for name in row.columns if name in self.named and name not in taken]
            if any(len(name) > 1 or self.named[name].is_angle for name in there):
                self.block(row.columns)
        return tuple(row for row in complete if self.block(row.columns))


class _Blocks(NamedTuple):
    """Columns of a program's numbers; empty where there are none."""

    #: Joint values, in the order of the joints.
    joints: Columns
    #: x, y and z.
    points: Columns
    #: That of the orientations; None without.
    convention: Convention | None


def _read_header(table: Table, joint_names: Sequence[str], options: ColumnOptions) -> _Header:
    """Find out which column is what, and which are filled in.

    Args:
        table: The table of the program.
        joint_names: Of the measured joints.
        options: What is said of the columns.

    Raises:
        MeasurementError: The table is one of commands, not of a program, or its joints have a brand's names.
    """
    named, _ = name_columns(table, joint_names, options)
    if any(name.startswith(CORRECTION) for name in named):
        raise MeasurementError(
            f"{table.source}: these are commands of calib compensate, corrected already. Give the "
            "program itself."
        )
    of_brand = "" if options.brand else fix_for_brand(list(named))
    if of_brand and not any(name in named for name in joint_names):
        raise MeasurementError(
            f"{table.source}: no column for the joints {choices(joint_names)}. {list_columns(table)}{of_brand}"
        )
    filled: set[int] = set()
    for row in table.cells:
        filled.update(i for i, cell in enumerate(row) if cell)
    return _Header(table, joint_names, options, named, filled)


def _blocks(header: _Header) -> _Blocks:
    """Find the columns of joint values, positions and orientations; raises `MeasurementError`."""
    joints = header.block(header.joint_names)
    points = header.block(POINT)
    conventions = header.conventions()
    source = header.table.source
    if not (joints or points):
        raise MeasurementError(
            f"{source}: there are no joint values and no positions, or all their cells are empty. "
            f"{list_columns(header.table)} A program has '{header.joint_names[0]} [deg]' and so "
            "on, or 'x [mm]', 'y [mm]', 'z [mm]'."
        )
    if len(conventions) > 1:
        names = " and as ".join(row.words for row in conventions)
        raise MeasurementError(
            f"{source}: the orientation is there twice, as {names}. Leave one out: --columns "
            f'"{conventions[1].columns[0]}=-" and so on.'
        )
    return _Blocks(joints, points, conventions[0] if conventions and points else None)


def _labels(header: _Header) -> tuple[str, ...]:
    """Return what messages call each row: by the column ``row`` if it numbers them, else by their order."""
    table = header.table
    labels = table.column(header.named["row"]) if "row" in header.named else []
    if len(set(labels)) < len(table.cells) or "" in labels:
        labels = [str(i + 1) for i in range(len(table.cells))]
    return tuple(f"row {label}" for label in labels)


def _kept(header: _Header) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return header and cells of the columns that have no meaning here, in the order of the table."""
    table = header.table
    known = _known_names(header)
    kept = {column.index for name, column in header.named.items() if name not in known}
    # A column without a name is kept if anything is in it: separators at the end of each line are none.
    kept |= {i for i, label in enumerate(table.header) if not label and i in header.filled}
    columns = []
    for i in sorted(kept):
        cells = tuple(row[i] for row in table.cells)
        columns.append((table.header[i], cells))
    return tuple(columns)


def _known_names(header: _Header) -> set[str]:
    """Return the names of columns that have a meaning: joints, positions, orientations, and those of commands."""
    known = {*header.joint_names, *POINT, EXPECTED, STATUS}
    for convention in CONVENTIONS.values():
        if is_complete(convention, header.named, header.joint_names):
            known.update(convention.columns)
    return known


def _numbers(header: _Header, robot: Robot, blocks: _Blocks) -> tuple[Array | None, Array | None]:
    """Read joint values and poses.

    Args:
        header: Table and columns of the program, N rows.
        robot: The nominal robot, whose joint types say which units fit.
        blocks: The columns of the numbers.

    Returns:
        Joint values, shape (N, m), [rad] or [m], and poses, shape (N, 4, 4), [m], with the identity for orientations
        that are not given; None for what there is not.

    Raises:
        MeasurementError: A number or unit that does not fit, or a row without a position.
    """
    table = header.table
    orientation: Orientation | None = None
    if blocks.convention is not None:
        orientation = in_units(table, header.named, blocks.convention, header.options)
    columns = {
        "joints": _joint_columns(header, robot, blocks.joints),
        "points": tuple(with_unit(table, column, "length") for column in blocks.points),
        "orientation": () if orientation is None else orientation.columns,
    }
    layout = Layout({}, (), columns, (_kind(columns),), orientation=orientation)
    values = Measurements(**read_values(table, layout))
    if values.unmeasured:
        raise MeasurementError(
            f"{table.source}, row {values.unmeasured[0]}: there is no position, all its cells are "
            "empty, while other rows have one. Fill it in, or remove the row."
        )
    q = values.joints if blocks.joints else None
    if not blocks.points:
        return q, None
    poses = poses_at(values.points)
    if values.rotations is not None:
        poses[:, :3, :3] = values.rotations
    return q, poses


def _kind(columns: Mapping[str, Columns]) -> str:
    """Return the kind of measurement, of `calib.data.kinds`, whose columns a program's poses have.

    Args:
        columns: Those of ``"points"`` and ``"orientation"``; empty where there are none.
    """
    if not columns["points"]:
        return "fixed"
    return "pose" if columns["orientation"] else "point"


def _joint_columns(header: _Header, robot: Robot, columns: Columns) -> Columns:
    """Return the joints' columns with their units; raises `MeasurementError` for one that does not fit its joint.

    Args:
        header: Table and what is said of its columns.
        robot: The nominal robot, whose joint types say which units fit.
        columns: Of joint values, by the joints' names.
    """
    with_units = []
    for column in columns:
        joint_type = robot.joint_types[column.name]
        with_units.append(joint_with_unit(header.table, column, joint_type, header.options))
    return tuple(with_units)
