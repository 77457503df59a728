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
from typing import Any, Literal

import numpy as np
from scipy.special import betaincinv

from calib.basics.arguments import check_mapping, check_type
from calib.basics.arrays import Mask
from calib.basics.channels import RESIDUAL_UNITS, residual_unit
from calib.basics.units import split_header
from calib.basics.values import ReadOnlyMapping, Value, keep_read_only, one_line
from calib.data.cell import Cell
from calib.data.measurements import Measurements
from calib.diagnosis.coverage import OutsideRow
from calib.diagnosis.reasons import Reason, Why
from calib.diagnosis.usual_mistakes import find_usual_mistake
from calib.errors import CalibError, MeasurementError, choices
from calib.numerics.moves import common_side
from calib.result.calibration import Calibration
from calib.robot.robot import Robot
from calib.verbs.evaluate.accuracy import Accuracy, PoseAccuracy, accuracy, fitted_rows
from calib.verbs.evaluate.characteristics import Characteristic, characteristics
from calib.verbs.evaluate.evaluation import (
    Evaluation,
    evaluate,
    moved_place,
    registration_rows,
    with_uncertainty,
)

Outcome = Literal["pass", "undecided", "fail"]

#: From the best to the worst: of several checks the worst outcome counts.
OUTCOMES: tuple[Outcome, ...] = ("pass", "undecided", "fail")

#: Figures that can be compared with the tolerance: the largest AP, their mean, or the largest error of a single repeat.
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
    #: Expanded measuring uncertainty U as stated; 0 if none was
    uncertainty: float
    #: The factor f: random errors before registration to the same rows over those after it; >= 1
    factor: float
    #: Whether a calibration was fitted to the judged rows
    seen: bool

    @property
    def outcome(self) -> Outcome:
        """``"fail"`` if A - U > T, ``"pass"`` if f A + U <= T and the judged rows are unseen, else ``"undecided"``."""
        if self.figure - self.uncertainty > self.tolerance:
            return "fail"
        if self.held <= self.tolerance and not self.seen:
            return "pass"
        return "undecided"

    @property
    def held(self) -> float:
        """The sum f A + U, which must be within the tolerance for a pass; in the unit of the figure."""
        return self.figure * self.factor + self.uncertainty


@dataclass(frozen=True, slots=True, eq=False)
class Acceptance:
    """The outcome of an acceptance test."""

    #: Accuracy and repeatability at each pose
    accuracy: Accuracy
    #: One of `CRITERIA`
    criterion: str
    #: The comparison in each unit that has a tolerance, by its symbol: ``"m"`` of positions or lengths, ``"rad"`` of
    #: orientations, ``"px"`` of images
    checks: Mapping[str, Check]
    #: Number of poses that are within the tolerances, by the error that the criterion looks at in each
    within: int

    def __post_init__(self) -> None:
        """Keep a copy that cannot be changed."""
        object.__setattr__(self, "checks", ReadOnlyMapping(self.checks))

    def __repr__(self) -> str:
        """Return one line: the outcome; the figure and its tolerance in mm, deg or px; the number of poses within."""
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

        Clopper and Pearson's lower limit of a binomial share; it holds for poses chosen at random and independently of
        each other.
        """
        count = len(self.accuracy.poses)
        if not self.within:
            return 0.0
        return float(betaincinv(self.within, count - self.within + 1, 0.05))

    def size(self, pose: PoseAccuracy, unit: str) -> float:
        """Return the error of a judged pose that the criterion looks at; see `pose_error`."""
        return pose_error(pose, self.criterion, unit)

    def used(self, pose: PoseAccuracy) -> float:
        """Return a judged pose's error over its tolerance [1]: the largest of the units, 0 if it has none."""
        largest = 0.0
        for unit, check in self.checks.items():
            share = self.size(pose, unit) / check.tolerance
            if np.isfinite(share):
                largest = max(largest, share)
        return largest


