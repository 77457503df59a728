"""One robot of a fleet: read from its files, calibrated in any executor, and handed back as the bytes of its files.

The process that reads the inputs writes the files too: workers on other machines need no shared disk.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from calib.calibration import calibrate
from calib.errors import CalibError
from calib.fleets.record import FleetRow
from calib.measure.cell import Cell
from calib.measure.measurements import Measurements
from calib.measure.table import Table
from calib.model.robot import Robot
from calib.model.urdf import Urdf, read_urdf
from calib.show.report import write_report
from calib.units import split_header
from calib.version import __version__

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
        cell, renamed = cell or Cell(), dict(columns or {})

        def load(urdf_of: Callable[[str], Urdf]) -> FleetInputs:
            names = {split_header(label)[0] for label in Table.read(data).header}
            names |= {split_header(wanted)[0] for wanted in renamed.values()}
            urdf = urdf_of(str(robot))
            arm = Robot.from_urdf(urdf, cell.base, cell.tip, measured=names, held=cell.held)
            rows = Measurements.read(
                data,
                joint_names=arm.joint_names,
                joint_types=arm.joint_types,
                columns=renamed,
                kind=cell.kind,
                points=points,
                points_unit=points_unit,
            )
            return FleetInputs(arm, rows, cell)

        return cls(name, load)


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
    """

    solver: str = "lm"
    robust: bool = True
    validate: bool = True
    reports: bool = True
    target_link: bool = False
    command: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """What a robot's calibration came to.

    Attributes:
        row: Its row of the fleet's table.
        files: The bytes of its files by name.
    """

    row: FleetRow
    files: dict[str, bytes]


def inputs_fingerprint(name: str, inputs: FleetInputs, options: FleetOptions) -> str:
    """The SHA-256 of all that a robot's files depend on: its inputs, the options, the version of calib."""
    robot, options = inputs.robot, replace(options, command="")
    measured = {f: getattr(inputs.measurements, f) for f in Measurements.__dataclass_fields__}
    return fingerprint(
        name, robot, robot.urdf.source, measured, inputs.cell, options, __version__, _LAYOUT
    )


def fingerprint(*values: object) -> str:
    """The SHA-256 of some values: of dataclasses by the fields that count in a comparison, of arrays by every bit.

    Raises:
        TypeError: A value is of a kind that has none.

    Example:
        >>> fingerprint("a", 1.0) == fingerprint("a", 1.0), fingerprint("a", 1.0) == fingerprint("a1.0")
        (True, False)
    """
    return hashlib.sha256(json.dumps(values, default=_parts).encode()).hexdigest()


def _parts(value: object) -> object:
    """What JSON has no word for, by its kind and what it consists of."""
    kind = type(value).__name__
    if is_dataclass(value) and not isinstance(value, type):
        return [kind, *((f.name, getattr(value, f.name)) for f in fields(value) if f.compare)]
    if isinstance(value, (np.ndarray, np.generic)):
        return [kind, value.dtype.str, value.shape, value.tobytes().hex()]
    if isinstance(value, Mapping):
        return [kind, *value.items()]
    if isinstance(value, (bytes, Path)):
        return [kind, str(value)]
    raise TypeError(f"a value of type {kind} has no fingerprint")


#: Counted up when the files of a robot change.
_LAYOUT = 3


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
        with tempfile.TemporaryDirectory() as folder:
            there = Path(folder)
            result.write_urdf(there / URDF, target_link=options.target_link)
            result.write_json(there / RESULT)
            text = f"{result.summary()}\n"
            (there / SUMMARY).write_text(text, encoding="utf-8", errors="backslashreplace")
            if options.reports:
                command = f"{options.command}  # {name}" if options.command else ""
                write_report(result, there / REPORT, command=command)
            files = {path.name: path.read_bytes() for path in there.iterdir()}
        return Made(FleetRow.of(name, result), files)
    except CalibError as error:
        return str(error)
    except Exception as error:  # noqa: BLE001  a fault with one robot must not cost the others
        return fault(error)


def fault(error: Exception) -> str:
    """What is said of an error that is not due to the inputs."""
    return f"internal error: {type(error).__name__}: {error}. Please report it with this robot's files."


def urdf_reader() -> Callable[[str], Urdf]:
    """`read_urdf` that keeps the last few, for robots that share one."""
    return lru_cache(maxsize=8)(read_urdf)
