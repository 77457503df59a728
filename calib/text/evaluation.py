"""Evaluation of every robot that a URDF and a result hold, by `calib evaluate`, as text and as nested tables."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

import calib.data.kinds as registry
from calib.channels import RESIDUAL_UNITS
from calib.errors import choices
from calib.numerics.errors import Errors
from calib.result.acceptance import Acceptance, Assessment, Check
from calib.result.accuracy import FEWEST_APART, Accuracy, PoseAccuracy, accuracy as accuracy_of
from calib.result.calibration_file import error_table as stored_errors, pose_table, versions
from calib.result.evaluation import EvaluationValues
from calib.text.layout.doubtful_rows import outside_text
from calib.text.layout.lines import WIDTH, mm, plural, wrap
from calib.text.layout.sizes import shown, with_unit
from calib.text.layout.tables import Column, name_column, table_lines
from calib.text.summary import error_table, error_title
from calib.text.verdict import reason_text

#: Poses that are listed; the others are counted.
_MOST_POSES = 10

#: Rows of a pose that are named.
_MOST_ROWS = 3

#: Characters of the label of a pose; longer ones are shortened.
_LABEL = 22

#: Repeats of each pose that ISO 9283 asks for.
_ISO_REPEATS = 30

#: Poses that ISO 9283 asks for.
_ISO_POSES = 5

#: The robots in the table of accuracies.
_NAMES = {
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
_FIGURES = {
    "max": "largest AP",
    "mean": "mean AP",
    "single": "largest error of a single repeat",
}


def assessment_text(e: Assessment, result: str, source: str) -> str:
    """Write an evaluation: the outcome first, then places of targets, errors and accuracy of each robot.

    Args:
        e: The evaluation.
        result: Name of the result's file.
        source: Where targets are from that were not registered, such as "as given".

    Returns:
        The text, in lines of 100 columns.
    """
    robot = _LONG_NAMES[e.judged].format(result)
    parts = [_places_text(e.evaluations["urdf"], source), _errors_text(e.evaluations, result)]
    repeated = any(accuracy.repeats[1] > 1 for accuracy in e.accuracies.values())
    if e.accepted is not None or repeated:
        figures = {_NAMES[who]: accuracy for who, accuracy in e.accuracies.items()}
        parts.append(accuracy_text(figures))
    if e.accepted is not None:
        reasons = [wrap(reason, "  ") for reason in _reasons(e, e.accepted, robot)]
        verdict = "\n".join([f"Verdict: {e.accepted.outcome}", *reasons])
        parts = [verdict, *parts, poses_text(e.accepted, robot)]
    elif e.hint is not None:
        parts.append(textwrap.fill(reason_text(e.hint), WIDTH, break_on_hyphens=False))
    return "\n\n".join(parts)


def evaluation_text(e: EvaluationValues) -> str:
    """Write the evaluation of one robot: places of targets, errors, and accuracy where poses were repeated."""
    assessment = Assessment(
        evaluations={"urdf": e},
        accuracies={"urdf": accuracy_of(e)},
        judged="urdf",
        accepted=None,
        outside=((), ()),
        hint=None,
    )
    return assessment_text(assessment, "", "as given")


def _reasons(e: Assessment, a: Acceptance, robot: str) -> Iterator[str]:
    """Word what an outcome rests on, and its caveats; ``robot`` is the evaluated robot in words."""
    for unit in a.checks:
        yield from _check_reasons(a, unit, robot)
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
    total = check.held
    if check.outcome == "fail":
        total = check.figure - check.uncertainty
    if np.isfinite(check.held) and total != check.figure:
        yield _sum_sentence(check, total, unit)


def _figure_sentence(a: Acceptance, unit: str, robot: str) -> str:
    """Word a figure against its tolerance; the arguments are those of `_check_reasons`."""
    check, poses = a.checks[unit], a.accuracy.poses
    name = _FIGURES[a.criterion]
    if unit != "m":
        name += f" of {RESIDUAL_UNITS[unit].measured}"
    sizes = [a.size(pose, unit) for pose in poses]
    where = ""
    if a.criterion != "mean":
        worst = poses[int(np.nanargmax(sizes))]
        where = f" ({_rows_label(worst)})"
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
        repeats = str(high) if low == high else f"{low} to {high}"
        times = "times" if high > 1 else "time"
        yield (
            f"ISO 9283 asks for {_ISO_POSES} poses, each {_ISO_REPEATS} times; measured: {count}, each {repeats} "
            f"{times}."
        )
    if a.criterion != "mean" and count > 1 and not (a.within and accuracy.seen):
        share = np.floor(100.0 * a.share)
        yield (
            f"{a.within} of {count} poses are within: of poses chosen at random in the same way at least {share:.0f} % "
            "are, with 95 % confidence."
        )


def accuracy_text(robots: Mapping[str, Accuracy]) -> str:
    """Write accuracy AP and repeatability RP of several robots.

    Args:
        robots: The accuracy of each robot, by its name in the table.

    Returns:
        A table for each unit that was measured: of positions [mm], of orientations [deg].
    """
    units = {unit for accuracy in robots.values() for unit in accuracy.units}
    return "\n\n".join(_accuracy_table(robots, unit) for unit in RESIDUAL_UNITS if unit in units)


def _accuracy_title(robots: Mapping[str, Accuracy], unit: str) -> str:
    """Title of a table of accuracies in one unit: the accuracy of lengths alone is none of a pose."""
    poses = [pose for accuracy in robots.values() for pose in accuracy.poses]
    points = any(registry.get(pose.kind).coordinates for pose in poses)
    if unit == "m":
        return "Pose accuracy, ISO 9283 [mm]" if points else "Length accuracy [mm]"
    of_unit = RESIDUAL_UNITS[unit]
    standard = ", ISO 9283" if unit == "rad" else " accuracy"
    return f"{of_unit.measured.capitalize()}{standard} [{of_unit.shown}]"


def _accuracy_table(robots: Mapping[str, Accuracy], unit: str) -> str:
    """Write a table of accuracies in one unit."""
    columns = [name_column(_accuracy_title(robots, unit), 33), Column("poses", 5, gap=0)]
    columns += [Column(head, 9) for head in ("AP max", "mean", "RP max", "mean", "single")]
    rows = []
    for name, accuracy in robots.items():
        count = len(accuracy.of("ap", unit))
        figures = [shown(figure, unit) for figure in accuracy.figures(unit).values()]
        rows.append((f"  {name}", str(count), *figures))
    return "\n".join(table_lines(columns, rows))


def poses_text(a: Acceptance, robot: str) -> str:
    """Write the table of poses, the worst first.

    Args:
        a: The acceptance test.
        robot: The evaluated robot in words.

    Returns:
        A line for each of at most ten poses, with AP and RP [mm] and, where orientations were measured, [deg].
    """
    poses = sorted(a.accuracy.poses, key=a.used, reverse=True)
    units = a.accuracy.units
    columns = [name_column("", 24), Column("repeats", 7)]
    for unit in units:
        of_unit = RESIDUAL_UNITS[unit]
        columns.append(Column(f"AP [{of_unit.shown}]", 8))
        axes = ("x", "y", "z") if of_unit.shows_span else ()
        columns += [Column(head, 7) for head in (*axes, "RP")]
        if unit == units[0]:
            columns.append(Column("single", 7))
    several_targets = len({pose.target for pose in poses}) > 1
    several_stations = len({pose.group for pose in poses}) > 1
    rows = []
    for pose in poses[:_MOST_POSES]:
        names = []
        if several_targets:
            names.append(pose.target)
        if several_stations:
            names.append(pose.group)
        rows.append(_pose_row(pose, names, units))
    lines = [wrap(f"Poses, the worst first, of {robot}:"), *table_lines(columns, rows)]
    if len(poses) > _MOST_POSES:
        lines.append(f"  and {len(poses) - _MOST_POSES} more")
    return "\n".join(lines)


def _pose_row(pose: PoseAccuracy, names: list[str], units: Sequence[str]) -> list[str]:
    """Cells of a pose in some units; names are those of its target and station where the table has several."""
    label = _rows_label(pose)
    if names:
        label += f" ({', '.join(names)})"
    label = textwrap.shorten(label, _LABEL, placeholder="...")
    cells = [f"  {label}", str(len(pose.rows))]
    for unit in units:
        figures = pose[unit]
        along = figures.ap_axis if RESIDUAL_UNITS[unit].shows_span else ()
        values = [figures.ap, *along, figures.rp]
        if unit == units[0]:
            values.append(figures.single)
        cells += [shown(value, unit) for value in values]
    return cells


def _rows_label(pose: PoseAccuracy) -> str:
    """Name the rows of a pose: ``row 4``, ``rows 1, 2, 3, ...``; of pairs the first one."""
    rows = pose.rows
    if registry.get(pose.kind).paired:
        rows = rows[:1]
    names = [str(row) for row in rows[:_MOST_ROWS]]
    if len(pose.rows) > _MOST_ROWS:
        names.append("...")
    noun = "rows" if len(rows) > 1 else "row"
    return f"{noun} {', '.join(names)}"


def _places_text(evaluation: EvaluationValues, source: str) -> str:
    """Word the places of targets and frames, and where these are from."""
    origin = "registered to the rows" if "target" in evaluation.registered else source
    lines, setup = [], evaluation.setup
    for name, T in zip(setup.targets, setup.T_tip_target, strict=True):
        place = ", ".join(map(mm, T[:3, 3]))
        label = f"Target '{name}'" if len(setup.targets) > 1 else "Target"
        text = f"{label} at ({place}) mm in {evaluation.robot.tip}, {origin}."
        lines.append(textwrap.fill(text, WIDTH))
    if "frame" in evaluation.registered:
        label = "Measurement frames" if len(setup.groups) > 1 else "Measurement frame"
        lines.append(f"{label}: registered to the rows.")
    return "\n".join(lines)


def _errors_text(robots: Mapping[str, EvaluationValues], result: str) -> str:
    """Write the tables of errors, with a block of rows for each robot."""
    names = {who: _LONG_NAMES[who].format(result) for who in robots}
    blocks = {names[who]: evaluation for who, evaluation in robots.items()}
    channels = robots["urdf"].channels
    tables = []
    for unit in channels.present:
        lines = error_table(error_title(unit, channels), unit, _blocks(blocks, unit))
        tables.append("\n".join(lines))
    return "\n\n".join(tables)


def _blocks(
    robots: Mapping[str, EvaluationValues], unit: str
) -> Iterator[tuple[str, Errors] | str]:
    """Rows of a table of errors in one unit: the name of each robot, then its errors by set."""
    for name, evaluation in robots.items():
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


def assessment_table(e: Assessment) -> dict[str, Any]:
    """Evaluation as nested tables in SI units, which `calib evaluate --json` writes; see docs/result-json.md."""
    urdf, acceptance = e.evaluations["urdf"], e.accepted
    m, setup, robot = urdf.measurements, urdf.setup, urdf.robot
    frames = zip(setup.groups, setup.T_frame_base, strict=True)
    targets = zip(setup.targets, setup.T_tip_target, strict=True)
    accepted = None
    if acceptance is not None:
        accepted = {"robot": e.judged, **acceptance_table(acceptance)}
    read = {"name": m.source, "sha256": m.sha256, "orientation": m.orientation or None}
    return {
        "schema": "evaluation 4",  # a word, so that it is not taken for a result's
        "robot": {"name": robot.name, "base": robot.base, "tip": robot.tip},
        "frames": {
            **pose_table(setup.T_frame_base[0], "frame_base_"),
            "target_m": setup.T_tip_target[0, :3, 3],
            "registered": list(urdf.registered),
            "set_ups": [{"group": name, **pose_table(T, "frame_base_")} for name, T in frames],
            "targets": [{"target": name, **pose_table(T)} for name, T in targets],
        },
        "errors": {who: _errors_table(evaluation) for who, evaluation in e.evaluations.items()},
        "inputs": {
            "urdf": {"name": robot.urdf.source, "sha256": robot.urdf.sha256},
            "measurements": {**read, "rows": len(m)},
        },
        "versions": versions(),
        "accuracy": {who: accuracy_table(figures) for who, figures in e.accuracies.items()},
        "acceptance": accepted,
    }


def _errors_table(evaluation: EvaluationValues) -> dict[str, Any]:
    """Errors of one robot as nested tables in SI units, by the set of rows: ``estimation``, ``validation``, ``all``."""
    return {name: stored_errors(errors) for name, errors in evaluation.errors.items()}


def accuracy_table(accuracy: Accuracy) -> dict[str, Any]:
    """Accuracy and repeatability of one robot, in SI units."""
    low, high = accuracy.repeats
    figures = {unit: accuracy.figures(unit) for unit in accuracy.units}
    poses = []
    for pose in accuracy.poses:
        by_unit = {unit: asdict(of_unit) for unit, of_unit in pose.by_unit.items()}
        names = {"rows": pose.rows, "kind": pose.kind, "group": pose.group, "target": pose.target}
        poses.append(names | by_unit)
    return {
        "rows": accuracy.rows,
        "measured": accuracy.measured,
        "fitted": accuracy.fitted,
        "seen": accuracy.seen,
        "repeats_min": low,
        "repeats_max": high,
        **figures,
        "poses": poses,
    }


def acceptance_table(a: Acceptance) -> dict[str, Any]:
    """Acceptance test in SI units: outcome, criterion, and the check in each unit that has a tolerance."""
    table: dict[str, Any] = {
        "outcome": a.outcome,
        "criterion": a.criterion,
        "within": a.within,
        "share": a.share,
    }
    for unit, check in a.checks.items():
        table[unit] = {
            "figure": check.figure,
            "tolerance": check.tolerance,
            "uncertainty": check.uncertainty,
            "held": check.held,
            "factor": check.factor,
            "outcome": check.outcome,
        }
    return table