def pose_error(pose: PoseAccuracy, criterion: str, unit: str) -> float:
    """Return the error of a pose that a criterion of acceptance looks at.

    Args:
        pose: Accuracy and repeatability at the pose.
        criterion: ``"single"`` looks at the largest error of a single repeat, ``"max"`` and ``"mean"`` at the pose
            accuracy AP.
        unit: Symbol of the unit: ``"m"`` for the error of the position or length, ``"rad"`` for the orientation's,
            ``"px"`` for that in the image.

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
    """Compare a robot's pose accuracy with a tolerance by ISO 14253-1: pass, fail or undecided.

    Rows that no calibration was fitted to and nothing was registered to are judged if there are enough of them,
    otherwise all measured rows; see `calib.verbs.evaluate.accuracy.judged_rows`.

    Args:
        evaluation: Residuals, measured minus predicted, of the robot that is judged at the N rows of a table, with
            frames and targets as given or registered.
        tolerance: By the symbol of its unit: ``"m"`` of positions and lengths, ``"rad"`` of orientations, ``"px"`` of
            images; what has none is not judged.
        uncertainty: Expanded uncertainty (k = 2) of what is measured, by the same symbols; None, and a unit that is
            missing, count as 0. A unit without a tolerance has no effect.
        criterion: Figure that must be within: ``"max"``, the pose accuracy AP of every pose, the norm of its mean error
            over repeats; ``"mean"``, the mean of AP over the poses; ``"single"``, the error of every single repeat.
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
        symbol, stated = residual_unit(unit).symbol, uncertainty.get(unit, 0.0)
        if not 0.0 < limit < np.inf or not 0.0 <= stated < np.inf:
            raise CalibError(
                f"The tolerance is {limit} {symbol} with an uncertainty of {stated} {symbol}; the first must be above "
                "0, the second 0 or larger."
            )
    if criterion not in CRITERIA:
        raise CalibError(f"The criterion is '{criterion}'; choose one of {choices(CRITERIA)}.")

    judged = accuracy(evaluation, seen=seen)
    checks = {}
    within = np.ones(len(judged.poses), dtype=bool)
    for symbol, of_unit in RESIDUAL_UNITS.items():
        if symbol not in tolerance:
            continue
        limit, stated = tolerance[symbol], uncertainty.get(symbol, 0.0)
        sizes = np.array([pose_error(pose, criterion, symbol) for pose in judged.poses])
        if not np.any(np.isfinite(sizes)):
            raise MeasurementError(
                f"{evaluation.measurements.source or 'Measurements'}: a tolerance of {of_unit.to_shown * limit:g} "
                f"{of_unit.shown} was stated, and no {of_unit.measured} was measured in the rows that are judged."
            )
        figure = np.nanmean(sizes) if criterion == "mean" else np.nanmax(sizes)
        checks[symbol] = Check(float(figure), limit, stated, judged.factor, judged.seen)
        # A pose without such an error, NaN here, is judged by its others.
        within &= ~(sizes > limit)
    return Acceptance(judged, criterion, checks, int(np.sum(within)))


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
    #: The acceptance, if a tolerance was stated
    accepted: Acceptance | None
    #: Judged rows with joint values outside of the fitted ranges, and the numbers of all judged rows
    outside: tuple[tuple[OutsideRow, ...], tuple[int, ...]]
    #: What may explain the errors of the rows: a usual mistake, a frame or target that has moved since the calibration,
    #: or joints that came from other sides
    hint: Reason | None
    #: Error of a board's position that the judged result expects near the poses that it was fitted to, rms [m]; None
    #: without a result of images
    expected: float | None = None

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
        cell: Known frames, targets and loads.
        calibration: A result of this robot; None: only the URDF is evaluated.
        which: Places taken from the result and not registered to these rows: ``"frame"``, ``"target"``, both or none.
        judge: Name of the robot that is judged, a key of `Assessment.evaluations`; None: the calibrated one, or the
            URDF's without a result.
        limits: Arguments of `acceptance` by name, such as ``{"tolerance": {"m": 5e-4}}``; None or empty: no acceptance
            test.

    Returns:
        Residuals and pose accuracy of each robot by its name, and the acceptance of the judged one if there are limits;
        judged rows outside of the fitted joint ranges; and what may explain the errors.

    Raises:
        CalibError: There is no such robot to be judged, or what `evaluate` and `acceptance` raise.
        MeasurementError: The table holds commands, and nothing was measured.
    """
    _refuse_commands(robot, table, calibration)
    evaluations: dict[str, Evaluation] = {}
    seen = np.zeros(len(table), dtype=bool)
    if calibration is None:
        evaluations["urdf"] = evaluate(robot, table, cell)
    else:
        cell = calibration.complete_cell(cell)
        nominal, corrected = calibration.uncorrected(robot), calibration.corrected(robot)
        setup = calibration.setup
        if calibration.rows.nominal_is_judged:
            known = calibration.nominal_setup
            evaluations["nominal"] = evaluate(nominal, table, cell, known=known, which=which)
        as_it_is = evaluate(robot, table, cell, known=setup, which=which)
        calibrated = evaluate(corrected, table, cell, known=setup, which=which)
        calibrated = with_uncertainty(calibrated, calibration, cell, which)
        if np.array_equal(as_it_is.residual, calibrated.residual):
            as_it_is = replace(as_it_is, uncertainty=calibrated.uncertainty)
        evaluations |= {"urdf": as_it_is, "calibration": calibrated}
        if calibration.non_geometric is not None:
            by_model = evaluate(
                nominal, table, cell, which=which, non_geometric=calibration.non_geometric
            )
            evaluations["non_geometric"] = with_uncertainty(
                by_model, calibration, cell, which, non_geometric=True
            )
        seen = fitted_rows(calibration, robot, table, cell)

    judged = judge or ("urdf" if calibration is None else "calibration")
    if judged not in evaluations:
        raise CalibError(
            f"--judge {judged}: there is no such robot; choose one of {choices(evaluations)}."
        )
    accuracies = {name: accuracy(evaluation, seen=seen) for name, evaluation in evaluations.items()}
    accepted = None
    if limits:
        accepted = acceptance(evaluations[judged], **limits, seen=seen)

    # Only these robots depend on the ranges that the calibration was fitted to.
    outside: tuple[OutsideRow, ...] = ()
    numbers = tuple(pose.rows[0] for pose in accuracies[judged].poses)
    if calibration is not None and judged in ("calibration", "non_geometric"):
        first_rows = np.isin(table.rows, numbers)
        q = table.joints_for(calibration.nominal.joint_names)[first_rows]
        numbers = tuple(np.array(table.rows)[first_rows].tolist())
        outside = calibration.outside_of_measured(q)

    if calibration is None:
        urdf = evaluations["urdf"]
        # A target that was given is where it was given, its orientation too; a clasp's is its tip.
        is_given = cell.target is not None or bool(cell.targets)
        given = replace(cell, estimate_target="target" in urdf.registered or not is_given)
        hint = find_usual_mistake(urdf.robot, given, table.select(registration_rows(table)))
    else:
        robot_now = evaluations["calibration"].robot
        hint = moved_place(robot_now, table, cell, calibration.setup, which)
        if hint is None and _is_from_other_sides(table, calibration):
            hint = Reason.of(Why.OTHER_SIDES)
    expected = None
    if calibration is not None and judged in ("calibration", "non_geometric"):
        part = calibration.geometry if judged == "calibration" else calibration.non_geometric
        if part is not None and part.board is not None:
            expected, _ = part.new_point
    return Assessment(
        evaluations=evaluations,
        accuracies=accuracies,
        characteristics={
            name: characteristics(evaluations[name], figures)
            for name, figures in accuracies.items()
        },
        judged=judged,
        accepted=accepted,
        outside=(outside, numbers),
        hint=hint,
        expected=expected,
    )


def _is_from_other_sides(table: Measurements, calibration: Calibration) -> bool:
    """Return whether joints came to some row of a table from another side than to all rows of the calibration."""
    verdict, names = calibration.verdict, calibration.nominal.joint_names
    of_side = [] if verdict is None else [r for r in verdict.reasons if r.why is Why.ONE_SIDED]
    if not of_side:
        return False
    side = common_side(table.moves_for(names))
    if side is None:
        return True
    falling = [name for name, sign in zip(names, side, strict=True) if sign < 0.0]
    return falling != list(of_side[0].values["falling"])


def _refuse_commands(robot: Robot, table: Measurements, calibration: Calibration | None) -> None:
    """Refuse a table of commands by a `MeasurementError`: the nominal robot predicts them, so any tolerance seems kept.

    Commands are recognised by a column that 'calib compensate' writes, together with errors of the nominal robot below
    `_EXACT` [m] in all rows, which hold more scalars than the registration of frame and target has unknowns. With
    too few rows for that registration nothing is refused.
    """
    columns = {split_header(label)[0] for label in table.ignored}
    if _COMMANDS not in columns:
        return
    nominal = robot if calibration is None else calibration.uncorrected(robot)
    try:
        evaluation = evaluate(nominal, table, Cell(estimate_frame=True))
    except CalibError:
        return  # too few rows to decide
    enough = evaluation.used.sum() > evaluation.setup.count
    if enough and evaluation.errors["all"]["m"].max < _EXACT:
        raise MeasurementError(
            f"{table.source}: these are commands that 'calib compensate' wrote, and nothing was measured. Put what was "
            "measured in the place of x, y, z, or give it as a list of its own with --points."
        )
