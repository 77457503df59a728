"""certificate: a calibration certificate of a robot, as found and as left, with uncertainties and decision rule.

Rows that were measured after the calibration, or the validation rows of its own table, are compared with the nominal
robot (as found) and with the calibrated one (as left), by the acceptance test of `calib.verbs.evaluate.acceptance`.
What the certificate says besides is computed from the result (uncertainty, budget, validity), taken from the record
(who, where, with what), or left blank.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.basics.arguments import check_mapping, check_path, check_type
from calib.basics.arrays import read_only
from calib.basics.dates import date_text, now
from calib.basics.files import read_bytes
from calib.basics.json_files import digest
from calib.basics.values import Value, keep_read_only, shown_by
from calib.data.cell import Cell
from calib.data.cell_chains import robot_with_chains_of
from calib.data.inputs import CellInput, RobotInput, TableInput, cell_of, inputs_of
from calib.data.measurements import Measurements
from calib.data.record import Record
from calib.errors import ArgumentError, CalibError, MeasurementError, choices
from calib.result.calibration import Calibration, is_corrected
from calib.result.calibration_file import read_result
from calib.result.chain_of_result import with_chain_of_result
from calib.robot.ranges import column_limits
from calib.robot.robot import Robot
from calib.robot.urdf import read_urdf
from calib.uncertainty.budget import Budget
from calib.verbs.certificate.conformity import (
    Risks,
    conformance_probability,
    global_risks,
)
from calib.verbs.certificate.points import (
    PARTS,
    Deviation,
    Expanded,
    Point,
    PointRows,
    deviations,
    point_rows,
    reading_noise,
    standard_uncertainty,
)
from calib.verbs.certificate.untested import Gap, gaps
from calib.verbs.evaluate.acceptance import Assessment, Check, Outcome, acceptance, assess
from calib.verbs.evaluate.accuracy import Accuracy, fitted_rows
from calib.verbs.evaluate.evaluation import PLACES

#: Entries of the record that are about the item and the parties: those of the calibration hold for fresh rows too.
_OF_ITEM = (
    *("customer", "order", "robot", "robot_serial", "controller_serial"),
    *("laboratory", "country", "responsible"),
)

#: Letters of a certificate's id.
_ID_DIGITS = 12


@dataclass(frozen=True, slots=True)
class Decision:
    """The statement of conformity in one unit."""

    #: The comparison of the largest deviation as left with the tolerance; its uncertainty is the guard band
    check: Check
    #: Probability that the true deviation at every point is within the tolerance: 1 less the sum of the risks of all
    conformance: float
    #: Mean and standard deviation of such robots' largest deviation, as stated; None: it was not stated
    prior: tuple[float, float] | None
    #: The risks over all such robots; None without a prior
    risks: Risks | None

    @property
    def specific_risk(self) -> float:
        """Probability that the outcome is wrong: of a pass that a point is out of tolerance, of a fail that none is.

        NaN if the outcome is undecided.
        """
        if self.check.outcome == "undecided":
            return np.nan
        return 1.0 - self.conformance if self.check.outcome == "pass" else self.conformance


@dataclass(frozen=True, slots=True)
class Range:
    """A joint's part of the box in which a certificate is valid [rad] or [m]."""

    joint: str
    prismatic: bool
    #: Range over the rows that the calibration was fitted to: the certificate is valid within
    calibrated: tuple[float, float]
    #: Range over the certificate's points
    tested: tuple[float, float]
    #: Limits of the URDF; infinite without
    limits: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Files:
    """Names and hashes of what a certificate rests on; empty if it came from memory."""

    #: The result's file
    result: str = ""
    result_sha256: str = ""
    #: The command line
    command: str = ""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Certificate(Value):
    """A calibration certificate of a robot."""

    #: The calibration that it certifies
    calibration: Calibration
    #: The comparison of the nominal and of the calibrated robot with the rows
    assessment: Assessment
    #: Who certifies what for whom, where and with what; what is not given is empty
    record: Record
    #: The points, in the order of their measurement
    points: tuple[Point, ...]
    #: What the uncertainty of the calibrated robot's pose is made of, over the points
    budget: Budget
    #: By the symbol of the unit; empty without a tolerance
    decisions: Mapping[str, Decision]
    #: By joint, where the certificate is valid
    box: tuple[Range, ...]
    #: What was not tested
    gaps: tuple[Gap, ...]
    #: U of the deviations (k = 2) as the laboratory states it, by the symbol of the unit; without a unit: computed
    stated: Mapping[str, float]
    #: Names and hashes
    files: Files
    #: When it was made, UTC
    time: str

    def __post_init__(self) -> None:
        """Keep copies that cannot be changed."""
        keep_read_only(self, "decisions", "stated")

    def __repr__(self) -> str:
        """One line: robot, number, outcome, largest deviations."""
        return str(shown_by("verbs.certificate.text").certificate_line(self))

    @property
    def id(self) -> str:
        """12 hexadecimal digits that its page, its JSON and its DCC carry: of its numbers and its record."""
        numbers = [
            [
                point.joints,
                [(unit, d.found, d.left, d.uncertainty) for unit, d in point.deviations.items()],
            ]
            for point in self.points
        ]
        entries = sorted(self.record.given.items())
        return digest([self.calibration.run, numbers, entries, self.outcome])[:_ID_DIGITS]

    @property
    def outcome(self) -> Outcome | None:
        """``"pass"``, ``"undecided"`` or ``"fail"``; None without a tolerance."""
        accepted = self.assessment.accepted
        return None if accepted is None else accepted.outcome

    @property
    def is_fresh(self) -> bool:
        """True if the calibration was fitted to no row of the table; else the points are those that it was not."""
        return not self.assessment.accuracies[self.assessment.judged].fitted

    @property
    def measurements(self) -> Measurements:
        """The table whose rows are certified."""
        return self.assessment.evaluations[self.assessment.judged].measurements

    @property
    def units(self) -> tuple[str, ...]:
        """Symbols of the units that some point has: ``"m"``, ``"rad"`` or both."""
        return tuple(unit for unit in PARTS if any(unit in one.deviations for one in self.points))

    def of(self, unit: str) -> tuple[Deviation, ...]:
        """Return the deviations in one unit at the points that have one, in their order.

        Args:
            unit: ``"m"`` or ``"rad"``.
        """
        return tuple(one.deviations[unit] for one in self.points if unit in one.deviations)

    def summary(self) -> str:
        """Return the certificate as text, without colours, in 100 columns, as ``calib certificate`` prints it."""
        return str(shown_by("verbs.certificate.report").summary(self))

    def write_report(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the certificate as a page that prints on A4, with lines to sign and to fill in.

        Args:
            path: The file, a page (.html) or a PDF (.pdf), which an installed Chromium, Chrome or Edge prints.
            overwrite: Whether a file that exists is replaced.

        Returns:
            The path.

        Raises:
            ArgumentError: The path is of another type.
            CalibError: No browser is installed for a PDF.
            FileError: The name ends otherwise, the file exists, or it cannot be written.
        """
        check_path("path", path)
        report = shown_by("verbs.certificate.report")
        return Path(report.write_report(self, path, overwrite=overwrite))

    def write_json(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the certificate as JSON, see docs/certificate.md.

        Args:
            path: The file.
            overwrite: Whether a file that exists is replaced.

        Returns:
            The path.

        Raises:
            ArgumentError: The path is of another type.
            FileError: The file exists, or cannot be written.
        """
        check_path("path", path)
        writer = shown_by("verbs.certificate.certificate_file")
        return Path(writer.write_certificate(self, path, overwrite=overwrite))

    def write_dcc(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the certificate as a Digital Calibration Certificate, XML of the PTB's schema 3.2.1.

        Args:
            path: The file.
            overwrite: Whether a file that exists is replaced.

        Returns:
            The path.

        Raises:
            ArgumentError: The path is of another type.
            CalibError: The record lacks an entry that a DCC must have.
            FileError: The file exists, or cannot be written.
        """
        check_path("path", path)
        writer = shown_by("verbs.certificate.dcc")
        return Path(writer.write_dcc(self, path, overwrite=overwrite))


def certificate(
    robot: RobotInput,
    measurements: TableInput | None = None,
    *,
    calibration: Calibration | str | Path,
    cell: CellInput = None,
    tolerance: Mapping[str, float] | None = None,
    uncertainty: Mapping[str, float] | None = None,
    prior: Mapping[str, tuple[float, float]] | None = None,
    non_geometric: bool = False,
) -> Certificate:
    """Make a calibration certificate of a calibrated robot.

    Args:
        robot: The robot, nominal or corrected, or its path or name.
        measurements: Rows that were measured after the calibration, or the path of their table; also the calibration's
            own table, of which the validation rows are certified. None: that table, if the calibration was made in this
            process.
        calibration: The result, or the path of its file.
        cell: What else is known of these rows, and their record, or the path of a cell file; None: nothing. Frames and
            targets that it does not give are those of the result. Entries of the record about the robot and the parties
            that it does not give are those of the result, and all of them if the rows are of the calibration's table.
        tolerance: Largest deviation allowed, by the symbol of the unit, ``"m"`` or ``"rad"``, in that unit; None:
            conformity is not stated.
        uncertainty: Expanded uncertainty (k = 2) of a measured deviation, by the same symbols, as the laboratory states
            it; None, and a unit that is missing: it is computed.
        prior: Mean and standard deviation of the largest deviation of such robots after calibration, by the same
            symbols, for the risks over all of them; None: these are not stated.
        non_geometric: Whether the robot with the non-geometric model is certified, else that of the corrected URDF.

    Returns:
        The certificate.

    Raises:
        ArgumentError: An argument of another type or with another unit.
        CalibError: A tolerance, uncertainty or prior that is not positive, or an input that is refused.
        ModelError: No measurements were given, and the calibration was read from a file; or the robot is neither the
            nominal nor the corrected one of the calibration.
        MeasurementError: The rows measure neither positions, lengths nor orientations, or the calibration was fitted to
            all of them.
    """
    check_type(
        "calibration",
        calibration,
        (Calibration, str, Path),
        "a Calibration, or the path of its file",
    )
    files, result = Files(), calibration
    if not isinstance(result, Calibration):
        files = files_of(result)
        result = read_result(result)
    stated_cell = with_chain_of_result(cell_of(cell), result, "The calibration")
    if not isinstance(robot, Robot) and (result.nominal.branches or result.nominal.parts):
        robot = robot_with_chains_of(result.nominal, read_urdf(str(robot)), stated_cell.held)
    table: TableInput = result.fit.measurements if measurements is None else measurements
    arm, rows, known_cell = inputs_of(robot, table, result.complete_cell(stated_cell))
    return certificate_of(
        arm,
        rows,
        known_cell,
        result,
        files,
        tolerance=tolerance,
        uncertainty=uncertainty,
        prior=prior,
        non_geometric=non_geometric,
    )


def certificate_of(
    robot: Robot,
    table: Measurements,
    cell: Cell,
    calibration: Calibration,
    files: Files,
    *,
    which: tuple[str, ...] = PLACES,
    tolerance: Mapping[str, float] | None = None,
    uncertainty: Mapping[str, float] | None = None,
    prior: Mapping[str, tuple[float, float]] | None = None,
    non_geometric: bool = False,
) -> Certificate:
    """Make a certificate of inputs that were read; see `certificate`.

    Args:
        robot: The robot.
        table: The rows.
        cell: With the chain of the result.
        calibration: The result.
        files: Names and hashes.
        which: Places taken from the result and not registered to the rows: ``"frame"``, ``"target"``, both or none.
        tolerance: As of `certificate`.
        uncertainty: As of `certificate`.
        prior: As of `certificate`.
        non_geometric: As of `certificate`.
    """
    limits, stated, priors = _checked(tolerance, uncertainty, prior)
    judged = "non_geometric" if non_geometric else "calibration"
    if non_geometric and calibration.non_geometric is None:
        raise CalibError(
            "The result has no non-geometric model to be certified; leave non_geometric (--judge) out."
        )
    is_corrected(calibration, robot)  # refuses one that is neither as found nor as left
    assessment = assess(robot, table, cell, calibration, which=which, judge=judged)
    left = assessment.evaluations[judged]
    accurate = assessment.accuracies[judged]
    _check_rows(table, accurate)

    found = assessment.accuracies.get("nominal")
    rows = point_rows(calibration, left, accurate.poses, non_geometric=non_geometric)
    by_unit: dict[str, list[Deviation | None]] = {}
    estimated = []
    for unit in PARTS:
        if unit not in accurate.units:
            continue
        if unit in stated:
            expanded = Expanded.stated(stated[unit], len(rows.poses))
        else:
            reading = reading_noise(calibration, cell, left, accurate.poses, unit)
            expanded = Expanded.of(rows, unit, reading)
            if not reading.is_stated:
                estimated.append(unit)
        by_unit[unit] = deviations(rows, () if found is None else found.poses, unit, expanded)
        if unit in limits:
            by_unit[unit] = _with_conformance(by_unit[unit], limits[unit], accurate.factor)

    decisions: dict[str, Decision] = {}
    if limits:
        guard_bands = {
            unit: max(one.uncertainty for one in by_unit.get(unit, ()) if one is not None)
            for unit in limits
            if unit in by_unit
        }
        seen = fitted_rows(calibration, robot, table, cell)
        accepted = acceptance(left, limits, uncertainty=guard_bands, seen=seen)
        assessment = replace(assessment, accepted=accepted)
        for unit, check in accepted.checks.items():
            decisions[unit] = _decision(check, by_unit[unit], priors.get(unit))

    points = _points(rows, table, calibration, by_unit)
    record = _record(cell.record, calibration.record, own_table=bool(accurate.fitted))
    return Certificate(
        calibration=calibration,
        assessment=assessment,
        record=record,
        points=points,
        budget=Budget.of(rows.uncertainty),
        decisions=decisions,
        box=_box(calibration, points),
        gaps=gaps(assessment, calibration, points, record, estimated),
        stated={unit: value for unit, value in stated.items() if unit in by_unit},
        files=files,
        time=date_text(now()),
    )


def files_of(path: str | Path, command: str = "") -> Files:
    """Return name and hash of the result's file, with the command line.

    Args:
        path: The file.
        command: The command line; empty: none.

    Raises:
        FileError: It cannot be read.
    """
    contents = read_bytes(path, "calibration result")
    return Files(Path(path).name, hashlib.sha256(contents).hexdigest(), command)


def priors_of(
    means: Mapping[str, float] | None, stds: Mapping[str, float] | None
) -> dict[str, tuple[float, float]] | None:
    """Return mean and standard deviation by unit; None for neither.

    Args:
        means: By the symbol of the unit, in that unit; None: not given.
        stds: The same.

    Raises:
        CalibError: One has a unit that the other lacks.
    """
    if means is None and stds is None:
        return None
    if means is None or stds is None or means.keys() != stds.keys():
        raise CalibError(
            '--prior-mean and --prior-std go together, in the same units: --prior-mean "0.3 mm" --prior-std '
            '"0.1 mm".'
        )
    return {unit: (mean, stds[unit]) for unit, mean in means.items()}


def _checked(
    tolerance: Mapping[str, float] | None,
    uncertainty: Mapping[str, float] | None,
    prior: Mapping[str, tuple[float, float]] | None,
) -> tuple[Mapping[str, float], Mapping[str, float], Mapping[str, tuple[float, float]]]:
    """Return tolerances, uncertainties and priors by unit, empty for None; ArgumentError for what is not allowed."""
    for name, given in (("tolerance", tolerance), ("uncertainty", uncertainty), ("prior", prior)):
        if given is None:
            continue
        check_mapping(name, given)
        for unit, value in given.items():
            if unit not in PARTS:
                raise ArgumentError(
                    f"The argument '{name}' is for {unit!r}; a certificate states {choices(PARTS)}."
                )
            numbers = value if isinstance(value, tuple) else (value,)
            if len(numbers) != (2 if name == "prior" else 1) or not all(
                isinstance(number, (int, float)) and 0.0 < number < np.inf for number in numbers
            ):
                wanted = "a mean and a standard deviation" if name == "prior" else "a number"
                raise ArgumentError(
                    f"The argument '{name}' has {value!r} for {unit!r}; it must be {wanted} above 0."
                )
    if prior is not None and tolerance is None:
        raise ArgumentError(
            "A prior (--prior-mean and --prior-std, in Python 'prior') needs a tolerance (--tolerance), as its risks "
            "are those of a decision."
        )
    return tolerance or {}, uncertainty or {}, prior or {}


def _check_rows(table: Measurements, accurate: Accuracy) -> None:
    """Refuse, by a `MeasurementError`, rows that measure only images, and rows that the calibration was fitted to."""
    source = table.source or "Measurements"
    if not any(unit in accurate.units for unit in PARTS):
        raise MeasurementError(
            f"{source}: a certificate states deviations of positions, lengths or orientations, and these rows are "
            "images. Measure points or poses, or test images by 'calib evaluate --tolerance \"0.5 px\"'."
        )
    if accurate.seen:
        raise MeasurementError(
            f"{source}: the calibration was fitted to all rows, which then prove nothing. Give rows that were measured "
            "afterwards, of five poses or more, or calibrate with some rows set aside (set = validate)."
        )


def _with_conformance(
    of_points: Sequence[Deviation | None], tolerance: float, factor: float
) -> list[Deviation | None]:
    """Return the deviations of points, each with its probability to be within a tolerance.

    Deviations count by the ``factor`` by which they were larger before something was registered to the same rows.
    """
    result: list[Deviation | None] = []
    for one in of_points:
        if one is None:
            result.append(None)
            continue
        p = conformance_probability(factor * one.left, tolerance, one.uncertainty, one.freedom)
        result.append(replace(one, conformance=float(p)))
    return result


def _decision(
    check: Check, of_points: Sequence[Deviation | None], prior: tuple[float, float] | None
) -> Decision:
    """Return the decision in one unit, with its risks."""
    measured = [one for one in of_points if one is not None]
    risks = None
    widest = max(measured, key=lambda one: one.uncertainty)
    if prior is not None:
        risks = global_risks(
            prior, check.tolerance, standard_uncertainty(widest), check.uncertainty
        )
    missing = sum(1.0 - one.conformance for one in measured)
    return Decision(check, max(1.0 - missing, 0.0), prior, risks)


def _points(
    rows: PointRows,
    table: Measurements,
    calibration: Calibration,
    by_unit: Mapping[str, Sequence[Deviation | None]],
) -> tuple[Point, ...]:
    """Return the points with what was measured there."""
    q = table.joints_for(calibration.nominal.joint_names)
    points = []
    for k, pose in enumerate(rows.poses):
        of_point = {}
        for unit, of_points in by_unit.items():
            one = of_points[k]
            if one is not None:
                of_point[unit] = one
        points.append(
            Point(
                rows=pose.rows,
                group=pose.group,
                target=pose.target,
                joints=read_only(q[rows.first[k]]),
                position=read_only(rows.positions[k]),
                deviations=of_point,
            )
        )
    return tuple(points)


def _box(calibration: Calibration, points: Sequence[Point]) -> tuple[Range, ...]:
    """Return by joint the range in which the certificate is valid."""
    robot = calibration.nominal
    q = np.array([point.joints for point in points])
    ranges = zip(
        robot.inputs, calibration.rows.ranges, q.min(axis=0), q.max(axis=0), column_limits(robot),
        strict=True,
    )  # fmt: skip
    return tuple(
        Range(
            joint=joint.name,
            prismatic=joint.type == "prismatic",
            calibrated=(float(fitted[0]), float(fitted[1])),
            tested=(float(low), float(high)),
            limits=(float(limits[0]), float(limits[1])),
        )
        for joint, fitted, low, high, limits in ranges
    )


def _record(given: Record, of_result: Record, *, own_table: bool) -> Record:
    """Return the record of a certificate: as given, and what it lacks from the result's.

    Of the result's come the entries about robot and parties, and all if its own table is certified.
    """
    names = of_result.given if own_table else [name for name in _OF_ITEM if name in of_result.given]
    missing = {name: getattr(of_result, name) for name in names if name not in given.given}
    return replace(given, **missing)
