"""Commands of a program as `calib compensate` prints them: expected errors, corrections, warnings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from calib.basics.arrays import Array, rigid_inverse
from calib.data.forms.orientations import find_convention
from calib.diagnosis.reasons import Why
from calib.result.calibration import is_corrected
from calib.show.lines import fill
from calib.show.robot_sentences import coupling_sentence
from calib.show.tables import Column, name_column, table_lines
from calib.show.verdict_text import reason_text
from calib.verbs.compensate.expected import BAND

if TYPE_CHECKING:
    from calib.robot.robot import Robot
    from calib.verbs.compensate.commands import Code, Commands, CommandWarning
    from calib.verbs.compensate.expected import ExpectedErrors, Source
    from calib.verbs.compensate.nominal_actual import Pair


_MM = 1e3
_DEG = float(np.degrees(1.0))

#: If a program's positions and those at its joint values differ by more than this (median), they do not belong
#: together [m]: no calibration moves a tool so far.
_MISMATCH = 0.02

#: The same for orientations [deg].
_MISMATCH_DEG = 10.0

#: Angles of a pose below this are rounding [deg].
_ROUNDING_DEG = 1e-9

_MATCHED = {
    "pose": "position and orientation",
    "position": "position; the orientation is left free",
    "axis": "position and direction of the tool's z axis",
}

#: Sources of expected errors with a smaller share of their mean square are not shown.
_SMALL_SHARE = 0.005

#: Width of the labels of both tables.
_LABEL = 58

#: The label of each source of expected errors.
_SOURCES: dict[Source, str] = {
    "model": "errors that the model lacks, from held-out rows",
    "parameters": "the model's parameters, near the measured poses",
    "poses": "the program's poses away from these",
    "tool": "the tool away from the measured target",
    "base": "the base in the measurement frame",
    "scale": "the scale of the instrument, in the arm's lengths",
}

#: Advice that lowers the contribution of a source, unless the result allows more specific advice.
_REMEDIES: dict[Source, str] = {
    "model": "look for errors that no parameter of this model represents (docs/troubleshooting.md); more poses do not "
    "lower them.",
    "parameters": "measure more poses, planned with calib plan --taken, or with less noise.",
    "poses": "also measure poses like the program's: calib plan --taken.",
    "tool": "measure a target at the tool's working point and give it as --tool target; or measure several targets, or "
    "poses, with known places in the tip (--fix-target).",
    "base": "measure in a frame of known points on the base (--frame known).",
    "scale": "name the instrument in the cell file (instrument), or check a known length and state scale_certified = "
    "true.",
}

#: The text of each code: {0} and {1} are its numbers in {unit}, or both as {miss}; {joint}, {row} are its subject.
_TEXTS: dict[Code, str] = {
    "unreachable": "the true robot cannot reach it: {miss} would be left",
    "beyond limit": "'{joint}' would have to be at {0:.4f} {unit}, beyond its limit {1:.4f}",
    "other branch": "next to a singularity: the solution lies in another branch of the arm",
    "near singularity": "near a singularity: 1 mm of the tool may take {0:.1f} {unit} of '{joint}'",
    "large pose correction": "the pose to send is moved by {miss}",
    "large joint correction": "a joint is corrected by {0:.1f} {unit}: '{joint}'",
    "jump": "a jump: from {row} '{joint}' moves {0:.1f} {unit}, much more than in the program",
    "ambiguous pose": "sent as a pose it may end {miss} off: the controller may choose other joint values",
    "outside measured range": "outside the joint range that was measured: '{joint}' by {0:.3g} {unit}",
}


def text(commands: Commands, name: str, written: Path | None) -> str:
    """Write what `calib compensate` prints on commands.

    Args:
        commands: The commands.
        name: The file that the actual robot is from.
        written: The table of commands that was written; None if none was.

    Returns:
        Verdict, expected errors, program, corrections, notes, and warnings by row, in lines of 100 columns.
    """
    usage = "Nothing was written; -o commands.csv writes the commands."
    if written is not None:
        advice = (
            "Send the joint values, or send the poses to a controller with the nominal model; one with the corrected "
            "model would apply the correction twice. Then measure some rows, see docs/compensation.md."
        )
        usage = f"Written: {written}\n{fill(advice)}"
    # To check before the commands go to the robot.
    pair, robot = commands.pair, commands.nominal
    notes = [_mismatch(commands)]
    several = pair.result is not None and bool(pair.result.nominal.branches)
    if pair.result is not None and not several and is_corrected(pair.result, robot):
        notes.append(
            f"{robot.urdf.source} has the corrected joint origins: the commands are for a controller with this model, "
            "and correct only what the non-geometric model adds. For a controller with the nominal model give its URDF."
        )
    notes += approach_notes(pair)
    if pair.target is not None:
        notes.append(
            f"Set the controller's tool to {place_text(pair.nominal.T_tip_tool)} in '{robot.tip}'; the poses to send "
            "refer to that tool."
        )
    if pair.group is not None:
        place = place_text(rigid_inverse(pair.T_frame_base))
        notes.append(
            f"Set the controller's work object to {place} in '{robot.base}'; the poses to send refer to it."
        )
    parts = [
        verdict_paragraph(commands, name),
        expected_paragraphs(commands),
        _program(commands),
        corrections_table(commands),
        *[fill(note) for note in notes if note],
        _findings_paragraph(commands, "without a command", _reasons(commands)),
        _findings_paragraph(commands, "with a warning", commands.warnings),
        usage,
    ]
    return "\n\n".join(part for part in parts if part)


def approach_notes(pair: Pair) -> list[str]:
    """Say what commands rest on if joints stop short: the order of the rows, or the side of the approach.

    Args:
        pair: The robots that the commands are for.
    """
    if pair.actual.kinematics.model.depends_on_moves:
        return [
            "Where a joint stops depends on its last move, so the rows are corrected in their order: keep it. How the "
            "joints come to the first row is not known; let it be the pose from which the program starts."
        ]
    verdict = None if pair.result is None else pair.result.verdict
    if verdict is not None and any(reason.why is Why.ONE_SIDED for reason in verdict.reasons):
        return [
            "At the calibration all joints arrived at every pose from one side: let the program arrive from this side "
            "too, else lost motion is not corrected."
        ]
    return []


def no_commands(commands: Commands) -> str:
    """Word the message about rows without a command, with the reasons and the remedy."""
    advice = _mismatch(commands) or (
        "Check --tool, --poses-in and the units. --tolerance accepts a small remaining error, --match position leaves "
        "the orientation free, and --skip leaves such rows empty except for the reason."
    )
    missing = sum(~commands.reached)
    head = f"{missing} of {len(commands)} rows have no command, and nothing was written:"
    found = findings_lines(commands.program.labels, _reasons(commands), commands.nominal)
    return "\n".join([head, *found, fill(advice)])


def _reasons(commands: Commands) -> list[tuple[CommandWarning, ...]]:
    """Return why each row has no command, as findings about the row; empty for a row that has one."""
    return [() if reason is None else (reason,) for reason in commands.reasons]


def _findings_paragraph(
    commands: Commands, what: str, rows: Sequence[Sequence[CommandWarning]]
) -> str:
    """Write a paragraph of findings, given for each row, headed by what these rows are; empty if there are none."""
    if not any(rows):
        return ""
    head = f"Rows {what}: {sum(map(bool, rows))} of {len(commands)}"
    return "\n".join([head, *findings_lines(commands.program.labels, rows, commands.nominal)])


def findings_lines(
    labels: Sequence[str], rows: Sequence[Sequence[CommandWarning]], robot: Robot
) -> list[str]:
    """Write lines of findings: for each code its first row, and how many more have it.

    Args:
        labels: What each row is called.
        rows: The findings about each row.
        robot: The robot, whose joint types decide on units.
    """
    by_code: dict[str, dict[str, CommandWarning]] = {}
    for label, findings in zip(labels, rows, strict=True):
        for finding in findings:
            by_code.setdefault(finding.code, {}).setdefault(label, finding)
    lines = []
    for by_row in by_code.values():
        first, *others = by_row
        more = f"; and {len(others)} more" if others else ""
        lines.append(fill(f"{first}: {finding_text(by_row[first], robot)}{more}", "  ", "  "))
    return lines


def finding_text(finding: CommandWarning, robot: Robot) -> str:
    """Word a finding about a row.

    Args:
        finding: The finding, its numbers in SI units.
        robot: The robot, whose joint types decide on units.

    Returns:
        A sentence without its end, with numbers in mm and deg.
    """
    numbers, factor, unit = finding.numbers, _DEG, "deg"
    if robot.joint_types.get(finding.joint) == "prismatic":
        factor, unit = _MM, "mm"
    miss = ""
    if not finding.joint and numbers:
        miss = f"{_MM * numbers[0]:.4f} mm"
        if not np.isnan(numbers[1]):
            miss += f", {_DEG * numbers[1]:.4f} deg"
    scaled = [factor * number for number in numbers]
    if finding.code == "unreachable" and not numbers:
        return "the nominal robot reaches it at no joint values inside its limits"
    words = {"joint": finding.joint, "row": finding.row, "unit": unit, "miss": miss}
    return _TEXTS[finding.code].format(*scaled, **words)


def verdict_paragraph(commands: Commands, name: str) -> str:
    """Write the verdict on the model in use, with its reasons, and which model that is.

    Args:
        commands: The commands.
        name: The file that the model is from.
    """
    pair = commands.pair
    if pair.result is None:
        lines = [
            f"The true robot is {name}, a URDF: with --calibration the expected errors are known."
        ]
        stated = pair.actual.robot.urdf.verdict
        if stated:
            lines.insert(0, f"Verdict on {name}: {stated}")
        return "\n".join(map(fill, lines))
    model = "joint origins"
    if pair.non_geometric:
        non_geometric = pair.result.part(non_geometric=True)
        model = f"non-geometric model '{non_geometric.model.name}'"
    verdict = pair.result.verdict_on(non_geometric=pair.non_geometric)
    if verdict is None:
        return f"Verdict: none ({name}, {model}), the result was not validated."
    lines = [f"Verdict: {verdict.use} ({name}, {model})"]
    if verdict.use != "use":
        lines += [fill(reason_text(reason), "  ") for reason in verdict.reasons]
    return "\n".join(lines)


def expected_paragraphs(commands: Commands, noun: str = "row") -> str:
    """Write the expected position error, its sources, and what lowers the largest; empty if it is not known.

    The table of sources has the mean error that each would leave alone, and its share of the mean square.

    Args:
        commands: The commands.
        noun: What a row of the commands is.
    """
    expected = commands.expected
    if expected is None:
        return ""
    errors = _MM * expected.errors[:, 0]
    labels = np.array(commands.program.labels, dtype=object)[commands.reached]
    worst = labels[int(np.argmax(errors))]
    low, high = expected.band
    sentence = (
        f"Expect position errors of {_MM * expected.mean:.3f} mm (mean over the {noun}s), {errors.max():.3f} mm at "
        f"{worst}. Of ten calibrations like this one, {10 * BAND:.0f} have a mean between "
        f"{_MM * low:.3f} and {_MM * high:.3f} mm."
    )

    columns = [
        name_column("Expected error, by its source", _LABEL),
        Column("mean mm", 9),
        Column("share", 9),
    ]
    total = sum(expected.contributions.values())
    rows = []
    for source, square in expected.contributions.items():
        share = square / total if total > 0.0 else 0.0
        if share >= _SMALL_SHARE:
            alone = _MM * expected.mean * np.sqrt(share)
            rows.append((_SOURCES[source], f"{alone:.3f}", f"{100.0 * share:.0f} %"))
    sources = "\n".join(table_lines(columns, rows))

    remedies = map(fill, _remedies(commands, expected, noun))
    return "\n\n".join([fill(sentence), sources, *remedies])


def _remedies(commands: Commands, expected: ExpectedErrors, noun: str) -> Iterator[str]:
    """Yield sentences on what the expected errors leave out, and on what lowers the largest contribution to them.

    Rows are called by a noun; those of a robot program are motions, whose poses are in its own frames.
    """
    pair, largest = commands.pair, expected.largest
    result = pair.result
    assert result is not None  # else nothing is expected
    if not expected.validated:
        yield (
            "The result was not cross-validated: errors that its model lacks are not included. Calibrate without "
            "--no-validate."
        )
    if largest == "model" and expected.noise == "unknown":
        yield (
            "The instrument's noise was not stated, so held-out errors count in full. For a better estimate, state it "
            "at the calibration (sigma_mm in the cell file, or a column 'sigma [mm]'), or measure some poses "
            "repeatedly."
        )
    elif largest == "model" and result.non_geometric is not None and not pair.non_geometric:
        yield "To lower it: use the non-geometric model, without --geometry."
    elif largest == "base" and expected.in_measured_frame is not None and noun != "row":
        yield (
            f"Among each other the motions are more accurate ({_MM * expected.in_measured_frame:.3f} mm): an estimated "
            "frame absorbs whatever displaces the first joint in the base. To lower the rest: measure in a frame of "
            "known points on the base (--frame known)."
        )
    elif largest == "base" and expected.in_measured_frame is not None:
        groups, ends = result.setup.groups, pair.nominal.robot
        # Of several chains, a frame on the base of the commands, or else the first one that sees the hand.
        links = result.setup.frame_links or (ends.base,) * len(groups)
        bases = [chain.base for chain in result.nominal.chains if chain.tip == ends.tip]
        link = (
            ends.base
            if ends.base in links
            else next((one for one in links if one in bases), links[0])
        )
        name = "measured" if len(groups) == 1 else f'"{groups[links.index(link)]}"'
        base = "" if link == ends.base else f" --base {link}"
        yield (
            f"To lower it: give the program in the measurement frame, --poses-in {name}{base} "
            f"({_MM * expected.in_measured_frame:.3f} mm): an estimated frame absorbs whatever displaces the first "
            "joint in the base. Or measure in a frame of known points on the base (--frame known)."
        )
    else:
        yield f"To lower it: {_REMEDIES[largest]}"


def _program(commands: Commands) -> str:
    """Word the program, how it is matched, and the frame of its poses."""
    robot, program, pair = commands.nominal, commands.program, commands.pair
    content = "joint values"
    if program.T_wanted is not None:
        content = "poses" if program.oriented else "positions"
        if program.form:
            content = f"poses ({find_convention(program.form).words.removeprefix('a ')})"
        if program.q is not None:
            content += " with joint values to start at"
    frame = f"'{robot.base}'"
    if pair.group is not None:
        frame = "the measured frame"
        if pair.group:
            frame += f" of {pair.group!r}"
    text = (
        f"Program: {len(commands)} rows of {content}. Tool: {place_text(pair.actual.T_tip_tool)} in '{robot.tip}'. "
        f"Matched: {_MATCHED[commands.match]}. Poses are in {frame}."
    )
    kept = ", ".join(label for label, _ in program.kept if label)
    if kept:
        text += f" Copied as they are: {kept}."
    coupling = coupling_sentence(robot)
    return fill(f"{text} {coupling}" if coupling else text)


def corrections_table(commands: Commands, noun: str = "row") -> str:
    """Write the table of errors with and without compensation, and of corrections, in mm and deg.

    Args:
        commands: The commands; rows without one do not count.
        noun: What a row of the commands is.
    """
    title = f"By the calibrated model, {noun}s with commands: {int(commands.reached.sum())}"
    columns = [name_column(title, _LABEL)]
    columns += [Column(head, 9) for head in ("max mm", "mean mm", "max deg", "mean deg")]
    rows = []
    for label, (lengths, angles) in _errors_and_corrections(commands).items():
        cells = [label]
        for column, factor in ((lengths, _MM), (angles, _DEG)):
            known = factor * column[np.isfinite(column)]
            if known.size:
                cells += [f"{known.max():.4f}", f"{known.mean():.4f}"]
            else:
                cells += ["-", "-"]
        if cells[1:] != ["-"] * 4:
            rows.append(cells)
    return "\n".join(table_lines(columns, rows))


def _errors_and_corrections(commands: Commands) -> dict[str, tuple[Array, Array]]:
    """Return lengths [m] and angles [rad], all positive or zero, of the K rows that have a command, by their label.

    Their shapes are (K,), of joints (K, prismatic joints) and (K, other joints); what is not known is NaN.
    """
    rows, robot = commands.reached, commands.nominal
    values = {
        "error without compensation": commands.missed,
        "model residual after compensation": commands.left,
        "model residual if sent as a pose": commands.left_by_pose,
        "expected error after compensation": commands.expected_errors,
        "correction of the pose to send": commands.pose_corrections,
    }
    pairs = {label: (sizes[rows, 0], sizes[rows, 1]) for label, sizes in values.items()}
    joints = np.abs(commands.joint_corrections[rows])
    slides = np.array([robot.joint_types[name] == "prismatic" for name in robot.joint_names])
    pairs["correction of a joint"] = (joints[:, slides], joints[:, ~slides])
    return pairs


def place_text(T: Array) -> str:
    """Format a pose as its position [mm] and, if it is rotated, its rotation vector [deg].

    Args:
        T: The pose, shape (4, 4) [m].
    """
    turn = _DEG * Rotation.from_matrix(T[:3, :3]).as_rotvec()
    text = f"({_listed(_MM * T[:3, 3])}) mm"
    if np.abs(turn).max() > _ROUNDING_DEG:
        text += f", rotation vector ({_listed(turn)}) deg"
    return text


def _listed(values: Array) -> str:
    """List numbers (n,) with four decimals and commas between, none of them -0."""
    return ", ".join(f"{value:.4f}" for value in values.round(4) + 0.0)


def _mismatch(commands: Commands) -> str:
    """Word that the joint values of a program do not belong to its poses; empty if they do, or only one is there."""
    program, pair = commands.program, commands.pair
    if program.q is None or program.T_wanted is None:
        return ""
    poses = pair.T_frame_base @ pair.nominal.poses(program.q)
    apart = np.linalg.norm(poses[:, :3, 3] - program.T_wanted[:, :3, 3], axis=1)
    median = float(np.median(apart))
    if median >= _MISMATCH:
        return (
            f"At the program's joint values the nominal robot's tool is {_MM * median:.0f} mm from the program's "
            "positions (median). Do these belong to another tool (--tool) or to another frame (--poses-in), or were "
            'they measured (--columns "x=-" ignores them)? Or are joint readings coupled (--cell)?'
        )
    turns = Rotation.from_matrix(poses[:, :3, :3]).inv() * Rotation.from_matrix(
        program.T_wanted[:, :3, :3]
    )
    turned_deg = _DEG * float(np.median(turns.magnitude()))
    if not program.oriented or turned_deg < _MISMATCH_DEG:
        return ""
    return (
        "At the program's joint values the nominal robot's tool is in the right places, but rotated by "
        f"{turned_deg:.0f} deg from the program's orientations (median). Do these follow another convention "
        "(--orientation), or belong to another tool (--tool)?"
    )
