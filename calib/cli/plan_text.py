"""What ``calib plan`` prints: candidates, forecast, how many poses pay, the way, in plain words."""

from __future__ import annotations

import math
import shlex
import textwrap
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from calib.design.forecast import Forecast
    from calib.design.plan import Plan
    from calib.design.plan_file import Taken
    from calib.measure.cell import Cell

#: Of the text, and of a line of the command to type next.
_WIDTH, _COMMAND = 100, 87

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
    paragraphs = [
        [_what(plan), *_model(plan, asked_model)],
        [_candidates(plan)],
        list(_forecasts(plan)),
        [_parameters(plan.forecast)],
        list(_ladder(plan)),
        [_travel(plan)],
        [f"Note: {note}" for note in (*remarks, *plan.notes, *_blocked(plan))],
    ]
    return "\n\n".join(
        "\n".join(line if line.startswith("  ") else fill(line) for line in lines)
        for lines in paragraphs
        if lines
    )


def taken_text(taken: Taken | None, path: Path | None) -> Iterator[str]:
    """What of the table of poses taken does not count."""
    from calib.cli.terminal import row_ranges

    if taken is None or path is None:
        return
    if taken.unmeasured:
        yield (
            f"Of {path.name} these rows are not measured, and do not count as taken: "
            f"{row_ranges(taken.unmeasured)}."
        )
    if taken.validation:
        yield (
            f"Of {path.name} {taken.validation} validation rows do not count as taken: nothing is estimated from them."
        )


def expected_text(cell: Cell, base: str) -> Iterator[str]:
    """That what to expect is said in another frame than it will be measured in."""
    if cell.estimate_frame and cell.T_frame_base is None and not cell.frames:
        yield (
            f"The columns 'expected ...' are in the frame of '{base}', for where the instrument stands is not known."
        )


def next_text(
    made: Plan,
    robot: str,
    output: Path | None,
    taken: Path | None,
    options: dict[str, str | None],
    held: list[str],
) -> str:
    """What a person does next.

    Args:
        made: The plan.
        robot: The robot as it was named.
        output: The table of the plan.
        taken: The table of poses taken.
        options: Of the call, those that the fit needs too.
        held: Each ``--hold``.
    """
    if output is None:
        return "No table was written; add -o plan.csv to write it."
    table = output if taken is None else taken
    said = [(option, value) for option, value in options.items() if value is not None]
    said += [("--hold", value) for value in held]
    fit = [shlex.join(["calib", "fit", robot, str(table)]), *map(shlex.join, said)]
    fit.append("-o corrected.urdf")
    listed = [*fit[:1], "--points tracker.txt", *fit[1:]]
    first = (
        f"Drive the {len(made.joints)} poses of {output} from top to bottom, and measure at each."
    )
    empty = {"distance": "distance", "pose": "x, y, z, qx, qy, qz, qw"}.get(made.kind, "x, y, z")
    second = f"Write what was measured into the empty columns {empty}"
    if made.kind == "point" and taken is None:
        second += ", or keep the tracker's list, its points called as in the column 'point'"
    steps = [first, f"{second}."]
    if taken is not None:
        steps.append(f"Add the rows to {taken}, column for column.")
    lines = ["Next:", *(fill(f"  {k}. {step}", "     ") for k, step in enumerate(steps, 1))]
    lines.append(f"  {len(lines)}. {command_text(fit, 11)}")
    if made.kind == "point" and taken is None:
        lines.append(f"     or {command_text(listed, 11)}")
    return "\n".join(lines)


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


def fill(text: str, indent: str = "") -> str:
    """A sentence in lines of the usual width."""
    return textwrap.fill(
        text, _WIDTH, subsequent_indent=indent, break_on_hyphens=False, break_long_words=False
    )


def _poses(count: int) -> str:
    """A number of poses in words."""
    return f"{count} pose" if count == 1 else f"{count} poses"


def _mm(value: float) -> str:
    """A length in mm, of four digits that matter."""
    size = abs(1e3 * value)
    return f"{1e3 * value:.{1 if size >= 100 else 2 if size >= 10 else 3 if size >= 1 else 4}f} mm"


def _what(plan: Plan) -> str:
    """How many poses of which robot."""
    robot, validation = plan.robot, len(plan.validation)
    more = f", and {validation} to validate with" if validation else ""
    taken = f", beside {_poses(len(plan.taken))} measured already" if len(plan.taken) else ""
    many = f" Each measures the targets {', '.join(plan.targets)}." if len(plan.targets) > 1 else ""
    return (
        f"Plan for '{robot.name}' ({robot.urdf.source}), chain {robot.base} to {robot.tip}: "
        f"{_poses(len(plan.estimation))} to calibrate with{taken}{more}, chosen {_CRITERIA[plan.criterion]}.{many}"
    )


def _model(plan: Plan, asked: str) -> Iterator[str]:
    """What is to be estimated, and how much of it these poses tell."""
    f = plan.forecast
    instead = (
        ", the largest that 'auto' may choose" if asked == "auto" and plan.model != asked else ""
    )
    yield (
        f"Error model: '{plan.model}'{instead}: {f.columns} parameters, of which these poses tell {f.rank} apart"
        + (f" (the whole workspace: {f.workspace_rank})." if f.rank != f.workspace_rank else ".")
    )
    indices = ", ".join(f"{name} {value:.3g}" for name, value in f.indices.items())
    yield f"Observability indices: {indices} (in steps of 1 mm, 1 mrad)."


