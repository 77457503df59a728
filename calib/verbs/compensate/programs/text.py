"""What `calib compensate` prints on a program: errors before and after, what was corrected, what is left and why."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from calib.show.lines import deg, fill, mm, plural, row_ranges
from calib.verbs.compensate.commands import CommandWarning
from calib.verbs.compensate.programs.correction import CorrectedProgram
from calib.verbs.compensate.programs.program_file import LeftCode
from calib.verbs.compensate.text import (
    approach_notes,
    corrections_table,
    expected_paragraphs,
    findings_lines,
    place_text,
    verdict_paragraph,
)

#: Lines of what is left that are listed for each code.
_LISTED = 8

#: Distances below this are not worth a word [m]: a tenth of what a robot repeats.
_WORTH = 5e-6

#: Why numbers stay as they are, by its code.
_LEFT: dict[LeftCode, str] = {
    "relative": "an offset from where the robot is, which the correction there does not belong to",
    "computed": "the program makes or changes the target as it runs",
    "partial": "numbers that are left out stay those of the motion before",
    "shared": "the motions that go to this target need different numbers",
    "configuration": "no joint values of the nominal robot agree with the configuration data, here or before, at a "
    "target that this one follows; or the corrected ones do not",
    "external axes": "an axis moves that is not in the URDF",
    "external tool": "the tool stands still, and the robot carries the part",
    "other file": "the target's numbers are not in the files given (--data)",
    "not a motion": "the numbers are no target of the robot",
    "group": "another motion group than the first",
    "spline": "its shape depends on more than its targets",
    "conveyor": "the frame moves",
    "search": "the motion ends at a sensor's signal",
    "force": "the motion is led by a force",
    "unread": "it moves the robot, and calib does not know how",
    "unused": "no motion goes to the target, so that its tool and frame are not known",
}


def program_text(corrected: CorrectedProgram, name: str, written: Sequence[Path]) -> str:
    """Write what `calib compensate` prints on a corrected program.

    Args:
        corrected: The program.
        name: The file that the model of the true robot is from.
        written: The files that were written.

    Returns:
        Verdict, expected errors, corrections, and by line what was corrected, what is left, and warnings.
    """
    first = corrected.commands[0]
    usage = ["Nothing was written; -o FILE writes the program."]
    if written:
        usage = [f"Written: {path}" for path in written]
        advice = (
            "The program is for a controller with the nominal model and the same tools and frames; do not correct it "
            "again. Run it slowly the first time, and measure some of its targets, see docs/programs.md."
        )
        usage.append(fill(advice))
    parts = [verdict_paragraph(first, name)]
    for commands in corrected.commands:
        if len(corrected.commands) > 1:
            tool = place_text(commands.pair.nominal.T_tip_tool)
            parts.append(fill(f"Motions of the tool at {tool} in '{commands.nominal.tip}':"))
        if commands.reached.any():
            parts += [
                expected_paragraphs(commands, "motion"),
                corrections_table(commands, "motion"),
            ]
    parts += map(fill, approach_notes(first.pair))
    parts += map(fill, _digits_and_shared(corrected))
    parts.append("\n".join(_corrected_lines(corrected)))
    parts.append("\n".join(_left_lines(corrected)))
    reasons = [() if reason is None else (reason,) for reason in corrected.reasons]
    parts.append(_findings(corrected, "that cannot be corrected", reasons))
    parts.append(_findings(corrected, "with a warning", corrected.warnings))
    parts.append("\n".join(usage))
    return "\n\n".join(part for part in parts if part)


def not_reached_text(corrected: CorrectedProgram) -> str:
    """Word the message about motions that cannot be corrected, with the reasons and the remedy.

    Args:
        corrected: The program.
    """
    reasons = [() if reason is None else (reason,) for reason in corrected.reasons]
    advice = (
        "Check the tools and frames of the program (--tool, --frame). --tolerance accepts a small remaining error, and "
        "--skip leaves the targets of such motions as they are."
    )
    count = sum(map(bool, reasons))
    head = f"{count} of {len(reasons)} motions cannot be corrected, and nothing was written:"
    lines = findings_lines(_labels(corrected), reasons, corrected.commands[0].nominal)
    return "\n".join([head, *lines, fill(advice)])


def _labels(corrected: CorrectedProgram) -> list[str]:
    """Return what each motion is called: ``line 12 of prog.src``."""
    texts = corrected.program.texts
    return [f"line {move.line} of {texts[move.file].path.name}" for move in corrected.program.moves]


def _findings(
    corrected: CorrectedProgram, what: str, rows: Sequence[Sequence[CommandWarning]]
) -> str:
    """Write a paragraph of findings, given for each motion, headed by what these are; empty if there are none."""
    if not any(rows):
        return ""
    head = f"Motions {what}: {sum(map(bool, rows))} of {len(rows)}"
    lines = findings_lines(_labels(corrected), rows, corrected.commands[0].nominal)
    return "\n".join([head, *lines])


def _corrected_lines(corrected: CorrectedProgram) -> Iterator[str]:
    """Yield lines on the motions and targets that were corrected: how many, and in which lines of which file."""
    program = corrected.program
    moved = np.flatnonzero(corrected.is_corrected).tolist()
    changed = sorted({program.moves[i].target for i in moved if corrected.corrections[i].any()})
    kept = len(program.moves) - len(moved) + len(corrected.left)
    rest = f"; {plural(kept, 'motion')} or other lines stay, see below" if kept else ""
    yield f"Corrected: {plural(len(changed), 'target')} of {plural(len(moved), 'motion')}{rest}"
    for file, text in enumerate(program.texts):
        lines = {program.targets[t].line for t in changed if program.targets[t].file == file}
        if lines:
            yield fill(f"{text.path.name}: lines {row_ranges(lines)}", "  ", "  ")


def _left_lines(corrected: CorrectedProgram) -> Iterator[str]:
    """Yield lines on what is left as it is: for each code the places, as many as are worth listing."""
    if not corrected.left:
        return
    yield f"Left as it is: {plural(len(corrected.left), 'line')}"
    for code in dict.fromkeys(item.code for item in corrected.left):
        items = [item for item in corrected.left if item.code == code]
        yield fill(f"{code}: {_LEFT[code]}", "  ", "  ")
        for item in items[:_LISTED]:
            path = corrected.program.texts[item.file].path
            what = f": {item.what}" if item.what else ""
            yield fill(f"line {item.line} of {path.name}{what}", "    ", "  ")
        if len(items) > _LISTED:
            lines = row_ranges({item.line for item in items[_LISTED:]})
            yield fill(f"and {len(items) - _LISTED} more: lines {lines}", "    ", "  ")


def _digits_and_shared(corrected: CorrectedProgram) -> Iterator[str]:
    """Yield sentences on what the digits that the controller reads cost, and targets with the mean of corrections."""
    rounded, shared = corrected.rounded, corrected.shared
    lengths = np.nan_to_num(rounded[:, 0])
    if lengths.max() > _WORTH:
        yield (
            f"The controller reads numbers of so few digits that motions miss their poses by up to {mm(lengths.max())} "
            f"mm, {deg(np.nan_to_num(rounded[:, 1]).max(), 4)} deg."
        )
    several = np.nan_to_num(shared[:, 0]) > _WORTH
    if several.any():
        worst = int(np.argmax(np.nan_to_num(shared[:, 0])))
        yield (
            f"{plural(int(several.sum()), 'motion')} share targets with others that need other numbers, and get the "
            f"mean: up to {mm(shared[worst, 0])} mm remain, at {_labels(corrected)[worst]}. A target of its own for "
            "each removes that."
        )
