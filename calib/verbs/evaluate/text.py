"""An evaluation in words: places of targets, the outcome of an acceptance test and what it rests on."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import calib.data.kinds as registry
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.values import one_line
from calib.errors import choices
from calib.show.lines import listed, mm, plural, row_ranges, times
from calib.show.verdict_text import reason_text
from calib.show.words import chain_name, outside_text, rms_text, shown, with_unit
from calib.verbs.evaluate.acceptance import Acceptance, Assessment, Check
from calib.verbs.evaluate.accuracy import FEWEST_APART, Accuracy, PoseAccuracy
from calib.verbs.evaluate.evaluation import Evaluation

#: Repeats of each pose that ISO 9283 asks for.
_ISO_REPEATS = 30

#: Poses that ISO 9283 asks for.
_ISO_POSES = 5

#: Rows of a pose that are named.
_MOST_ROWS = 3

#: The robots in tables.
NAMES = {
    "nominal": "nominal",
    "urdf": "URDF as it is",
    "calibration": "calibrated",
    "non_geometric": "non-geometric model",
}

#: The robots in a sentence; {} is the name of the result's file.
_LONG_NAMES = {
    "nominal": "the nominal robot of {}",
    "urdf": "the URDF as it is",
    "calibration": "the robot with the joint origins of {}",
    "non_geometric": "the robot with the non-geometric model of {}",
}

#: The figure of each criterion.
FIGURES = {
    "max": "largest AP",
    "mean": "mean AP",
    "single": "largest error of a single repeat",
}

#: The same figures as `calib.verbs.evaluate.accuracy.Accuracy.figures` calls them.
FIGURE_KEYS = {"max": "ap_max", "mean": "ap_mean", "single": "single_max"}

#: Definition of the figure of each criterion, which follows its name.
_MEANING = {
    "max": " AP is the pose accuracy of ISO 9283: the mean error of the repeats of a pose.",
    "mean": " AP is the pose accuracy of ISO 9283: the mean error of the repeats of a pose.",
    "single": "",
}


def evaluation_line(e: Evaluation) -> str:
    """Write an evaluation in one line: robot, error, rows."""
    errors = e.errors["all"]
    count = plural(len(e.measurements), "row")
    return one_line("Evaluation", chain_name(e.robot), f"rms {rms_text(errors)}", count)


def named_robot(who: str, result: str) -> str:
    """Name a robot in a sentence.

    Args:
        who: A key of `NAMES`.
        result: Name of the result's file.
    """
    return _LONG_NAMES[who].format(result)


def rows_label(pose: PoseAccuracy) -> str:
    """Name the first rows of a pose: ``row 4``, ``rows 1, 2, 3, ...``; of pairs the first row alone."""
    rows = pose.rows
    if registry.get(pose.kind).paired:
        rows = rows[:1]
    names = [str(row) for row in rows[:_MOST_ROWS]]
    if len(pose.rows) > _MOST_ROWS:
        names.append("...")
    noun = "rows" if len(rows) > 1 else "row"
    return f"{noun} {', '.join(names)}"


def place_sentences(e: Assessment, source: str) -> list[str]:
    """Word the place of each target in the tip [mm], its source, and that frames were registered to the rows, if so.

    Args:
        e: The evaluation.
        source: Source, in words, of targets that were not registered to the rows.
    """
    evaluation = e.evaluations["urdf"]
    origin = "registered to the rows" if "target" in evaluation.registered else source
    sentences, setup = [], evaluation.setup
    for t, (name, T) in enumerate(zip(setup.targets, setup.T_tip_target, strict=True)):
        place = ", ".join(map(mm, T[:3, 3]))
        label = f"Target '{name}'" if len(setup.targets) > 1 else "Target"
        links = evaluation.setup.target_links
        link = links[t] if links else evaluation.robot.tip
        sentences.append(f"{label} at ({place}) mm in {link}, {origin}.")
    if "frame" in evaluation.registered:
        label = "Measurement frames" if len(setup.groups) > 1 else "Measurement frame"
        sentences.append(f"{label}: registered to the rows.")
    return sentences


def uncertainty_sentences(accuracy: Accuracy) -> Iterator[str]:
    """Word in each unit how many of the judged rows have an error within its U, and which are beyond."""
    counted = {unit: known for unit, known in accuracy.known.items() if known}
    for unit, known in counted.items():
        beyond = accuracy.beyond[unit]
        measured = RESIDUAL_UNITS[unit].measured
        of = f" of {measured}" if unit != "m" else ""
        text = f"{known - len(beyond)} of {plural(known, 'row')} {'is' if known == 1 else 'are'} within U{of}"
        text += f", beyond: {row_ranges(beyond)}." if beyond else "."
        if unit == next(iter(counted)):
            text += (
                " U is the expanded uncertainty (95.45 %, as k = 2) of a row's error: that of the prediction, with "
                "what the model lacks, and that of the measurement together."
            )
        yield text


def outcome_reasons(e: Assessment, result: str) -> Iterator[str]:
    """Word what the outcome of an acceptance test rests on, and its caveats; nothing if no tolerance was stated.

    Args:
        e: The evaluation.
        result: Name of the result's file.
    """
    a = e.accepted
    if a is None:
        return
    for unit, check in a.checks.items():
        yield from _figure_sentences(a, unit, named_robot(e.judged, result))
        if "nominal" in e.accuracies:
            nominal = e.accuracies["nominal"].figures(unit)[FIGURE_KEYS[a.criterion]]
            if nominal < check.figure:
                yield (
                    f"That of the nominal robot is smaller, {with_unit(nominal, unit)}: by this figure the calibration "
                    "is no improvement."
                )
    yield from _rows_reasons(a)
    for unit in a.accuracy.units:
        if unit not in a.checks:
            measured = RESIDUAL_UNITS[unit].measured.capitalize()
            yield f"{measured}s have no tolerance and are not evaluated."
    kinds = dict.fromkeys(pose.kind for pose in a.accuracy.poses)
    partial = [kind for kind in kinds if not registry.get(kind).coordinates]
    if partial:
        yield f"Rows of kind {choices(partial)} measure no position: what they do not see is not evaluated."
    outside = outside_text(*e.outside)
    if outside:
        yield f"Joint values outside of the calibrated range: {outside}."
    if e.hint is not None:
        yield reason_text(e.hint)


def decisive_sum(check: Check) -> float:
    """Return the sum that is compared with the tolerance: A - U of a figure A that fails, else f A + U."""
    return check.figure - check.uncertainty if check.outcome == "fail" else check.held


def _figure_sentences(a: Acceptance, unit: str, robot: str) -> Iterator[str]:
    """Word the figure of a robot in one unit against its tolerance, then the sum that decides, unless both are equal.

    A figure that fails is above the tolerance without its guard band, one that passes is within it with its guard band:
    ISO 14253-1.
    """
    check, poses = a.checks[unit], a.accuracy.poses
    name = FIGURES[a.criterion]
    if unit != "m":
        name += f" of {RESIDUAL_UNITS[unit].measured}"
    sizes = [a.size(pose, unit) for pose in poses]
    where = ""
    if a.criterion != "mean":
        worst = poses[int(np.nanargmax(sizes))]
        where = f" ({rows_label(worst)})"
    # Of mixed tables some poses were not measured in this unit.
    count = int(np.count_nonzero(np.isfinite(sizes)))
    figure = with_unit(check.figure, unit)
    tolerance = with_unit(check.tolerance, unit)
    relation = "above" if check.figure > check.tolerance else "within"
    yield (
        f"Evaluated: {robot}. The {name} of {plural(count, 'pose')} is {figure}{where}, {relation} the "
        f"tolerance of {tolerance}."
    )

    total = decisive_sum(check)
    if not np.isfinite(check.held) or total == check.figure:
        return
    fails = check.outcome == "fail"
    terms = shown(check.figure, unit)
    if not fails and check.factor != 1.0:
        terms += f" x {check.factor:.3f} (registration)"
    if check.uncertainty > 0.0:
        sign = "-" if fails else "+"
        guard_band = shown(check.uncertainty, unit)
        terms += f" {sign} guard band {guard_band} (k = 2, ISO 14253-1)"
    sign = ">" if total > check.tolerance else "<="
    yield f"{terms} = {with_unit(total, unit)} {sign} {tolerance}."


def _rows_reasons(a: Acceptance) -> Iterator[str]:
    """Yield sentences: which rows are evaluated, what was registered to them, and what they mean for other poses."""
    accuracy, count = a.accuracy, len(a.accuracy.poses)
    if accuracy.seen:
        yield (
            f"The calibration was fitted to {accuracy.fitted} of the {accuracy.measured} rows, and the others are of "
            f"fewer than {FEWEST_APART} poses: they can fail, but not pass. Measure fresh ones."
        )
    elif accuracy.rows != "all":
        used = sum(len(pose.rows) for pose in accuracy.poses)
        others = " and the ".join(accuracy.others)
        left = "the other was" if accuracy.measured - used == 1 else "the others were"
        are = "is" if used == 1 else "are"
        yield (
            f"{used} of the {accuracy.measured} rows {are} evaluated; {left} used for the {others}."
        )
    if accuracy.registered:
        scaled = "no degree of freedom remains"
        if np.isfinite(accuracy.factor):
            scaled = f"random errors are scaled by {accuracy.factor:.3f}"
        yield (
            f"Registered to these rows: {' and '.join(accuracy.registered)}, {accuracy.unknowns} unknowns from "
            f"{accuracy.numbers} numbers; {scaled}."
        )
    low, high = accuracy.repeats
    if low < _ISO_REPEATS or count < _ISO_POSES:
        yield (
            f"ISO 9283 asks for {_ISO_POSES} poses, each {_ISO_REPEATS} times; measured: {count}, each "
            f"{times(low, high)}."
        )
    if a.criterion != "mean" and count > 1 and not (a.within and accuracy.seen):
        share = np.floor(100.0 * a.share)
        yield (
            f"{a.within} of {count} poses are within: of poses chosen at random in the same way at least {share:.0f} % "
            "are, with 95 % confidence."
        )


def rule_sentences(e: Assessment) -> Iterator[str]:
    """Word poses and repeats, and, if a tolerance was stated, the rule by which the outcome is decided."""
    judged = e.accuracies[e.judged]
    yield f"Evaluated: {plural(len(judged.poses), 'pose')}, each measured {times(*judged.repeats)}."
    if e.judged in ("calibration", "non_geometric"):
        yield (
            "The errors after calibration are of the model: of the robot itself only if its controller, or the "
            "programs sent to it, use the model."
        )
    a = e.accepted
    if a is None:
        return
    limits = [with_unit(check.tolerance, unit) for unit, check in a.checks.items()]
    yield f"Tolerance T: {listed(limits)}, of the {FIGURES[a.criterion]}, A.{_MEANING[a.criterion]}"
    if any(check.uncertainty > 0.0 for check in a.checks.values()):
        yield (
            "Decision rule: ISO 14253-1, with the expanded uncertainty U as guard band: pass if f A + U <= T, fail if "
            "A - U > T, else undecided; f is 1 unless a frame or target was registered. Who has to prove bears the "
            "uncertainty: for a pass the supplier, for a rejection the customer."
        )
    else:
        yield (
            "Decision rule: pass if f A <= T, fail if A > T, else undecided; f is 1 unless a frame or target was "
            "registered. No measurement uncertainty was stated (--uncertainty), so near the tolerance the outcome is a "
            "matter of chance."
        )
