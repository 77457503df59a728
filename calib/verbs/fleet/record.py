"""The row of a robot in a fleet's tables, small enough to hold those of ten thousand robots in memory."""

from __future__ import annotations

import csv
import hashlib
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields

import numpy as np

from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.json_files import JsonLayout
from calib.data.measurements import Measurements
from calib.diagnosis.reasons import NO
from calib.model.parameters import FRAME, TARGET
from calib.numerics.errors import Errors
from calib.result.calibration import Calibration
from calib.robot.robot import Robot

#: Status of a robot that has a result.
DONE = "done"

#: Status of a robot without a result of these inputs.
FAILED = "failed"

#: State of a corrected URDF: written, as its verdict allows.
WRITTEN = "written"

#: State of a corrected URDF: not written, because the verdict is ``do not use``.
WITHHELD = "withheld"

#: State of a corrected URDF: written in spite of the verdict ``do not use``, which was accepted.
ACCEPTED = "accepted"

#: Columns of `FleetRow` that are no columns of ``fleet.csv``; the message is its last one.
_NOT_IN_CSV = ("message", "kind", "measured", "parameters")

#: Digits of joint values and measurements that a hash counts: a nanometre and a nanoradian. Files hold a few digits, in
#: degrees or radians.
_HASHED_DIGITS = 9

#: Stands in a hash for values that were not measured [m, rad].
_NOT_MEASURED = 1e9


@dataclass(frozen=True, slots=True)
class FleetParameter:
    """One estimated parameter of a robot, to be compared with those of the other robots."""

    #: Its name
    name: str
    #: Its unit: ``"m"``, ``"rad"``, ``"1"``, or that of a compliance
    unit: str
    #: Calibrated minus nominal; of a target its position in the tip
    change: float
    #: Standard deviation; NaN where the measurements do not determine the parameter, or a bound stopped it
    std: float


@dataclass(frozen=True, slots=True)
class FleetRow:
    """One robot of a fleet. Numbers that do not exist are NaN, texts ``""``.

    Errors and noise are by unit: ``"m"`` of lengths [m], ``"rad"`` of angles [rad], ``"px"`` of image coordinates [px].
    A unit that was not measured is missing; of a robot that failed the mappings are empty.
    """

    #: Its name
    name: str
    #: `DONE` or `FAILED`
    status: str
    #: Why it failed
    message: str = ""
    #: ``"use"``, ``"use with care"`` or ``"do not use"``
    verdict: str = ""
    #: State of its corrected URDF: `WRITTEN`, `WITHHELD` or `ACCEPTED`
    urdf: str = ""
    #: The geometry's parameter set
    model: str = ""
    #: The non-geometric model
    non_geometric: str = ""
    #: Number of rows that were fitted
    rows: int = 0
    #: Number of flagged rows among them
    outliers: int = 0
    #: Error of the nominal robot on the fitted rows, by unit
    nominal_rms: Mapping[str, float] = field(default_factory=dict)
    #: Error of the calibrated robot on the fitted rows, by unit
    calibrated_rms: Mapping[str, float] = field(default_factory=dict)
    #: Rows of ``unseen_rms``: ``"validation"`` or ``"cross-validation"``
    unseen: str = ""
    #: Error of the calibrated robot on rows that were not fitted, by unit
    unseen_rms: Mapping[str, float] = field(default_factory=dict)
    #: Error on held-out rows that are not flagged, by cross-validation, by unit
    held_out_rms: Mapping[str, float] = field(default_factory=dict)
    #: Estimated noise of one scalar, by unit
    sigma: Mapping[str, float] = field(default_factory=dict)
    #: Text that robots must share to be compared: name in the URDF, base, tip, joints
    kind: str = ""
    #: Name of the table of measurements
    data: str = ""
    #: Hash of the measured values, see `measured_hash`
    measured: str = ""
    #: Those of the geometry, without those of frames
    parameters: tuple[FleetParameter, ...] = ()

    @classmethod
    def of(cls, name: str, calibration: Calibration, *, accept: bool = False) -> FleetRow:
        """Return the row of a calibrated robot.

        Args:
            name: The robot's name.
            calibration: Its calibration.
            accept: Whether its URDF is written also where the verdict is ``do not use``.

        Returns:
            The row.
        """
        verdict = "" if calibration.verdict is None else calibration.verdict.use
        non_geometric = calibration.non_geometric
        nominal_errors = calibration.errors["nominal"]
        calibrated_errors = calibration.errors["calibrated"]
        unseen, unseen_rms = _unseen_error(calibration)
        return cls(
            name=name,
            status=DONE,
            verdict=verdict,
            urdf=_urdf_state(verdict, accept=accept),
            model=calibration.model.name,
            non_geometric="" if non_geometric is None else non_geometric.name,
            rows=int(calibration.fit.measurements.estimation.sum()),
            outliers=len(calibration.rows.outliers),
            nominal_rms=_rms_by_unit(nominal_errors["estimation"]),
            calibrated_rms=_rms_by_unit(calibrated_errors["estimation"]),
            unseen=unseen,
            unseen_rms=unseen_rms,
            held_out_rms=_held_out_rms(calibration),
            sigma=calibration.noise.sigma,
            kind=_kind(calibration.nominal),
            data=calibration.fit.measurements.source,
            measured=measured_hash(calibration.fit.measurements),
            parameters=_parameters(calibration),
        )


