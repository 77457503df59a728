"""What ``calib compensate`` prints: what to expect of the commands, how large the corrections are, what to look at."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from calib.cli.compensate import Truth
    from calib.compensate.commands import Commands

from calib.cli.setup import row_ranges

Array = NDArray[np.float64]

_WIDTH = 100

#: Rows of the table of corrections, and rows that are named behind a warning.
_ROWS, _NAMED = 5, 8

#: Joint values of a program further from its poses than this ask for a second look [m]: no calibration moves a tool so.
_ELSEWHERE = 0.02

#: Rows that a message names with their reasons, one by one.
_MOST_NAMED = 50

#: Hardly anything, on an arm: position [m], angle [deg].
_HARDLY = (1e-4, 0.2)

_UNKNOWN = "The result was not validated (calib fit --no-validate): how far it can be relied on is not known."
_WORSE = "Commands made with this result may be worse than none. Calibrate anew before they go to the robot."

_MM, _DEG = 1e3, float(np.degrees(1.0))


def text(
    found: Commands,
    truth: Truth,
    *,
    tool: str | None,
    larger: bool,
    send: str,
    written: Path | None,
) -> str:
    """All of it.

    Args:
        found: The commands.
        truth: What they were made with.
        tool: What was given as the tool.
        larger: Whether the larger model of the result was used.
        send: What is written.
        written: Where to; None where nothing was.
    """
    parts = [
        _expected(found, truth, larger=larger),
        _asked(found, tool),
        _errors(found),
        _joints(found),
        _first_rows(found),
        *_notes(found, truth, larger=larger),
        _next(send, written),
    ]
    return "\n\n".join(part for part in parts if part)


def no_commands(found: Commands, *, skip: bool) -> str:
    """The message that names each row without a command and why it has none.

    Args:
        found: The commands.
        skip: Whether such rows may stay empty: then no row has a command.
    """
    rows = _named(found, found.reasons)
    count, every = len(rows), len(found)
    head = (
        f"none of the {every} rows has a command"
        if count == every
        else f"{count} of {every} rows {'has' if count == 1 else 'have'} no command"
    )
    more = count - _MOST_NAMED
    if more > 0:
        labels = [
            label for label, why in zip(found.program.labels, found.reasons, strict=True) if why
        ]
        rows = [*rows[:_MOST_NAMED], _fill(f"and rows {_listed(labels[_MOST_NAMED:], more)}", "  ")]
    advice = [_small(found), _few_joints(found)]
    if count == every:
        advice.append("Check --poses-in, --tool, --match, and the units.")
    if not skip and count < every:
        advice.append("--skip leaves these rows empty and writes the others.")
    said = " ".join(one for one in advice if one) or "Correct the program."
    return "\n".join([f"{head}, and nothing was written:", *rows, _fill(said)])


def _small(found: Commands) -> str:
    """How to accept rows of which hardly anything is left, as next to a singularity."""
    length, angle = _HARDLY
    missing = ~found.reached & np.isfinite(found.left[:, 0])
    hardly = missing & (found.left[:, 0] <= length) & ~(found.left[:, 1] > np.radians(angle))
    # Rows that end at a joint's limit may be off by nothing: what is left of them does not matter.
    hardly &= found.left[:, 0] > 1e-9
    if not hardly.any():
        return ""
    words = f"{_MM * length:g} mm {angle:g} deg"
    return (
        f"Of {_counted(int(hardly.sum()), 'row')} less than {words.replace('mm ', 'mm and ')} would be left: --accept "
        f'"{words}" takes {"it" if hardly.sum() == 1 else "them"}.'
    )


def _few_joints(found: Commands) -> str:
    """What an arm of fewer than six joints can do."""
    joints = len(found.nominal.joint_names)
    if joints >= 6 or found.match not in ("pose", "axis"):
        return ""
    return f"With {joints} joints most poses cannot be reached exactly: --match weighted, or --match position."


def _expected(found: Commands, truth: Truth, *, larger: bool) -> str:
    """The verdict of the result and its error on rows that it had not seen: what to expect on the robot."""
    if truth.table is None:
        return _fill(
            f"The true robot is {truth.name}. How far it can be relied on is not in a URDF: with --calibration "
            "result.json this says what to expect."
        )
    sure, used = found.certainty, f"  of {truth.name}, {_model(truth.table, larger=larger)}."
    if sure is None or not sure.use:
        return "Verdict: none\n" + used + "\n" + _fill(_UNKNOWN, "  ")
    lines = [f"Verdict: {sure.use}", used]
    if sure.use != "use":
        lines += [_fill(reason, "  ") for reason in sure.reasons]
    if sure.use == "do not use":
        lines.append(_fill(_WORSE, "  "))
    rows = _unseen(truth.table, larger=larger)
    if rows:
        lines += [
            "",
            f"{'Position error of the result [mm]':<58}{'max':>10}{'mean':>10}{'rms':>10}",
        ]
        lines += [
            f"{label:<58}" + "".join(f"{_MM * value:>10.3f}" for value in values)
            for label, values in rows
        ]
        lines.append(
            "Expect errors of this size on the robot. What is computed below leaves them out."
        )
    return "\n".join(lines)


def _model(table: dict[str, Any], *, larger: bool) -> str:
    """Which of the result's models was used."""
    if larger:
        return f"its larger model '{table['larger']['set']}'"
    if table["larger"] is not None:
        return "its joint origins, without the larger model that it has"
    return "its joint origins"


