"""One robot of a fleet: its name, which is that of its folder, and the function that reads its inputs."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from calib.basics.tables import Table
from calib.data.cell import Cell
from calib.data.columns import column_names
from calib.data.forms.column_options import ColumnsInput, column_options
from calib.data.inputs import CellInput, RobotInput, TableInput, inputs_of
from calib.data.measurements import Measurements
from calib.errors import CalibError
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf

#: Pattern of the names that a robot, and so its folder, may have.
_NAME = re.compile(r"[^\W_](?:[\w .+-]{0,98}[\w+-])?")

#: Inputs of one robot: the nominal robot, its measurements, its measurement setup.
FleetInputs = tuple[Robot, Measurements, Cell]

#: Function that returns the URDF of a file (URDF or xacro) or of a robot's name such as ``"ur3"``.
UrdfReader = Callable[[str], Urdf]


@dataclass(frozen=True, slots=True, eq=False)
class FleetRobot:
    """One robot of a fleet, whose inputs are read when its turn has come."""

    #: Unique in the fleet; the name of its folder
    name: str
    #: Reads the robot's inputs. Its argument reads URDFs and keeps the last ones, which many robots may share
    load: Callable[[UrdfReader], FleetInputs]

    @classmethod
    def of_files(
        cls,
        name: str,
        robot: str | Path,
        data: str | Path,
        cell: Cell | None = None,
        *,
        columns: ColumnsInput = None,
        points: str | Path | None = None,
        points_unit: str | None = None,
    ) -> FleetRobot:
        """Return a robot that is read from files; nothing is read yet.

        Args:
            name: Unique name of the robot and its folder.
            robot: URDF or xacro, or a name of example-robot-data such as ``"ur3"``.
            data: Table of measurements.
            cell: Measurement setup; None: the default `Cell`.
            columns: What is said of the table's columns, see `Measurements.read`; None: nothing.
            points: List of measured points; None: the table has the positions.
            points_unit: Unit of that list, ``"mm"``; None: the list names it.

        Returns:
            The robot.
        """
        setup = cell or Cell()
        options = column_options(columns)

        def load(read_robot: UrdfReader) -> FleetInputs:
            """Read the table, the URDF, and the measurements of the chain's joints."""
            table = Table.read(data)
            urdf = read_robot(str(robot))
            measured = column_names(table, options)
            nominal = Robot.from_urdf(
                urdf, setup.base, setup.tip, measured, setup.held, setup.coupling
            )
            measurements = Measurements.read(
                table,
                nominal.joint_names,
                nominal.joint_types,
                options,
                setup.kind,
                points,
                points_unit,
            )
            return nominal, measurements, setup

        return cls(name, load)

    @classmethod
    def of_values(
        cls, name: str, robot: RobotInput, table: TableInput, cell: CellInput = None
    ) -> FleetRobot:
        """Return a robot of values, or of the paths and names that they are read from when its turn has come.

        Args:
            name: Unique name of the robot and its folder.
            robot: The nominal robot, the path of its URDF or xacro, or its name such as ``"ur3"``.
            table: Its measurements, or the path of their table.
            cell: Its measurement setup, or the path of a cell file; None: the default `Cell`.
        """
        return cls(name, partial(_inputs, robot, table, cell))


def _inputs(
    robot: RobotInput, table: TableInput, cell: CellInput, read_robot: UrdfReader
) -> FleetInputs:
    """Return the inputs of a robot; what is named by a path is read."""
    return inputs_of(robot, table, cell, read=read_robot)


def check_names(names: Iterable[tuple[str, str]]) -> None:
    """Check that names of robots can be those of folders, and that no two are equal but for capitals.

    Args:
        names: Each name, and its place for the message (``"Robot 1"``, ``"fleet.csv, line 2"``).

    Raises:
        CalibError: A name is not allowed, or was there before.
    """
    earlier = set()
    for name, place in names:
        if not _NAME.fullmatch(name) or name.casefold() in earlier:
            raise CalibError(
                f"{place}: {name!r} cannot be the name of a robot's folder. A name has 1 to 100 letters, digits, and "
                "'_', '-', '+', '.' or blanks between them, and is no other robot's, capitals aside."
            )
        earlier.add(name.casefold())
