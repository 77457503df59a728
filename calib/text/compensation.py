"""What ``calib compensate`` prints: what to expect of the commands, how large the corrections are, what to look at."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from calib.compensation.expected import BAND
from calib.robot.robot import rigid_inverse
from calib.text.lines import fill
from calib.text.verdict import reason_text
from calib.units import Array

if TYPE_CHECKING:
    from calib.compensation.commands import Code, Commands, Finding
    from calib.compensation.expected import ExpectedErrors, Source
    from calib.robot.robot import Robot


_MM, _DEG = 1e3, float(np.degrees(1.0))

#: Joint values of a program further from its poses than this ask for a second look [m]: no calibration moves a tool so.
_ELSEWHERE = 0.02

_MATCHED = {
    "pose": "position and orientation",
    "position": "position; the orientation is left free",
    "axis": "position and direction of the tool's z axis",
}

#: A source of expected errors with a smaller share of their mean square is not shown.
_SMALL_SHARE = 0.005

#: What each source of expected errors is.
_SOURCES: dict[Source, str] = {
    "model": "what the model lacks, by held-out rows",
    "parameters": "the model's parameters, near the measured poses",
    "poses": "the program's poses away from these",
    "tool": "the tool away from the measured target",
    "base": "the base in the measurement frame",
}

#: What lowers the contribution of a source, where nothing else is known.
_REMEDIES: dict[Source, str] = {
    "model": "errors remain that no parameter of this model holds, and more poses do not lower them; "
    "docs/troubleshooting.md.",
    "parameters": "measure more poses, planned with calib plan --taken, or with less noise.",
    "poses": "measure where the program is, too: calib plan --taken.",
    "tool": "measure a target at the tool's working point and give it as --tool target; or several targets, or poses, "
    "whose places in the tip are known (--fix-target).",
    "base": "measure in a frame of known points on the base (--frame known).",
}

#: What each code says: {0} and {1} are its numbers in {unit}, or both as {miss}; {joint}, {row} what it is about.
_TEXTS: dict[Code, str] = {
    "unreachable": "the true robot cannot reach it: {miss} would be left",
    "beyond limit": "'{joint}' would have to be at {0:.4f} {unit}, beyond its limit {1:.4f}",
    "other branch": "next to a singularity: the solution lies in another branch of the arm",
    "near singularity": "near a singularity: 1 mm of the tool may take {0:.1f} {unit} of '{joint}'",
    "large pose correction": "the pose to send is moved by {miss}",
    "large joint correction": "a joint is corrected by {0:.1f} {unit}: '{joint}'",
    "jump": "a jump: from {row} '{joint}' moves {0:.1f} {unit}, much more than in the program",
    "ambiguous pose": "sent as a pose it may end {miss} off: the controller can come to other joint values",
    "outside measured range": "outside the joint range that was measured: '{joint}' by {0:.3g} {unit}",
}


def text(found: Commands, name: str, written: Path | None) -> str:
    """All of it; ``name`` is the file that the true robot is from, ``written`` the table, None where there is none."""
    after = "Nothing was written; -o commands.csv writes the commands."
    if written is not None:
        after = f"Written: {written}\n" + fill(
            "Send the joint values, or the poses to a controller that keeps its nominal model: one that has the "
            "corrected model would correct twice. Then measure some rows: docs/compensation.md."
        )
    parts = [_verdict(found, name), _expected_errors(found), _program(found), _sizes(found)]
    parts += map(fill, _notes(found))
    reasons = [(one,) if one else () for one in found.reasons]
    for what, rows in (("without a command", reasons), ("with a warning", found.warnings)):
        if any(rows):
            head = f"Rows {what}: {sum(map(bool, rows))} of {len(found)}"
            parts.append("\n".join([head, *_findings(found, rows)]))
    return "\n\n".join([part for part in parts if part] + [after])


def no_commands(found: Commands) -> str:
    """The message about rows without a command: why they have none."""
    lines = _findings(found, [(one,) if one else () for one in found.reasons])
    advice = _elsewhere(found) or (
        "Check --tool, --poses-in and the units; --tolerance takes rows of which little is left, --match position "
        "those whose orientation may be free; --skip leaves rows empty, but for the reason."
    )
    head = f"{sum(~found.reached)} of {len(found)} rows have no command, and nothing was written:"
    return "\n".join([head, *lines, fill(advice)])


def finding_text(finding: Finding, robot: Robot) -> str:
    """A finding in words, in mm and deg."""
    numbers, scale, unit, miss = finding.numbers, _DEG, "deg", ""
    if robot.joint_types.get(finding.joint) == "prismatic":
        scale, unit = _MM, "mm"
    if not finding.joint and numbers:
        angle = "" if np.isnan(numbers[1]) else f", {_DEG * numbers[1]:.4f} deg"
        miss = f"{_MM * numbers[0]:.4f} mm{angle}"
    scaled = (scale * number for number in numbers)
    words = {"joint": finding.joint, "row": finding.row, "unit": unit, "miss": miss}
    return _TEXTS[finding.code].format(*scaled, **words)


def _verdict(found: Commands, name: str) -> str:
    """The verdict of the result, and which of its models is used."""
    result, non_geometric = found.pair.result, found.pair.non_geometric
    if result is None:
        lines = [
            f"The true robot is {name}, a URDF: with --calibration the errors to expect are known."
        ]
        if stated := found.pair.actual.robot.urdf.verdict:
            lines.insert(0, f"Verdict on {name}: {stated}")
        return "\n".join(map(fill, lines))
    part, verdict = (
        result.part(non_geometric=non_geometric),
        result.verdict_on(non_geometric=non_geometric),
    )
    own = f"non-geometric model '{part.model.name}'" if non_geometric else "joint origins"
    if verdict is None:
        return f"Verdict: none ({name}, {own}), the result was not validated."
    lines = [f"Verdict: {verdict.use} ({name}, {own})"]
    if verdict.use != "use":
        lines += [fill(reason_text(reason), "  ") for reason in verdict.reasons]
    return "\n".join(lines)


def _expected_errors(commands: Commands) -> str:
    """The position error to expect, the sources that it comes from, and what lowers the largest."""
    expected = commands.expected
    if expected is None:
        return ""
    errors, (low, high) = _MM * expected.errors[:, 0], expected.band
    labels = [
        label
        for label, there in zip(commands.program.labels, commands.reached, strict=True)
        if there
    ]
    parts = [
        fill(
            f"Expect position errors of {_MM * expected.mean:.3f} mm (mean over the rows), {errors.max():.3f} mm at "
            f"{labels[int(np.argmax(errors))]}. Of ten calibrations like this one, {10 * BAND:.0f} have a mean between "
            f"{_MM * low:.3f} and {_MM * high:.3f} mm."
        ),
        _sources(expected),
    ]
    parts += map(fill, _remedies(commands, expected))
    return "\n\n".join(parts)


def _sources(expected: ExpectedErrors) -> str:
    """The table of sources: the mean error that each would leave alone, and its share of the mean square."""
    total = sum(one.square for one in expected.contributions)
    lines = [f"{'Expected error, by its source':<58}   mean mm     share"]
    for one in expected.contributions:
        share = one.square / total if total > 0.0 else 0.0
        if share >= _SMALL_SHARE:
            alone = _MM * expected.mean * np.sqrt(share)
            lines.append(f"{_SOURCES[one.source]:<58}{alone:>10.3f}{100.0 * share:>8.0f} %")
    return "\n".join(lines)


def _remedies(commands: Commands, expected: ExpectedErrors) -> Iterator[str]:
    """What lowers the largest contribution, and what is not known of the errors."""
    pair = commands.pair
    result = pair.result
    assert result is not None  # else nothing is expected
    if not expected.validated:
        yield (
            "The result was not cross-validated: what its model lacks is not in these errors. Calibrate without "
            "--no-validate."
        )
    largest = expected.largest
    if largest == "model" and expected.noise == "unknown":
        yield (
            "To know better: the instrument's noise was not stated, and held-out errors count in full. State it at the "
            "calibration (sigma_mm in the cell file, or a column 'sigma [mm]'), or measure some poses repeatedly."
        )
    elif largest == "model" and result.non_geometric is not None and not pair.non_geometric:
        yield "To lower it: use the non-geometric model, without --geometry."
    elif largest == "base" and expected.in_measured_frame is not None:
        name = "measured" if len(result.setup.groups) == 1 else f'"{result.setup.groups[0]}"'
        yield (
            f"To lower it: give the program in the measurement frame, --poses-in {name} "
            f"({_MM * expected.in_measured_frame:.3f} mm): a frame that is estimated takes up whatever displaces the "
            "first joint in the base. Or measure in a frame of known points on the base (--frame known)."
        )
    else:
        yield f"To lower it: {_REMEDIES[largest]}"


def _program(found: Commands) -> str:
    """What is to arrive, how it is matched, and in which frame poses are."""
    robot, program, pair = found.nominal, found.program, found.pair
    what = "joint values"
    if program.T_wanted is not None:
        what = program.form and f"poses ({program.form})"
        what = what or ("poses" if program.oriented else "positions")
        what += " with joint values to start at" * (program.q is not None)
    frame = f"the measured frame{f' of {pair.set_up!r}' * bool(pair.set_up)}"
    frame = f"'{robot.base}'" if pair.set_up is None else frame
    unread = ", ".join(label for label, _ in program.kept if label)
    unread = f" Passed through unread: {unread}." if unread else ""
    return fill(
        f"Program: {len(found)} rows of {what}. Tool: {_place(pair.actual.T_tip_tool)} in '{robot.tip}'. Matched: "
        f"{_MATCHED[found.match]}. Poses are in {frame}.{unread}"
    )


def _sizes(found: Commands) -> str:
    """How far the robot would have missed, what is left, and how far poses and joints are moved."""
    rows, robot = found.reached, found.nominal
    slides = np.array([robot.joint_types[name] == "prismatic" for name in robot.joint_names])
    joints = np.abs(found.joint_corrections[rows])
    table = {
        "error without compensation": found.missed[rows].T,
        "model residual after compensation": found.left[rows].T,
        "model residual if sent as a pose": found.left_by_pose[rows].T,
        "error to expect after compensation": found.expected_errors[rows].T,
        "correction of the pose to send": found.pose_corrections[rows].T,
        "correction of a joint": (joints[:, slides], joints[:, ~slides]),
    }
    title = f"By the calibrated model, rows with commands: {int(rows.sum())}"
    lines = [f"{title:<58}    max mm   mean mm   max deg  mean deg"]
    for label, (lengths, angles) in table.items():
        there = [one[np.isfinite(one)] for one in (_MM * lengths, _DEG * angles)]
        cells = (
            f"{one.max():>10.4f}{one.mean():>10.4f}" if one.size else f"{'-':>10}" * 2
            for one in there
        )
        if any(one.size for one in there):
            lines.append(f"{label:<58}{''.join(cells)}")
    return "\n".join(lines)


def _notes(found: Commands) -> Iterator[str]:
    """What to look at before the commands go to the robot, a note each."""
    pair, robot = found.pair, found.nominal
    if elsewhere := _elsewhere(found):
        yield elsewhere
    if pair.target is not None:
        yield (
            f"Set the controller's tool to {_place(pair.nominal.T_tip_tool)} in '{robot.tip}': the poses to send, and "
            "those computed from joint values, are of it."
        )
    if pair.set_up is not None:
        place = _place(rigid_inverse(pair.T_frame_base))
        yield f"Set the controller's work object to {place} in '{robot.base}': the poses to send are in it."


def _place(T: Array) -> str:
    """A pose in words; its rotation vector where it is turned."""
    turn = _DEG * Rotation.from_matrix(T[:3, :3]).as_rotvec()
    place, turned = (
        ", ".join(f"{v:.4f}" for v in one.round(4) + 0.0) for one in (_MM * T[:3, 3], turn)
    )
    return f"({place}) mm" + f", rotation vector ({turned}) deg" * bool(np.abs(turn).max() > 1e-9)


def _elsewhere(found: Commands) -> str:
    """A program whose joint values do not belong to its poses: mostly another tool, or another frame."""
    program, pair = found.program, found.pair
    if program.q is None or program.T_wanted is None:
        return ""
    poses = pair.T_frame_base @ pair.nominal.poses(program.q)
    far = float(np.median(np.linalg.norm(poses[:, :3, 3] - program.T_wanted[:, :3, 3], axis=1)))
    if far < _ELSEWHERE:
        return ""
    return (
        f"At the program's joint values the nominal robot has the tool {_MM * far:.0f} mm from the program's positions "
        "(median). Are these of another tool (--tool), in another frame (--poses-in), or measured ones (--columns "
        '"x=-" leaves one out)?'
    )


def _findings(found: Commands, rows: Sequence[Sequence[Finding]]) -> list[str]:
    """What was found of the rows, one line for each code, the first of its rows as the example."""
    kinds: dict[str, dict[str, Finding]] = {}
    for label, said in zip(found.program.labels, rows, strict=True):
        for one in said:
            kinds.setdefault(one.code, {}).setdefault(label, one)
    lines = []
    for labels in kinds.values():
        first, *others = labels
        more = f"; and {len(others)} more" if others else ""
        words = finding_text(labels[first], found.nominal)
        lines.append(fill(f"{first}: {words}{more}", "  ", "  "))
    return lines
