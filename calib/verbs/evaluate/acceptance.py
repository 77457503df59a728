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
from dataclasses import dataclass, replace
from typing import Any, Literal, NoReturn

import numpy as np
from scipy.special import betaincinv

from calib.basics.arguments import check_mapping, check_type
from calib.basics.arrays import Array, Mask
from calib.basics.channels import RESIDUAL_UNITS, residual_unit
from calib.basics.units import split_header
from calib.basics.values import ReadOnlyMapping, Value, keep_read_only, one_line
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.coverage import OutsideRow
from calib.diagnosis.reasons import Reason
from calib.diagnosis.usual_mistakes import find_usual_mistake
from calib.errors import CalibError, MeasurementError, choices
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.verbs.evaluate.accuracy import Accuracy, PoseAccuracy, accuracy, fitted_rows
from calib.verbs.evaluate.characteristics import Characteristic, characteristics
from calib.verbs.evaluate.evaluation import (
    Evaluation,
    evaluate,
    moved_place,
    registration_rows,
)

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
    """One figure compared with its tolerance, in one unit."""

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
        """``"fail"`` if A - U > T, ``"pass"`` if f A + U <= T and the judged rows are unseen, else ``"undecided"``.

        Of this check's fields, A is ``figure``, an error such as the largest pose accuracy, U ``uncertainty``, the
        expanded measuring uncertainty, and T ``tolerance``, all in m or all in rad; f >= 1 is ``factor``, random errors
        before frames or targets were registered to the judged rows over those after it. ``seen`` is True where a
        calibration was fitted to judged rows: these can fail, but not pass.
        """
        if self.figure - self.uncertainty > self.tolerance:
            return "fail"
        if self.held <= self.tolerance and not self.seen:
            return "pass"
        return "undecided"

    @property
    def held(self) -> float:
        """The sum f A + U [m] or [rad], which must be within the tolerance for a pass.

        A is the judged error ``figure``, U its expanded measuring ``uncertainty``, in the same unit, and f >= 1 the
        ``factor`` by which random errors were larger before frames or targets were registered to the judged rows.
        """
        return self.figure * self.factor + self.uncertainty


@dataclass(frozen=True, slots=True, eq=False)
class Acceptance:
    """The outcome of an acceptance test."""

    #: Accuracy and repeatability at each pose
    accuracy: Accuracy
    #: One of `CRITERIA`
    criterion: str
    #: The comparison in each unit of which a tolerance was stated: ``"m"`` of positions or lengths, ``"rad"`` of
    #: orientations
    checks: Mapping[str, Check]
    #: Number of poses that are within the tolerances, by the error that the criterion looks at in each
    within: int

    def __post_init__(self) -> None:
        """Keep a copy that cannot be changed."""
        object.__setattr__(self, "checks", ReadOnlyMapping(self.checks))

    def __repr__(self) -> str:
        """Return one line: the outcome, each figure with its tolerance, and the poses within."""
        figures = []
        for symbol, check in self.checks.items():
            unit = residual_unit(symbol)
            figure, tolerance = unit.to_shown * check.figure, unit.to_shown * check.tolerance
            figures.append(
                f"{self.criterion} {figure:.{unit.digits}f} of {tolerance:g} {unit.shown}"
            )
        within = f"{self.within} of {len(self.accuracy.poses)} poses within"
        return one_line("Acceptance", self.outcome, *figures, within)

    @property
    def outcome(self) -> Outcome:
        """``"pass"``, ``"undecided"`` or ``"fail"``: the worst outcome of the ``checks``."""
        outcomes = [check.outcome for check in self.checks.values()]
        return max(outcomes, key=OUTCOMES.index)

    @property
    def share(self) -> float:
        """Least share of poses, chosen as these were, that is within the tolerances, with 95 % confidence; 0 to 1.

        Clopper and Pearson's lower limit of a binomial share, where the number ``within`` of the judged
        ``accuracy.poses`` are within the tolerances; it holds for poses chosen at random and independently of each
        other.
        """
        count = len(self.accuracy.poses)
        if not self.within:
            return 0.0
        return float(betaincinv(self.within, count - self.within + 1, 0.05))

    def size(self, pose: PoseAccuracy, unit: str) -> float:
        """Return the error of a pose that this acceptance test's ``criterion`` looks at.

        Args:
            pose: Accuracy and repeatability at one of the judged poses, over its repeats.
            unit: Symbol of the unit: ``"m"`` for the error of the position or length, ``"rad"`` for the orientation's.

        Returns:
            The largest error of a single repeat where the criterion is ``"single"``; for ``"max"`` and ``"mean"`` the
            pose accuracy AP, the norm of the mean error over the repeats; in the unit, 0 or more. NaN if it was not
            measured.
        """
        return error_of(pose, self.criterion, unit)

    def used(self, pose: PoseAccuracy) -> float:
        """Return the share of its tolerance that a pose uses: error over tolerance.

        Args:
            pose: Accuracy and repeatability at one of the judged poses. Its error is the largest of a single repeat, or
                the pose accuracy AP, by ``criterion``.

        Returns:
            The largest error over tolerance in a unit of which ``checks`` has a tolerance [1]: 0 or more, above 1 out
            of tolerance; 0 if no such error was measured at the pose.
        """
        largest = 0.0
        for unit, check in self.checks.items():
            share = self.size(pose, unit) / check.tolerance
            if np.isfinite(share):
                largest = max(largest, share)
        return largest


