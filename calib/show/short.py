"""Results in one line, as Python shows them; what they say of errors, the tables for notebooks say too."""

from __future__ import annotations

from calib.numerics.errors import Errors
from calib.result.calibration import Calibration
from calib.show.lines import listed
from calib.show.sizes import with_unit


def before_and_after(c: Calibration) -> tuple[str, Errors, Errors]:
    """Return the errors of the nominal and of the calibrated robot that say most.

    Args:
        c: The result.

    Returns:
        Which rows they are of, ``"held-out"``, ``"validation"`` or ``"fitted"``; and the errors of both robots, of the
        geometry alone and without outliers.
    """
    before, after = c.trust.nominal_cross_validation, c.cross_validation
    if before is not None and after is not None:
        return "held-out", before.errors_without_outliers, after.errors_without_outliers
    nominal, calibrated = c.errors["nominal"], c.errors["calibrated"]
    name, rows = "fitted", "estimation"
    if c.rows.validation.any():
        name, rows = "validation", "validation"
    return name, nominal[rows], calibrated[rows]


def rms_text(errors: Errors) -> str:
    """Word the rms error of some rows in each unit that was measured; a dash without any."""
    return listed([with_unit(errors[unit].rms, unit) for unit in errors.units]) or "-"
