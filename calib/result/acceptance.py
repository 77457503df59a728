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
from calib.result.calibration import CalibrationValues
from calib.result.evaluation import (
    Accuracy,
    Evaluation,
    PoseAccuracy,
    accuracy,
    evaluate,
    fitted_rows,
    moved,
    registering,
)
from calib.robot.robot import Robot
from calib.units import Mask, split_header

Outcome = Literal["pass", "undecided", "fail"]

#: From the best to the worst: of several checks the worst outcome counts.
OUTCOMES: tuple[Outcome, ...] = ("pass", "undecided", "fail")

#: What is compared with the tolerance: the largest AP, their mean, or the largest error of a single repeat.
CRITERIA = ("max", "mean", "single")

#: A column that every table of commands has, and how exactly the poses to send are those of the nominal robot [m].
_COMMANDS, _EXACT = "correction position", 1e-6


@dataclass(frozen=True, slots=True)
class Check:
    """One figure compared with its tolerance, in m or rad."""

    figure: float  #: What is judged
    tolerance: float  #: What it may be
    uncertainty: float  #: Expanded measuring uncertainty as stated; 0 where none was
    factor: float  #: How much larger errors were before registration to the same rows
    seen: bool  #: Whether a calibration was fitted to the rows

    @property
    def outcome(self) -> Outcome:
        """One of `OUTCOMES`."""
        if self.figure - self.uncertainty > self.tolerance:
            return "fail"
        return "pass" if self.held <= self.tolerance and not self.seen else "undecided"

    @property
    def held(self) -> float:
        """The sum f A + U, which must be within the tolerance for a pass."""
        return self.figure * self.factor + self.uncertainty


@dataclass(frozen=True, slots=True, eq=False)
class Acceptance:
    """What an acceptance test found."""

    accuracy: Accuracy  #: Accuracy and repeatability at each pose
    criterion: str  #: One of `CRITERIA`
    length: Check | None  #: Of positions or lengths; None where no tolerance was stated
    angle: Check | None  #: That of orientations; likewise
    within: int  #: How many poses are within the tolerances, by what the criterion looks at in each

    @property
    def checks(self) -> tuple[tuple[Check, bool], ...]:
        """Those that there are, each with whether it is of angles."""
        both = ((self.length, False), (self.angle, True))
        return tuple((check, angle) for check, angle in both if check is not None)

    @property
    def outcome(self) -> Outcome:
        """``"pass"``, ``"undecided"`` or ``"fail"``: the worst of the checks."""
        return max((check.outcome for check, _ in self.checks), key=OUTCOMES.index)

    @property
    def share(self) -> float:
        """Of poses chosen as these were, at least this share is within the tolerances, with 95 % confidence.

        Clopper and Pearson's lower limit; it holds for poses chosen at random and independently of each other.
        """
        count = len(self.accuracy.poses)
        if not self.within:
            return 0.0
        return float(betaincinv(self.within, count - self.within + 1, 0.05))

    def size(self, pose: PoseAccuracy, *, angle: bool) -> float:
        """What the criterion looks at in a pose [m] or [rad]; NaN if it has none."""
        name = "single" if self.criterion == "single" else "ap"
        return float(getattr(pose, f"{name}_angle" if angle else name))

    def used(self, pose: PoseAccuracy) -> float:
        """How much of its tolerance a pose uses, as a share."""
        shares = (self.size(pose, angle=angle) / c.tolerance for c, angle in self.checks)
        return max((share for share in shares if np.isfinite(share)), default=0.0)


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
    given = ((tolerance, uncertainty, "m"), (tolerance_angle, uncertainty_angle, "rad"))
    if tolerance is None and tolerance_angle is None:
        raise CalibError("State a tolerance: of positions in m, of orientations in rad, or both.")
    for limit, sure, unit in given:
        if (limit is not None and not 0.0 < limit < np.inf) or not 0.0 <= sure < np.inf:
            raise CalibError(
                f"The tolerance is {limit} {unit} with an uncertainty of {sure} {unit}; the first must be above 0, the "
                "second 0 or larger."
            )
    if criterion not in CRITERIA:
        raise CalibError(f"The criterion is '{criterion}'; choose one of {choices(CRITERIA)}.")
    one = accuracy(evaluation, seen=seen)
    if tolerance_angle is not None and not len(one.of("ap_angle")):
        raise MeasurementError(
            f"{evaluation.measurements.source or 'Measurements'}: a tolerance of {np.degrees(tolerance_angle):g} deg "
            "was stated, and no orientation was measured in the rows that are judged."
        )
    fine = np.ones(len(one.poses), dtype=bool)
    found = Acceptance(one, criterion, None, None, 0)
    checks: list[Check | None] = [None, None]  # of lengths, of angles
    for k, (limit, sure, _) in enumerate(given):
        if limit is None:
            continue
        values = np.array([found.size(pose, angle=k > 0) for pose in one.poses])
        fine &= ~(values > limit)  # a pose without an orientation is judged by its position
        figure = float(np.nanmean(values) if criterion == "mean" else np.nanmax(values))
        checks[k] = Check(figure, limit, sure, one.factor, one.seen)
    return Acceptance(one, criterion, checks[0], checks[1], int(np.sum(fine)))


