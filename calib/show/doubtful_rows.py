"""Rows that are in doubt, in words: outside of the measured range, or with a lowered weight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calib.basics.channels import RESIDUAL_UNITS
from calib.diagnosis.coverage import Beyond, OutsideRow
from calib.fit.selection.robustness import Robustness
from calib.result.calibration import Calibration
from calib.result.parts import Outlier
from calib.show.lines import mm, plural
from calib.show.sizes import shown

#: Rows outside of the measured range that are named one by one; a sentence with more is hard to read.
_NAMED = 3

#: Outliers that are listed; the others are counted.
_LISTED = 12

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


def rows_lie(values: Mapping[str, Any]) -> str:
    """Word how many validation rows, or images, lie somewhere; rows of other reasons may be a list."""
    if "image" in values:
        images = values["images"]
        return f"{plural(images, 'validation image')} {'lies' if images == 1 else 'lie'}"
    rows = values.get("rows", 0)
    return "1 validation row lies" if rows == 1 else f"{rows} validation rows lie"


def row_or_image(values: Mapping[str, Any]) -> str:
    """Name the image of a reason's values, or else its row."""
    return f"'{values['image']}'" if "image" in values else f"row {values.get('row', 0)}"


def outliers_text(c: Calibration, outliers: Sequence[Outlier]) -> str:
    """List rows, or the images that they are corners of, with residual and score."""
    if c.rows.images:
        return _outliers_by_image(c, outliers)
    rows = []
    for outlier in outliers[:_LISTED]:
        sizes = [
            f"{shown(residual, unit, 2)} {RESIDUAL_UNITS[unit].shown}"
            for unit, residual in outlier.residual.items()
        ]
        rows.append(f"row {outlier.row} ({', '.join(sizes)}, {outlier.score:.1f} sigma)")
    more = len(outliers) - _LISTED
    if more > 0:
        rows.append(f"and {more} more")
    return "; ".join(rows)


def _outliers_by_image(c: Calibration, outliers: Sequence[Outlier]) -> str:
    """List images with the number of their corners that are outliers, and the largest residual and score."""
    images = dict(zip(c.rows.numbers, c.rows.images, strict=True))
    by_image: dict[str, list[Outlier]] = {}
    for outlier in outliers:
        by_image.setdefault(images[outlier.row] or f"row {outlier.row}", []).append(outlier)
    parts = []
    for image, of_image in list(by_image.items())[:_LISTED]:
        unit = next(iter(of_image[0].residual))
        largest = max(outlier.residual.get(unit, 0.0) for outlier in of_image)
        score = max(outlier.score for outlier in of_image)
        size = f"{shown(largest, unit, 2)} {RESIDUAL_UNITS[unit].shown}"
        corners = plural(len(of_image), "corner")
        parts.append(f"{image}, {corners} (up to {size}, {score:.1f} sigma)")
    more = len(by_image) - _LISTED
    if more > 0:
        parts.append(f"and {plural(more, 'more image')}")
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
