"""One robot of a fleet: its inputs, read when its turn has come, and its calibration as a job for any worker.

A job and its result can be pickled, and the worker writes nothing: workers on other machines need no shared disk.
"""

from __future__ import annotations

import hashlib
import json
import re
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path

import numpy as np

import calib.basics.plugins as plugins
from calib.basics.tables import Table
from calib.data.cell import Cell
from calib.data.columns import column_names
from calib.data.forms.column_options import ColumnsInput, column_options
from calib.data.inputs import CellInput, RobotInput, TableInput, inputs_of
from calib.data.measurements import Measurements
from calib.errors import CalibError
from calib.result.calibrate import calibrate
from calib.robot.robot import Robot
from calib.robot.urdf import Urdf
from calib.verbs.calibrate.report import write_report
from calib.verbs.fleet.fleet_row import FAILED, WITHHELD, FleetRow
from calib.verbs.fleet.robot_folder import SCHEMA, URDF
from calib.version import __version__

#: Pattern of the names that a robot, and so its folder, may have.
_NAME = re.compile(r"[^\W_](?:[\w .+-]{0,98}[\w+-])?")

#: Inputs of one robot: the nominal robot, its measurements, its cell.
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
            cell: Its cell; None: the default `Cell`.
            columns: Names and units of the table's columns, see `Measurements.read`; None: nothing.
            points: List of measured points; None: the table has the positions.
            points_unit: Unit of that list, ``"mm"``; None: the list names it.
        """
        given_cell = cell or Cell()
        options = column_options(columns)

        def load(read_robot: UrdfReader) -> FleetInputs:
            """Read the table, the URDF, and the measurements of the chain's joints."""
            table = Table.read(data)
            urdf = read_robot(str(robot))
            nominal = Robot.from_urdf(
                urdf,
                given_cell.base,
                given_cell.tip,
                column_names(table, options),
                given_cell.held,
                given_cell.coupling,
            )
            measurements = Measurements.read(
                table,
                nominal.joint_names,
                nominal.joint_types,
                options,
                given_cell.kind,
                points,
                points_unit,
            )
            return nominal, measurements, given_cell

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
            cell: Its cell, or the path of a cell file; None: the default `Cell`.
        """

        def load(read_robot: UrdfReader) -> FleetInputs:
            """Return the inputs; those that are named by a path are read."""
            return inputs_of(robot, table, cell, read=read_robot)

        return cls(name, load)


def check_names(names: Iterable[tuple[str, str]]) -> None:
    """Check that names of robots can be those of folders, and that no two are equal apart from capitals.

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


@dataclass(frozen=True, slots=True)
class FleetOptions:
    """Options that hold for all robots of a fleet."""

    #: As of `calibrate`
    solver: str = "lm"
    #: As of `calibrate`
    robust: bool = True
    #: As of `calibrate`
    validate: bool = True
    #: Whether each robot gets a report, which takes longer than the fit
    reports: bool = True
    #: Whether the corrected URDFs get a link at the target
    target_link: bool = False
    #: Whether URDFs are also written if the verdict is ``do not use``
    accept: bool = False
    #: The command that made the reports, to be shown in them
    command: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class FleetJob:
    """One robot to calibrate."""

    #: The robot's name
    name: str
    #: The nominal robot
    robot: Robot
    #: Its measured rows
    measurements: Measurements
    #: Its cell
    cell: Cell

    def fingerprint(self, options: FleetOptions) -> str:
        """Return the fingerprint of all that the robot's files depend on, the plugins that are loaded among them.

        Two options are left aside: the command, and ``accept``, which changes only the files of robots whose verdict is
        ``do not use``.

        Args:
            options: The options of the fleet.

        Returns:
            64 hexadecimal digits.
        """
        # By every field, the source's name too, which does not count when measurements are compared.
        names = [f.name for f in fields(Measurements)]
        rows = {name: getattr(self.measurements, name) for name in names}
        urdf_source = self.robot.urdf.source
        inputs = (self.name, self.robot, urdf_source, rows, self.cell)
        relevant = replace(options, command="", accept=False)
        contents = [plugin.sha256 for plugin in plugins.loaded()]
        return fingerprint(*inputs, relevant, contents, __version__, SCHEMA)


def fingerprint(*values: object) -> str:
    """Return the SHA-256 of values: of dataclasses by the fields that count in a comparison, of arrays by every bit.

    Args:
        values: Values that JSON has, arrays, paths, bytes, mappings, and dataclasses of these.

    Returns:
        64 hexadecimal digits.

    Raises:
        TypeError: A value is of another type.

    Example:
        >>> fingerprint("a", 1.0) == fingerprint("a", 1.0)
        True
        >>> fingerprint("a", 1.0) == fingerprint("a1.0")
        False
    """
    text = json.dumps(values, default=_parts)
    return hashlib.sha256(text.encode()).hexdigest()


def _parts(value: object) -> object:
    """Return a value that JSON does not have as its type's name and the values it consists of, or raise `TypeError`."""
    kind = type(value).__name__
    if is_dataclass(value) and not isinstance(value, type):
        compared = [f.name for f in fields(value) if f.compare]
        return [kind, *((name, getattr(value, name)) for name in compared)]
    if isinstance(value, (np.ndarray, np.generic)):
        return [kind, value.dtype.str, value.shape, value.tobytes().hex()]
    if isinstance(value, Mapping):
        return [kind, *value.items()]
    if isinstance(value, (bytes, Path)):
        return [kind, str(value)]
    raise TypeError(f"a value of type {kind} has no fingerprint")


def calibrate_job(options: FleetOptions, job: FleetJob) -> tuple[FleetRow, dict[str, bytes]]:
    """Calibrate one robot; an error becomes a failed row, so that the other robots are finished.

    Args:
        options: The options of the fleet.
        job: The robot and its data.

    Returns:
        The row, and the content of each file by its name; there are none if the robot failed.
    """
    try:
        calibration = calibrate(
            job.robot,
            job.measurements,
            cell=job.cell,
            solver=options.solver,
            robust=options.robust,
            validate=options.validate,
        )
        row = FleetRow.of(job.name, calibration, accept=options.accept)
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            if row.urdf != WITHHELD:
                calibration.write_urdf(folder / URDF, target_link=options.target_link, accept=True)
            calibration.write_json(folder / "result.json")
            summary = f"{calibration.summary()}\n"
            content = summary.encode("utf-8", "backslashreplace")
            (folder / "summary.txt").write_bytes(content)
            if options.reports:
                command = ""
                if options.command:
                    command = f"{options.command}  # {row.name}"
                write_report(calibration, folder / "report.html", command=command)
            files = {file.name: file.read_bytes() for file in folder.iterdir()}
        hashes = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
        row = replace(row, urdf_sha256=hashes.get(URDF, ""), result_sha256=hashes["result.json"])
    except Exception as error:  # noqa: BLE001  a fault with one robot must not cost the others
        return failed_row(job.name, error), {}
    return row, files


def failed_row(name: str, error: Exception) -> FleetRow:
    """Return the row of a robot without a result.

    Args:
        name: The robot's name.
        error: The reason; any other than a `CalibError` is a fault of calib, and is called so.

    Returns:
        The row, with the message.
    """
    message = str(error)
    if not isinstance(error, CalibError):
        kind = type(error).__name__
        message = f"internal error: {kind}: {error}. Please report it with this robot's files."
    return FleetRow(name, FAILED, message)
