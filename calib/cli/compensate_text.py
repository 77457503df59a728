"""What ``calib compensate`` prints: what to expect of the commands, and how large the corrections are."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from calib.cli.compensate_notes import DEG, MM, counted, fill, notes, passed_through, place
from calib.cli.compensate_setup import BASE, MEASURED, TARGET

if TYPE_CHECKING:
    from calib.cli.compensate_setup import Robots
    from calib.compensate.commands import Commands
    from calib.identify.result import Calibration

Array = NDArray[np.float64]

#: What a controller misses by above this, sent as a pose and not as joint values, is worth a line [m], [rad].
_ELSEWHERE = 1e-7

#: Rows of the table of corrections.
_ROWS = 5

#: Corrections that differ by less are the same [rad or m].
_TIE = 1e-9

_UNKNOWN = "The result was not validated (calib fit --no-validate): how far it can be relied on is not known."
_WORSE = "Commands made with this result may be worse than none. Calibrate anew before they go to the robot."


def text(
    found: Commands,
    robots: Robots,
    *,
    tool: str | None,
    larger: bool,
    send: str,
    poses_in: str,
    written: Path | None,
) -> str:
    """All of it.

    Args:
        found: The commands.
        robots: What they were made with.
        tool: What was given as the tool.
        larger: Whether the larger model of the result was used.
        send: What is written.
        poses_in: What was given as the frame of the poses.
        written: Where to; None where nothing was.
    """
    in_base = poses_in == BASE
    spread = bool(np.isfinite(found.std[found.reached]).any())
    of_target = tool is not None and tool.startswith(TARGET)
    parts = [
        _expected(
            robots,
            larger=larger,
            of_target=of_target,
            spread=spread,
        ),
        _asked(found, tool, poses_in),
        _errors(found, poses=send != "joints", spread=spread),
        _joints(found),
        _largest(found),
        *notes(
            found,
            robots,
            larger=larger,
            of_target=of_target,
            poses=send != "joints",
            in_base=in_base,
        ),
        _next(send, written),
    ]
    return "\n\n".join(part for part in parts if part)


def _expected(robots: Robots, *, larger: bool, of_target: bool, spread: bool) -> str:
    """The verdict of the result and its error on rows that it had not seen: what to expect on the robot.

    Args:
        robots: What the commands were made with.
        larger: Whether the larger model of the result was used.
        of_target: Whether the tool is the calibrated target.
        spread: Whether standard deviations are printed below.
    """
    if robots.result is None:
        return fill(
            f"The true robot is {robots.name}. How far it can be relied on is not in a URDF: with --calibration "
            "result.json this says what to expect."
        )
    sure, used = (
        robots.result.verdict,
        f"  of {robots.name}, {_model(robots.result, larger=larger)}.",
    )
    if sure is None:
        return "\n".join(["Verdict: none", used, fill(_UNKNOWN, "  ")])
    if larger:
        used = fill(
            f"of {robots.name}, its joint origins: the verdict is of these. The commands are made with "
            f"{_model(robots.result, larger=True)}, which has no verdict of its own; the errors are its.",
            "  ",
        )
    lines = [f"Verdict: {sure.use}", used]
    if sure.use != "use":
        lines += [fill(str(reason), "  ") for reason in sure.reasons]
    if sure.use == "do not use":
        lines.append(fill(_WORSE, "  "))
    rows = _unseen(robots.result, larger=larger)
    if rows:
        lines += [
            "",
            f"{'Position error of the result [mm]':<58}{'max':>10}{'mean':>10}{'rms':>10}",
        ]
        lines += [
            f"{label:<58}" + "".join(f"{MM * value:>10.3f}" for value in values)
            for label, values in rows
        ]
        lines.append(fill(_expect(of_target=of_target, spread=spread)))
    return "\n".join(lines)


def _expect(*, of_target: bool, spread: bool) -> str:
    """Of what the errors are, which are those of the target, and what they say of the tool."""
    if of_target:
        return "Expect errors of this size on the robot. What is computed below leaves them out."
    more = (
        ": expect at least the standard deviation below besides"
        if spread
        else ", and may be larger at this tool"
    )
    return (
        f"These are errors of the target that was measured, not of this tool{more}. What is computed below leaves "
        "them out."
    )


def _model(result: Calibration, *, larger: bool) -> str:
    """Which of the result's models was used."""
    if larger:
        return f"its larger model '{result.part(larger=True).model.name}'"
    if result.larger is not None:
        return "its joint origins, without the larger model that it has"
    return "its joint origins"


def _unseen(result: Calibration, *, larger: bool) -> list[tuple[str, tuple[float, float, float]]]:
    """Largest, mean and rms error on validation rows and on left-out rows, [m], where there are any."""
    errors, crossed = result.errors, result.part(larger=larger).cross_validation
    found = [
        ("validation rows, with the nominal robot", errors["nominal"]["validation"]),
        ("validation rows", errors["larger" if larger else "calibrated"]["validation"]),
    ]
    if crossed is not None:
        found.append(("left-out rows", crossed.errors_without_outliers))
    return [(label, (one.max, one.mean, one.rms)) for label, one in found if one.n]