def _unseen(table: dict[str, Any], *, larger: bool) -> list[tuple[str, tuple[float, float, float]]]:
    """Largest, mean and rms error on validation rows and on left-out rows, [m], where there are any."""
    errors = table["errors"]
    model = "larger" if larger else "calibrated"
    crossed = table["larger"]["cross_validation"] if larger else table["cross_validation"]
    found = [
        ("validation rows, with the nominal robot", errors["nominal"]["validation"]),
        ("validation rows", errors.get(model, {}).get("validation")),
        ("left-out rows", None if crossed is None else crossed["without_outliers"]),
    ]
    return [
        (label, (one["max_m"], one["mean_m"], one["rms_m"]))
        for label, one in found
        if one and one["n"] and one["mean_m"] is not None
    ]


def _asked(found: Commands, tool: str | None) -> str:
    """What is to arrive, and how it is matched."""
    robot, program = found.nominal, found.program
    what = "joint values"
    if program.T_wanted is not None:
        what = "poses" if program.oriented else "positions"
        what += ", joint values to start at" if program.q is not None else ""
    arrives = f"the tip '{robot.tip}'"
    if tool is not None:
        place = ", ".join(f"{_MM * v:.3f}" for v in found.T_tip_tool[:3, 3])
        arrives = f"the point ({place}) mm in '{robot.tip}'"
    matched = {
        "pose": "position and orientation",
        "position": "position; the orientation is left free",
        "axis": "position and direction of the tool's z axis",
        "weighted": "position and orientation, as well as they can be",
    }[found.match]
    return _fill(
        f"Program: {len(found)} row{'s' if len(found) > 1 else ''} of {what}. "
        f"What arrives: {arrives}. Matched: {matched}."
    )


def _errors(found: Commands) -> str:
    """How far the robot would have missed, what is left, and how far the poses are moved."""
    rows = found.reached
    angles = bool(np.isfinite(found.missed[rows, 1]).any())
    head = f"{'By the result, over ' + _counted(int(rows.sum()), 'row') + ' with commands':<58}"
    lines = [
        head
        + f"{'max mm':>10}{'mean mm':>10}"
        + (f"{'max deg':>10}{'mean deg':>10}" if angles else "")
    ]
    for label, values in (
        ("the tool would miss without correction by", found.missed),
        ("it misses with it by", found.left),
        ("standard deviation of where it arrives (covariance)", found.std),
        ("the pose to send is moved by", found.pose_corrections),
    ):
        if not np.isfinite(values[rows]).any():
            continue
        cells = [_numbers(_MM * values[rows, 0], 4)]
        if angles:
            cells.append(_numbers(_DEG * values[rows, 1], 4))
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
        cells = _numbers((_MM if slides else _DEG) * column, 4)
        where = found.program.labels[int(np.nanargmax(column))]
        short = textwrap.shorten(f"{name} [{'mm' if slides else 'deg'}]", 55, placeholder="...")
        lines.append(f"  {short:<56}{cells}   {textwrap.shorten(where, 16, placeholder='...')}")
    return "\n".join(lines)


def _first_rows(found: Commands) -> str:
    """The corrections of the first rows that have any."""
    shown = np.flatnonzero(found.reached)[:_ROWS]
    robot = found.nominal
    scale = np.array(
        [_MM if robot.joint_types[n] == "prismatic" else _DEG for n in robot.joint_names]
    )
    most = min(len(scale), 7)
    names = [f"joint {i + 1}" for i in range(most)]
    lines = [
        f"{'First corrections [mm, deg]':<28}{'pose mm':>9}"
        + "".join(f"{name:>9}" for name in names)
    ]
    for i in shown:
        cells = [f"{_MM * found.pose_corrections[i, 0]:>9.4f}"]
        cells += [
            f"{value:>9.4f}" if np.isfinite(value) else f"{'-':>9}"
            for value in (scale * found.joint_corrections[i])[:most]
        ]
        lines.append(
            f"{textwrap.shorten(found.program.labels[i], 26, placeholder='...'):<28}"
            + "".join(cells)
        )
    return "\n".join(lines)


