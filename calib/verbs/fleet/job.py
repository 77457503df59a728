"""The calibration of one robot of a fleet as a job for any worker: from inputs to the contents of the robot's files.

A job and its result can be pickled, and the worker writes nothing: workers on other machines need no shared disk.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import calib.basics.plugins as plugins
from calib.basics.values import keep_read_only
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.errors import CalibError
from calib.result.calibrate import calibrate
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.verbs.calibrate.report import write_report
from calib.verbs.fleet.fingerprint import fingerprint
from calib.verbs.fleet.record import FAILED, WITHHELD, FleetRow
from calib.verbs.fleet.robot_folder import SCHEMA, URDF
from calib.version import __version__


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
    #: Whether URDFs are written also where the verdict is ``do not use``
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
    #: Its measurement setup
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
        # By every field, the source's name too, which no comparison of measurements counts.
        names = [f.name for f in fields(Measurements)]
        rows = {name: getattr(self.measurements, name) for name in names}
        urdf_source = self.robot.urdf.source
        inputs = (self.name, self.robot, urdf_source, rows, self.cell)
        relevant = replace(options, command="", accept=False)
        contents = [plugin.sha256 for plugin in plugins.loaded()]
        return fingerprint(*inputs, relevant, contents, __version__, SCHEMA)


@dataclass(frozen=True, slots=True, eq=False)
class FleetJobResult:
    """The result of one robot, not written yet."""

    #: Its row of the fleet's table; its status is `FAILED` if there is no result
    row: FleetRow
    #: Content of each file, by name; none if the robot failed
    files: Mapping[str, bytes] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Keep a read-only copy of the files."""
        keep_read_only(self, "files")


def calibrate_job(options: FleetOptions, job: FleetJob) -> FleetJobResult:
    """Calibrate one robot; an error becomes a failed row, so that the other robots are finished.

    Args:
        options: The options of the fleet.
        job: The robot and its data.

    Returns:
        The row, and the contents of the files.
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
        with tempfile.TemporaryDirectory() as folder:
            _write_files(calibration, row, options, Path(folder))
            files = {file.name: file.read_bytes() for file in Path(folder).iterdir()}
    except Exception as error:  # noqa: BLE001  a fault with one robot must not cost the others
        return FleetJobResult(failed_row(job.name, error))
    return FleetJobResult(row, files)


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


def _write_files(
    calibration: Calibration,
    row: FleetRow,
    options: FleetOptions,
    folder: Path,
) -> None:
    """Write a robot's files into a folder: result, summary, and by row and options the URDF and the report."""
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
