"""Rows that are in doubt, in words: outside of the measured range, or with a lowered weight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.channels import RESIDUAL_UNITS
from calib.diagnosis.coverage import Beyond, OutsideRow
from calib.selection.robustness import Robustness
from calib.text.layout.lines import mm, plural
from calib.text.layout.sizes import shown

#: Rows outside of the measured range that are named one by one; a sentence with more is hard to read.
_NAMED = 3

_DEG = float(np.degrees(1.0))


def joint_unit(*, prismatic: bool) -> tuple[float, str]:
    """Return the unit in which a joint's values are shown, with its factor from SI, before it."""
    return (1e3, "mm") if prismatic else (_DEG, "deg")


def outside_text(rows: Sequence[OutsideRow], numbers: Sequence[int]) -> str:
    """List the rows outside of the measured range.

    Args:
        rows: The rows, of which the first few are named with their joints, the furthest joint first.
        numbers: The number of each queried row in its table, by `OutsideRow.index`.

    Returns:
        The rows in one line; empty if there are none.
    """
    parts = []
    for row in rows[:_NAMED]:
        joints = ", ".join(map(_beyond, row.beyond))
        parts.append(f"row {numbers[row.index]}: {joints} beyond the measured range")
    more = len(rows) - _NAMED
    if more > 0:
        parts.append(f"and {plural(more, 'more row')}")
    return "; ".join(parts)


def _beyond(beyond: Beyond) -> str:
    """Word how far a joint value lies outside of its measured range."""
    factor, unit = joint_unit(prismatic=beyond.prismatic)
    return f"'{beyond.joint}' {factor * beyond.by:.3g} {unit}"


def robustness_text(robustness: Robustness) -> str:
    """Word the effect of lowering the weights of doubtful rows.

    Args:
        robustness: Predictions and held-out errors with full and with lowered weights.

    Returns:
        The effect of the weights that the fit does not use, in a sentence.
    """
    used, other = robustness.errors_full, robustness.errors_lowered
    other_weights = "lowered"
    if robustness.lowered:
        used, other = other, used
        other_weights = "full"
    text = (
        f"With {other_weights} weight these rows would change the prediction by {mm(robustness.moved_rms)} mm rms "
        f"at the measured poses, {mm(robustness.moved_max)} mm at most"
    )
    figures = used.leading
    if figures.n:
        unit = RESIDUAL_UNITS[figures.unit]
        after = shown(other[figures.unit].rms, figures.unit)
        change = f"from about {shown(figures.rms, figures.unit)} to {after} {unit.shown} rms"
        text += f", and the held-out error of the others {change}"
    return text + "."