def _notes(found: Commands, truth: Truth, *, larger: bool) -> list[str]:
    """What to look at before the commands go to the robot."""
    notes = [_elsewhere(found), _orientation_unsure(found)]
    if truth.was_corrected:
        notes.append(
            "ROBOT has the corrected joint origins already; what the controller has was taken from the result."
        )
    if not np.array_equal(found.T_tip_tool, found.T_tip_tool_nominal):
        place = ", ".join(f"{_MM * v:.4f}" for v in found.T_tip_tool_nominal[:3, 3])
        notes.append(
            f"The poses to send are those of a tool at ({place}) mm in '{found.nominal.tip}': set the controller's "
            "tool to that. It is where the target was before the calibration, which found it elsewhere."
        )
    empty = _named(found, found.reasons)
    if empty:
        what = "row has" if len(empty) == 1 else f"of {len(found)} rows have"
        empty[:0] = [
            f"{len(empty)} {what} no command, and {'is' if len(empty) == 1 else 'are'} empty in the table:"
        ]
    lists = ["\n".join(empty), _warnings(found, larger=larger)]
    return [*(_fill(note) for note in notes if note), *(one for one in lists if one)]


def _named(found: Commands, words: Iterable[str]) -> list[str]:
    """The rows of which something is said, and what."""
    return [
        _fill(f"{label}: {what}", "  ")
        for label, what in zip(found.program.labels, words, strict=True)
        if what
    ]


def _elsewhere(found: Commands) -> str:
    """A program whose joint values do not belong to its poses: mostly another tool, or another frame."""
    program = found.program
    if program.q is None or program.T_wanted is None:
        return ""
    poses = found.T_frame_base @ found.nominal.poses(program.q) @ found.T_tip_tool_nominal
    far = np.linalg.norm(poses[:, :3, 3] - program.T_wanted[:, :3, 3], axis=1)
    if np.median(far) < _ELSEWHERE:
        return ""
    return (
        f"At the program's joint values the nominal robot has the tool {_MM * float(np.median(far)):.0f} mm from the "
        "program's positions (median). Are these of another tool (--tool), in another frame (--poses-in), or measured "
        "ones (--given joints)?"
    )


def _orientation_unsure(found: Commands) -> str:
    """What is known of the orientation where positions alone were measured."""
    sure, rows = found.certainty, found.reached
    if sure is None or sure.turned or found.match == "position" or not np.isfinite(found.std).any():
        return ""
    unsure, moved = _DEG * found.std[rows, 1].mean(), _DEG * found.pose_corrections[rows, 1].mean()
    return (
        f"Positions alone were measured for the result: how the tip is turned follows from them to {unsure:.2f} deg "
        f"(standard deviation), and the corrections turn it by {moved:.2f} deg on average. The calibrated target is "
        "known best: --tool target, or --match position."
    )


def _warnings(found: Commands, *, larger: bool) -> str:
    """The warnings of all rows, one line for each kind of them, the first of its rows as the example."""
    kinds: dict[str, list[tuple[str, str]]] = {}
    for label, said in zip(found.program.labels, found.warnings, strict=True):
        for what in said:
            kinds.setdefault(_KIND.match(what)[0], []).append((label, what))  # type: ignore[index]  # it always does
    if not kinds:
        return ""
    count = sum(bool(said) for said in found.warnings)
    lines = [f"{count} of {len(found)} rows {'has' if count == 1 else 'have'} a warning:"]
    for rows in kinds.values():
        (label, what), others = rows[0], [other for other, _ in rows[1:]]
        more = (
            f"; and {_counted(len(others), 'row')} more: {_listed(others, _NAMED)}"
            if others
            else ""
        )
        lines.append(_fill(f"{label}: {what}{more}", "  "))
    if any(kind.startswith("outside") for kind in kinds):
        text = "The result was not tested outside of the measured range."
        if larger:
            text += (
                " Errors that grow with a joint's value or load, as those of the larger model in use, can be far off "
                "there: measure there too, or compare with --geometry."
            )
        lines.append(_fill(text))
    return "\n".join(lines)


#: What a warning is of: its words up to the first number, name or colon.
_KIND = re.compile(r"[^\d':]*")


def _listed(labels: list[str], most: int) -> str:
    """Some rows by their names, at most so many of them or runs of them, and how many more."""
    names = [label.removeprefix("row ") for label in labels]
    if all(name.isdecimal() for name in names):
        return row_ranges(map(int, names), most)
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


def _next(send: str, written: Path | None) -> str:
    """Where the commands are, and what to do with them."""
    if written is None:
        return "Nothing was written; -o commands.csv writes the commands."
    how = {
        "joints": "Send the joint values.",
        "poses": "Send the poses to the controller that keeps its own model.",
        "both": "Send the joint values, or the poses to the controller that keeps its own model: never both corrected "
        "poses to a controller that was given the corrected model.",
    }[send]
    return f"Written: {written}\n" + _fill(
        f"{how} Then measure some rows and see what was gained: docs/compensation.md."
    )


def _counted(number: int, what: str) -> str:
    """Such as ``1 row``, ``35 rows``."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def _fill(sentence: str, indent: str = "") -> str:
    """Broken at 100 columns, names left whole."""
    return textwrap.fill(
        sentence,
        _WIDTH,
        initial_indent=indent,
        subsequent_indent=indent + ("  " if indent else ""),
        break_on_hyphens=False,
        break_long_words=False,
    )
