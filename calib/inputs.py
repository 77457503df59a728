"""Robots, tables and cells as users give them: the value itself, or the path or the name that it is read from.

Where a path or a name stands in for a value, it is read as the command line reads it: base, tip and held joints are the
cell's; a tip that the cell does not name is the end of the longest chain whose joints all have values in the table.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import TypeAlias

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.data.table import Table
from calib.errors import CalibError
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf, read_urdf
from calib.values.arguments import check_type

#: A robot; or the path of its URDF or xacro; or its name in example-robot-data, such as ``"ur3"``.
RobotInput: TypeAlias = Robot | str | Path

#: Measurements, or the path of their table.
TableInput: TypeAlias = Measurements | str | Path

#: A cell, or the path of its file; None: the default cell.
CellInput: TypeAlias = Cell | str | Path | None

#: What messages call these.
ROBOT = "a Robot, the path of a URDF or xacro, or a name such as 'ur3'"
TABLE = "Measurements, or the path of a table"
CELL = "a Cell, the path of a cell file, or None"

#: Endings of tables: one of these in the place of a robot is a mistake.
_TABLES = (".csv", ".txt", ".tsv")


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


def robot_of(
    robot: RobotInput,
    cell: Cell | None = None,
    *,
    measured: Collection[str] | None = None,
    argument: str = "robot",
    read: Callable[[str], Urdf] = read_urdf,
) -> Robot:
    """Return a robot: as given, or read from its file or by its name.

    Args:
        robot: As a user gave it.
        cell: Names base, tip and held joints of one that is read; None: the URDF's root and its farthest link.
        measured: Names of the joints whose values are known, which decide a tip that the cell does not name.
        argument: Its name, for messages.
        read: Reads the URDF of a path or a name.

    Raises:
        ArgumentError: It is none of these.
        CalibError: It is the path of a table, or a file that cannot be read.
        UrdfError: No such robot, link or joint, or a chain that calib cannot take.
    """
    _check_robot(robot, argument)
    if isinstance(robot, Robot):
        return robot
    cell = cell or Cell()
    return Robot.from_urdf(read(str(robot)), cell.base, cell.tip, measured, cell.held)


def inputs_of(
    robot: RobotInput,
    table: TableInput,
    cell: CellInput = None,
    *,
    read: Callable[[str], Urdf] = read_urdf,
) -> tuple[Robot, Measurements, Cell]:
    """Return robot, measurements and cell that belong together: as given, or read from their files.

    Args:
        robot: As a user gave it.
        table: Measurements, or the path of their table, whose joint columns are those of the robot's chain.
        cell: As a user gave it.
        read: Reads the URDF of a path or a name.

    Raises:
        ArgumentError: One of them has a wrong type.
        CalibError: A file cannot be read; the class is the reader's.
    """
    setup = cell_of(cell)
    _check_robot(robot, "robot")
    check_type("measurements", table, (Measurements, str, Path), TABLE)
    if isinstance(table, Measurements):
        return robot_of(robot, setup, measured=table.joint_names, read=read), table, setup
    read_table = Table.read(table)
    arm = robot_of(robot, setup, measured=read_table.names(), read=read)
    measurements = Measurements.read(read_table, arm.joint_names, arm.joint_types, kind=setup.kind)
    return arm, measurements, setup


def _check_robot(robot: object, argument: str) -> None:
    """Refuse what is no robot, and the path of a table in its place."""
    check_type(argument, robot, (Robot, str, Path), ROBOT)
    if isinstance(robot, (str, Path)) and Path(robot).suffix.lower() in _TABLES:
        raise CalibError(
            f"The argument '{argument}' is '{robot}', a table; it must be {ROBOT}. The robot comes before the table."
        )
