"""What a fleet keeps of one robot, small enough to hold ten thousand of them, and its line in the fleet's tables."""

from __future__ import annotations

import csv
import hashlib
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from calib.data.measurements import Measurements
from calib.files import Layout
from calib.model.kinematics import FRAME, TARGET
from calib.result.calibration import Calibration

#: How it went.
DONE, FAILED = "done", "failed"


@dataclass(frozen=True, slots=True)
class FleetParameter:
    """One parameter, as it is compared with the other robots'."""

    name: str  #: Its name
    unit: str  #: Its unit
    change: float  #: From the nominal value; of a target its place in the tip
    #: Standard deviation of it; NaN where the measurements do not determine it, or a bound stopped it
    std: float


@dataclass(frozen=True, slots=True)
class FleetRow:
    """One robot of a fleet. Numbers that there are not are NaN, words ``""``."""

    name: str  #: Its name
    status: str  #: `DONE` or `FAILED`
    message: str = ""  #: Why it failed
    verdict: str = ""  #: ``"use"``, ``"use with care"`` or ``"do not use"``
    model: str = ""  #: The geometry's parameter set
    larger: str = ""  #: The larger model
    rows: int = 0  #: Rows that were fitted
    outliers: int = 0  #: How many of them are flagged
    nominal_rms: float = math.nan  #: Error of the nominal robot on the rows that were fitted [m]
    calibrated_rms: float = math.nan  #: Of the calibrated robot [m]
    unseen: str = ""  #: What ``unseen_rms`` is of: ``"validation"`` or ``"cross-validation"``
    unseen_rms: float = math.nan  #: Of the calibrated robot on rows that were not fitted [m]
    #: On left-out rows that are not flagged, by cross-validation [m]
    left_out_rms: float = math.nan
    sigma: float = math.nan  #: Noise of one coordinate or length that the fit found [m]
    sigma_angle: float = math.nan  #: Of an angle [rad]
    #: What robots must share to be compared: the robot's name, its joints, base and tip
    kind: str = ""
    data: str = ""  #: The measurements' file
    measured: str = ""  #: A hash of what was measured, whatever file it stood in
    parameters: tuple[FleetParameter, ...] = ()  #: Those of the geometry, frames aside

    @classmethod
    def of(cls, name: str, c: Calibration) -> FleetRow:
        """The row of a calibration."""
        errors, v = c.errors, c.cross_validation
        validation = errors["calibrated"]["validation"]
        left_out = math.nan if v is None else v.errors_without_outliers.rms
        unseen = "" if v is None else "cross-validation"
        return cls(
            name=name,
            status=DONE,
            verdict="" if c.verdict is None else c.verdict.use,
            model=c.model.name,
            larger="" if c.larger is None else c.larger.name,
            rows=int(c.measurements.estimation.sum()),
            outliers=len(c.outliers),
            nominal_rms=errors["nominal"]["estimation"].rms,
            calibrated_rms=errors["calibrated"]["estimation"].rms,
            unseen="validation" if validation.n else unseen,
            unseen_rms=validation.rms if validation.n else left_out,
            left_out_rms=left_out,
            sigma=c.sigma,
            sigma_angle=c.sigma_angle,
            kind=" ".join([c.nominal.name, c.nominal.base, c.nominal.tip, *c.nominal.joint_names]),
            data=c.measurements.source,
            measured=measured_hash(c.measurements),
            # Those that robots can be compared by: where an instrument stands says nothing of a robot.
            parameters=tuple(
                FleetParameter(
                    found.name,
                    found.unit,
                    found.value if own.family == TARGET else found.delta,
                    found.std if found.identifiable and not found.at_bound else math.nan,
                )
                for found, own in zip(c.parameters, c.model.parameters, strict=True)
                if own.family != FRAME
            ),
        )


_UNITS = {
    **dict.fromkeys(("nominal_rms", "calibrated_rms", "unseen_rms", "left_out_rms", "sigma"), "m"),
    "sigma_angle": "rad",
}

#: How a row stands in a file, with the units in the keys.
ROWS = Layout({FleetRow: {name: f"{name}_{unit}" for name, unit in _UNITS.items()}}, {})


def csv_bytes(rows: Sequence[FleetRow], odd: Sequence[tuple[str, str]]) -> bytes:
    """A table for a spreadsheet, UTF-8, a line a robot, mm and mrad, and why it is odd; what is not there is empty."""
    apart = ("message", "kind", "measured", "parameters")
    names = [f.name for f in fields(FleetRow) if f.name not in apart]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    heads = [f"{name} [m{_UNITS[name]}]" if name in _UNITS else name for name in names]
    writer.writerow((*heads, "odd", "message"))
    for row in rows:
        values = [getattr(row, name) for name in names]
        numbers = [f"{1e3 * v:.6g}" if isinstance(v, float) and v == v else v for v in values]
        cells = ["" if cell != cell else cell for cell in numbers]
        reasons = "; ".join(reason for name, reason in odd if name == row.name)
        writer.writerow((*cells, reasons, " ".join(row.message.split())))
    return text.getvalue().encode("utf-8", "backslashreplace")


def measured_hash(measurements: Measurements) -> str:
    """The same for the same joint values and measurements, in whatever order and file they stand."""
    m, count = measurements, len(measurements)
    arrays = [m.joints, m.points]
    arrays += [a for a in (m.rotations, m.distances) if a is not None]
    rows = np.hstack([np.asarray(a, dtype=np.float64).reshape(count, -1) for a in arrays])
    # Rounded to a nanometre and a nanoradian: files hold a few digits, in degrees or radians. No number is -0.
    lines = sorted(line.tobytes() for line in np.nan_to_num(np.round(rows, 9), nan=1e9) + 0.0)
    return hashlib.sha256(b"".join(lines)).hexdigest()
