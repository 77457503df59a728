"""Acceptance: whether a robot's pose accuracy is within a stated tolerance, proved against the measuring uncertainty.

With the figure A that is judged, the tolerance T, the expanded measuring uncertainty U (ISO 14253-1), and the factor
f >= 1 by which errors were larger before something was registered to the same rows,

    f A + U <= T    pass:       conformity is proved
    A - U > T       fail:       non-conformity is proved
    else            undecided:  neither is

Without U this is the plain comparison of A with T. Rows that a calibration was fitted to can fail, but not pass.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv

import calib.kinds as registry
from calib.errors import CalibError, MeasurementError, choices
from calib.identify.accuracy import FEWEST_APART, FEWEST_REPEATS, Accuracy, PoseAccuracy, accuracy
from calib.identify.evaluation import Evaluation
from calib.identify.statistics import interval_factor
from calib.identify.summary import wrap

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
        >>> from calib.data import paper_measurements, paper_urdf
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

#: Poses that are listed, and rows of a pose that are named.
_MOST_POSES, _MOST_ROWS = 10, 3

#: What the criteria look at: of positions, of lengths, of orientations.
_FIGURES = {
    "max": ("largest pose accuracy AP", "largest AP of a length", "largest AP of orientation"),
    "mean": ("mean pose accuracy AP", "mean AP of lengths", "mean AP of orientation"),
    "single": (*("largest error of a single repeat",) * 2, "largest angle of a single repeat"),
}
_COLUMNS = "{:<33}{:>5} {:>9} {:>9} {:>9} {:>9} {:>9}"


def acceptance_text(a: Acceptance, judged: str, notes: Sequence[str] = ()) -> str:
    """The outcome, and what it stands on."""
    reasons = acceptance_reasons(a, judged, notes)
    return "\n".join([f"Verdict: {a.outcome}", *(wrap(reason, "  ") for reason in reasons)])


def acceptance_reasons(a: Acceptance, judged: str, notes: Sequence[str] = ()) -> list[str]:
    """What an outcome stands on and what must be minded with it, sentence by sentence."""
    one, figures = a.accuracy, []
    for check, angle in a.checks:
        sizes = [size_of(pose, a.criterion, angle=angle) for pose in one.poses]
        worst = "" if a.criterion == "mean" else f" ({_rows_label(one.poses[np.nanargmax(sizes)])})"
        side = "above" if check.figure > check.tolerance else "within"
        figures.append(
            f"the {_FIGURES[a.criterion][2 if angle else _narrow(one)]} of {len(sizes)} pose{'s' * (len(sizes) != 1)} "
            f"is {_sized(check.figure, angle)}{worst}, {side} the tolerance of {_sized(check.tolerance, angle)}"
        )
    found = [f"Judged is {judged}: {'; '.join(figures)}."]
    found += [_uncertainty_text(a), _apart_text(one), _registered_text(one)]
    found += [text for check, angle in a.checks for text in _check_texts(check, angle)]
    found += [_repeats_text(one), _share_text(a)]
    # What was measured and not judged, and what was not measured.
    if a.angle is None and len(one.of("ap_angle")):
        found.append("Orientations were measured and have no tolerance: they are not judged.")
    if a.length is None:
        found.append("Positions were measured and have no tolerance: they are not judged.")
    kinds = dict.fromkeys(p.kind for p in one.poses if not registry.get(p.kind).coordinates)
    if kinds:
        found.append(f"Rows of the kind {choices(kinds)} say nothing of errors across them.")
    return [sentence for sentence in (*found, *notes) if sentence]


def accuracy_text(found: Mapping[str, Accuracy]) -> str:
    """AP and RP of several robots, by name: positions [mm], and orientations [deg] where there are any."""
    narrow = all(_narrow(one) for one in found.values())
    titles = ["Length accuracy [mm]" if narrow else "Pose accuracy, ISO 9283 [mm]"]
    if any(len(one.of("ap_angle")) for one in found.values()):
        titles.append("Orientation, ISO 9283 [deg]")
    parts = []
    for angle, title in enumerate(titles):
        scale = float(np.degrees(1.0)) if angle else 1e3
        lines = [_COLUMNS.format(title, "poses", "AP max", "mean", "RP max", "mean", "single")]
        for name, one in found.items():
            numbers = (_number(scale * v, 3 + angle) for v in figures_of(one, angle=bool(angle)))
            count = len(one.of("ap_angle" if angle else "ap"))
            lines.append(_COLUMNS.format(f"  {name}", count, *numbers))
        parts.append("\n".join(line.rstrip() for line in lines))
    return "\n\n".join(parts)


def poses_text(a: Acceptance, judged: str) -> str:
    """The poses one by one, the worst first; at most ten."""
    poses = worst_first(a)
    shown = poses[:_MOST_POSES]
    # Where single repeats are judged, they stand in the place of RP.
    last = "single" if a.criterion == "single" else "RP"
    head = ["repeats", "AP [mm]", "x", "y", "z", last]
    turned = any(np.isfinite(pose.ap_angle) for pose in shown)
    head += ["AP [deg]", last] if turned else []
    name = "Poses, the worst first" if len(shown) > 1 else "The pose"
    rows = [("", head)]
    for pose in shown:
        ends = (pose.single, pose.single_angle) if last == "single" else (pose.rp, pose.rp_angle)
        cells = [str(len(pose.rows))]
        cells += [_number(1e3 * v, 3) for v in (pose.ap, *pose.ap_xyz, ends[0])]
        if turned:
            cells += [_number(float(np.degrees(v)), 4) for v in (pose.ap_angle, ends[1])]
        # The target and the set-up of a pose, where the table has several.
        named = [pose.target] * (len({p.target for p in poses}) > 1)
        named += [pose.group] * (len({p.group for p in poses}) > 1)
        label = f"  {_rows_label(pose)}" + (f" ({', '.join(named)})" if named else "")
        rows.append((f"  {textwrap.shorten(label, 24, placeholder='...')}", cells))
    widths = (8, 10, 10, 10, 10, 8, 10, 8)
    lines = [wrap(f"{name}, of {judged}:")]
    for label, cells in rows:
        set_cells = (f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=False))
        lines.append(f"{label:<26}{''.join(set_cells)}")
    more = len(poses) - len(shown)
    return "\n".join([*lines, *([f"  and {more} more"] if more else [])])


def worst_first(a: Acceptance) -> list[PoseAccuracy]:
    """The poses by how much of their tolerance they use, the worst first."""

    def used(pose: PoseAccuracy) -> float:
        shares = (
            size_of(pose, a.criterion, angle=angle) / check.tolerance for check, angle in a.checks
        )
        return max((share for share in shares if np.isfinite(share)), default=0.0)

    return sorted(a.accuracy.poses, key=used, reverse=True)


def figures_of(one: Accuracy, *, angle: bool) -> list[float]:
    """Of AP and RP the largest and the mean, of single repeats the largest; NaN where there are none."""
    ap, rp, single = (one.of(f"{name}{'_angle' * angle}") for name in ("ap", "rp", "single"))
    found = [(float(v.max()), float(v.mean())) if len(v) else (np.nan, np.nan) for v in (ap, rp)]
    return [*found[0], *found[1], float(single.max()) if len(single) else np.nan]


def _uncertainty_text(a: Acceptance) -> str:
    """What of the measuring uncertainty was counted."""
    stated = [_sized(check.uncertainty, angle) for check, angle in a.checks if check.uncertainty]
    if not stated:
        return (
            "The measuring uncertainty is not counted; where it is not far below the tolerance, state it "
            "(--uncertainty)."
        )
    return f"The measuring uncertainty of {' and '.join(stated)} (k = 2) is counted against the outcome (ISO 14253-1)."


def _apart_text(one: Accuracy) -> str:
    """Which rows were judged, and whether a calibration has seen them."""
    if one.seen:
        return (
            f"The calibration was fitted to {one.fitted} of the {one.measured} rows, and the others are of fewer than "
            f"{FEWEST_APART} poses: they can show that it fails, not that it passes. Measure fresh ones."
        )
    if one.rows == "all":
        return ""
    parts = ["the calibration was fitted"] * ("calibration" in one.others)
    parts += [f"the {what} was registered" for what in one.others if what != "calibration"]
    count = sum(len(pose.rows) for pose in one.poses)
    which = f"{count} of the {one.measured}" if one.rows == "fresh" else "The validation"
    return f"{which} rows alone are judged: to the others {' and '.join(parts)}."


def _registered_text(one: Accuracy) -> str:
    """What registering to the same rows takes away."""
    if not one.registered:
        return ""
    lost = "nothing is left to judge by"
    if np.isfinite(one.factor):
        small = 100.0 * (1.0 - 1.0 / one.factor)
        lost = f"random errors look {small:.2g} % too small, which is counted against the outcome"
    return (
        f"Registered to these rows: {' and '.join(one.registered)}, {one.unknowns} unknowns from {one.numbers} "
        f"numbers, so {lost}. What displacing {'them' if len(one.registered) > 1 else 'it'} explains is not in AP."
    )


def _check_texts(check: Check, angle: bool) -> Iterator[str]:
    """The sum that decided, where it is not the figure itself, and whether the repeats tell the figure well enough."""
    fails = check.outcome == FAIL
    total = check.figure - check.uncertainty if fails else check.held
    if np.isfinite(check.held) and total != check.figure:
        sums = _sized(check.figure, angle)
        if not fails and check.factor != 1.0:
            sums += f" x {check.factor:.3f}"
        if check.uncertainty:
            sums += f" {'-' if fails else '+'} {_sized(check.uncertainty, angle)}"
        side = "above" if total > check.tolerance else "within"
        limit = _sized(check.tolerance, angle)
        yield f"Held against the tolerance is {sums} = {_sized(total, angle)}: {side} {limit}."
    if abs(check.figure - check.tolerance) < check.random:
        yield (
            f"The repeats scatter so that an AP is known to ± {_sized(check.random, angle)} (95 %): the figure is "
            "closer to the tolerance than that. Repeat the poses more often."
        )


def _repeats_text(one: Accuracy) -> str:
    """How the poses and repeats compare with what the standard asks for."""
    (low, high), count = one.repeats, len(one.poses)
    if low >= ISO_REPEATS and count >= ISO_POSES:
        return ""
    asked = f"ISO 9283 asks for {ISO_REPEATS} repeats of each of {ISO_POSES} poses"
    if high == 1:
        text = "Each pose was measured once: its AP holds repeatability and noise too, and RP cannot be told."
        # What the standard asks for is of poses.
        return text if _narrow(one) else f"{text} {asked}."
    repeats = f"{low}" if low == high else f"{low} to {high}"
    fewest = f" RP takes {FEWEST_REPEATS} at least." * (high < FEWEST_REPEATS)
    return f"{asked}; here are {repeats} of {'each of ' * (count > 1)}{count}.{fewest}"


def _share_text(a: Acceptance) -> str:
    """What the poses say of others; rows that a fit has seen tell nothing of them."""
    count = len(a.accuracy.poses)
    if a.criterion == "mean" or count == 1 or (a.within and a.accuracy.seen):
        return ""
    text = f"All {count} poses" if a.within == count else f"{a.within} of {count} poses"
    return (
        f"{text} are within: of poses chosen at random in the same way at least {np.floor(100.0 * a.share):.0f} % are, "
        "with 95 % confidence."
    )


def _narrow(one: Accuracy) -> bool:
    """Whether every row measures one length alone."""
    return not any(registry.get(pose.kind).coordinates for pose in one.poses)


def _sized(value: float, angle: bool, digits: int = 3) -> str:
    """A length in mm or an angle in deg, which has a digit more, with its unit."""
    return f"{np.degrees(value):.{digits + 1}f} deg" if angle else f"{1e3 * value:.{digits}f} mm"


def _number(value: float, digits: int) -> str:
    """A number of a table; a dash where there is none, and no minus before a zero."""
    return f"{round(value, digits) + 0.0:.{digits}f}" if np.isfinite(value) else "-"


def _rows_label(pose: PoseAccuracy) -> str:
    """The rows of a pose in few words."""
    rows = pose.rows
    if registry.get(pose.kind).paired:
        return f"pair of row {rows[0]}{', ...' * (len(rows) > 1)}"
    listed = ", ".join(map(str, rows[:_MOST_ROWS])) + ", ..." * (len(rows) > _MOST_ROWS)
    return f"row{'s' * (len(rows) > 1)} {listed}"
