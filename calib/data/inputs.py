"""Robots, tables and cells as users give them: the value itself, or the path or the name that it is read from.

Where a path or a name stands in for a value, it is read as the command line reads it: base, tip, held joints and
coupled readings are the cell's; a tip that the cell does not name is the end of the longest chain whose joints all have
values in the table. For plans and inspections without measurements there are a table of poses and a generic target and
anchor.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

import calib.data.kinds as registry
from calib.basics.arguments import check_names, check_type
from calib.basics.arrays import Array
from calib.basics.frames import Frame, is_frame, table_of_frame
from calib.basics.records import changes
from calib.basics.tables import Table
from calib.data.cell import Cell
from calib.data.cell_chains import Sight, check_links_named, robot_of_cell, sights_of
from calib.data.columns import column_names
from calib.data.measurements import Measurements
from calib.data.whole_turns import brought_back
from calib.errors import ArgumentError, CalibError, ModelError, choices
from calib.robot.dh_file import is_other_table
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf, read_urdf

#: A robot; or the path of its URDF, xacro, MJCF or DH rows; or its name in example-robot-data, such as ``"ur3"``.
RobotInput: TypeAlias = Robot | str | Path

#: Measurements; or the path of their table; or their table as a frame of pandas or polars or a dict of columns.
TableInput: TypeAlias = Measurements | Frame | str | Path

#: A cell, or the path of its file; None: the default cell.
CellInput: TypeAlias = Cell | str | Path | None

#: Descriptions of the three, for messages.
ROBOT = "a Robot, the path of a URDF, a xacro, an MJCF or DH rows, or a name such as 'ur3'"
TABLE = "Measurements, the path of a table, or a frame or dict of its columns"
CELL = "a Cell, the path of a cell file, or None"


def cell_of(cell: CellInput, argument: str = "cell") -> Cell:
    """Return a cell: as given, read from its file, or the default one for None.

    Args:
        cell: As a user gave it.
        argument: Its name, for messages.

    Raises:
        ArgumentError: It is none of these.
        CalibError: The file cannot be read.
    """
    check_type(argument, cell, (Cell, str, Path, type(None)), CELL)
    if cell is None:
        return Cell()
    return cell if isinstance(cell, Cell) else Cell.read(cell)


def cell_with(cell: CellInput, robot: RobotInput, **given: str | Sequence[str] | None) -> Cell:
    """Return a cell with options over it, as the command line takes them over a cell file.

    Args:
        cell: As a user gave it.
        robot: As a user gave it; a `Robot` has a base and a tip of its own.
        **given: Texts by the names of options, such as ``frame="estimate"``; several of an option that can be
            repeated; None: not given.

    Raises:
        ArgumentError: A wrong type, or another base or tip than that of a `Robot`.
        CalibError: A text that the option does not take, or the file cannot be read.
    """
    stated = cell_of(cell)
    typed: dict[str, str | Sequence[str]] = {}
    for name, words in given.items():
        if words is None:
            continue
        if not isinstance(words, str):
            check_names(name, words)
        if isinstance(robot, Robot) and name in ("base", "tip") and words != getattr(robot, name):
            raise ArgumentError(
                f"The argument '{name}' is for a robot that is read from a file; the given Robot is from "
                f"'{robot.base}' to '{robot.tip}'. Leave it out, or give the robot's path."
            )
        typed[name] = words
    return replace(stated, **changes(stated, typed))


def robot_of(
    robot: RobotInput,
    cell: Cell | None = None,
    *,
    measured: Collection[str] | None = None,
    sights: Iterable[Sight] | None = None,
    argument: str = "robot",
    read: Callable[[str], Urdf] = read_urdf,
) -> Robot:
    """Return a robot: as given, or read from its file or by its name.

    Args:
        robot: As a user gave it.
        cell: Names base, tip, held joints and coupled readings of one that is read; None: the URDF's root and its
            farthest link.
        measured: Names of the joints whose values are known, which decide a tip that the cell does not name.
        sights: Stations and targets that occur together; None: all that the cell names.
        argument: Its name, for messages.
        read: Reads the URDF of a path or a name.

    Raises:
        ArgumentError: It is none of these.
        CalibError: It is the path of a table, or a file that cannot be read; or a robot was given, and the cell couples
            other readings than it does.
        UrdfError: No such robot, link or joint, or a chain that calib cannot take.
    """
    _check_robot(robot, argument)
    cell = cell or Cell()
    if isinstance(robot, Robot):
        if cell.coupling and cell.coupling != robot.reading_coupling:
            raise CalibError(
                f"The cell couples the readings of {choices(cell.coupling)} differently from the given robot. "
                "Give the robot's path instead of the Robot, or load it by Robot.load(..., coupling=cell.coupling)."
            )
        return robot
    urdf = read(str(robot))
    return robot_of_cell(urdf, cell, measured, sights)


def chain_of(robot: Robot) -> Cell:
    """Return the base, the tip, the held joints and the coupled readings of a robot, as a cell."""
    return Cell(base=robot.base, tip=robot.tip, held=robot.held, coupling=robot.reading_coupling)


def inputs_of(
    robot: RobotInput,
    table: TableInput,
    cell: CellInput = None,
    *,
    read: Callable[[str], Urdf] = read_urdf,
) -> tuple[Robot, Measurements, Cell]:
    """Return robot, measurements and cell that belong together: as given, or read from their files.

    Readings that are whole turns outside of the limits are brought back (`calib.data.whole_turns`).

    Args:
        robot: As a user gave it.
        table: Measurements, or the path of their table, whose joint columns are those of the robot's chain.
        cell: As a user gave it.
        read: Reads the URDF of a path or a name.

    Raises:
        ArgumentError: One of them has a wrong type.
        CalibError: A file cannot be read; the class is the reader's.
    """
    cell = cell_of(cell)
    _check_robot(robot, "robot")
    if not is_frame(table):
        check_type("measurements", table, (Measurements, str, Path), TABLE)
    if isinstance(table, Measurements):
        sights = tuple(dict.fromkeys(zip(table.groups, table.targets, strict=True)))
        if not isinstance(robot, Robot):
            check_links_named(cell, sights, table.source or "Measurements")
        arm = robot_of(robot, cell, measured=table.joint_names, sights=sights, read=read)
        return arm, brought_back(arm, table), cell
    read_table = Table.read(table) if isinstance(table, (str, Path)) else table_of_frame(table)
    names = column_names(read_table)
    sights = sights_of(read_table, kind=cell.kind)
    if not isinstance(robot, Robot):
        check_links_named(cell, sights, read_table.source)
    arm = robot_of(robot, cell, measured=names, sights=sights, read=read)
    measurements = Measurements.read(
        read_table,
        arm.joint_names,
        arm.joint_types,
        kind=cell.kind,
        needs_all_joints=not arm.branches,
    )
    return arm, brought_back(arm, measurements), cell


def _check_robot(robot: object, argument: str) -> None:
    """Refuse an argument that is not a robot or the path or name of one (ArgumentError), or is a table (CalibError).

    A table of DH rows is a robot. MeasurementError if the path is that of a table that cannot be read.
    """
    check_type(argument, robot, (Robot, str, Path), ROBOT)
    if isinstance(robot, (str, Path)) and is_other_table(robot):
        raise CalibError(
            f"The argument '{argument}' is the table '{robot}', which has no DH rows: it has no columns d and alpha. "
            f"It must be {ROBOT}. The robot comes before the table."
        )


# Without measurements

#: Place in the tip of a target that was not given: off every axis of the tip [m].
GENERIC_TARGET = (0.05, 0.07, 0.03)


#: Place in the base of an anchor that was not given: off the first axis, which its distances would not observe [m].
GENERIC_ANCHOR = (0.7, -0.5, 0.3)


def table_of_poses(robot: Robot, name: str, joints: Array) -> Measurements:
    """Make a table of rows of one kind at given joint values, with placeholders for the measured values.

    Args:
        robot: The nominal robot.
        name: Kind of the rows, such as ``"point"``.
        joints: Joint values, shape (N, m), [rad] or [m].

    Returns:
        A table of N rows of this kind.

    Raises:
        ModelError: A kind of pairs, or one that needs the target at a certain place, such as a socket.
    """
    kind = registry.get(name)
    if kind.paired or kind.measure is None:
        raise ModelError(f"Poses alone say nothing of kind '{name}'. Give a table of such rows.")
    T_frame_target = np.tile(np.eye(4), (len(joints), 1, 1))
    T_frame_target[:, :3, 3] = 1.0
    sliding = tuple(joint.name for joint in robot.inputs if joint.type == "prismatic")
    return Measurements(
        joint_names=robot.joint_names,
        joints=joints,
        kinds=(name,) * len(joints),
        **Measurements.columns_of(kind, kind.measure(T_frame_target)),
        prismatic=sliding,
    )