def _parameters(forecast: Forecast) -> str:
    """How well each parameter will be known, those that these poses tell by themselves."""
    from calib.families import unit_of

    known: dict[str, list[str]] = {}
    for name, unit, std, alone in zip(
        forecast.names,
        forecast.units,
        forecast.parameter_std,
        forecast.identifiable,
        strict=True,
    ):
        if alone:
            scale, shown = unit_of(unit).shown
            known.setdefault(shown, []).append(f"{name} {scale * std:.2g}")
    lists = "; ".join(f"in {unit}: {', '.join(values)}" for unit, values in known.items())
    rest = len(forecast.names) - sum(map(bool, forecast.identifiable))
    others = f" The other {rest} are known in combinations only." if rest else ""
    if not lists:
        return (
            f"Of the parameters none is known by itself; the {rest} are known in combinations only."
        )
    return f"Expected standard deviation of the parameters {lists}.{others}"


def _candidates(plan: Plan) -> str:
    """What was drawn, and why some of it was refused."""
    said = [f"{count} {reason}" for reason, count in plan.refused.items() if count]
    if not said:
        return f"Chosen from {plan.candidates} poses drawn over the joint ranges; none was refused."
    return (
        f"Chosen from {plan.candidates} poses. Of {plan.drawn} drawn for them over the joint ranges were refused: "
        f"{', '.join(said)}."
    )


def _forecasts(plan: Plan) -> Iterator[str]:
    """What the plan will reach, and what random poses and those taken alone would."""
    f = plan.forecast
    yield "Expected error of a predicted position after the calibration, over the workspace:"
    yield f"  {'':<32}{'rms':>11}{'of 90 % of calibrations':>28}{'worst place':>14}"
    every = len(plan.taken) + len(plan.estimation)
    label = f"these {every} poses" if not len(plan.taken) else f"those taken and these, {every}"
    yield _row(label, f)
    yield _row(
        f"{len(plan.estimation)} random ones" + (" in place of these" * bool(len(plan.taken))),
        plan.at_random,
    )
    if plan.before is not None:
        yield _row(f"the {len(plan.taken)} taken alone", plan.before)
    yield (
        f"One measured coordinate has a noise of {_mm(f.sigma)}: the calibrated robot predicts a position with "
        f"{f.rms / f.sigma:.2f} times that, after random poses {plan.at_random.rms / f.sigma:.2f} times. Errors that "
        "the model lacks come on top."
    )


def _row(label: str, f: Forecast) -> str:
    """A row of the table of forecasts."""
    span = f"{_mm(f.rms_low)} to {_mm(f.rms_high)}"
    return f"  {label:<32}{_mm(f.rms):>11}{span:>28}{_mm(f.max):>14}"


def _ladder(plan: Plan) -> Iterator[str]:
    """Forecasts for other numbers of poses, and where more of them stop paying."""
    if not plan.ladder:
        return
    more = f" beside the {len(plan.taken)} taken" if len(plan.taken) else ""
    yield f"How many poses{more}? Expected rms error, its range, and the worst place:"
    for number, f in plan.ladder:
        mark = "  <- this plan" if number == len(plan.estimation) else ""
        span = f"{_mm(f.rms_low)} to {_mm(f.rms_high)}"
        yield f"  {number:>6} poses{_mm(f.rms):>13}{span:>28}{_mm(f.max):>14}{mark}"
    yield from _where_it_stops(plan)


def _where_it_stops(plan: Plan) -> Iterator[str]:
    """From how many poses on five more gain little."""
    steps = list(zip(plan.ladder, plan.ladder[1:], strict=False))
    if not steps:
        return
    gains = [
        1.0 - (after.rms / before.rms) ** (_FIVE / (more - fewer))
        for (fewer, before), (more, after) in steps
    ]
    # From the first step on behind which no step gains more.
    little = next((k for k in range(len(gains)) if max(gains[k:]) < _PAYS), None)
    if little is None:
        yield (
            f"Up to {_poses(plan.ladder[-1][0])}, {_FIVE} more lower the error by more than {100 * _PAYS:.0f} %."
        )
        return
    yield (
        f"Beyond {_poses(steps[little][0][0])}, {_FIVE} more lower the error by less than {100 * _PAYS:.0f} %."
    )


def _travel(plan: Plan) -> str:
    """How long the way is."""
    robot = plan.robot
    if any(kind == "prismatic" for kind in robot.joint_types.values()):
        return "Order: the poses stand in a short order to drive."
    cost = plan.travel
    return (
        "Order: the poses stand in a short order to drive. The joint that turns farthest in each move turns "
        f"{math.degrees(cost):.0f} deg in all, {_time(cost / _SPEED)} at "
        f"{math.degrees(_SPEED):.0f} deg/s without stops."
    )


def _time(seconds: float) -> str:
    """A time in words."""
    return f"{seconds:.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.1f} min"


def _blocked(plan: Plan) -> Iterator[str]:
    """Moves whose straight way collides, each with a pose to drive by, if one was found."""
    if not plan.blocked:
        return
    k = len(plan.targets)
    named = []
    for one in plan.blocked[:_NAMED]:
        by = "" if one.by is None else f" (drive by {_joints_text(plan, one.by)})"
        start = f"row {k * (one.start - 1) + 1}" if one.start else "the start"
        named.append(f"{start} to row {k * (one.end - 1) + 1}{by}")
    rest = f" and {len(plan.blocked) - _NAMED} more" if len(plan.blocked) > _NAMED else ""
    yield f"The straight way in joint space collides from {', '.join(named)}{rest}; drive there by a pose in between."


def _joints_text(plan: Plan, q: NDArray[np.float64]) -> str:
    """Joint values in degrees and millimetres, in the order of the table's columns."""
    names = plan.robot.joint_names
    slides = [plan.robot.joint_types[name] == "prismatic" for name in names]
    return ", ".join(
        f"{1e3 * v:.1f} mm" if s else f"{math.degrees(v):.1f} deg"
        for v, s in zip(q, slides, strict=True)
    )
