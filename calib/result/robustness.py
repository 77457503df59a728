"""Robustness: what lowering the weights of doubtful rows does to a fit.

Robust weights rest on the belief that a few rows are accidents; the fit with every row in full stands beside.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.errors import MeasurementError
from calib.estimate.fitting import Fitted, fit
from calib.numerics.errors import Errors
from calib.result.prediction import without_rigid_motion
from calib.selection.linear_folds import linear_cross_validation


@dataclass(frozen=True, slots=True, eq=False)
class Robustness:
    """The fit with the weights of doubtful rows lowered, beside the one with every row in full."""

    lowered: bool  # Whether it is the calibration that has the weights lowered, or the fit that it is compared with
    moved_rms: float  # How far the other fit's predictions at the measured poses lie from the calibration's [m]
    moved_max: float  # The same at most [m]
    # Of rows not flagged, left out of a linearised fit, with weights lowered
    errors_lowered: Errors
    errors_full: Errors  # The same with every row in full


def compare_weights(fitted: Fitted) -> Robustness:
    """Fit once more with robust weights where there were none, or without where there were, and compare."""
    estimate, rows = fitted.estimate, fitted.estimate.problem.rows
    task = replace(fitted.task, robust=not fitted.task.robust)
    other = fit(task, replace(rows, weights=None), registered=fitted.setup)
    samples = rows.samples
    as_one_body = not any(kind.position for kind in rows.present)
    if as_one_body:
        samples = replace(samples, frame=np.zeros_like(samples.frame))
    here = fitted.kinematics.points(estimate.x, samples)
    moves = (other.kinematics.points(other.estimate.x, samples) - here)[:, :, None]
    if as_one_body:
        moves = without_rigid_motion(here, moves)
    flagged, both = estimate.outliers, (fitted, other) if fitted.task.robust else (other, fitted)
    try:
        left = [linear_cross_validation(one).residual[~flagged] for one in both]
        lowered, full = (Errors.of(residual, rows.used[~flagged]) for residual in left)
    except MeasurementError:  # rows of a single pose, of which none can be left out
        lowered = full = Errors.of(np.zeros((0, rows.width)))
    moved = np.linalg.norm(moves[:, :, 0], axis=1)
    return Robustness(
        lowered=fitted.task.robust,
        moved_rms=float(np.sqrt(np.mean(moved**2))),
        moved_max=float(np.max(moved)),
        errors_lowered=lowered,
        errors_full=full,
    )
