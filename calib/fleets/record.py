"""What a fleet keeps of each robot, small enough to hold ten thousand of them, and which robots are unlike the others.

A figure x of robot i is compared with those of all robots of its kind by

    z_i = (x_i - median) / scale_i,   scale_i = max(1.4826 MAD, floor, std_i)

with the median absolute deviation MAD, which odd ones hardly move, a floor below which differences do not matter, and
the figure's own standard deviation where it has one. Errors and noise are compared by their logarithms. A robot is
flagged where |z| is beyond what one fleet in twenty, with nothing odd in it, reaches anywhere among its n robots and k
figures, were they normally distributed:

    limit = quantile of Student's t with 0.41 n degrees of freedom at 1 - 0.05 / (2 n k)

The degrees of freedom make up for the MAD's own scatter; 0.41 is just below what simulations of 5 to 500 robots gave.
Half of the 0.05 is spent on the errors and the noise, the other half on the parameters. Of robots with the same
data one counts in n, median and MAD, and all are compared.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.special import stdtrit

from calib.data.measurements import Measurements
from calib.diagnosis.reasons import NO
from calib.json_files import JsonLayout
from calib.model.parameters import FRAME, TARGET
from calib.result.calibration import CalibrationValues
from calib.text.fleet import data_text, few_text, figure_text
from calib.units import Array, Mask

#: How it went.
DONE, FAILED = "done", "failed"

#: What became of a corrected URDF: written as its verdict allows; not written, because the verdict is ``do not use``;
#: written in spite of that verdict, which was accepted.
WRITTEN, WITHHELD, ACCEPTED = "written", "withheld", "accepted"

#: With fewer robots nothing is said of what is usual.
FEWEST = 5

#: How often a fleet without odd ones has one flagged.
CHANCE = 0.05

#: Degrees of freedom of a scale from a MAD, for each robot.
_FREEDOM = 0.41

#: Errors and noise that differ by less are alike (natural logarithm).
_LOG_FLOOR = 0.05

#: Changes of a parameter that differ by less are alike, by unit; joint gains and compliances have their std only.
_FLOORS = {"m": 20e-6, "rad": 20e-6, "1": 20e-6}

_FIGURES = {
    "nominal_rms": ("nominal error", "m"),
    "held_out_rms": ("cross-validated error", "m"),
    "sigma": ("noise", "m"),
    "sigma_angle": ("noise of orientations", "rad"),
}


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
    urdf: str = ""  #: What became of its corrected URDF: `WRITTEN`, `WITHHELD` or `ACCEPTED`
    model: str = ""  #: The geometry's parameter set
    non_geometric: str = ""  #: The non-geometric model
    rows: int = 0  #: Rows that were fitted
    outliers: int = 0  #: How many of them are flagged
    nominal_rms: float = math.nan  #: Error of the nominal robot on the rows that were fitted [m]
    calibrated_rms: float = math.nan  #: Of the calibrated robot [m]
    unseen: str = ""  #: What ``unseen_rms`` is of: ``"validation"`` or ``"cross-validation"``
    unseen_rms: float = math.nan  #: Of the calibrated robot on rows that were not fitted [m]
    #: On held-out rows that are not flagged, by cross-validation [m]
    held_out_rms: float = math.nan
    sigma: float = math.nan  #: Noise of one coordinate or length that the fit found [m]
    sigma_angle: float = math.nan  #: Of an angle [rad]
    #: What robots must share to be compared: the robot's name, its joints, base and tip
    kind: str = ""
    data: str = ""  #: The measurements' file
    measured: str = ""  #: A hash of what was measured, whatever file it stood in
    parameters: tuple[FleetParameter, ...] = ()  #: Those of the geometry, frames aside

    @classmethod
    def of(cls, name: str, c: CalibrationValues, *, accept: bool = False) -> FleetRow:
        """The row of a calibration.

        Args:
            name: The robot's name.
            c: The calibration, in memory.
            accept: Whether its URDF is written also where the verdict is ``do not use``.

        Returns:
            The row.
        """
        rejected = c.verdict is not None and c.verdict.use == NO
        urdf = (ACCEPTED if accept else WITHHELD) if rejected else WRITTEN
        errors, v = c.errors, c.cross_validation
        validation = errors["calibrated"]["validation"]
        held_out = math.nan if v is None else v.errors_without_outliers.rms
        unseen = "" if v is None else "cross-validation"
        return cls(
            name=name,
            status=DONE,
            verdict="" if c.verdict is None else c.verdict.use,
            urdf=urdf,
            model=c.model.name,
            non_geometric="" if c.non_geometric is None else c.non_geometric.name,
            rows=int(c.measurements.estimation.sum()),
            outliers=len(c.outliers),
            nominal_rms=errors["nominal"]["estimation"].rms,
            calibrated_rms=errors["calibrated"]["estimation"].rms,
            unseen="validation" if validation.n else unseen,
            unseen_rms=validation.rms if validation.n else held_out,
            held_out_rms=held_out,
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
    **dict.fromkeys(("nominal_rms", "calibrated_rms", "unseen_rms", "held_out_rms", "sigma"), "m"),
    "sigma_angle": "rad",
}

#: How a row stands in a file, with the units in the keys.
ROWS = JsonLayout({FleetRow: {name: f"{name}_{unit}" for name, unit in _UNITS.items()}}, {})


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


@dataclass(frozen=True, slots=True)
class FleetOutlier:
    """One reason why a robot is odd."""

    name: str  #: The robot
    #: What is odd about it: a figure's or a parameter's name, or ``"data"``
    figure: str
    unit: str = ""  #: Of value and usual; ``""`` for data, of which all numbers are NaN
    value: float = math.nan  #: Its value
    usual: float = math.nan  #: The median of the robots of its kind
    z: float = math.nan  #: How far it is off, see the module's text
    limit: float = math.nan  #: Beyond which it is flagged
    text: str = ""  #: The same in words


def fleet_outliers(rows: Sequence[FleetRow]) -> tuple[tuple[FleetOutlier, ...], tuple[str, ...]]:
    """The odd ones of a fleet, in the order of the robots and the farthest off first; and what could not be said."""
    done = [row for row in rows if row.status == DONE]
    found, notes = [*_same_data(done)], []
    kinds = dict.fromkeys(row.kind for row in done)
    for kind in kinds:
        alike = [row for row in done if row.kind == kind]
        count = int(np.sum(_counted(alike)))
        if count >= FEWEST:
            found += _figures(alike)
        else:
            shown = kind.split()[0] if len(kinds) > 1 else ""
            notes.append(few_text(len(alike), count, FEWEST, shown))
    place = {row.name: i for i, row in enumerate(rows)}
    found.sort(key=lambda odd: (place[odd.name], -math.inf if odd.z != odd.z else -abs(odd.z)))
    return tuple(found), tuple(notes)


def limit(robots: int, figures: int, chance: float = CHANCE) -> float:
    """The |z| beyond which one of k figures of one of n robots is flagged.

    Example:
        >>> [round(limit(n, 30), 1) for n in (5, 20, 200)]
        [50.5, 7.2, 4.8]
    """
    return float(stdtrit(_FREEDOM * robots, 1.0 - chance / (2.0 * robots * figures)))


def _counted(rows: Sequence[FleetRow]) -> Mask:
    """Which robots count in what is usual, shape (n,): of those with the same data the first."""
    mask = np.zeros(len(rows), dtype=np.bool_)
    mask[np.unique([row.measured for row in rows], return_index=True)[1]] = True
    return mask


def _figures(rows: list[FleetRow]) -> Iterator[FleetOutlier]:
    """Robots whose errors, noise or parameters are odd."""
    once, exact = _counted(rows), np.zeros(len(rows))
    errors: list[tuple[str, str, Array, Array, float]] = []
    parameters: list[tuple[str, str, Array, Array, float]] = []
    for name, (figure, unit) in _FIGURES.items():
        x = np.array([getattr(row, name) for row in rows])
        errors.append((figure, unit, np.log(np.where(x > 0.0, x, math.nan)), exact, _LOG_FLOOR))
    named = [{p.name: p for p in row.parameters if p.std == p.std} for row in rows]
    for figure, unit in {p.name: p.unit for own in named for p in own.values()}.items():
        own = [of.get(figure) for of in named]
        x, std = np.array([(p.change, p.std) if p else (math.nan, math.nan) for p in own]).T
        parameters.append((figure, unit, x, std, _FLOORS.get(unit, 0.0)))
    for group, size in ((errors, np.exp), (parameters, np.asarray)):
        shared = [one for one in group if np.sum(np.isfinite(one[2][once])) >= FEWEST]
        for figure, unit, x, std, floor in shared:
            bound = limit(int(np.sum(once)), len(shared), 0.5 * CHANCE)
            z = scores(x, std, floor, once)
            usual = float(size(np.nanmedian(x[once])))
            for i in np.flatnonzero(np.abs(z) > bound):
                found = (figure, unit, float(size(x[i])), usual, float(z[i]), bound)
                yield FleetOutlier(rows[i].name, *found, figure_text(*found))


def scores(x: Array, std: Array, floor: float, once: Mask) -> Array:
    """The z of each value, shape (n,); see the module's text. Those of ``once`` count in median and MAD."""
    away = x - np.nanmedian(x[once])
    scale = np.fmax(np.fmax(1.4826 * np.nanmedian(np.abs(away[once])), floor), std)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(away == 0.0, 0.0, away / scale)


def _same_data(rows: Sequence[FleetRow]) -> Iterator[FleetOutlier]:
    """Robots whose measurements are those of another."""
    same: dict[str, list[FleetRow]] = {}
    for row in rows:
        same.setdefault(row.measured, []).append(row)
    for group in same.values():
        for row in group:
            others = [other.name for other in group if other is not row]
            if others:
                yield FleetOutlier(row.name, "data", text=data_text(others, row.data))
