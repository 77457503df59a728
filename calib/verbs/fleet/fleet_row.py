"""The row of a robot in a fleet's tables, small enough to keep those of ten thousand robots in memory."""

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
from calib.model.error_model import FRAME, TARGET
from calib.numerics.errors import Errors
from calib.result.calibration import Calibration

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

#: Attributes of `FleetRow` that are not columns of ``fleet.csv``, or not in their place: parameters and zeros have a
#: column each after the others, and the message is the last one.
_NOT_IN_CSV = ("message", "kind", "measured", "parameters", "zeros")

#: Attributes of `FleetRow` with a number for each unit.
_BY_UNIT = ("nominal_rms", "calibrated_rms", "unseen_rms", "held_out_rms", "sigma")

#: Unit of a column, and factor to it, by the unit of its numbers: angles are small.
_CSV_UNITS = {"m": ("mm", 1e3), "rad": ("mrad", 1e3)}

#: Decimals of joint values and measurements that a hash counts, a nanometre and a nanoradian: files have fewer digits,
#: in degrees or radians.
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
    #: Standard deviation without a scale error of the instrument, which robots share; NaN if the measurements do not
    #: determine the parameter, or a bound stopped it
    std: float


@dataclass(frozen=True, slots=True)
class FleetRow:
    """One robot of a fleet; texts that do not exist are ``""``.

    Errors and noise are by unit: ``"m"`` of lengths [m], ``"rad"`` of angles [rad], ``"px"`` of image coordinates [px].
    A unit that was not measured is missing; the mappings of a robot that failed are empty.
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
    #: The best joint zeros alone, whatever the model; none of a robot of which they could not be fitted
    zeros: tuple[FleetParameter, ...] = ()
    #: Serial number, as the cell's record says
    serial: str = ""
    #: When it was measured, as the cell's record says, else when it was calibrated
    measured_on: str = ""
    #: When it was calibrated, UTC
    calibrated_on: str = ""
    #: SHA-256 of the nominal URDF
    robot_sha256: str = ""
    #: SHA-256 of the table; empty if there was no file
    data_sha256: str = ""
    #: SHA-256 of ``corrected.urdf``; empty if none was written
    urdf_sha256: str = ""
    #: SHA-256 of ``result.json``
    result_sha256: str = ""

    @classmethod
    def of(cls, name: str, calibration: Calibration, *, accept: bool = False) -> FleetRow:
        """Return the row of a calibrated robot.

        Args:
            name: The robot's name.
            calibration: Its calibration.
            accept: Whether its URDF is also written if the verdict is ``do not use``.

        Returns:
            The row.
        """
        verdict = "" if calibration.verdict is None else calibration.verdict.use
        urdf = WRITTEN
        if verdict == NO:
            urdf = ACCEPTED if accept else WITHHELD
        calibrated = calibration.errors["calibrated"]
        held_out_rms: dict[str, float] = {}
        if calibration.cross_validation is not None:
            held_out_rms = _rms_by_unit(calibration.cross_validation.errors_without_outliers)
        # Validation rows come before held-out ones.
        unseen, unseen_rms = "", held_out_rms
        if calibrated["validation"].units:
            unseen, unseen_rms = "validation", _rms_by_unit(calibrated["validation"])
        elif calibration.cross_validation is not None:
            unseen = "cross-validation"
        # Robots are compared by the parameters of robot and target; those of frames are of the instrument's place. The
        # covariance leaves the instrument's scale error out: all robots that it measured share it.
        compared = []
        stds = np.sqrt(np.diag(calibration.covariance))
        estimates = zip(calibration.parameters, calibration.model.parameters, stds, strict=True)
        for estimated, parameter, std in estimates:
            if parameter.family == FRAME:
                continue
            change = estimated.value if parameter.family == TARGET else estimated.delta
            if not estimated.identifiable or estimated.at_bound:
                std = math.nan
            compared.append(FleetParameter(estimated.name, estimated.unit, change, float(std)))

        zeros = []
        if calibration.zeros is not None:
            of_zeros = calibration.zeros
            names = [f"zero of {joint}" for joint in of_zeros.joints]
            units = ["m" if j.type == "prismatic" else "rad" for j in calibration.nominal.inputs]
            numbers = (of_zeros.delta.tolist(), of_zeros.std.tolist())
            zeros = [FleetParameter(*zero) for zero in zip(names, units, *numbers, strict=True)]

        robot, measurements = calibration.nominal, calibration.fit.measurements
        calibrated_on = calibration.method.time
        non_geometric = calibration.non_geometric
        return cls(
            name=name,
            status=DONE,
            verdict=verdict,
            urdf=urdf,
            model=calibration.model.name,
            non_geometric="" if non_geometric is None else non_geometric.name,
            rows=int(measurements.estimation.sum()),
            outliers=len(calibration.rows.outliers),
            nominal_rms=_rms_by_unit(calibration.errors["nominal"]["estimation"]),
            calibrated_rms=_rms_by_unit(calibrated["estimation"]),
            unseen=unseen,
            unseen_rms=unseen_rms,
            held_out_rms=held_out_rms,
            sigma=calibration.noise.sigma,
            kind=" ".join([robot.name, robot.base, robot.tip, *robot.joint_names]),
            data=measurements.source,
            measured=measured_hash(measurements),
            parameters=tuple(compared),
            zeros=tuple(zeros),
            serial=calibration.record.robot_serial,
            measured_on=calibration.record.date or calibrated_on,
            calibrated_on=calibrated_on,
            robot_sha256=robot.urdf.sha256,
            data_sha256=calibration.source.sha256,
        )


def _rms_by_unit(errors: Errors) -> dict[str, float]:
    """Return the rms error in each unit that was measured, by its symbol: ``"m"`` [m] and so on."""
    return {unit: errors[unit].rms for unit in errors.units}


#: Layout of a row in a JSON file.
ROW_LAYOUT = JsonLayout({}, {})


def fleet_csv(rows: Sequence[FleetRow], reasons: Mapping[str, Sequence[str]]) -> bytes:
    """Return the table for a spreadsheet: UTF-8, one line for each robot.

    Lengths are in mm, angles in mrad, image coordinates in px. Figures of a unit that no robot measured have no column.
    Each parameter, and each joint zero, has a column with its change; it is empty where it is not determined.

    Args:
        rows: The robots.
        reasons: Texts why a robot is a fleet outlier, by the robot's name.
    """
    measured = {unit for row in rows for unit in row.nominal_rms}
    units = [unit for unit in RESIDUAL_UNITS if unit in measured]
    heads, columns = [], []
    for name in (f.name for f in fields(FleetRow)):
        values = [getattr(row, name) for row in rows]
        if name in _BY_UNIT:
            for unit in units:
                shown, factor = _CSV_UNITS.get(unit, (unit, 1.0))
                heads.append(f"{name} [{shown}]")
                columns.append([_number_cell(numbers.get(unit), factor) for numbers in values])
        elif name not in _NOT_IN_CSV:
            heads.append(name)
            columns.append(values)
    for of_rows in ([row.parameters for row in rows], [row.zeros for row in rows]):
        units_of = {p.name: p.unit for parameters in of_rows for p in parameters}
        for name, unit in units_of.items():
            shown, factor = _CSV_UNITS.get(unit, (unit, 1.0))
            heads.append(f"{name} [{shown}]")
            changes = [
                {p.name: p.change for p in parameters if not math.isnan(p.std)}
                for parameters in of_rows
            ]
            columns.append([_number_cell(change.get(name), factor) for change in changes])
    outliers = ["; ".join(reasons.get(row.name, ())) for row in rows]
    messages = [" ".join(row.message.split()) for row in rows]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*heads, "outlier", "message"])
    writer.writerows(zip(*columns, outliers, messages, strict=True))
    return text.getvalue().encode("utf-8", "backslashreplace")


def _number_cell(number: float | None, factor: float) -> str:
    """Return a number times a factor, to 6 digits; empty for none."""
    if number is None or math.isnan(number):
        return ""
    return f"{factor * number:.6g}"


def measured_hash(measurements: Measurements) -> str:
    """Return a SHA-256 of joint values and measurements, independent of the rows' order and of the file.

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
