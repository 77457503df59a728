"""A program as a file: a table of joint values, of poses, or of both.

It is read as a table of measurements is (`calib.data.layout`). What is different: poses may also be given by roll,
pitch and yaw, nothing may be missing, and columns that have no meaning here are kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from scipy.spatial.transform import Rotation

from calib.compensation.program import CORRECTION, EXPECTED, Program, poses_at
from calib.data.columns import (
    POINT,
    QUATERNION,
    ROLL_PITCH_YAW,
    ROTATION_VECTOR,
    STATUS,
    list_columns,
    name_columns,
    with_unit,
)
from calib.data.layout import Layout
from calib.data.measurements import Measurements
from calib.data.values import read_values
from calib.errors import MeasurementError, choices
from calib.robot.robot import Robot
from calib.table import Column, Table
from calib.units import Array, Quantity

#: Forms of an orientation; roll, pitch and yaw are about fixed axes: Rz(yaw) Ry(pitch) Rx(roll).
FORMS = {
    ROTATION_VECTOR: "rotation vector",
    QUATERNION: "quaternion",
    ROLL_PITCH_YAW: "roll, pitch, yaw",
}


def read_program(
    path: str | Path,
    robot: Robot,
    *,
    columns: Mapping[str, str] | None = None,
    match: str | None = None,
    start: Mapping[str, float] | None = None,
) -> Program:
    """Read a table of joint values, of poses, or of both; see docs/compensation.md.

    Args:
        path: The table, a CSV file.
        robot: The nominal robot, whose joint names are looked for among the columns.
        columns: Names that calib uses, by the table's names; None: they are the same.
        match: What of the poses is to be reached, one of `calib.compensation.inverse.MATCHES`; None: see `Program`.
        start: Joint values by name [rad] or [m] near which the first of poses alone is solved; None: mid range.

    Returns:
        The program: its rows, and the columns of the table that have no meaning here.

    Raises:
        MeasurementError: The table cannot be read; the text names file, row and column.
    """
    table = Table.read(path)
    header = _read_header(table, robot.joint_names, columns or {})
    blocks = _blocks(header)
    q, T_wanted = _numbers(table, robot, blocks)
    form = tuple(column.name for column in blocks.orientation)
    return Program(
        labels=_labels(header),
        q=q,
        T_wanted=T_wanted,
        oriented=bool(form) or not blocks.points,
        match=match,
        start=start,
        kept=_kept(header),
        form=FORMS.get(form, ""),
    )


@dataclass(frozen=True, slots=True)
class _Header:
    """Columns of a table."""

    #: The table.
    table: Table
    #: Names of the measured joints.
    joint_names: Sequence[str]
    #: Columns by the names that calib uses.
    named: Mapping[str, Column]
    #: Columns, from 0, in which any cell is filled in.
    filled: set[int]

    def block(self, names: Sequence[str]) -> tuple[Column, ...]:
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


class _Blocks(NamedTuple):
    """Columns of a program's numbers; empty where there are none."""

    #: Joint values, in the order of the joints.
    joints: tuple[Column, ...]
    #: x, y and z.
    points: tuple[Column, ...]
    #: Of one of `FORMS`.
    orientation: tuple[Column, ...]


def _read_header(table: Table, joint_names: Sequence[str], columns: Mapping[str, str]) -> _Header:
    """Find out which column is what, and which are filled in.

    Args:
        table: The table of the program.
        joint_names: Of the measured joints.
        columns: Names that calib uses, by the table's names, where they differ.

    Raises:
        MeasurementError: The table is one of commands, not of a program.
    """
    named, _ = name_columns(table, joint_names, columns)
    if any(name.startswith(CORRECTION) for name in named):
        raise MeasurementError(
            f"{table.source}: these are commands of calib compensate, corrected already. Give the "
            "program itself."
        )
    filled: set[int] = set()
    for row in table.cells:
        filled.update(i for i, cell in enumerate(row) if cell)
    return _Header(table, joint_names, named, filled)


