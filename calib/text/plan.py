"""What ``calib plan`` prints: candidates, forecast, how many poses pay, the way."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING

from calib.text.lines import fill

if TYPE_CHECKING:
    from pathlib import Path

    from calib.design.candidates import Code, Note
    from calib.design.forecast import Forecast
    from calib.design.plan import Plan, Taken

#: Five more poses that gain less than this part of the error hardly pay.
_PAYS, _FIVE = 0.05, 5

#: A joint's speed for the time that is printed [rad/s]: slow enough for any arm with a reflector on it.
_SPEED = math.radians(30.0)

#: So many moves that collide are named.
_NAMED = 10

_CRITERIA = {
    "V": "least mean error over the workspace (V-optimal)",
    "D": "most information on the parameters (D-optimal)",
    "A": "least mean variance of the parameters (A-optimal)",
}

_REASONS = {
    "region": "outside the region",
    "tracker_range": "out of the tracker's range",
    "reflector_cone": "with the reflector turned away",
    "beam": "with something in the beam",
    "collision": "in collision",
}

_NOTES: dict[Code, str] = {
    "generic_target": "No target was given: planned for one at {0} m in the tip (--target).",
    "orientation_noise": "Assumed noise of an orientation: {0} rad about each axis (sigma_angle_deg in the cell).",
    "reflector_not_checked": "The reflector's direction was not checked: no position of the tracker (--tracker).",
    "collisions_not_checked": "Collisions were not checked.",
    "collisions_checked": "Checked for collisions: links, and each target with a rod of {0} as its holder, with each "
    "other{1}. Not checked: obstacles that the cell file does not name, cables, hoses, other holders, the "
    "instrument, people. Drive the first round slowly.",
    "floor_not_checked": "The floor was not checked.",
    "no_geometry": "Not checked for collisions, without geometry in the URDF: {0}.",
    "visual_geometry": "Checked by their visual geometry, for want of another: {0}.",
    "always_close": "Always closer than the clearance, refused only where they touch: {0}.",
    "always_touching": "Not checked against each other, for they touch at (nearly) all poses: {0}.",
}


def plan_text(plan: Plan) -> str:
    """The text of a plan."""
    notes = [f"Note: {note}" for note in (*map(note_text, plan.notes), *_blocked(plan))]
    paragraphs = (_head(plan), _forecasts(plan), _ladder(plan), _travel(plan), notes)
    return "\n\n".join(
        "\n".join(line if line.startswith("  ") else fill(line) for line in lines)
        for lines in map(list, paragraphs)
        if lines
    )


def note_text(note: Note) -> str:
    """A note as a sentence."""
    if note.code == "collisions_checked":
        radius, *around = note.values
        others = f" and with {', '.join(map(str, around))}" if around else ""
        return _NOTES[note.code].format(f"{1e3 * float(radius):g} mm radius", others)
    return _NOTES[note.code].format(", ".join(map(str, note.values)))


def next_text(plan: Plan, robot: str, output: Path | None, taken: Taken | None) -> str:
    """What to do next with the robot as it was named, the table of the plan and that of the poses taken."""
    if output is None:
        return "No table was written; add -o plan.csv to write it."
    fit = [
        "calib",
        "calibrate",
        robot,
        str(taken.source if taken else output),
        "-o",
        "corrected.urdf",
    ]
    fit += ["--base", plan.robot.base, "--tip", plan.robot.tip]
    steps = [
        f"Drive the {len(plan.joints)} poses of {output} from top to bottom, and measure at each.",
        "Write what was measured into the empty columns, or name the points as in the column 'point'"
        + (f", and add the rows to {taken.source}." if taken else " (--points tracker.txt)."),
    ]
    lines = [fill(f"{k}. {step}", "  ", "   ") for k, step in enumerate(steps, 1)]
    return "\n".join(["Next:", *lines, f"  3. {shlex.join(fit)}"])


def _mm(value: float) -> str:
    """A length in mm, of four digits that matter."""
    size = abs(1e3 * value)
    return f"{1e3 * value:.{1 if size >= 100 else 2 if size >= 10 else 3 if size >= 1 else 4}f} mm"


def _head(plan: Plan) -> Iterator[str]:
    """How many poses of which robot, out of which candidates, and what is to be estimated."""
    robot, f, count = plan.robot, plan.forecast, len(plan.estimation)
    taken = f", beside {len(plan.taken)} measured already" if len(plan.taken) else ""
    yield (
        f"Plan for '{robot.name}' ({robot.urdf.source}), chain {robot.base} to {robot.tip}: {count} poses to calibrate "
        f"with{taken}, {len(plan.joints) - count} to validate with; targets at each: {', '.join(plan.targets)}."
    )
    auto = ", for 'auto'" if plan.cell.model != plan.model else ""
    indices = ", ".join(f"{name} {value:.3g}" for name, value in f.indices.items())
    refused = ", ".join(f"{n} {_REASONS[why]}" for why, n in plan.refused.items() if n)
    for label, value in (
        ("criterion", _CRITERIA[plan.request.criterion]),
        (
            "error model",
            f"{plan.model}{auto}: {f.columns} parameters, rank {f.rank} (whole workspace {f.workspace_rank})",
        ),
        ("observability", f"{indices} (1 mm, 1 mrad)"),
        ("candidates", f"{plan.candidates} of {plan.drawn} drawn"),
        ("refused", refused or "none"),
    ):
        yield f"  {label:<15}{value}"


def _forecasts(plan: Plan) -> Iterator[str]:
    """What the plan will reach, and what random poses and those taken alone would; how well parameters are known."""
    f, count, taken = plan.forecast, len(plan.estimation), len(plan.taken)
    yield "Expected error of a predicted position after the calibration, over the workspace:"
    yield f"  {'':<32}{'rms':>11}{'of 90 % of calibrations':>28}{'worst place':>14}"
    for label, one in (
        (f"those taken and these, {taken + count}" if taken else f"these {count} poses", f),
        (f"{count} random ones" + (" in place of these" if taken else ""), plan.at_random),
        (f"the {taken} taken alone", plan.before),
    ):
        if one is not None:
            yield f"  {label:<32}{_mm(one.rms):>11}{_span(one)}"
    yield (
        f"Noise of one measured coordinate: {_mm(f.sigma)}; expected rms error in units of it: {f.rms / f.sigma:.2f}, "
        f"with random poses {plan.at_random.rms / f.sigma:.2f}. Errors that the model lacks come on top."
    )
    if rest := f.columns - sum(map(bool, f.identifiable)):
        yield f"{rest} parameters are known in combinations only."


def _span(f: Forecast) -> str:
    """The last columns of a table of forecasts: the range of the rms error, and the worst place."""
    return f"{f'{_mm(f.rms_low)} to {_mm(f.rms_high)}':>28}{_mm(f.max):>14}"


def _ladder(plan: Plan) -> Iterator[str]:
    """Forecasts for other numbers of poses, and from which on five more of them gain little."""
    if not plan.ladder:
        return
    more = f" beside the {len(plan.taken)} taken" if len(plan.taken) else ""
    yield f"How many poses{more}? Expected rms error, its range, and the worst place:"
    for number, f in plan.ladder:
        mark = "  <- this plan" if number == len(plan.estimation) else ""
        yield f"  {number:>6} poses{_mm(f.rms):>13}{_span(f)}{mark}"
    gains = [
        1.0 - (after.rms / before.rms) ** (_FIVE / (more - fewer))
        for (fewer, before), (more, after) in pairwise(plan.ladder)
    ]
    # From the first step on behind which no step gains more.
    little = next((k for k in range(len(gains)) if max(gains[k:]) < _PAYS), None)
    if little is not None:
        yield f"Beyond {plan.ladder[little][0]} poses, {_FIVE} more lower the error by less than {100 * _PAYS:.0f} %."


def _travel(plan: Plan) -> Iterator[str]:
    """How long the way is."""
    if "prismatic" not in plan.robot.joint_types.values():
        yield (
            f"Order to drive: {math.degrees(plan.travel):.0f} deg of joint travel in all, "
            f"{plan.travel / _SPEED / 60.0:.1f} min at {math.degrees(_SPEED):.0f} deg/s without stops."
        )


def _blocked(plan: Plan) -> Iterator[str]:
    """Moves whose straight way collides, each with a pose to drive by, if one was found."""
    k = len(plan.targets)
    units = [
        (1e3, "mm") if j.type == "prismatic" else (180 / math.pi, "deg") for j in plan.robot.inputs
    ]
    named = []
    for one in plan.blocked[:_NAMED]:
        by = [] if one.by is None else zip(one.by, units, strict=True)
        drive = ", ".join(f"{scale * v:.1f} {unit}" for v, (scale, unit) in by)
        start = f"row {k * (one.start - 1) + 1}" if one.start else "the start"
        named.append(
            f"{start} to row {k * (one.end - 1) + 1}" + f" (drive by {drive})" * bool(drive)
        )
    if named:
        rest = len(plan.blocked) - len(named)
        more = f" and {rest} more" if rest else ""
        yield f"The straight way in joint space collides from {', '.join(named)}{more}."
