"""Targets that stand still in words: how often each was read, its scatter, and what they show."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.diagnosis.frame_drift import FrameDrift, Movement, Mover, shown_by_references
from calib.diagnosis.reasons import Why
from calib.numerics.frame_path import Form
from calib.show.lines import mm
from calib.show.verdict_text import reason_text


def reference_lines(drift: FrameDrift) -> Iterator[str]:
    """Yield a line for each reference, and what none of them shows by itself.

    Args:
        drift: What the references of a table show.

    Yields:
        Such as ``Reference 'floor 1': 8 times, scatter 0.012 mm; step of 0.080 mm between rows 21 and 24.``
    """
    for one in drift.targets:
        here = [
            movement
            for movement in drift.found
            if movement.group == one.group and movement.reference in ("", one.target)
        ]
        station = f" from station '{one.group}'" if one.group else ""
        link = f" on the {one.link}" if one.link else ""
        # Once drift and steps are known, what is left of the scatter is the noise of all references.
        scatter = drift.scatter if here else one.scatter
        known = "" if np.isnan(scatter) else f", scatter {mm(scatter)} mm"
        times = "once" if one.readings == 1 else f"{one.readings} times"
        shown = "".join(f"; {_movement(movement)}" for movement in here)
        yield f"Reference '{one.target}'{link}{station}: {times}{known}{shown}."
    for reason in shown_by_references(drift):
        if reason.why in (Why.REFERENCES_STILL, Why.REFERENCES_TOO_FEW):
            yield reason_text(reason)


def _movement(movement: Movement) -> str:
    """Word a movement, such as ``step of 0.080 mm between rows 21 and 24``."""
    size = f"{mm(movement.size)} mm"
    who = {Mover.INSTRUMENT: " of the instrument", Mover.BASE: " of the base"}.get(
        movement.mover, ""
    )
    if movement.mover is Mover.REFERENCE:
        who = " of this reference alone"
    if movement.form is Form.READING:
        return f"the reading in row {movement.row} is {size} off"
    if movement.form is Form.DRIFT:
        return f"drift{who} of {size} from the first row to the last"
    return f"step{who} of {size} between rows {movement.after_row} and {movement.before_row}"
