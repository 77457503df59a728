"""calibrate_one: one robot of a fleet, from what was read of it to the bytes of its files; a job for any executor.

The process that reads the inputs writes the files too: workers on other machines need no shared disk. Files say neither
how long the work took nor where it was done, so that the same inputs give the same bytes everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

from calib.errors import CalibError
from calib.identify.calibration import calibrate
from calib.identify.executors import versions
from calib.identify.fingerprint import fingerprint
from calib.identify.fleet_rows import FleetRow
from calib.identify.result import Calibration
from calib.identify.result_file import result_table
from calib.identify.result_urdf import checked_urdf
from calib.identify.summary import summary
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.measure.table import Table
from calib.model.json_file import json_bytes
from calib.model.robot import Robot
from calib.model.sources import read_urdf
from calib.model.urdf import Urdf
from calib.units import split_header

URDF, RESULT, SUMMARY, REPORT = "corrected.urdf", "result.json", "summary.txt", "report.html"


@dataclass(frozen=True, slots=True, eq=False)
class FleetInputs:
    """What was read of one robot.

    Attributes:
        robot: The nominal robot.
        measurements: Its rows.
        cell: Its set-up.
    """

    robot: Robot
    measurements: Measurements
    cell: Cell


@dataclass(frozen=True, slots=True, eq=False)
class FleetRobot:
    """One robot of a fleet, not read yet.

    Attributes:
        name: Unique; the name of its folder.
        load: Reads it, when its turn has come. Its argument reads a URDF, a xacro or a robot by its name, and keeps the
            last ones, which many robots may share.
    """

    name: str
    load: Callable[[Callable[[str], Urdf]], FleetInputs]

    @classmethod
    def of_files(
        cls,
        name: str,
        robot: str | Path,
        data: str | Path,
        cell: Cell | None = None,
        *,
        columns: Mapping[str, str] | None = None,
        points: str | Path | None = None,
        points_unit: str | None = None,
    ) -> FleetRobot:
        """A robot from its files.

        Args:
            name: Its name.
            robot: URDF or xacro file, or a name such as ``"ur3"``.
            data: Table of its measurements.
            cell: Its set-up, with base and tip.
            columns: New names of the table's columns, see `Measurements.read`.
            points: The measured points, where they stand in a list of their own.
            points_unit: The unit of that list, if it names none.
        """
        files = _Files(str(robot), Path(data), cell or Cell(), columns, points, points_unit)
        return cls(name, files.read)


@dataclass(frozen=True, slots=True, eq=False)
class _Files:
    """Where a robot's inputs are."""

    robot: str
    data: Path
    cell: Cell
    columns: Mapping[str, str] | None
    points: str | Path | None
    points_unit: str | None

    def read(self, urdf_of: Callable[[str], Urdf]) -> FleetInputs:
        """Read them.

        Raises:
            CalibError: A file cannot be read, or does not fit the other.
        """
        cell, renamed = self.cell, dict(self.columns or {})
        names = {split_header(label)[0] for label in Table.read(self.data).header}
        names |= {split_header(wanted)[0] for wanted in renamed.values()}
        urdf = urdf_of(self.robot)
        robot = Robot.from_urdf(urdf, cell.base, cell.tip, measured=names, held=cell.held)
        measurements = Measurements.read(
            self.data,
            joint_names=robot.joint_names,
            joint_types=robot.joint_types,
            columns=renamed,
            kind=cell.kind,
            points=self.points,
            points_unit=self.points_unit,
        )
        return FleetInputs(robot, measurements, cell)


@dataclass(frozen=True, slots=True)
class FleetOptions:
    """How all robots of a fleet are calibrated.

    Attributes:
        solver: As of `calibrate`.
        robust: As of `calibrate`.
        validate: As of `calibrate`.
        reports: Whether each gets a report, which takes longer than the fit.
        target_link: Whether the corrected URDFs get a link at the target.
        command: For the reports: the command that made them.
        date: For the reports: the date that they bear.
    """

    solver: str = "lm"
    robust: bool = True
    validate: bool = True
    reports: bool = True
    target_link: bool = False
    command: str = field(default="", compare=False)
    date: str = field(default="", compare=False)


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """What a robot's calibration came to.

    Attributes:
        row: Its row of the fleet's table.
        files: The bytes of its files by name.
    """

    row: FleetRow
    files: Mapping[str, bytes]

    def __reduce__(self) -> tuple[object, ...]:
        """To another process and back: a read-only mapping travels as a dict."""
        return _made, (self.row, dict(self.files))


def inputs_fingerprint(name: str, inputs: FleetInputs, options: FleetOptions) -> str:
    """What a robot's files hang on: its inputs, the options, and the versions of what computes.

    Whether there is a report makes no difference to the other files, and counts by its file: see `file_names`.
    """
    robot, options = inputs.robot, replace(options, reports=True)
    measured = {f: getattr(inputs.measurements, f) for f in Measurements.__dataclass_fields__}
    return fingerprint(
        name, robot, robot.urdf.source, measured, inputs.cell, options, versions(), _LAYOUT
    )


def file_names(options: FleetOptions) -> tuple[str, ...]:
    """The files that a robot gets."""
    return (URDF, RESULT, SUMMARY, *((REPORT,) if options.reports else ()))


#: Counted up when the files of a robot change.
_LAYOUT = 1


def calibrate_one(options: FleetOptions, job: tuple[str, FleetInputs]) -> Made | str:
    """Calibrate a robot; its files, or why there are none.

    Args:
        options: How.
        job: The robot's name, and what was read of it.
    """
    name, inputs = job
    try:
        result = calibrate(
            inputs.robot,
            inputs.measurements,
            cell=inputs.cell,
            solver=options.solver,
            robust=options.robust,
            validate=options.validate,
        )
        # How long it took is the only thing that differs from one time to the next.
        result = replace(result, seconds=math.nan)
        return Made(FleetRow.of(name, result), MappingProxyType(_files(result, options, name)))
    except CalibError as error:
        return str(error)
    except Exception as error:  # noqa: BLE001  a fault with one robot must not cost the others
        return fault(error)


def fault(error: Exception) -> str:
    """What is said of an error that is none of the inputs'."""
    return f"a fault of calib itself: {type(error).__name__}: {error}. Please report it with this robot's files."


def urdf_reader() -> Callable[[str], Urdf]:
    """`read_urdf` that keeps the last few, for robots that share one."""
    kept: dict[str, Urdf] = {}

    def read(source: str) -> Urdf:
        if source not in kept:
            while len(kept) >= _KEPT:
                del kept[next(iter(kept))]
            kept[source] = read_urdf(source)
        return kept[source]

    return read


#: URDFs that are kept.
_KEPT = 8


def _files(c: Calibration, options: FleetOptions, name: str) -> dict[str, bytes]:
    """The bytes of a robot's files by name."""
    files = {URDF: checked_urdf(c, target_link=options.target_link).data}
    files[RESULT] = json_bytes(result_table(c))
    files[SUMMARY] = f"{summary(c)}\n".encode("utf-8", "backslashreplace")
    if options.reports:
        from calib.show.report import report_bytes

        command = f"{options.command}  # {name}" if options.command else ""
        files[REPORT] = report_bytes(c, command=command, date=options.date)
    return files


def _made(row: FleetRow, files: dict[str, bytes]) -> Made:
    """See `Made.__reduce__`."""
    return Made(row, MappingProxyType(files))