def error_of(pose: PoseAccuracy, criterion: str, unit: str) -> float:
    """Return the error of a pose that a criterion of acceptance looks at.

    Args:
        pose: Accuracy and repeatability at one pose, over its repeats: measured minus predicted.
        criterion: ``"single"`` looks at the largest error of a single repeat; ``"max"`` and ``"mean"`` at the pose
            accuracy AP, the norm of the mean error over the repeats.
        unit: Symbol of the unit: ``"m"`` for the error of the position or length, ``"rad"`` for the orientation's.

    Returns:
        The error in the unit, 0 or more; NaN if it was not measured at the pose.
    """
    figures = pose[unit]
    return figures.single if criterion == "single" else figures.ap


def acceptance(
    evaluation: Evaluation,
    tolerance: Mapping[str, float],
    *,
    uncertainty: Mapping[str, float] | None = None,
    criterion: str = "max",
    seen: bool | Mask = False,
) -> Acceptance:
    """Compare a robot's pose accuracy with a tolerance, which it keeps or not for certain, or neither (ISO 14253-1).

    Judged are rows that no calibration was fitted to and nothing registered to where there are enough of them, else all
    measured rows; see `calib.verbs.evaluate.accuracy.judged_rows`.

    Args:
        evaluation: Residuals, measured minus predicted, of the robot that is judged at the N rows of a table, with
            frames and targets as given or registered.
        tolerance: By the symbol of its unit: ``"m"`` of positions and lengths, ``"rad"`` of orientations; what has none
            is not judged.
        uncertainty: Expanded uncertainty (k = 2) of what is measured, by the same symbols; None, and for a unit that is
            missing: it is not taken account of.
        criterion: What must be within: ``"max"``, the pose accuracy AP of every pose, the norm of its mean error over
            repeats; ``"mean"``, the mean of AP over the poses; ``"single"``, the error of every single repeat.
        seen: True for the rows that a calibration of this robot was fitted to, shape (N,); or one bool: whether it was
            fitted to the estimation rows.

    Returns:
        The check in each unit, ``"pass"``, ``"undecided"`` or ``"fail"``; the accuracy at each pose; and the number of
        poses within all tolerances.

    Raises:
        ArgumentError: An argument of another type.
        CalibError: No tolerance, one that is not positive, an uncertainty below 0, or no such criterion or unit.
        MeasurementError: No row measures anything, or none in a unit that has a tolerance.
    """
    check_type("evaluation", evaluation, Evaluation, "an Evaluation, such as of calib.evaluate")
    check_mapping("tolerance", tolerance)
    if uncertainty is not None:
        check_mapping("uncertainty", uncertainty)
    if not tolerance:
        raise CalibError("State a tolerance: of positions in m, of orientations in rad, or both.")
    uncertainty = {} if uncertainty is None else uncertainty
    for unit, limit in tolerance.items():
        _check_limits(limit, uncertainty.get(unit, 0.0), residual_unit(unit).symbol)
    if criterion not in CRITERIA:
        raise CalibError(f"The criterion is '{criterion}'; choose one of {choices(CRITERIA)}.")
    judged = accuracy(evaluation, seen=seen)
    checks = {}
    within = np.ones(len(judged.poses), dtype=bool)
    for unit in (unit for unit in RESIDUAL_UNITS if unit in tolerance):
        limit = tolerance[unit]
        sizes = np.array([error_of(pose, criterion, unit) for pose in judged.poses])
        if not np.any(np.isfinite(sizes)):
            _refuse_unmeasured(evaluation.measurements.source, limit, unit)
        checks[unit] = _check(judged, criterion, sizes, limit, uncertainty.get(unit, 0.0))
        # A pose without such an error, NaN here, is judged by its others.
        within &= ~(sizes > limit)
    return Acceptance(judged, criterion, checks, int(np.sum(within)))


