"""Acceptance: whether a robot's pose accuracy is within a stated tolerance, proved against the measuring uncertainty.

With the figure A that is judged, the tolerance T, the expanded measuring uncertainty U (ISO 14253-1), and the factor
f >= 1 by which errors were larger before something was registered to the same rows,

    f A + U <= T    pass:       conformity is proved
    A - U > T       fail:       non-conformity is proved
    else            undecided:  neither is

Without U this is the plain comparison of A with T. Rows that a calibration was fitted to can fail, but not pass.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv

from calib.errors import CalibError, MeasurementError, choices
from calib.estimate.statistics import interval_factor
from calib.result.accuracy import Accuracy, PoseAccuracy, accuracy
from calib.result.evaluation import Evaluation

Mask = NDArray[np.bool_]

PASS, UNDECIDED, FAIL = "pass", "undecided", "fail"

#: From the best to the worst: of several checks the worst outcome counts.
OUTCOMES = (PASS, UNDECIDED, FAIL)

#: What is compared with the tolerance: the largest AP, their mean, or the largest error of a single repeat.
CRITERIA = ("max", "mean", "single")


@dataclass(frozen=True, slots=True)
class Check:
    """One figure held against its tolerance, in m or rad.

    Attributes:
        figure: What is judged.
        tolerance: What it may be.
        uncertainty: Expanded measuring uncertainty as stated; 0 where none was.
        factor: By how much errors were larger before something was registered to the same rows.
        random: Half the 95 % interval of an AP as far as the repeats tell; NaN without repeats.
        seen: Whether a calibration was fitted to the rows.
    """

    figure: float
    tolerance: float
    uncertainty: float
    factor: float
    random: float
    seen: bool

    @property
    def outcome(self) -> str:
        """One of `OUTCOMES`.

        Example:
            >>> Check(0.4e-3, 0.5e-3, 0.2e-3, 1.0, float("nan"), seen=False).outcome
            'undecided'
        """
        if self.figure - self.uncertainty > self.tolerance:
            return FAIL
        return PASS if self.held <= self.tolerance and not self.seen else UNDECIDED

    @property
    def held(self) -> float:
        """The sum f A + U, which must be within the tolerance for a pass; infinite where nothing is left over."""
        return self.figure * self.factor + self.uncertainty


@dataclass(frozen=True, slots=True, eq=False)
class Acceptance:
    """What an acceptance test found.

    Attributes:
        accuracy: Accuracy and repeatability at each pose.
        criterion: One of `CRITERIA`.
        length: The check of positions or lengths; None where no tolerance was stated for them.
        angle: That of orientations; likewise.
        within: How many poses are within the tolerances, by what the criterion looks at in each.
    """

    accuracy: Accuracy
    criterion: str
    length: Check | None
    angle: Check | None
    within: int

    @property
    def checks(self) -> tuple[tuple[Check, bool], ...]:
        """Those that there are, each with whether it is of angles."""
        both = ((self.length, False), (self.angle, True))
        return tuple((check, angle) for check, angle in both if check is not None)

    @property
    def outcome(self) -> str:
        """``"pass"``, ``"undecided"`` or ``"fail"``: the worst of the checks."""
        return max((check.outcome for check, _ in self.checks), key=OUTCOMES.index)

    @property
    def passed(self) -> bool:
        """Whether the tolerance was shown to be kept."""
        return self.outcome == PASS

    @property
    def share(self) -> float:
        """Of poses chosen as these were, at least this share is within the tolerances, with 95 % confidence.

        Clopper and Pearson's lower limit; it holds for poses chosen at random and independently of each other.
        """
        count = len(self.accuracy.poses)
        if not self.within:
            return 0.0
        return float(betaincinv(self.within, count - self.within + 1, 0.05))


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
    """Hold a robot's pose accuracy against a tolerance.

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

    Example:
        >>> from calib import Cell, Measurements, Robot, evaluate
        >>> from calib.example import paper_measurements, paper_urdf
        >>> robot = Robot.load(paper_urdf(), base="base", tip="tool0")
        >>> table = Measurements.read(paper_measurements(), robot.joint_names)
        >>> acceptance(evaluate(robot, table, Cell(target=[-0.07, 0.07, 0.0225])), 0.5e-3).outcome
        'fail'
    """
    given = ((tolerance, uncertainty, "m"), (tolerance_angle, uncertainty_angle, "rad"))
    if tolerance is None and tolerance_angle is None:
        raise CalibError(
            "State a tolerance: of positions in m, of orientations in rad, or of both."
        )
    for limit, sure, unit in given:
        if limit is not None and not 0.0 < limit < np.inf:
            raise CalibError(f"The tolerance is {limit} {unit}; it must be a number above 0.")
        if not 0.0 <= sure < np.inf:
            raise CalibError(f"The measuring uncertainty is {sure} {unit}; it must be 0 or larger.")
    if criterion not in CRITERIA:
        raise CalibError(f"The criterion is '{criterion}'; choose one of {choices(CRITERIA)}.")
    found = accuracy(evaluation, seen=seen)
    if tolerance_angle is not None and not len(found.of("ap_angle")):
        raise MeasurementError(
            f"{evaluation.measurements.source or 'Measurements'}: a tolerance of {np.degrees(tolerance_angle):g} deg "
            "was stated, and no orientation was measured in the rows that are judged. Measure poses, or state a "
            "tolerance of positions alone."
        )
    fine = np.ones(len(found.poses), dtype=bool)
    checks: list[Check | None] = [None, None]  # of lengths, of angles
    for k, (limit, sure, _) in enumerate(given):
        if limit is None:
            continue
        values = np.array([size_of(pose, criterion, angle=k > 0) for pose in found.poses])
        fine &= ~(values > limit)  # a pose without an orientation is judged by its position
        std, freedom = (found.scatter, found.scatter_angle)[k]
        half = interval_factor(freedom) * std / np.sqrt(found.repeats[0]) if freedom else np.nan
        figure = float(np.nanmean(values) if criterion == "mean" else np.nanmax(values))
        checks[k] = Check(figure, limit, sure, found.factor, float(half), found.seen)
    return Acceptance(found, criterion, checks[0], checks[1], int(np.sum(fine)))


def size_of(pose: PoseAccuracy, criterion: str, *, angle: bool) -> float:
    """What a criterion looks at in a pose: AP, or the largest error of a single repeat [m] or [rad]; NaN if none."""
    if criterion == "single":
        return pose.single_angle if angle else pose.single
    return pose.ap_angle if angle else pose.ap


#: What ISO 9283 asks for: repeats of a pose, and poses.
ISO_REPEATS, ISO_POSES = 30, 5
