"""What ``calib plan`` prints: candidates, forecast, how many poses pay, the way, in plain words."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from typing import TYPE_CHECKING

from calib.text.lines import fill, row_ranges

if TYPE_CHECKING:
    from pathlib import Path

    from calib.design.forecast import Forecast
    from calib.design.plan import Plan
    from calib.design.plan_file import Taken

#: The width of a line of the command to type next.
_COMMAND = 87

#: Five more poses that gain less than this part of the error hardly pay.
_PAYS, _FIVE = 0.05, 5

#: A joint's speed for the time that is printed [rad/s]: slow enough for any arm with a reflector on it.
_SPEED = math.radians(30.0)

#: So many moves that collide are named.
_NAMED = 10

_CRITERIA = {
    "V": "for the least mean error over the workspace (V-optimal)",
    "D": "for the most information on the parameters (D-optimal)",
    "A": "for the least mean variance of the parameters (A-optimal)",
}


def plan_text(plan: Plan, asked_model: str, remarks: Iterable[str] = ()) -> str:
    """The text of a plan.

    Args:
        plan: The plan.
        asked_model: The model of the cell, which may be ``auto``.
        remarks: Sentences on what the plan was made from.
    """
    notes = [f"Note: {note}" for note in (*remarks, *plan.notes, *_blocked(plan))]
    paragraphs = (_head(plan, asked_model), _forecasts(plan), _ladder(plan), _travel(plan), notes)
    return "\n\n".join(
        "\n".join(line if line.startswith("  ") else fill(line) for line in lines)
        for lines in map(list, paragraphs)
        if lines
    )


def notes_of(plan: Plan, taken: Taken | None, path: Path | None) -> Iterator[str]:
    """What of the table of poses taken does not count, and in which frame the expected values are."""
    if taken is not None and path is not None and taken.unmeasured:
        yield (
            f"Of {path.name} these rows are not measured, and do not count as taken: {row_ranges(taken.unmeasured)}."
        )
    if taken is not None and path is not None and taken.validation:
        yield (
            f"Of {path.name} {taken.validation} validation rows do not count as taken: nothing is estimated from them."
        )
    cell = plan.cell
    if cell.estimate_frame and cell.T_frame_base is None and not cell.frames:
        yield (
            f"The columns 'expected ...' are in the frame of '{plan.robot.base}', for where the instrument stands is "
            "not known."
        )


def next_text(
    made: Plan, robot: str, output: Path | None, taken: Path | None, options: Mapping[str, object]
) -> str:
    """What a person does next.

    Args:
        made: The plan.
        robot: The robot as it was named.
        output: The table of the plan.
        taken: The table of poses taken.
        options: Of the call, those that the fit needs too, by their names.
    """
    if output is None:
        return "No table was written; add -o plan.csv to write it."
    said = [
        shlex.join([f"--{name}", str(value)])
        for name, given in options.items()
        for value in (given if isinstance(given, list) else [given])
        if value is not None
    ]
    fit = [shlex.join(["calib", "fit", robot, str(taken or output)]), *said, "-o corrected.urdf"]
    empty = {"distance": "distance", "pose": "x, y, z, qx, qy, qz, qw"}.get(made.kind, "x, y, z")
    steps = [
        f"Drive the {len(made.joints)} poses of {output} from top to bottom, and measure at each.",
        f"Write what was measured into the empty columns {empty}.",
    ]
    listed = made.kind == "point" and taken is None
    if listed:
        steps[1] = (
            f"{steps[1][:-1]}, or keep the tracker's list, its points called as in the column 'point'."
        )
    if taken is not None:
        steps.append(f"Add the rows to {taken}, column for column.")
    lines = [fill(f"{k}. {step}", "  ", "   ") for k, step in enumerate(steps, 1)]
    lines.append(f"  {len(lines) + 1}. {command_text(fit, 11)}")
    if listed:
        lines.append(f"     or {command_text([fit[0], '--points tracker.txt', *fit[1:]], 11)}")
    return "\n".join(["Next:", *lines])


def command_text(parts: Iterable[str], indent: int) -> str:
    """A command in lines that a shell joins again.

    Args:
        parts: What is not to be broken.
        indent: Of the lines after the first.
    """
    lines = [""]
    for part in parts:
        if lines[-1] and len(lines[-1]) + len(part) > _COMMAND:
            lines.append("")
        lines[-1] += f" {part}" if lines[-1] else part
    return (" \\\n" + " " * indent).join(lines)


def _poses(count: int) -> str:
    """A number of poses in words."""
    return f"{count} pose" if count == 1 else f"{count} poses"


def _mm(value: float) -> str:
    """A length in mm, of four digits that matter."""
    size = abs(1e3 * value)
    return f"{1e3 * value:.{1 if size >= 100 else 2 if size >= 10 else 3 if size >= 1 else 4}f} mm"


def _head(plan: Plan, asked: str) -> Iterator[str]:
    """How many poses of which robot, out of which candidates, and what is to be estimated."""
    robot, f, validation = plan.robot, plan.forecast, len(plan.validation)
    taken = f", beside {_poses(len(plan.taken))} measured already" if len(plan.taken) else ""
    more = f", and {validation} to validate with" if validation else ""
    many = f" Each measures the targets {', '.join(plan.targets)}." if len(plan.targets) > 1 else ""
    yield (
        f"Plan for '{robot.name}' ({robot.urdf.source}), chain {robot.base} to {robot.tip}: "
        f"{_poses(len(plan.estimation))} to calibrate with{taken}{more}, chosen {_CRITERIA[plan.criterion]}.{many}"
    )
    auto = ", the largest that 'auto' may choose" if asked == "auto" and plan.model != asked else ""
    whole = f" (the whole workspace: {f.workspace_rank})" if f.rank != f.workspace_rank else ""
    indices = ", ".join(f"{name} {value:.3g}" for name, value in f.indices.items())
    yield (
        f"Error model: '{plan.model}'{auto}: {f.columns} parameters, of which these poses tell {f.rank} apart{whole}."
    )
    yield f"Observability indices: {indices} (in steps of 1 mm, 1 mrad)."
    said = ", ".join(f"{count} {reason}" for reason, count in plan.refused.items() if count)
    yield (
        f"Chosen from {plan.candidates} poses. Of {plan.drawn} drawn for them over the joint ranges were refused: "
        f"{said}."
        if said
        else f"Chosen from {plan.candidates} poses drawn over the joint ranges; none was refused."
    )


def _forecasts(plan: Plan) -> Iterator[str]:
    """What the plan will reach, and what random poses and those taken alone would; how well parameters are known."""
    from calib.model.families import unit_of

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
        f"One measured coordinate has a noise of {_mm(f.sigma)}: the calibrated robot predicts a position with "
        f"{f.rms / f.sigma:.2f} times that, after random poses {plan.at_random.rms / f.sigma:.2f} times. Errors that "
        "the model lacks come on top."
    )
    known: dict[str, list[str]] = {}
    for name, unit, std, alone in zip(
        f.names, f.units, f.parameter_std, f.identifiable, strict=True
    ):
        if alone:
            scale, shown = unit_of(unit).shown
            known.setdefault(shown, []).append(f"{name} {scale * std:.2g}")
    rest = f.columns - sum(map(bool, f.identifiable))
    lists = "; ".join(f"in {unit}: {', '.join(values)}" for unit, values in known.items())
    parts = [f"Expected standard deviation of the parameters {lists}."] if lists else []
    if rest:
        parts.append(f"{rest} parameters are known in combinations only.")
    yield " ".join(parts)


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
    if gains:
        yield (
            f"Up to {_poses(plan.ladder[-1][0])}, {_FIVE} more lower the error by more than {100 * _PAYS:.0f} %."
            if little is None
            else f"Beyond {_poses(plan.ladder[little][0])}, {_FIVE} more lower the error by less than "
            f"{100 * _PAYS:.0f} %."
        )


def _travel(plan: Plan) -> Iterator[str]:
    """How long the way is."""
    long = ""
    if "prismatic" not in plan.robot.joint_types.values():
        seconds = plan.travel / _SPEED
        time = f"{seconds:.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.1f} min"
        long = (
            f" The joint that turns farthest in each move turns {math.degrees(plan.travel):.0f} deg in all, {time} at "
            f"{math.degrees(_SPEED):.0f} deg/s without stops."
        )
    yield f"Order: the poses stand in a short order to drive.{long}"


def _blocked(plan: Plan) -> Iterator[str]:
    """Moves whose straight way collides, each with a pose to drive by, if one was found."""
    names, k = plan.robot.joint_names, len(plan.targets)
    slides = [plan.robot.joint_types[name] == "prismatic" for name in names]
    named = []
    for one in plan.blocked[:_NAMED]:
        values = [] if one.by is None else zip(one.by, slides, strict=True)
        by = [f"{1e3 * v:.1f} mm" if s else f"{math.degrees(v):.1f} deg" for v, s in values]
        start = f"row {k * (one.start - 1) + 1}" if one.start else "the start"
        drive = f" (drive by {', '.join(by)})" if by else ""
        named.append(f"{start} to row {k * (one.end - 1) + 1}{drive}")
    rest = f" and {len(plan.blocked) - _NAMED} more" if len(plan.blocked) > _NAMED else ""
    if named:
        yield (
            f"The straight way in joint space collides from {', '.join(named)}{rest}; drive there by a pose in between."
        )