def _refuse_unmeasured(source: str, tolerance: float, symbol: str) -> NoReturn:
    """Refuse a tolerance of what no judged row measures.

    Args:
        source: The table's file; may be empty.
        tolerance: The tolerance, in its unit.
        symbol: Symbol of the unit.
    """
    unit = RESIDUAL_UNITS[symbol]
    raise MeasurementError(
        f"{source or 'Measurements'}: a tolerance of {unit.to_shown * tolerance:g} {unit.shown} was stated, and no "
        f"{unit.measured} was measured in the rows that are judged."
    )


def _check_limits(tolerance: float, uncertainty: float, unit: str) -> None:
    """Refuse a tolerance that is not positive and finite, and an uncertainty that is negative or infinite.

    Args:
        tolerance: The stated tolerance, in the unit.
        uncertainty: Expanded measuring uncertainty, in the unit; 0 where none was stated.
        unit: Symbol of the unit, for the error message.

    Raises:
        CalibError: One of them is out of range.
    """
    if not 0.0 < tolerance < np.inf or not 0.0 <= uncertainty < np.inf:
        raise CalibError(
            f"The tolerance is {tolerance} {unit} with an uncertainty of {uncertainty} {unit}; the first must be above "
            "0, the second 0 or larger."
        )


def _check(
    judged: Accuracy,
    criterion: str,
    sizes: Array,
    tolerance: float,
    uncertainty: float,
) -> Check:
    """Compare the errors of poses with a tolerance, all in one unit.

    Args:
        judged: Accuracy of the robot. Of it are used ``seen``, whether a calibration was fitted to judged rows, and
            ``factor``, 1 or more, random errors before frames or targets were registered to the judged rows over those
            after it.
        criterion: ``"mean"`` compares the mean of the errors, ``"max"`` and ``"single"`` compare the largest.
        sizes: Error of each of k poses, shape (k,), 0 or more; NaN where it was not measured, but not everywhere.
        tolerance: The tolerance T > 0.
        uncertainty: Expanded measuring uncertainty U; 0: it is not taken account of.

    Returns:
        The judged error with tolerance, uncertainty and factor, from which the outcome follows.
    """
    figure = np.nanmean(sizes) if criterion == "mean" else np.nanmax(sizes)
    return Check(float(figure), tolerance, uncertainty, judged.factor, judged.seen)


@dataclass(frozen=True, slots=True, eq=False)
class Assessment(Value):
    """Every robot that a URDF and a result hold, compared with one table."""

    #: Errors, by ``"nominal"``, ``"urdf"``, ``"calibration"`` and ``"non_geometric"`` as far as there are such robots
    evaluations: Mapping[str, Evaluation]
    #: Their pose accuracy, by the same names
    accuracies: Mapping[str, Accuracy]
    #: Their further characteristics by ISO 9283, by the same names
    characteristics: Mapping[str, tuple[Characteristic, ...]]
    #: Name of the robot that is judged
    judged: str
    #: The acceptance, where a tolerance was stated
    accepted: Acceptance | None
    #: Judged rows with joint values outside of the fitted ranges, and the numbers of all judged rows
    outside: tuple[tuple[OutsideRow, ...], tuple[int, ...]]
    #: An explanation by which the rows would fit far better: a usual mistake, or a frame or target that has moved since
    #: the calibration
    hint: Reason | None

    def __post_init__(self) -> None:
        """Keep read-only copies of the mappings."""
        keep_read_only(self, "evaluations", "accuracies", "characteristics")

    @classmethod
    def of_one(cls, evaluation: Evaluation, accepted: Acceptance | None = None) -> Assessment:
        """Return the assessment of a single robot, called ``"urdf"``.

        Args:
            evaluation: Residuals of the robot at the rows of a table.
            accepted: Its acceptance, of the same evaluation; None: no tolerance was stated.
        """
        judged = accuracy(evaluation) if accepted is None else accepted.accuracy
        return cls(
            evaluations={"urdf": evaluation},
            accuracies={"urdf": judged},
            characteristics={"urdf": characteristics(evaluation, judged)},
            judged="urdf",
            accepted=accepted,
            outside=((), ()),
            hint=None,
        )


