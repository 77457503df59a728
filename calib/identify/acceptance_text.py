"""Accuracy and acceptance as text of at most 100 columns."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

import calib.kinds as registry
from calib.errors import choices
from calib.identify.acceptance import FAIL, UNDECIDED, Acceptance, Check, size_of
from calib.identify.acceptance_rows import FEWEST_APART
from calib.identify.accuracy import FEWEST_REPEATS, Accuracy, PoseAccuracy
from calib.identify.words import wrap

Array = NDArray[np.float64]

#: What ISO 9283 asks for: repeats of a pose, and poses.
ISO_REPEATS, ISO_POSES = 30, 5

#: From this factor on, what registering took away can be mended.
_WORTH_ADVICE = 1.1

#: Poses that are listed, and rows of a pose that are named.
_MOST_POSES, _MOST_ROWS = 10, 3

#: What the criteria look at.
_LENGTHS = {
    "max": "largest pose accuracy AP",
    "mean": "mean pose accuracy AP",
    "single": "largest error of a single repeat",
}
_NARROW = {**_LENGTHS, "max": "largest AP of a length", "mean": "mean AP of lengths"}
_ANGLES = {
    "max": "largest AP of orientation",
    "mean": "mean AP of orientation",
    "single": "largest angle of a single repeat",
}
_COLUMNS = "{:<33}{:>5} {:>9} {:>9} {:>9} {:>9} {:>9}"


def acceptance_text(a: Acceptance, judged: str, notes: Sequence[str] = ()) -> str:
    """The outcome, and what it stands on.

    Args:
        a: The acceptance.
        judged: What the robot is called that was judged.
        notes: What else must be minded.
    """
    reasons = acceptance_reasons(a, judged, notes)
    return "\n".join([f"Verdict: {a.outcome}", *(wrap(reason, "  ") for reason in reasons)])


def acceptance_reasons(a: Acceptance, judged: str, notes: Sequence[str] = ()) -> list[str]:
    """What an outcome stands on and what must be minded with it, sentence by sentence.

    Args:
        a: The acceptance.
        judged: What the robot is called that was judged.
        notes: What else must be minded.
    """
    sentences = [
        f"Judged is {judged}: {'; '.join(_figure_text(a, check) for check in a.checks)}.",
        _uncertainty_text(a),
        _apart_text(a),
        _registered_text(a),
        *(_held_text(check, check is a.angle) for check in a.checks),
        *(_chance_text(a, check) for check in a.checks),
        _repeats_text(a.accuracy),
        _share_text(a),
        _left_out_text(a),
        *notes,
    ]
    return [sentence for sentence in sentences if sentence]


def accuracy_text(found: Mapping[str, Accuracy]) -> str:
    """AP and RP of several robots side by side: positions [mm], and orientations [deg] where there are any.

    Args:
        found: By what the robots are called.
    """
    head = ("poses", "AP max", "mean", "RP max", "mean", "single")
    narrow = all(_narrow(one) for one in found.values())
    title = "Length accuracy [mm]" if narrow else "Pose accuracy, ISO 9283 [mm]"
    lines = [_COLUMNS.format(title, *head)]
    for name, one in found.items():
        lines.append(_accuracy_row(name, len(one.ap), (one.ap, one.rp, one.single), 1e3, 3))
    if any(len(one.ap_angle) for one in found.values()):
        lines += ["", _COLUMNS.format("Orientation, ISO 9283 [deg]", *head)]
        for name, one in found.items():
            values = (one.ap_angle, one.rp_angle, one.single_angle)
            lines.append(_accuracy_row(name, len(one.ap_angle), values, float(np.degrees(1.0)), 4))
    return "\n".join(line.rstrip() for line in lines)


def poses_text(a: Acceptance, judged: str) -> str:
    """The poses one by one, the worst first; at most ten.

    Args:
        a: The acceptance.
        judged: What the robot is called that was judged.
    """
    poses = worst_first(a)
    shown = poses[:_MOST_POSES]
    # Where single repeats are judged, they stand in the place of RP.
    single = a.criterion == "single"
    last = "single" if single else "RP"
    head = ["repeats", "AP [mm]", "x", "y", "z", last]
    turned = any(np.isfinite(pose.ap_angle) for pose in shown)
    head += ["AP [deg]", last] if turned else []
    order = "worst" if len(a.checks) == 1 else "furthest beyond or nearest to a tolerance"
    name = f"Poses, the {order} first" if len(shown) > 1 else "The pose"
    lines = [wrap(f"{name}, of {judged}:"), _pose_row("", head)]
    for pose in shown:
        ends = (pose.single, pose.single_angle) if single else (pose.rp, float(np.max(pose.rp_abc)))
        lengths = [_number(1e3 * v, 3) for v in (pose.ap, *pose.ap_xyz, ends[0])]
        angles = [_number(float(np.degrees(v)), 4) for v in (pose.ap_angle, ends[1])]
        label = textwrap.shorten(f"  {_rows_label(pose)}{_place(a, pose)}", 24, placeholder="...")
        row = [str(len(pose.rows)), *lengths, *(angles if turned else [])]
        lines.append(_pose_row(f"  {label}", row))
    more = len(poses) - len(shown)
    lines += [f"  and {more} more"] if more else []
    return "\n".join(lines)


def worst_first(a: Acceptance) -> list[PoseAccuracy]:
    """The poses by how much of their tolerance they use, the worst first."""

    def used(pose: PoseAccuracy) -> float:
        """The largest share of a tolerance."""
        pairs = ((a.length, False), (a.angle, True))
        shares = [
            size_of(pose, a.criterion, angle=angle) / check.tolerance
            for check, angle in pairs
            if check is not None
        ]
        return max((share for share in shares if np.isfinite(share)), default=0.0)

    return sorted(a.accuracy.poses, key=used, reverse=True)


def _figure_text(a: Acceptance, check: Check) -> str:
    """What was judged, where, and by which tolerance."""
    count = len(a.accuracy.poses)
    poses = f"{count} pose{'s' * (count != 1)}"
    angle = check is a.angle
    figure, tolerance = _sized(check.figure, angle), _sized(check.tolerance, angle)
    if figure == tolerance:
        # Side by side they must differ where they do.
        figure = _sized(check.figure, angle, 6)
    words = _ANGLES if angle else _NARROW if _narrow(a.accuracy) else _LENGTHS
    what = f"{words[a.criterion]} of {poses} is {figure}"
    where = "" if a.criterion == "mean" else f" ({_rows_label(_worst(a, angle=angle))})"
    side = "above" if check.figure > check.tolerance else "within"
    return f"the {what}{where}, {side} the tolerance of {tolerance}"


def _worst(a: Acceptance, *, angle: bool) -> PoseAccuracy:
    """The pose whose figure was judged."""
    sizes = [size_of(pose, a.criterion, angle=angle) for pose in a.accuracy.poses]
    return a.accuracy.poses[int(np.nanargmax(sizes))]


def _uncertainty_text(a: Acceptance) -> str:
    """What of the measuring uncertainty was counted."""
    stated = [
        _sized(check.uncertainty, check is a.angle) for check in a.checks if check.uncertainty
    ]
    if not stated:
        return (
            "The measuring uncertainty is not counted; where it is not far below the tolerance, state it "
            "(--uncertainty)."
        )
    text = f"The measuring uncertainty of {' and '.join(stated)} (k = 2) is counted against the outcome (ISO 14253-1)"
    if any(check.uncertainty >= check.tolerance for check in a.checks):
        return f"{text}: it is not below the tolerance, so that no robot could pass. Measure more exactly."
    between = any(abs(check.figure - check.tolerance) <= check.uncertainty for check in a.checks)
    if a.outcome == UNDECIDED and between:
        text += ": neither that the tolerance is kept nor that it is not is proved"
    return f"{text}."


def _apart_text(a: Acceptance) -> str:
    """Which rows were judged, and whether a calibration has seen them."""
    one = a.accuracy
    if one.seen and one.fitted == one.measured:
        return (
            "The calibration was fitted to these very rows: they can show that it fails, not that it passes. Measure "
            "fresh ones."
        )
    if one.seen:
        return (
            f"The calibration was fitted to {one.fitted} of the {one.measured} rows, and the others are of fewer than "
            f"{FEWEST_APART} poses: the rows can show that it fails, not that it passes. Measure fresh ones, and give "
            "them alone."
        )
    if one.rows == "all":
        return ""
    parts = ["the calibration was fitted"] * ("calibration" in one.others)
    parts += [f"the {what} was registered" for what in one.others if what != "calibration"]
    count = sum(len(pose.rows) for pose in one.poses)
    which = f"{count} of the {one.measured}" if one.rows == "fresh" else "The validation"
    return f"{which} rows alone are judged: to the others {' and '.join(parts)}."


def _registered_text(a: Acceptance) -> str:
    """What registering to the same rows takes away."""
    r = a.accuracy.registered
    if not r.what:
        return ""
    what = " and ".join(r.what)
    many = len(r.what) > 1
    lost = (
        f"random errors look {100.0 * (1.0 - 1.0 / r.factor):.2g} % too small, which is counted against the outcome"
        if np.isfinite(r.factor)
        else "nothing is left to judge by"
    )
    advice = " Give them" if many else " Give it"
    advice += ", register with other points, or measure more poses."
    return (
        f"The {what} {'were' if many else 'was'} registered to these rows: {r.unknowns} unknowns from {r.numbers} "
        f"numbers, so {lost}. What a displaced {what.replace(' and ', ' or ')} explains is not in AP at all."
        f"{advice * (r.factor > _WORTH_ADVICE)}"
    )


def _held_text(check: Check, angle: bool) -> str:
    """The sum that decided, where it is not the figure itself."""
    if not np.isfinite(check.held) or check.held == check.figure:
        return ""
    fails = check.outcome == FAIL
    total = check.lowest if fails else check.held
    digits = 6 if _sized(total, angle) == _sized(check.tolerance, angle) else 3
    sums = _sized(check.figure, angle, digits)
    if not fails and check.factor != 1.0:
        sums += f" x {check.factor:.{digits}f}"
    if check.uncertainty:
        sums += f" {'-' if fails else '+'} {_sized(check.uncertainty, angle, digits)}"
    side = "above" if total > check.tolerance else "within"
    if total == check.figure:
        return ""
    return (
        f"Held against the tolerance is {sums} = {_sized(total, angle, digits)}: {side} "
        f"{_sized(check.tolerance, angle)}."
    )


def _chance_text(a: Acceptance, check: Check) -> str:
    """Whether the repeats tell the figure well enough."""
    if not check.by_chance:
        return ""
    return (
        f"The repeats scatter so that an AP is known to ± {_sized(check.random, check is a.angle)} (95 %): the figure "
        "is closer to the tolerance than that. Repeat the poses more often."
    )


def _repeats_text(one: Accuracy) -> str:
    """How the poses and repeats compare with what the standard asks for."""
    low, high = one.repeats
    count = len(one.poses)
    if low >= ISO_REPEATS and count >= ISO_POSES:
        return ""
    asked = f"ISO 9283 asks for {ISO_REPEATS} repeats of each of {ISO_POSES} poses"
    if high == 1:
        text = "Each pose was measured once: its AP holds repeatability and noise too, and RP cannot be told."
        # What the standard asks for is of poses.
        return text if _narrow(one) else f"{text} {asked}."
    repeats = f"{low}" if low == high else f"{low} to {high}"
    text = f"{asked}; here are {repeats} of {'each of ' * (count > 1)}{count}"
    if high < FEWEST_REPEATS:
        return f"{text}. RP takes {FEWEST_REPEATS} at least."
    return f"{text}."


def _share_text(a: Acceptance) -> str:
    """What the poses say of others."""
    count = len(a.accuracy.poses)
    if a.criterion == "mean" or count == 1:
        return ""
    if not a.within:
        return f"None of {count} poses is within."
    if a.accuracy.seen:
        return ""  # rows that a fit has seen tell nothing of others
    text = f"All {count} poses" if a.within == count else f"{a.within} of {count} poses"
    return (
        f"{text} are within: of poses chosen at random in the same way at least {_percent(a.share)} are, with 95 % "
        "confidence."
    )


def _left_out_text(a: Acceptance) -> str:
    """What was measured and not judged, and what was not measured."""
    parts = []
    if a.angle is None and len(a.accuracy.ap_angle):
        parts.append("Orientations were measured and have no tolerance: they are not judged.")
    if a.length is None:
        parts.append("Positions were measured and have no tolerance: they are not judged.")
    narrow = list(
        dict.fromkeys(p.kind for p in a.accuracy.poses if not registry.get(p.kind).coordinates)
    )
    if narrow:
        parts.append(f"Rows of the kind {choices(narrow)} say nothing of errors across them.")
    return " ".join(parts)


def _narrow(one: Accuracy) -> bool:
    """Whether every row measures one length alone."""
    return not any(registry.get(pose.kind).coordinates for pose in one.poses)


def _sized(value: float, angle: bool, digits: int = 3) -> str:
    """A length in mm or an angle in deg, which has a digit more, with its unit."""
    return f"{np.degrees(value):.{digits + 1}f} deg" if angle else f"{1e3 * value:.{digits}f} mm"


def _percent(share: float) -> str:
    """A share, never rounded up."""
    return f"{np.floor(100.0 * share):.0f} %"


def _number(value: float, digits: int) -> str:
    """A number of a table; a dash where there is none, and no minus before a zero."""
    return f"{round(value, digits) + 0.0:.{digits}f}" if np.isfinite(value) else "-"


def _rows_label(pose: PoseAccuracy) -> str:
    """The rows of a pose in few words."""
    rows = pose.rows
    if registry.get(pose.kind).paired:
        return f"pair of row {rows[0]}{', ...' * (len(rows) > 1)}"
    if len(rows) == 1:
        return f"row {rows[0]}"
    if rows == tuple(range(rows[0], rows[-1] + 1)):
        return f"rows {rows[0]} to {rows[-1]}"
    listed = ", ".join(str(row) for row in rows[:_MOST_ROWS])
    return f"rows {listed}{', ...' * (len(rows) > _MOST_ROWS)}"


def _place(a: Acceptance, pose: PoseAccuracy) -> str:
    """The target and the set-up of a pose, where the table has several."""
    poses = a.accuracy.poses
    named = [pose.target] * (len({p.target for p in poses}) > 1)
    named += [pose.group] * (len({p.group for p in poses}) > 1)
    return f" ({', '.join(named)})" if named else ""


def _pose_row(label: str, values: Sequence[str]) -> str:
    """One row of the table of poses."""
    widths = (8, 10, 10, 10, 10, 8, 10, 8)
    cells = (f"{value:>{width}}" for value, width in zip(values, widths, strict=False))
    return f"{label:<26}{''.join(cells)}"


def _accuracy_row(
    name: str, count: int, values: tuple[Array, Array, Array], scale: float, digits: int
) -> str:
    """One row of the table of robots: of AP and RP the largest and the mean, of single repeats the largest."""
    ap, rp, single = values
    numbers = [
        *((ap.max(), ap.mean()) if len(ap) else (np.nan, np.nan)),
        *((rp.max(), rp.mean()) if len(rp) else (np.nan, np.nan)),
        single.max() if len(single) else np.nan,
    ]
    return _COLUMNS.format(
        f"  {name}", count, *(_number(scale * float(v), digits) for v in numbers)
    )
