"""What captions say of the rows that a figure shows: words where they hold for this calibration, nothing otherwise."""

from __future__ import annotations

import numpy as np

from calib.identify.result import Calibration
from calib.show.figure_curves import MOST_LINES, shaded
from calib.show.figure_rows import flagged_rows, has_flagged, numbered_rows


def numbers_words(c: Calibration) -> str:
    """Which rows carry their numbers."""
    chosen, flagged = numbered_rows(c), flagged_rows(c)
    kinds = ((chosen & flagged, "outliers"), (chosen & ~flagged, "validation rows"))
    words = [word for mask, word in kinds if np.any(mask)]
    return f" {' and '.join(words).capitalize()} carry their row numbers." if words else ""


def thin_words(c: Calibration, most: int) -> str:
    """Which rows are drawn of many."""
    every = -(-len(c.measurements) // most)
    too = ", and all outliers" if has_flagged(c) else ""
    return f" One of {every} rows is drawn{too}." if every > 1 else ""


def shading_words(c: Calibration) -> str:
    """Behind the number of validation rows: whether they are shaded."""
    return " (shaded)" if shaded(c.measurements.validation) else ""


def left_out_words(c: Calibration) -> str:
    """What the dashes are."""
    if c.cross_validation is None or len(c.measurements) > MOST_LINES:
        return ""
    rows = "estimation rows" if np.any(c.measurements.validation) else "same rows"
    return f" Dashes: the {rows} predicted by fits that have not seen them."


def edge_words(c: Calibration) -> str:
    """Where outliers are."""
    return " Outliers beyond the scale stand at its edge." if has_flagged(c) else ""


def box_words(c: Calibration) -> str:
    """How boxes are read."""
    without = " without outliers" if has_flagged(c) else ""
    return (
        f"Above, both robots; below, the calibrated one alone{without}. Boxes hold the middle half of the rows and "
        "their median; whiskers reach from 5 to 95 %; dots are single rows, or the least and the largest of many."
    )