@dataclass(frozen=True, slots=True, eq=False)
class Assessment:
    """Every robot that a URDF and a result hold, compared with one table."""

    #: Errors, by ``"nominal"``, ``"urdf"``, ``"calibration"`` and ``"non_geometric"`` as far as they are there
    found: Mapping[str, Evaluation]
    figures: Mapping[str, Accuracy]  #: Their accuracy
    judged: str  #: The robot that is judged
    accepted: Acceptance | None  #: The acceptance, where a tolerance was stated
    #: Judged rows with joint values that the fit did not see, and the numbers of the rows asked for
    outside: tuple[tuple[OutsideRow, ...], tuple[int, ...]]
    #: What would explain the rows far better: another set-up, or a frame or target that moved since the calibration
    hint: Reason | None


def assess(
    robot: Robot,
    table: Measurements,
    cell: Cell,
    c: CalibrationValues | None = None,
    *,
    which: tuple[str, ...] = (),
    judge: str | None = None,
    limits: Mapping[str, Any] | None = None,
) -> Assessment:
    """Evaluate the robot as it is; and of a result its nominal robot, its joint origins, and its non-geometric model.

    ``which`` of the result's frame and target are used; ``judge`` names the robot that is judged, by default the
    corrected one; ``limits`` is what `acceptance` is given: without it nothing is judged.

    Raises:
        CalibError: There is no such robot to be judged, or what `evaluate` and `acceptance` raise.
        MeasurementError: The table holds commands, and nothing was measured.
    """
    nominal = robot if c is None else c.uncorrected(robot)
    _check_measured(nominal, table)
    seen = np.zeros(len(table), dtype=bool)
    hint: Reason | None = None
    if c is None:
        found = {"urdf": evaluate(robot, table, cell)}
        hint = find_usual_mistake(robot, cell, table.select(registering(table)))
    else:
        states = {
            "nominal": (nominal, c.nominal_setup, None),
            "urdf": (robot, c.setup, None),
            "calibration": (c.corrected(robot), c.setup, None),
            **(
                {}
                if c.non_geometric is None
                else {"non_geometric": (nominal, None, c.non_geometric)}
            ),
        }
        found = {
            who: evaluate(one, table, cell, known=known, which=which, non_geometric=non_geometric)
            for who, (one, known, non_geometric) in states.items()
        }
        seen = fitted_rows(c, robot, table, cell)
        hint = moved(found["calibration"].robot, table, cell, c.setup, which)
    judged = judge or ("urdf" if c is None else "calibration")
    if judged not in found:
        raise CalibError(
            f"--judge {judged}: there is no such robot; choose one of {choices(found)}."
        )
    figures = {who: accuracy(one, seen=seen) for who, one in found.items()}
    beyond: tuple[OutsideRow, ...] = ()
    rows = tuple(row for pose in figures[judged].poses for row in pose.rows[:1])
    if c is not None and judged in ("calibration", "non_geometric"):
        own_rows = np.isin(table.rows, rows)
        beyond = c.outside_of_measured(table.joints_for(c.nominal.joint_names)[own_rows])
        rows = tuple(np.array(table.rows)[own_rows].tolist())
    return Assessment(
        found=found,
        figures=figures,
        judged=judged,
        accepted=acceptance(found[judged], **limits, seen=seen) if limits else None,
        outside=(beyond, rows),
        hint=hint,
    )


def _check_measured(nominal: Robot, m: Measurements) -> None:
    """Refuse a table of commands, whose poses the nominal robot predicts: any tolerance would seem to be kept."""
    if _COMMANDS not in {split_header(label)[0] for label in m.ignored}:
        return
    try:
        found = evaluate(nominal, m, Cell(estimate_frame=True))
    except CalibError:
        return  # too few rows to tell
    if found.used.sum() > found.setup.count and found.errors["all"].max < _EXACT:
        raise MeasurementError(
            f"{m.source}: these are commands that 'calib compensate' wrote, and nothing was measured. Put what was "
            "measured in the place of x, y, z, or give it as a list of its own with --points."
        )
