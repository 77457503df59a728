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
from calib.data.table import Column, Table
from calib.data.values import read_values
from calib.errors import MeasurementError, choices
from calib.robot.robot import Robot
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
        path: The table.
        robot: The nominal robot.
        columns: Names that calib uses, by the table's names; None: they are the same.
        match: See `Program`.
        start: See `Program`.

    Returns:
        The program.

    Raises:
        MeasurementError: The table cannot be read; the text names file, row and column.
    """
    table = Table.read(path)
    named, _ = name_columns(table, robot.joint_names, columns or {})
    if any(name.startswith(CORRECTION) for name in named):
        raise MeasurementError(
            f"{table.source}: these are commands of calib compensate, corrected already. Give the "
            "program itself."
        )
    filled = {i for row in table.cells for i, cell in enumerate(row) if cell}
    header = _Header(table, robot.joint_names, named, filled)
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

    table: Table
    joint_names: Sequence[str]
    #: Columns by the names that calib uses
    named: Mapping[str, Column]
    #: Columns, from 0, in which any cell is filled in
    filled: set[int]

    def block(self, names: Sequence[str]) -> tuple[Column, ...]:
        """Return the columns of these names, all or none; none if no cell is filled in, as in a plan of poses.

        Raises:
            MeasurementError: Some of them are missing.
        """
        of_joints = names is self.joint_names
        columns = [
            self.named[name]
            for name in names
            if name in self.named and (of_joints or name not in self.joint_names)
        ]
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

    joints: tuple[Column, ...]
    points: tuple[Column, ...]
    orientation: tuple[Column, ...]


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
    orientation = tuple(header.named[name] for name in forms[0]) if forms and points else ()
    return _Blocks(joints, points, orientation)


def _labels(header: _Header) -> tuple[str, ...]:
    """Return what messages call each row: by the column ``row`` if it numbers them, else by their order."""
    table = header.table
    labels = table.column(header.named["row"]) if "row" in header.named else []
    if len(set(labels)) < len(table.cells) or "" in labels:
        labels = [str(i + 1) for i in range(len(table.cells))]
    return tuple(f"row {label}" for label in labels)


def _kept(header: _Header) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return header and cells of the columns that have no meaning here."""
    table, joint_names = header.table, header.joint_names
    of_poses = {name for form in (POINT, *FORMS) for name in form if name not in joint_names}
    known = of_poses | {*joint_names, EXPECTED, STATUS}
    kept = {column.index for name, column in header.named.items() if name not in known}
    # A column without a name is kept if anything is in it: separators at the end of each line are none.
    kept |= {i for i, label in enumerate(table.header) if not label and i in header.filled}
    return tuple((table.header[i], tuple(row[i] for row in table.cells)) for i in sorted(kept))


def _numbers(table: Table, robot: Robot, blocks: _Blocks) -> tuple[Array | None, Array | None]:
    """Read joint values (N, m) [rad] or [m], and poses (N, 4, 4) [m]; None for what there is not.

    Roll, pitch and yaw are read as joint values are.
    """
    form = tuple(column.name for column in blocks.orientation)
    by_angles = form == ROLL_PITCH_YAW
    joints = _joint_columns(table, robot, blocks.joints)
    orientation = _orientation_columns(table, blocks.orientation, form)
    columns: dict[str, tuple[Column, ...]] = {
        "joints": (*joints, *(orientation if by_angles else ())),
        "points": tuple(with_unit(table, column, "length") for column in blocks.points),
        "orientation": () if by_angles else orientation,
    }
    kind = "fixed"
    if blocks.points:
        kind = "pose" if columns["orientation"] else "point"
    values = Measurements(**read_values(table, Layout({}, (), columns, (kind,))))
    if values.unmeasured:
        raise MeasurementError(
            f"{table.source}, row {values.unmeasured[0]}: there is no position, all its cells are "
            "empty, while other rows have one. Fill it in, or remove the row."
        )
    q = values.joints[:, : len(joints)] if joints else None
    if not blocks.points:
        return q, None
    poses = poses_at(values.points)
    if by_angles:
        angles = values.joints[:, len(joints) :]
        poses[:, :3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
    elif values.rotations is not None:
        poses[:, :3, :3] = values.rotations
    return q, poses


def _joint_columns(table: Table, robot: Robot, columns: tuple[Column, ...]) -> tuple[Column, ...]:
    """Return the joints' columns, whose units fit the joints; raises `MeasurementError`."""
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
    """Return the columns of orientations, with units of angles unless they are quaternions."""
    if form == QUATERNION:
        return tuple(with_unit(table, column, None, FORMS[form]) for column in columns)
    common = "deg" if form == ROLL_PITCH_YAW else "rad"
    return tuple(with_unit(table, column, "angle", FORMS[form], common) for column in columns)
