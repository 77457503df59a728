"""Evaluation of every robot that a URDF and a result hold, by `calib evaluate`, as text."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator

import numpy as np

import calib.data.kinds as registry
from calib.basics.channels import RESIDUAL_UNITS
from calib.basics.values import one_line
from calib.errors import choices
from calib.numerics.errors import Errors
from calib.show.doubtful_rows import outside_text
from calib.show.errors import error_table, error_title
from calib.show.lines import WIDTH, mm, number, plural, times, wrap
from calib.show.notebook import chain_name, html_table
from calib.show.short import rms_text
from calib.show.sizes import shown, with_unit
from calib.show.tables import Column, name_column, table_lines
from calib.show.verdict import reason_text
from calib.verbs.evaluate.acceptance import Acceptance, Assessment, Check
from calib.verbs.evaluate.accuracy import FEWEST_APART
from calib.verbs.evaluate.accuracy_text import (
    NAMES,
    accuracy_text,
    characteristics_text,
    figures_of,
    poses_text,
    rows_label,
)
from calib.verbs.evaluate.evaluation import Evaluation

#: Repeats of each pose that ISO 9283 asks for.
_ISO_REPEATS = 30

#: Poses that ISO 9283 asks for.
_ISO_POSES = 5

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

FIGURE_KEYS = {"max": "ap_max", "mean": "ap_mean", "single": "single_max"}
"""The same figures as `calib.verbs.evaluate.accuracy.Accuracy.figures` calls them."""


def assessment_text(e: Assessment, result: str, source: str) -> str:
    """Write an evaluation: the outcome first, then places of targets, errors and accuracy of each robot.

    Args:
        e: The evaluation.
        result: Name of the result's file.
        source: Where targets are from that were not registered, such as "as given".

    Returns:
        The text, in lines of 100 columns.
    """
    places = [textwrap.fill(place, WIDTH) for place in places_of(e, source)]
    parts = ["\n".join(places), _errors_text(e, result), *_images_text(e, result)]
    repeated = any(accuracy.repeats[1] > 1 for accuracy in e.accuracies.values())
    if e.accepted is not None or repeated:
        parts.append(accuracy_text(figures_of(e)))
        parts.append(characteristics_text(e.characteristics[e.judged], NAMES[e.judged]))
    if e.accepted is not None:
        reasons = [wrap(reason, "  ") for reason in outcome_reasons(e, result)]
        verdict = "\n".join([f"Verdict: {e.accepted.outcome}", *reasons])
        parts = [verdict, *parts, poses_text(e, robot_in_words(e, result))]
    elif e.hint is not None:
        parts.append(textwrap.fill(reason_text(e.hint), WIDTH, break_on_hyphens=False))
    return "\n\n".join(parts)


def evaluation_text(e: Evaluation) -> str:
    """Write the evaluation of one robot: places of targets, errors, and accuracy where poses were repeated."""
    return assessment_text(Assessment.of_one(e), "", "as given")


def robot_in_words(e: Assessment, result: str) -> str:
    """Name the evaluated robot in a sentence.

    Args:
        e: The evaluation.
        result: Name of the result's file.
    """
    return _LONG_NAMES[e.judged].format(result)


def outcome_reasons(e: Assessment, result: str) -> Iterator[str]:
    """Word what the outcome of an acceptance test rests on, and its caveats; nothing where no tolerance was stated.

    Args:
        e: The evaluation.
        result: Name of the result's file.
    """
    a, robot = e.accepted, robot_in_words(e, result)
    if a is None:
        return
    for unit in a.checks:
        yield from _check_reasons(a, unit, robot)
        yield from _no_better(e, a, unit)
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


def _check_reasons(a: Acceptance, unit: str, robot: str) -> Iterator[str]:
    """Word a figure against its tolerance, and the sum that decides, if that is another number.

    Args:
        a: The acceptance test, which has the check: the figure, its tolerance and the outcome.
        unit: Symbol of the check's unit, ``"m"`` of positions, ``"rad"`` of orientations.
        robot: The evaluated robot in words.

    Yields:
        One sentence or two, with numbers in mm or deg.
    """
    check = a.checks[unit]
    yield _figure_sentence(a, unit, robot)
    total = decisive_sum(check)
    if np.isfinite(check.held) and total != check.figure:
        yield _sum_sentence(check, total, unit)


def _no_better(e: Assessment, a: Acceptance, unit: str) -> Iterator[str]:
    """Word that the figure of the nominal robot is smaller than that of the evaluated one; nothing where it is not.

    Args:
        e: The evaluation.
        a: Its acceptance test.
        unit: Symbol of the unit of the figure.
    """
    if "nominal" not in e.accuracies:
        return
    key = FIGURE_KEYS[a.criterion]
    nominal = e.accuracies["nominal"].figures(unit)[key]
    if nominal < a.checks[unit].figure:
        size = with_unit(nominal, unit)
        yield f"That of the nominal robot is smaller, {size}: by this figure the calibration is no improvement."


def decisive_sum(check: Check) -> float:
    """Return the sum that is compared with the tolerance: A - U of a figure A that fails, else f A + U."""
    return check.figure - check.uncertainty if check.outcome == "fail" else check.held


def _figure_sentence(a: Acceptance, unit: str, robot: str) -> str:
    """Word a figure against its tolerance; the arguments are those of `_check_reasons`."""
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
    return (
        f"Evaluated: {robot}. The {name} of {plural(count, 'pose')} is {figure}{where}, {relation} the "
        f"tolerance of {tolerance}."
    )


def _sum_sentence(check: Check, total: float, unit: str) -> str:
    """Write the sum that decides as an equation, against the tolerance.

    A figure that fails is above the tolerance without its guard band, one that passes is within it with its guard band:
    ISO 14253-1.

    Args:
        check: The figure, its factor and guard band, and the tolerance, in the unit.
        total: The sum, in the same unit.
        unit: Symbol of the unit.
    """
    fails = check.outcome == "fail"
    terms = shown(check.figure, unit)
    if not fails and check.factor != 1.0:
        terms += f" x {check.factor:.3f} (registration)"
    if check.uncertainty > 0.0:
        sign = "-" if fails else "+"
        guard_band = shown(check.uncertainty, unit)
        terms += f" {sign} guard band {guard_band} (k = 2, ISO 14253-1)"
    relation = ">" if total > check.tolerance else "<="
    tolerance = with_unit(check.tolerance, unit)
    return f"{terms} = {with_unit(total, unit)} {relation} {tolerance}."


def _rows_reasons(a: Acceptance) -> Iterator[str]:
    """Word which rows are evaluated, what was registered to them, and what they mean for other poses."""
    accuracy, count = a.accuracy, len(a.accuracy.poses)
    if accuracy.seen:
        yield (
            f"The calibration was fitted to {accuracy.fitted} of the {accuracy.measured} rows, and the others are of "
            f"fewer than {FEWEST_APART} poses: they can fail, but not pass. Measure fresh ones."
        )
    elif accuracy.rows != "all":
        used = sum(len(pose.rows) for pose in accuracy.poses)
        others = " and the ".join(accuracy.others)
        yield (
            f"{used} of the {accuracy.measured} rows are evaluated; the others were used for the {others}."
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


def places_of(e: Assessment, source: str) -> list[str]:
    """Word the places of targets and frames, and their sources.

    Args:
        e: The evaluation.
        source: Source, in words, of targets that were not registered to the rows.
    """
    evaluation = e.evaluations["urdf"]
    origin = "registered to the rows" if "target" in evaluation.registered else source
    sentences, setup = [], evaluation.setup
    for name, T in zip(setup.targets, setup.T_tip_target, strict=True):
        place = ", ".join(map(mm, T[:3, 3]))
        label = f"Target '{name}'" if len(setup.targets) > 1 else "Target"
        sentences.append(f"{label} at ({place}) mm in {evaluation.robot.tip}, {origin}.")
    if "frame" in evaluation.registered:
        label = "Measurement frames" if len(setup.groups) > 1 else "Measurement frame"
        sentences.append(f"{label}: registered to the rows.")
    return sentences


def _errors_text(e: Assessment, result: str) -> str:
    """Write the tables of errors, with a block of rows for each robot."""
    channels = e.evaluations["urdf"].channels
    tables = []
    for unit in channels.present:
        lines = error_table(error_title(unit, channels), unit, error_blocks(e, unit, result))
        tables.append("\n".join(lines))
    return "\n\n".join(tables)


def _images_text(e: Assessment, result: str) -> Iterator[str]:
    """Write a table of the errors of images, a row for each robot; nothing without images."""
    columns = [
        name_column("Corners of images", 26),
        *(Column(head, 8) for head in ("mean px", "95 %", "max", "bias u", "bias v")),
        *(Column(head, 8) for head in ("mean mm", "95 %", "max")),
    ]
    rows = []
    for who, evaluation in e.evaluations.items():
        i = evaluation.images
        if i is None:
            continue
        pixels = (i.mean, i.p95, i.largest, *i.bias)
        lengths = (i.mean_at_board, i.p95_at_board, i.largest_at_board)
        cells = [*(number(value) for value in pixels), *(mm(value) for value in lengths)]
        rows.append((f"  {NAMES[who].format(result)}", *cells))
        counted = (
            f"{i.corners:,} corners in {i.images} images; bias is the mean of measured minus predicted, mm are at the "
            "board."
        )
    if rows:
        yield "\n".join([*table_lines(columns, rows), textwrap.fill(counted, WIDTH)])


def error_blocks(e: Assessment, unit: str, result: str) -> Iterator[tuple[str, Errors] | str]:
    """Yield the rows of a table of errors in one unit: the name of each robot, then its errors by set.

    Args:
        e: The evaluation.
        unit: Symbol of the unit.
        result: Name of the result's file.
    """
    for who, evaluation in e.evaluations.items():
        name = _LONG_NAMES[who].format(result)
        yield textwrap.shorten(name, WIDTH - 1, placeholder="...") + ":"
        counts = {key: errors[unit].n for key, errors in evaluation.errors.items()}
        one_set = counts["all"] in (counts["estimation"], counts["validation"])
        validated = np.any(evaluation.measurements.validation)
        for key, errors in evaluation.errors.items():
            if not counts[key] or (key == "all" and one_set):
                continue
            label = key
            if key == "estimation" and not validated:
                # Nothing says that anything is estimated from these rows.
                label = "measured"
            yield f"  {label} rows", errors


def evaluation_html(e: Evaluation) -> str:
    """Write an evaluation: the errors of each set of rows."""
    rows = []
    for name, errors in e.errors.items():
        if errors.units:
            rows.append((f"rms error, {name} rows", rms_text(errors)))
    rows.append(("rows", str(len(e.measurements))))
    if e.registered:
        rows.append(("registered to the rows", " and ".join(e.registered)))
    return html_table(f"Evaluation of {chain_name(e.robot)}", rows)


def evaluation_line(e: Evaluation) -> str:
    """Write an evaluation in one line: robot, error, rows."""
    errors = e.errors["all"]
    count = plural(len(e.measurements), "row")
    return one_line("Evaluation", chain_name(e.robot), f"rms {rms_text(errors)}", count)
