"""Moved from calib.result.acceptance."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

import calib.data.kinds as registry
from calib.errors import choices
from calib.result.acceptance import FAIL, ISO_POSES, ISO_REPEATS, Acceptance, Check, size_of
from calib.result.accuracy import FEWEST_APART, FEWEST_REPEATS, Accuracy, PoseAccuracy
from calib.text.lines import wrap

#: Poses that are listed, and rows of a pose that are named.
_MOST_POSES = 10


_MOST_ROWS = 3


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