def _asked(found: Commands, tool: str | None, poses_in: str) -> str:
    """What is to arrive, how it is matched, and in which frame poses are."""
    robot, program = found.nominal, found.program
    what = "joint values"
    if program.T_wanted is not None:
        what = "poses" if program.oriented else "positions"
        what += f" (orientation: {program.form})" if program.form else ""
        what += ", joint values to start at" if program.q is not None else ""
    arrives = f"the tip '{robot.tip}'"
    if tool is not None:
        arrives = f"the point {place(found.T_tip_tool)} in '{robot.tip}'"
    matched = {
        "pose": "position and orientation",
        "position": "position; the orientation is left free",
        "axis": "position and direction of the tool's z axis",
        "weighted": "position and orientation, as well as they can be",
    }[found.match]
    frame = {
        BASE: f"'{robot.base}'",
        MEASURED: "the frame that was measured in",
    }.get(poses_in, f"the frame of the set-up '{poses_in}'")
    return fill(
        f"Program: {len(found)} row{'s' if len(found) > 1 else ''} of {what}. "
        f"What arrives: {arrives}. Matched: {matched}. Poses are in {frame}. {passed_through(program)}"
    )


def _errors(found: Commands, *, poses: bool, spread: bool) -> str:
    """How far the robot would have missed, what is left, and how far the poses are moved."""
    rows = found.reached
    angles = bool(np.isfinite(found.missed[rows, 1]).any())
    head = f"{'By the calibrated model, over ' + counted(int(rows.sum()), 'row') + ' with commands':<58}"
    lines = [
        head
        + f"{'max mm':>10}{'mean mm':>10}"
        + (f"{'max deg':>10}{'mean deg':>10}" if angles else "")
    ]
    # A controller with a redundant joint may come to other joint values than those that were meant.
    other = poses and bool((np.abs(found.left_by_pose - found.left)[rows] > _ELSEWHERE).any())
    by_pose = [("it misses by, if sent as a pose", found.left_by_pose)] if other else []
    for label, values in (
        ("the tool would miss without correction by", found.missed),
        ("it misses with it by", found.left),
        *by_pose,
        *([("standard deviation of where it arrives (covariance)", found.std)] if spread else []),
        ("the pose to send is moved by", found.pose_corrections),
    ):
        if not np.isfinite(values[rows]).any():
            continue
        cells = [_numbers(MM * values[rows, 0], 4)]
        if angles:
            cells.append(_numbers(DEG * values[rows, 1], 4))
        lines.append(f"{label:<58}" + "".join(cells))
    return "\n".join(lines)


def _numbers(values: Array, digits: int) -> str:
    """Largest and mean of those that there are."""
    there = values[np.isfinite(values)]
    if not there.size:
        return f"{'-':>10}{'-':>10}"
    return f"{there.max():>10.{digits}f}{there.mean():>10.{digits}f}"


def _joints(found: Commands) -> str:
    """How far each joint is moved."""
    robot = found.nominal
    changes = np.abs(found.joint_corrections)
    if not np.isfinite(changes).any():
        return ""
    lines = [f"{'Correction of each joint':<58}{'max':>10}{'mean':>10}   in"]
    for name, column in zip(robot.joint_names, changes.T, strict=True):
        slides = robot.joint_types[name] == "prismatic"
        cells = _numbers((MM if slides else DEG) * column, 4)
        # The first of those that differ by rounding.
        where = found.program.labels[int(np.flatnonzero(column >= np.nanmax(column) - _TIE)[0])]
        short = textwrap.shorten(f"{name} [{'mm' if slides else 'deg'}]", 55, placeholder="...")
        lines.append(f"  {short:<56}{cells}   {textwrap.shorten(where, 16, placeholder='...')}")
    return "\n".join(lines)


def _largest(found: Commands) -> str:
    """The corrections of all rows, or of those where a joint is moved most."""
    robot = found.nominal
    scale = np.array(
        [MM if robot.joint_types[n] == "prismatic" else DEG for n in robot.joint_names]
    )
    changes = scale * found.joint_corrections
    shown = np.flatnonzero(found.reached)
    head = "Corrections [mm, deg]"
    if len(shown) > _ROWS:
        most = np.nan_to_num(np.abs(changes[shown])).max(axis=1)
        # Those that differ by rounding stay in their order.
        shown = shown[np.argsort(-most.round(6), kind="stable")[:_ROWS]]
        head = "Largest corrections [mm,deg]"
    columns = min(len(scale), 7)
    names = [f"joint {i + 1}" for i in range(columns)]
    lines = [f"{head:<28}{'pose mm':>9}" + "".join(f"{name:>9}" for name in names)]
    for i in shown:
        cells = [f"{MM * found.pose_corrections[i, 0]:>9.4f}"]
        cells += [
            f"{round(value, 4) + 0.0:>9.4f}" if np.isfinite(value) else f"{'-':>9}"
            for value in changes[i, :columns]
        ]
        label = textwrap.shorten(found.program.labels[i], 26, placeholder="...")
        lines.append(f"{label:<28}" + "".join(cells))
    return "\n".join(lines)


def _next(send: str, written: Path | None) -> str:
    """Where the commands are, and what to do with them."""
    if written is None:
        return "Nothing was written; -o commands.csv writes the commands."
    how = {
        "joints": "Send the joint values.",
        "poses": "Send the poses to the controller that keeps its own model.",
        "both": "Send the joint values, or the poses to the controller that keeps its own model.",
    }[send]
    if send != "joints":
        how += " Do not send corrected poses to a controller that was given the corrected model."
    return f"Written: {written}\n" + fill(
        f"{how} Then measure some rows and see what was gained: docs/compensation.md."
    )
