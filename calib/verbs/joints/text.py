"""Texts that ``calib joints`` prints: how many ways there are to the poses, and what decided which one it was."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.errors import choices
from calib.robot.robot import Robot
from calib.show.lines import fill, plural
from calib.verbs.joints.joints import JointValues

#: The most poses that are listed.
_LISTED = 12

#: What decided, by its code.
_DECIDED = {
    "limits": "the limits of the joints leave one solution of each pose",
    "poses": "the limits of the joints leave one solution of some poses, and at the others any other one would have "
    "taken the arm out of its branch and back",
    "measurements": "what was measured there decides{lead}",
}


def joints_text(controller: Robot, found: JointValues, rows: Sequence[int]) -> list[str]:
    """Word what was found, as paragraphs with lines of at most 100 columns.

    Args:
        controller: The robot as its controller has it.
        found: The joint values.
        rows: Number of the row where each pose comes first, from 1.
    """
    counts = found.counts
    some = f"{counts.min()} to {counts.max()}" if counts.min() < counts.max() else f"{counts[0]}"
    sentences = [
        f"{plural(len(counts), 'pose')} of '{controller.tip}' in '{controller.base}': {some} solutions of each inside "
        "the joints' limits, up to whole turns."
    ]
    if found.unique.all():
        lead = ""
        if np.isfinite(found.lead):
            lead = f", e^{found.lead:.0f} times as likely as the next way through the poses"
        sentences.append(
            f"Joint values are unique: {_DECIDED[found.decided_by].format(lead=lead)}."
        )
    else:
        sentences.append(not_unique_text(found, rows))
    if found.open_turns:
        sentences.append(
            f"{choices(found.open_turns)} may be a whole turn away at all poses; the values nearest to zero were "
            "taken. This matters for errors of a gear alone (gain)."
        )
    return [fill(sentence) for sentence in sentences]


def not_unique_text(found: JointValues, rows: Sequence[int]) -> str:
    """Word that joint values are not unique, at which poses, and what tells them apart, in one line."""
    numbers = [str(row) for row, unique in zip(rows, found.unique, strict=True) if not unique]
    listed = ", ".join(numbers[:_LISTED]) + (" ..." if len(numbers) > _LISTED else "")
    where = f"at {plural(len(numbers), 'pose')} (row{'s' * (len(numbers) > 1)} {listed})"
    remedy = "state the limits of the joints, or give what was measured there (--camera, --board)"
    if np.isfinite(found.lead) or found.decided_by:
        remedy = "state the limits of the joints in the URDF, or add poses with other wrists"
    return f"Joint values are not unique {where}: other branches explain them as well. To tell them apart, {remedy}."