def _blocks(header: _Header) -> _Blocks:
    """Find the columns of joint values, positions and orientations; raises `MeasurementError`."""
    joints = header.block(header.joint_names)
    points = header.block(POINT)
    forms = [form for form in FORMS if header.block(form)]
    source = header.table.source
    if not (joints or points):
        raise MeasurementError(
            f"{source}: there are no joint values and no positions, or all their cells are empty. "
            f"{list_columns(header.table)} A program has '{header.joint_names[0]} [deg]' and so "
            "on, or 'x [mm]', 'y [mm]', 'z [mm]'."
        )
    if len(forms) > 1:
        names = " and as ".join(FORMS[form] for form in forms)
        raise MeasurementError(
            f"{source}: the orientation is there twice, as {names}. Leave one out: --columns "
            f'"{forms[1][0]}=-" and so on.'
        )
    orientation: tuple[Column, ...] = ()
    if forms and points:
        orientation = tuple(header.named[name] for name in forms[0])
    return _Blocks(joints, points, orientation)


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
    of_poses = {name for form in (POINT, *FORMS) for name in form}
    known = of_poses | {*header.joint_names, EXPECTED, STATUS}
    kept = {column.index for name, column in header.named.items() if name not in known}
    # A column without a name is kept if anything is in it: separators at the end of each line are none.
    kept |= {i for i, label in enumerate(table.header) if not label and i in header.filled}
    columns = []
    for i in sorted(kept):
        cells = tuple(row[i] for row in table.cells)
        columns.append((table.header[i], cells))
    return tuple(columns)


def _numbers(table: Table, robot: Robot, blocks: _Blocks) -> tuple[Array | None, Array | None]:
    """Read joint values and poses.

    Roll, pitch and yaw are read as joint values are.

    Args:
        table: The table of the program, N rows.
        robot: The nominal robot, whose joint types say which units fit.
        blocks: The columns of the numbers.

    Returns:
        Joint values, shape (N, m), [rad] or [m], and poses, shape (N, 4, 4), [m], with the identity for orientations
        that are not given; None for what there is not.

    Raises:
        MeasurementError: A number or unit that does not fit, or a row without a position.
    """
    form = tuple(column.name for column in blocks.orientation)
    joints = _joint_columns(table, robot, blocks.joints)
    orientation = _orientation_columns(table, blocks.orientation, form)
    angles: tuple[Column, ...] = ()
    if form == ROLL_PITCH_YAW:
        angles, orientation = orientation, ()
    points = tuple(with_unit(table, column, "length") for column in blocks.points)
    columns = {"joints": (*joints, *angles), "points": points, "orientation": orientation}
    values = Measurements(**read_values(table, Layout({}, (), columns, (_kind(columns),))))
    if values.unmeasured:
        raise MeasurementError(
            f"{table.source}, row {values.unmeasured[0]}: there is no position, all its cells are "
            "empty, while other rows have one. Fill it in, or remove the row."
        )
    q = values.joints[:, : len(joints)] if joints else None
    if not points:
        return q, None
    poses = poses_at(values.points)
    if angles:
        roll_pitch_yaw = values.joints[:, len(joints) :]
        poses[:, :3, :3] = Rotation.from_euler("xyz", roll_pitch_yaw).as_matrix()
    elif values.rotations is not None:
        poses[:, :3, :3] = values.rotations
    return q, poses


def _kind(columns: Mapping[str, tuple[Column, ...]]) -> str:
    """Return the kind of measurement, of `calib.data.kinds`, whose columns a program's poses have.

    Args:
        columns: Those of ``"points"`` and ``"orientation"``; empty where there are none.
    """
    if not columns["points"]:
        return "fixed"
    return "pose" if columns["orientation"] else "point"


def _joint_columns(table: Table, robot: Robot, columns: tuple[Column, ...]) -> tuple[Column, ...]:
    """Return the joints' columns with their units; raises `MeasurementError` for one that does not fit its joint.

    Args:
        table: Their table.
        robot: The nominal robot, whose joint types say which units fit.
        columns: Of joint values, by the joints' names.
    """
    with_units = []
    for column in columns:
        joint_type = robot.joint_types[column.name]
        quantity: Quantity = "length" if joint_type == "prismatic" else "angle"
        what = f"{joint_type} joint '{column.name}'"
        with_units.append(with_unit(table, column, quantity, what))
    return tuple(with_units)


def _orientation_columns(
    table: Table, columns: tuple[Column, ...], form: tuple[str, ...]
) -> tuple[Column, ...]:
    """Return the columns of orientations, with units of angles unless they are quaternions.

    Args:
        table: Their table.
        columns: Of one form; empty where there is no orientation.
        form: Their names, of `FORMS`; empty where there is no orientation.

    Raises:
        MeasurementError: A column has no unit, or one that does not fit.
    """
    if form == QUATERNION:
        return tuple(with_unit(table, column, None, FORMS[form]) for column in columns)
    common = "deg" if form == ROLL_PITCH_YAW else "rad"
    return tuple(with_unit(table, column, "angle", FORMS[form], common) for column in columns)