def assess(
    robot: Robot,
    table: Measurements,
    cell: Cell,
    calibration: Calibration | None = None,
    *,
    which: tuple[str, ...] = (),
    judge: str | None = None,
    limits: Mapping[str, Any] | None = None,
) -> Assessment:
    """Evaluate the robot as it is; and of a result its nominal robot, its joint origins, and its non-geometric model.

    Args:
        robot: The robot as its URDF is, nominal or corrected.
        table: The N measurement rows that the robots are compared with.
        cell: What is known of frames, targets and loads.
        calibration: A result of this robot; None: only the URDF is evaluated.
        which: What is taken from the result and not registered to these rows: ``"frame"``, ``"target"``, both or none.
        judge: Name of the robot that is judged, a key of `Assessment.evaluations`; None: the calibrated one, or the
            URDF's without a result.
        limits: Arguments of `acceptance` by name, such as ``{"tolerance": {"m": 5e-4}}``; None or empty: no acceptance
            test.

    Returns:
        Residuals and pose accuracy of each robot by its name, and the acceptance of the judged one if there are limits;
        judged rows outside of the fitted joint ranges; and a usual mistake or a moved frame or target that explains
        large errors.

    Raises:
        CalibError: There is no such robot to be judged, or what `evaluate` and `acceptance` raise.
        MeasurementError: The table holds commands, and nothing was measured.
    """
    _refuse_commands(robot, table, calibration)
    if calibration is not None:
        cell = calibration.optics.given_to(cell)
    evaluations = _evaluations(robot, table, cell, calibration, which)
    seen = np.zeros(len(table), dtype=bool)
    if calibration is not None:
        seen = fitted_rows(calibration, robot, table, cell)
    judged = _judged_name(judge, evaluations)
    accuracies = {name: accuracy(evaluation, seen=seen) for name, evaluation in evaluations.items()}
    accepted = None
    if limits:
        accepted = acceptance(evaluations[judged], **limits, seen=seen)
    return Assessment(
        evaluations=evaluations,
        accuracies=accuracies,
        characteristics={
            name: characteristics(evaluations[name], figures)
            for name, figures in accuracies.items()
        },
        judged=judged,
        accepted=accepted,
        outside=_outside(table, calibration, accuracies[judged], judged),
        hint=_explanation(evaluations, cell, calibration, which),
    )


def _evaluations(
    robot: Robot,
    table: Measurements,
    cell: Cell,
    calibration: Calibration | None,
    which: tuple[str, ...],
) -> dict[str, Evaluation]:
    """Evaluate each robot that a URDF and a result hold against one table.

    Args:
        robot: The robot as its URDF is, nominal or corrected.
        table: The N measurement rows.
        cell: What is known of frames, targets and loads.
        calibration: A result of this robot: joint origins, frames and targets, nominal and calibrated; None: only the
            URDF is evaluated.
        which: What is taken from the result and not registered to these rows: ``"frame"``, ``"target"``, both or none.

    Returns:
        Residuals of each robot, measured minus predicted, by its name: ``"urdf"``, the robot as it is; and with a
        result ``"nominal"``, its nominal robot unless a frame of it was not found; ``"calibration"``, the robot with
        calibrated joint origins; and ``"non_geometric"``, the nominal robot with the non-geometric model, if there is
        one.
    """
    if calibration is None:
        return {"urdf": evaluate(robot, table, cell)}
    nominal, corrected = calibration.uncorrected(robot), calibration.corrected(robot)
    setup = calibration.setup
    evaluations = {}
    if calibration.rows.nominal_is_judged:
        known = calibration.nominal_setup
        evaluations["nominal"] = evaluate(nominal, table, cell, known=known, which=which)
    evaluations["urdf"] = evaluate(robot, table, cell, known=setup, which=which)
    evaluations["calibration"] = evaluate(corrected, table, cell, known=setup, which=which)
    if calibration.non_geometric is not None:
        model = calibration.non_geometric
        evaluations["non_geometric"] = evaluate(
            nominal, table, cell, which=which, non_geometric=model
        )
    return evaluations