def _urdf_state(verdict: str, *, accept: bool) -> str:
    """Return the state of the corrected URDF by the verdict: `WRITTEN`, `WITHHELD` or `ACCEPTED`."""
    if verdict != NO:
        return WRITTEN
    return ACCEPTED if accept else WITHHELD


def _rms_by_unit(errors: Errors) -> dict[str, float]:
    """Return the rms errors in each unit that was measured."""
    return {unit: errors[unit].rms for unit in errors.units}


def _held_out_rms(calibration: Calibration) -> dict[str, float]:
    """Return the errors of cross-validation without outliers, by unit; empty if there was none."""
    cross_validation = calibration.cross_validation
    if cross_validation is None:
        return {}
    return _rms_by_unit(cross_validation.errors_without_outliers)


def _unseen_error(calibration: Calibration) -> tuple[str, dict[str, float]]:
    """Return the kind of rows that were not fitted, and the errors on them: validation rows before held-out ones."""
    validation = calibration.errors["calibrated"]["validation"]
    if validation.units:
        return "validation", _rms_by_unit(validation)
    if calibration.cross_validation is None:
        return "", {}
    return "cross-validation", _held_out_rms(calibration)


def _kind(robot: Robot) -> str:
    """Return the text that robots must share to be compared."""
    return " ".join([robot.name, robot.base, robot.tip, *robot.joint_names])


def _parameters(calibration: Calibration) -> tuple[FleetParameter, ...]:
    """Return the parameters that robots can be compared by: the place of an instrument is no property of a robot."""
    compared = []
    pairs = zip(calibration.parameters, calibration.model.parameters, strict=True)
    for estimated, parameter in pairs:
        if parameter.family == FRAME:
            continue
        change = estimated.delta
        if parameter.family == TARGET:
            change = estimated.value
        determined = estimated.identifiable and not estimated.at_bound
        std = estimated.std if determined else math.nan
        compared.append(FleetParameter(estimated.name, estimated.unit, change, std))
    return tuple(compared)


#: Attributes with a number for each unit.
_BY_UNIT = ("nominal_rms", "calibrated_rms", "unseen_rms", "held_out_rms", "sigma")

#: Layout of a row in a JSON file.
ROWS = JsonLayout({}, {})


def csv_bytes(rows: Sequence[FleetRow], reasons: Mapping[str, Sequence[str]]) -> bytes:
    """Return the table for a spreadsheet: UTF-8, one line for each robot, lengths in mm, angles in mrad.

    Figures of a unit that no robot measured have no column.

    Args:
        rows: The robots.
        reasons: Texts why a robot is a fleet outlier, by the robot's name; robots without are none.

    Returns:
        The file's content; cells of numbers that do not exist are empty.
    """
    columns = _csv_columns(rows)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    heads = [_csv_head(name, unit) for name, unit in columns]
    writer.writerow((*heads, "outlier", "message"))
    for row in rows:
        cells = [_csv_cell(row, name, unit) for name, unit in columns]
        outlier = "; ".join(reasons.get(row.name, ()))
        message = " ".join(row.message.split())
        writer.writerow((*cells, outlier, message))
    return text.getvalue().encode("utf-8", "backslashreplace")


def _csv_columns(rows: Sequence[FleetRow]) -> list[tuple[str, str]]:
    """Return the columns of the table: the attribute, and the unit of its number; empty where it has none."""
    measured = {unit for row in rows for unit in row.nominal_rms}
    units = [unit for unit in RESIDUAL_UNITS if unit in measured]
    columns = []
    for name in (f.name for f in fields(FleetRow)):
        if name in _BY_UNIT:
            columns += [(name, unit) for unit in units]
        elif name not in _NOT_IN_CSV:
            columns.append((name, ""))
    return columns


#: Unit of a column, and factor to it, by the unit of its numbers: angles are small.
_CSV_UNITS = {"m": ("mm", 1e3), "rad": ("mrad", 1e3)}


def _csv_head(name: str, unit: str) -> str:
    """Return the head of the column of an attribute, with the unit: ``"sigma [mm]"``."""
    if not unit:
        return name
    shown, _ = _CSV_UNITS.get(unit, (unit, 1.0))
    return f"{name} [{shown}]"


def _csv_cell(row: FleetRow, name: str, unit: str) -> object:
    """Return the cell of an attribute: a number in mm or mrad, empty for none; texts and counts as they are."""
    value = getattr(row, name)
    if not unit:
        return value
    number = value.get(unit, math.nan)
    if math.isnan(number):
        return ""
    _, factor = _CSV_UNITS.get(unit, (unit, 1.0))
    return f"{factor * number:.6g}"


def measured_hash(measurements: Measurements) -> str:
    """Return a hash of joint values and measurements, independent of the rows' order and of the file.

    Args:
        measurements: N rows.

    Returns:
        64 hexadecimal digits, equal for measurements that are equal to a nanometre and a nanoradian.
    """
    count = len(measurements)
    columns = (
        measurements.joints,
        measurements.points,
        measurements.rotations,
        measurements.distances,
        *measurements.readings.values(),
    )
    present = [column for column in columns if column is not None]
    flat = [np.asarray(a, dtype=np.float64).reshape(count, -1) for a in present]
    rounded = np.round(np.hstack(flat), _HASHED_DIGITS)
    # Adding 0.0 makes 0.0 of -0.0.
    values = np.nan_to_num(rounded, nan=_NOT_MEASURED) + 0.0
    lines = sorted(row.tobytes() for row in values)
    return hashlib.sha256(b"".join(lines)).hexdigest()
