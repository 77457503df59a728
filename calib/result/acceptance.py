"""Acceptance: whether a robot's pose accuracy is within a stated tolerance, proved against the measuring uncertainty.

With the figure A that is judged, the tolerance T, the expanded measuring uncertainty U (ISO 14253-1), and the factor
f >= 1 by which errors were larger before something was registered to the same rows,

    f A + U <= T    pass:       conformity is proved
    A - U > T       fail:       non-conformity is proved
    else            undecided:  neither is

Without U this is the plain comparison of A with T. Rows that a calibration was fitted to can fail, but not pass.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.special import betaincinv

from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.coverage import OutsideRow
from calib.diagnosis.reasons import Reason
from calib.diagnosis.usual_mistakes import find_usual_mistake
from calib.errors import CalibError, MeasurementError, choices
from calib.result.accuracy import Accuracy, PoseAccuracy, accuracy, fitted_rows
from calib.result.calibration import CalibrationValues
from calib.result.evaluation import Evaluation, evaluate, moved_place, registration_rows
from calib.robot.robot import Robot
from calib.units import Array, Mask, split_header

Outcome = Literal["pass", "undecided", "fail"]

#: From the best to the worst: of several checks the worst outcome counts.
OUTCOMES: tuple[Outcome, ...] = ("pass", "undecided", "fail")

#: What is compared with the tolerance: the largest AP, their mean, or the largest error of a single repeat.
CRITERIA = ("max", "mean", "single")

#: A column that every table of commands has.
_COMMANDS = "correction position"

#: The nominal robot predicts the poses of commands to this distance [m]; measured ones are further off.
_EXACT = 1e-6


@dataclass(frozen=True, slots=True)
class Check:
    """One figure compared with its tolerance, in m or rad."""

    #: The figure A that is judged
    figure: float
    #: The tolerance T
    tolerance: float
    #: Expanded measuring uncertainty U as stated; 0 where none was
    uncertainty: float
    #: The factor f: random errors before registration to the same rows over those after it; >= 1
    factor: float
    #: Whether a calibration was fitted to the judged rows
    seen: bool

    @property
    def outcome(self) -> Outcome:
        """One of `OUTCOMES`."""
        if self.figure - self.uncertainty > self.tolerance:
            return "fail"
        if self.held <= self.tolerance and not self.seen:
            return "pass"
        return "undecided"

    @property
    def held(self) -> float:
        """The sum f A + U, which must be within the tolerance for a pass."""
        return self.figure * self.factor + self.uncertainty


@dataclass(frozen=True, slots=True, eq=False)
class Acceptance:
    """The outcome of an acceptance test."""

    #: Accuracy and repeatability at each pose
    accuracy: Accuracy
    #: One of `CRITERIA`
    criterion: str
    #: Of positions or lengths [m]; None where no tolerance was stated
    length: Check | None
    #: Of orientations [rad]; likewise
    angle: Check | None
    #: Number of poses that are within the tolerances, by the error that the criterion looks at in each
    within: int

    @property
    def checks(self) -> tuple[tuple[Check, bool], ...]:
        """The checks that were made, each with True if it is of angles."""
        both = ((self.length, False), (self.angle, True))
        return tuple((check, angle) for check, angle in both if check is not None)

    @property
    def outcome(self) -> Outcome:
        """``"pass"``, ``"undecided"`` or ``"fail"``: the worst of the checks."""
        return max((check.outcome for check, _ in self.checks), key=OUTCOMES.index)

    @property
    def share(self) -> float:
        """Least share of poses, chosen as these were, that is within the tolerances, with 95 % confidence.

        Clopper and Pearson's lower limit; it holds for poses chosen at random and independently of each other.
        """
        count = len(self.accuracy.poses)
        if not self.within:
            return 0.0
        return float(betaincinv(self.within, count - self.within + 1, 0.05))

    def size(self, pose: PoseAccuracy, *, angle: bool) -> float:
        """Return the error of a pose that the criterion looks at; NaN if it has none.

        Args:
            pose: One of the judged poses.
            angle: Of orientations [rad], and not of positions [m].
        """
        return error_of(pose, self.criterion, angle=angle)

    def used(self, pose: PoseAccuracy) -> float:
        """Return the share of its tolerance that a pose uses, the larger of both; 0 if it has no error."""
        shares = (self.size(pose, angle=angle) / c.tolerance for c, angle in self.checks)
        return max((share for share in shares if np.isfinite(share)), default=0.0)


def error_of(pose: PoseAccuracy, criterion: str, *, angle: bool) -> float:
    """Return the error of a pose that a criterion looks at; NaN if it has none.

    Args:
        pose: The pose.
        criterion: One of `CRITERIA`: ``"single"`` looks at the largest error of a repeat, the others at AP.
        angle: Of orientations [rad], and not of positions [m].
    """
    name = "single" if criterion == "single" else "ap"
    return float(getattr(pose, f"{name}_angle" if angle else name))


def acceptance(
    evaluation: Evaluation,
    tolerance: float | None = None,
    tolerance_angle: float | None = None,
    *,
    uncertainty: float = 0.0,
    uncertainty_angle: float = 0.0,
    criterion: str = "max",
    seen: bool | Mask = False,
) -> Acceptance:
    """Compare a robot's pose accuracy with a tolerance.

    Args:
        evaluation: The errors of the robot that is judged.
        tolerance: Of positions and lengths [m]; None: they are not judged.
        tolerance_angle: Of orientations [rad]; likewise.
        uncertainty: Expanded uncertainty (k = 2) of a measured position or length [m]; 0: it is not taken account of.
        uncertainty_angle: The same of a measured orientation [rad].
        criterion: What must be within: ``"max"``, the AP of every pose; ``"mean"``, the mean AP; ``"single"``, every
            single repeat.
        seen: Whether a calibration of this robot was fitted to the estimation rows; or to which rows, shape (N,).

    Raises:
        CalibError: No tolerance, one that is not positive, an uncertainty below 0, or no such criterion.
        MeasurementError: No row measures anything, or no orientation where these have a tolerance.
    """
    if tolerance is None and tolerance_angle is None:
        raise CalibError("State a tolerance: of positions in m, of orientations in rad, or both.")
    _check_limits(tolerance, uncertainty, "m")
    _check_limits(tolerance_angle, uncertainty_angle, "rad")
    if criterion not in CRITERIA:
        raise CalibError(f"The criterion is '{criterion}'; choose one of {choices(CRITERIA)}.")
    judged = accuracy(evaluation, seen=seen)
    if tolerance_angle is not None and not len(judged.of("ap_angle")):
        raise MeasurementError(
            f"{evaluation.measurements.source or 'Measurements'}: a tolerance of {np.degrees(tolerance_angle):g} deg "
            "was stated, and no orientation was measured in the rows that are judged."
        )
    length = angle = None
    within = np.ones(len(judged.poses), dtype=bool)
    if tolerance is not None:
        sizes = _sizes(judged, criterion, angle=False)
        length = _check(judged, criterion, sizes, tolerance, uncertainty)
        within &= ~(sizes > tolerance)
    if tolerance_angle is not None:
        sizes = _sizes(judged, criterion, angle=True)
        angle = _check(judged, criterion, sizes, tolerance_angle, uncertainty_angle)
        within &= ~(
            sizes > tolerance_angle
        )  # a pose without an orientation is judged by its position
    return Acceptance(judged, criterion, length, angle, int(np.sum(within)))


def _check_limits(tolerance: float | None, uncertainty: float, unit: str) -> None:
    """Refuse a tolerance that is not positive, and an uncertainty below 0, both in the unit."""
    stated = tolerance is None or 0.0 < tolerance < np.inf
    if not stated or not 0.0 <= uncertainty < np.inf:
        raise CalibError(
            f"The tolerance is {tolerance} {unit} with an uncertainty of {uncertainty} {unit}; the first must be above "
            "0, the second 0 or larger."
        )


def _sizes(judged: Accuracy, criterion: str, *, angle: bool) -> Array:
    """Return the error of each pose that the criterion looks at [m] or [rad], shape (poses,); NaN without one."""
    return np.array([error_of(pose, criterion, angle=angle) for pose in judged.poses])


def _check(
    judged: Accuracy, criterion: str, sizes: Array, tolerance: float, uncertainty: float
) -> Check:
    """Compare the errors of poses, shape (poses,), with a tolerance, all in [m] or in [rad]."""
    figure = np.nanmean(sizes) if criterion == "mean" else np.nanmax(sizes)
    return Check(float(figure), tolerance, uncertainty, judged.factor, judged.seen)


@dataclass(frozen=True, slots=True, eq=False)
class Assessment:
    """Every robot that a URDF and a result hold, compared with one table."""

    #: Errors, by ``"nominal"``, ``"urdf"``, ``"calibration"`` and ``"non_geometric"`` as far as there are such robots
    evaluations: Mapping[str, Evaluation]
    #: Their pose accuracy, by the same names
    accuracies: Mapping[str, Accuracy]
    #: Name of the robot that is judged
    judged: str
    #: The acceptance, where a tolerance was stated
    accepted: Acceptance | None
    #: Judged rows with joint values outside of the fitted ranges, and the numbers of all judged rows
    outside: tuple[tuple[OutsideRow, ...], tuple[int, ...]]
    #: An explanation by which the rows would fit far better: a usual mistake, or a frame or target that has moved since
    #: the calibration
    hint: Reason | None


def assess(
    robot: Robot,
    table: Measurements,
    cell: Cell,
    calibration: CalibrationValues | None = None,
    *,
    which: tuple[str, ...] = (),
    judge: str | None = None,
    limits: Mapping[str, Any] | None = None,
) -> Assessment:
    """Evaluate the robot as it is; and of a result its nominal robot, its joint origins, and its non-geometric model.

    Args:
        robot: The robot as its URDF is, nominal or corrected.
        table: The rows.
        cell: What is known of frames, targets and loads.
        calibration: A result of this robot; None: only the URDF is evaluated.
        which: What is taken from the result: ``"frame"``, ``"target"``, both or none.
        judge: Name of the robot that is judged; None: the calibrated one, or the URDF's without a result.
        limits: Arguments of `acceptance`; None: nothing is accepted or refused.

    Raises:
        CalibError: There is no such robot to be judged, or what `evaluate` and `acceptance` raise.
        MeasurementError: The table holds commands, and nothing was measured.
    """
    nominal = robot if calibration is None else calibration.uncorrected(robot)
    _check_measured(nominal, table)
    if calibration is None:
        evaluations = {"urdf": evaluate(robot, table, cell)}
        seen = np.zeros(len(table), dtype=bool)
        hint = find_usual_mistake(robot, cell, table.select(registration_rows(table)))
    else:
        evaluations = _evaluations(robot, table, cell, calibration, which)
        seen = fitted_rows(calibration, robot, table, cell)
        corrected = evaluations["calibration"].robot
        hint = moved_place(corrected, table, cell, calibration.setup, which)
    judged = judge or ("urdf" if calibration is None else "calibration")
    if judged not in evaluations:
        raise CalibError(
            f"--judge {judged}: there is no such robot; choose one of {choices(evaluations)}."
        )
    accuracies = {name: accuracy(one, seen=seen) for name, one in evaluations.items()}
    accepted = acceptance(evaluations[judged], **limits, seen=seen) if limits else None
    return Assessment(
        evaluations=evaluations,
        accuracies=accuracies,
        judged=judged,
        accepted=accepted,
        outside=_outside(table, calibration, accuracies[judged], judged),
        hint=hint,
    )


def _evaluations(
    robot: Robot,
    table: Measurements,
    cell: Cell,
    calibration: CalibrationValues,
    which: tuple[str, ...],
) -> dict[str, Evaluation]:
    """Evaluate the robots of a result; the arguments are those of `assess`.

    Returns:
        By the names of `Assessment.evaluations`.
    """
    nominal, corrected = calibration.uncorrected(robot), calibration.corrected(robot)
    setup = calibration.setup
    evaluations = {
        "nominal": evaluate(nominal, table, cell, known=calibration.nominal_setup, which=which),
        "urdf": evaluate(robot, table, cell, known=setup, which=which),
        "calibration": evaluate(corrected, table, cell, known=setup, which=which),
    }
    if calibration.non_geometric is not None:
        model = calibration.non_geometric
        evaluations["non_geometric"] = evaluate(
            nominal, table, cell, which=which, non_geometric=model
        )
    return evaluations


def _outside(
    table: Measurements, calibration: CalibrationValues | None, figures: Accuracy, judged: str
) -> tuple[tuple[OutsideRow, ...], tuple[int, ...]]:
    """List judged rows outside of the fitted ranges.

    Args:
        table: All rows.
        calibration: The result; None: there are no fitted ranges.
        figures: Accuracy of the robot that is judged.
        judged: Its name; only the calibrated one and the non-geometric model depend on fitted ranges.

    Returns:
        The rows outside, and the numbers of the first rows of all judged poses.
    """
    numbers = tuple(pose.rows[0] for pose in figures.poses)
    if calibration is None or judged not in ("calibration", "non_geometric"):
        return (), numbers
    first_rows = np.isin(table.rows, numbers)
    q = table.joints_for(calibration.nominal.joint_names)[first_rows]
    numbers = tuple(np.array(table.rows)[first_rows].tolist())
    return calibration.outside_of_measured(q), numbers


def _check_measured(nominal: Robot, m: Measurements) -> None:
    """Refuse a table of commands, whose poses the nominal robot predicts: any tolerance would seem to be kept."""
    if _COMMANDS not in {split_header(label)[0] for label in m.ignored}:
        return
    try:
        evaluation = evaluate(nominal, m, Cell(estimate_frame=True))
    except CalibError:
        return  # too few rows to tell
    enough = evaluation.used.sum() > evaluation.setup.count
    if enough and evaluation.errors["all"].max < _EXACT:
        raise MeasurementError(
            f"{m.source}: these are commands that 'calib compensate' wrote, and nothing was measured. Put what was "
            "measured in the place of x, y, z, or give it as a list of its own with --points."
        )