def _explanation(
    evaluations: Mapping[str, Evaluation],
    cell: Cell,
    calibration: Calibration | None,
    which: tuple[str, ...],
) -> Reason | None:
    """Explain large errors of the robot by something other than the robot itself.

    Args:
        evaluations: Errors of each robot at the rows of one table, by the names of `Assessment.evaluations`:
            ``"urdf"``, and with a result ``"calibration"``, each with its robot and the table.
        cell: What is known of frames, targets and loads.
        calibration: The result that was evaluated, with its frames and targets; None: there is none.
        which: What was taken from the result: ``"frame"``, ``"target"``, both or none.

    Returns:
        Without a result a usual mistake of the table, such as a wrong unit, that would explain the URDF's errors far
        better; with one the frame or target that has moved since. None where nothing of this kind explains the errors.
    """
    if calibration is None:
        urdf = evaluations["urdf"]
        table = urdf.measurements
        # A target that was given is where it was given, its orientation too.
        known = replace(cell, estimate_target="target" in urdf.registered)
        return find_usual_mistake(urdf.robot, known, table.select(registration_rows(table)))
    corrected = evaluations["calibration"]
    return moved_place(corrected.robot, corrected.measurements, cell, calibration.setup, which)


def _judged_name(judge: str | None, evaluations: Mapping[str, Evaluation]) -> str:
    """Return the name of the robot that is judged.

    Args:
        judge: The name that the user chose; None or empty: ``"calibration"`` if there is one, else ``"urdf"``.
        evaluations: Errors of each robot, by the names to choose from: ``"urdf"``, and with a result ``"nominal"``,
            ``"calibration"`` and perhaps ``"non_geometric"``.

    Returns:
        A key of ``evaluations``.

    Raises:
        CalibError: There is no such robot.
    """
    default = "calibration" if "calibration" in evaluations else "urdf"
    judged = judge or default
    if judged not in evaluations:
        raise CalibError(
            f"--judge {judged}: there is no such robot; choose one of {choices(evaluations)}."
        )
    return judged


def _outside(
    table: Measurements,
    calibration: Calibration | None,
    figures: Accuracy,
    judged: str,
) -> tuple[tuple[OutsideRow, ...], tuple[int, ...]]:
    """List judged rows whose joint values lie outside of the ranges that the calibration was fitted to.

    Args:
        table: All N rows, with their numbers in the table, from 1, and joint values.
        calibration: The result, with the smallest and largest fitted value of each joint; None: there are no fitted
            ranges.
        figures: Accuracy of the robot that is judged; each of its poses names the rows that repeat it, of which the
            first counts.
        judged: Name of that robot, of `Assessment.evaluations`; only ``"calibration"`` and ``"non_geometric"`` depend
            on fitted ranges.

    Returns:
        The rows outside, each by its index, from 0, in the second part, with the joints and by how much, [rad] or [m];
        empty for other robots. And the numbers in the table of the first rows of all judged poses.
    """
    numbers = tuple(pose.rows[0] for pose in figures.poses)
    if calibration is None or judged not in ("calibration", "non_geometric"):
        return (), numbers
    first_rows = np.isin(table.rows, numbers)
    q = table.joints_for(calibration.nominal.joint_names)[first_rows]
    numbers = tuple(np.array(table.rows)[first_rows].tolist())
    return calibration.outside_of_measured(q), numbers


def _refuse_commands(robot: Robot, table: Measurements, calibration: Calibration | None) -> None:
    """Refuse a table of commands, whose poses the nominal robot predicts: any tolerance would seem to be kept.

    Commands are recognised by a column that 'calib compensate' writes, together with errors of the nominal robot below
    `_EXACT` [m] in all rows, which hold more scalars than the registration of frame and target has unknowns.

    Args:
        robot: The robot as its URDF is, nominal or corrected.
        table: The rows, measured or commanded; ``ignored`` are the headers of columns that are not used otherwise.
        calibration: The result with the nominal joint origins of this robot; None: the robot is taken to be nominal.

    Raises:
        MeasurementError: The table holds commands, and nothing was measured.
        UrdfError: The robot lacks one of the result's joints.
    """
    nominal = robot if calibration is None else calibration.uncorrected(robot)
    columns = {split_header(label)[0] for label in table.ignored}
    if _COMMANDS not in columns:
        return
    try:
        evaluation = evaluate(nominal, table, Cell(estimate_frame=True))
    except CalibError:
        return  # too few rows to tell
    enough = evaluation.used.sum() > evaluation.setup.count
    if enough and evaluation.errors["all"]["m"].max < _EXACT:
        raise MeasurementError(
            f"{table.source}: these are commands that 'calib compensate' wrote, and nothing was measured. Put what was "
            "measured in the place of x, y, z, or give it as a list of its own with --points."
        )
