"""What `calib evaluate` finds of every robot that a URDF and a result hold, as text and as nested tables."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

import calib.data.kinds as registry
from calib.errors import choices
from calib.numerics.errors import Errors
from calib.result.acceptance import Acceptance, Assessment, Check
from calib.result.calibration_file import error_table, pose_table, versions
from calib.result.evaluation import FEWEST_APART, Accuracy, Evaluation, PoseAccuracy
from calib.text.lines import deg, mm, wrap
from calib.text.summary import ANGLE_HEAD, angle_row, error_head, error_row, error_title
from calib.text.verdict import outside_text, reason_text

#: Poses that are listed, and rows of a pose that are named.
_MOST_POSES, _MOST_ROWS = 10, 3

#: What ISO 9283 asks for: repeats of a pose, and poses.
_ISO_REPEATS, _ISO_POSES = 30, 5

#: The robots: in the table of accuracies, and in a sentence.
_NAMES = {
    "nominal": ("nominal", "the nominal robot of {}"),
    "urdf": ("URDF as it is", "the URDF as it is"),
    "calibration": ("calibrated", "the robot with the joint origins of {}"),
    "non_geometric": ("non-geometric model", "the robot with the non-geometric model of {}"),
}

#: What the criteria look at.
_FIGURES = {
    "max": "largest AP",
    "mean": "mean AP",
    "single": "largest error of a single repeat",
}

_COLUMNS = "{:<33}{:>5} {:>9} {:>9} {:>9} {:>9} {:>9}"


def assessment_text(e: Assessment, result: str, source: str) -> str:
    """Everything as text of 100 columns: the outcome first, where targets are, errors and accuracy of each robot.

    With the name of the result's file, and where targets are from that were not registered.
    """
    judged = _NAMES[e.judged][1].format(result)
    parts = [_places_text(e.found["urdf"], source), _errors_text(e.found, result)]
    if e.accepted is not None or any(one.repeats[1] > 1 for one in e.figures.values()):
        parts.append(accuracy_text({_NAMES[who][0]: one for who, one in e.figures.items()}))
    if e.accepted is not None:
        reasons = (wrap(reason, "  ") for reason in _reasons(e, e.accepted, judged))
        first = "\n".join([f"Verdict: {e.accepted.outcome}", *reasons])
        parts = [first, *parts, poses_text(e.accepted, judged)]
    elif e.hint is not None:
        parts.append(textwrap.fill(reason_text(e.hint), 100, break_on_hyphens=False))
    return "\n\n".join(parts)


def _reasons(e: Assessment, a: Acceptance, judged: str) -> Iterator[str]:
    """What an outcome rests on and what must be minded with it, sentence by sentence."""
    one = a.accuracy
    for check, angle in a.checks:
        yield from _check_reasons(a, check, judged, angle=angle)
    kinds = dict.fromkeys(p.kind for p in one.poses if not registry.get(p.kind).coordinates)
    beyond = outside_text(*e.outside)
    yield from _rows_reasons(a)
    every = {
        "Orientations have no tolerance and are not judged.": (
            a.angle is None and len(one.of("ap_angle"))
        ),
        "Positions have no tolerance and are not judged.": a.length is None,
        f"Rows of the kind {choices(kinds)} say nothing of errors across them.": kinds,
        f"Joint values outside of the calibrated range: {beyond}.": beyond,
        "" if e.hint is None else reason_text(e.hint): e.hint is not None,
    }
    yield from (sentence for sentence, applies in every.items() if applies)


def _check_reasons(a: Acceptance, check: Check, judged: str, *, angle: bool) -> Iterator[str]:
    """The figure, and the sum that decided where it is another."""
    unit, size = ("deg", lambda v: deg(v, 4)) if angle else ("mm", mm)
    poses, figure, tolerance = a.accuracy.poses, check.figure, check.tolerance
    worst = np.nanargmax([a.size(pose, angle=angle) for pose in poses])
    where = "" if a.criterion == "mean" else f" ({_rows_label(poses[worst])})"
    yield (
        f"Judged is {judged}: {_FIGURES[a.criterion]}{' of orientation' * angle} of {len(poses)} "
        f"pose{'s' * (len(poses) != 1)} {size(figure)} {unit}{where}, {'above' if figure > tolerance else 'within'} "
        f"the tolerance of {size(tolerance)} {unit}."
    )
    fails, sums = check.outcome == "fail", size(figure)
    total = figure - check.uncertainty if fails else check.held
    if np.isfinite(check.held) and total != figure:
        sums += f" x {check.factor:.3f} (registration)" * (not fails and check.factor != 1.0)
        guard = (
            f" {'-' if fails else '+'} guard band {size(check.uncertainty)} (k = 2, ISO 14253-1)"
        )
        sums += guard * (check.uncertainty > 0.0)
        sign = ">" if total > tolerance else "<="
        yield f"{sums} = {size(total)} {unit} {sign} {size(tolerance)} {unit}."


def _rows_reasons(a: Acceptance) -> Iterator[str]:
    """Which rows were judged, what was registered to them, and what they say of others."""
    one, (low, high), count = a.accuracy, a.accuracy.repeats, len(a.accuracy.poses)
    if one.seen:
        yield (
            f"The calibration was fitted to {one.fitted} of the {one.measured} rows, and the others are of fewer than "
            f"{FEWEST_APART} poses: they can fail, but not pass. Measure fresh ones."
        )
    elif one.rows != "all":
        used, others = sum(len(pose.rows) for pose in one.poses), " and the ".join(one.others)
        yield f"Judged are {used} of the {one.measured} rows; the others were used for the {others}."
    if one.registered:
        lost = f"random errors are scaled by {one.factor:.3f}"
        yield (
            f"Registered to these rows: {' and '.join(one.registered)}, {one.unknowns} unknowns from {one.numbers} "
            f"numbers; {lost if np.isfinite(one.factor) else 'no degree of freedom remains'}."
        )
    if low < _ISO_REPEATS or count < _ISO_POSES:
        made = f"{low}" if low == high else f"{low} to {high}"
        yield (
            f"ISO 9283 asks for {_ISO_POSES} poses, each {_ISO_REPEATS} times; measured: {count}, each {made} time"
            f"{'s' * (high > 1)}."
        )
    if a.criterion != "mean" and count > 1 and not (a.within and one.seen):
        yield (
            f"{a.within} of {count} poses are within: of poses chosen at random in the same way at least "
            f"{np.floor(100.0 * a.share):.0f} % are, with 95 % confidence."
        )


def accuracy_text(found: Mapping[str, Accuracy]) -> str:
    """AP and RP of several robots, by name: positions [mm], and orientations [deg] where there are any."""
    poses = [pose for one in found.values() for pose in one.poses]
    narrow = not any(registry.get(pose.kind).coordinates for pose in poses)
    titles = ["Length accuracy [mm]" if narrow else "Pose accuracy, ISO 9283 [mm]"]
    titles += ["Orientation, ISO 9283 [deg]"] * any(np.isfinite(p.ap_angle) for p in poses)
    parts = []
    for angle, title in zip((False, True), titles, strict=False):
        lines = [_COLUMNS.format(title, "poses", "AP max", "mean", "RP max", "mean", "single")]
        for name, one in found.items():
            values = one.figures(angle=angle).values()
            count = len(one.of("ap_angle" if angle else "ap"))
            cells = (deg(v, 4) if angle else mm(v) for v in values)
            lines.append(_COLUMNS.format(f"  {name}", count, *cells))
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


def poses_text(a: Acceptance, judged: str) -> str:
    """The poses one by one, the worst first; at most ten."""
    poses = sorted(a.accuracy.poses, key=a.used, reverse=True)
    head = ["repeats", "AP [mm]", "x", "y", "z", "RP", "single"]
    turned = any(np.isfinite(pose.ap_angle) for pose in poses)
    head += ["AP [deg]", "RP"] if turned else []
    rows = [("", head)]
    for pose in poses[:_MOST_POSES]:
        cells = [str(len(pose.rows)), *map(mm, (pose.ap, *pose.ap_xyz, pose.rp, pose.single))]
        cells += [deg(pose.ap_angle, 4), deg(pose.rp_angle, 4)] if turned else []
        # The target and the set-up of a pose, where the table has several.
        named = [pose.target] * (len({p.target for p in poses}) > 1)
        named += [pose.group] * (len({p.group for p in poses}) > 1)
        label = _rows_label(pose) + (f" ({', '.join(named)})" if named else "")
        rows.append((f"  {textwrap.shorten(label, 22, placeholder='...')}", cells))
    widths = (8, 9, 8, 8, 8, 8, 8, 9, 8)
    lines = [wrap(f"Poses, the worst first, of {judged}:")]
    for label, cells in rows:
        set_cells = (f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=False))
        lines.append(f"{label:<24}{''.join(set_cells)}")
    more = len(poses) - _MOST_POSES
    return "\n".join([*lines, *[f"  and {more} more"] * (more > 0)])


def _rows_label(pose: PoseAccuracy) -> str:
    """The rows of a pose in few words."""
    rows = pose.rows[:1] if registry.get(pose.kind).paired else pose.rows
    listed = ", ".join(map(str, rows[:_MOST_ROWS])) + ", ..." * (len(pose.rows) > _MOST_ROWS)
    return f"row{'s' * (len(rows) > 1)} {listed}"


def _places_text(first: Evaluation, source: str) -> str:
    """Where targets and frames are, and how that is known."""
    how = "registered to the rows" if "target" in first.registered else source
    lines, targets = [], first.setup.targets
    for name, T in zip(targets, first.setup.T_tip_target, strict=True):
        place = ", ".join(map(mm, T[:3, 3]))
        label = f"Target '{name}'" if len(targets) > 1 else "Target"
        lines.append(textwrap.fill(f"{label} at ({place}) mm in {first.robot.tip}, {how}.", 100))
    if "frame" in first.registered:
        many = "s" * (len(first.setup.groups) > 1)
        lines.append(f"Measurement frame{many}: registered to the rows.")
    return "\n".join(lines)


def _errors_text(found: Mapping[str, Evaluation], result: str) -> str:
    """The errors of each robot as tables."""
    shown = {_NAMES[who][1].format(result): one for who, one in found.items()}

    def table(head: str, row: Callable[[str, Errors], str], count: str) -> str:
        """Of lengths or angles; ``count`` names the attribute that says how many there are."""
        lines = [head]
        for label, one in shown.items():
            lines.append(textwrap.shorten(label, 99, placeholder="...") + ":")
            sizes = {name: getattr(errors, count) for name, errors in one.errors.items()}
            # Where the table sets none aside, nothing says that anything is estimated from these rows.
            called = {} if np.any(one.measurements.validation) else {"estimation": "measured"}
            for name, errors in one.errors.items():
                alone = name == "all" and sizes["all"] in (sizes["estimation"], sizes["validation"])
                if sizes[name] and not alone:
                    lines.append(row(f"  {called.get(name, name)} rows", errors))
        return "\n".join(lines)

    parts = [table(error_head(error_title(found["urdf"].used)), error_row, "n")]
    if any(one.errors["all"].n_angle for one in shown.values()):
        parts.append(table(ANGLE_HEAD, angle_row, "n_angle"))
    return "\n\n".join(parts)


def assessment_table(e: Assessment) -> dict[str, Any]:
    """Everything as nested tables in SI units, which `calib evaluate --json` writes; see docs/result-json.md."""
    urdf, a = e.found["urdf"], e.accepted
    m, setup, robot = urdf.measurements, urdf.setup, urdf.robot
    frames = zip(setup.groups, setup.T_frame_base, strict=True)
    targets = zip(setup.targets, setup.T_tip_target, strict=True)
    return {
        "schema": "evaluation 3",  # a word, so that it is not taken for a result's
        "robot": {"name": robot.name, "base": robot.base, "tip": robot.tip},
        "frames": {
            **pose_table(setup.T_frame_base[0], "frame_base_"),
            "target_m": setup.T_tip_target[0, :3, 3],
            "registered": list(urdf.registered),
            "set_ups": [{"group": name, **pose_table(T, "frame_base_")} for name, T in frames],
            "targets": [{"target": name, **pose_table(T)} for name, T in targets],
        },
        "errors": {
            who: {name: error_table(errors) for name, errors in one.errors.items()}
            for who, one in e.found.items()
        },
        "inputs": {
            "urdf": {"name": robot.urdf.source, "sha256": robot.urdf.sha256},
            "measurements": {"name": m.source, "sha256": m.sha256, "rows": len(m)},
        },
        "versions": versions(),
        "accuracy": {who: accuracy_table(one) for who, one in e.figures.items()},
        "acceptance": None if a is None else {"robot": e.judged, **acceptance_table(a)},
    }


def accuracy_table(one: Accuracy) -> dict[str, Any]:
    """Accuracy and repeatability of one robot."""
    low, high = one.repeats
    figures = {f"{key}_m": value for key, value in one.figures().items()}
    figures |= {f"{key}_rad": value for key, value in one.figures(angle=True).items()}
    names = ("rows", "measured", "fitted", "seen")
    units = {name: f"{name}_m" for name in ("ap", "ap_xyz", "rp", "single")}
    units |= {"ap_angle": "ap_rad", "single_angle": "single_rad"}
    units |= {name: f"{name}_rad" for name in ("ap_abc", "rp_abc")}
    return {
        **{name: getattr(one, name) for name in names},
        "repeats_min": low,
        "repeats_max": high,
        **figures,
        "poses": [{units.get(n, n): v for n, v in asdict(p).items()} for p in one.poses],
    }


def acceptance_table(a: Acceptance) -> dict[str, Any]:
    """An acceptance: outcome, criterion and both checks."""
    table: dict[str, Any] = {
        name: getattr(a, name) for name in ("outcome", "criterion", "within", "share")
    }
    table |= {"length": None, "angle": None}
    for check, angle in a.checks:
        unit = "rad" if angle else "m"
        sizes = ("figure", "tolerance", "uncertainty", "held")
        table["angle" if angle else "length"] = {
            **{f"{name}_{unit}": getattr(check, name) for name in sizes},
            "factor": check.factor,
            "outcome": check.outcome,
        }
    return table
