"""Robustness: the effect on a fit of lowering the weights of doubtful rows.

Robust weights rest on the belief that a few rows are accidents; the fit with every row in full is shown beside it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Array
from calib.errors import MeasurementError
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.selection.linear_folds import linear_cross_validation
from calib.numerics.errors import Errors
from calib.numerics.rigid_motion import without_rigid_motion


@dataclass(frozen=True, slots=True, eq=False)
class Robustness:
    """The fit with the weights of doubtful rows lowered, beside the one with every row in full."""

    #: True if the calibration has the weights lowered, and the other fit every row in full
    lowered: bool
    #: Distance between both fits' predictions at the measured poses, rms [m]
    moved_rms: float
    #: The largest such distance [m]
    moved_max: float
    #: Of rows not flagged, held out on the linearised problem, with weights lowered
    errors_lowered: Errors
    #: The same with every row in full
    errors_full: Errors


def compare_weights(fitted: Fitted) -> Robustness:
    """Fit once more with robust weights if there were none, or without if there were, and compare.

    Args:
        fitted: Fit to the rows that are compared.
    """
    rows = fitted.estimate.problem.rows
    task = replace(fitted.task, robust=not fitted.task.robust)
    other = fit(task, replace(rows, weights=None), registered=fitted.setup)
    distances = _distances(fitted, other)
    robust, full = (fitted, other) if fitted.task.robust else (other, fitted)
    kept = ~fitted.estimate.outliers
    try:
        of_robust = linear_cross_validation(robust).residual[kept]
        of_full = linear_cross_validation(full).residual[kept]
    except MeasurementError:  # rows of a single pose, of which none can be held out
        errors_lowered = errors_full = Errors.of(
            np.zeros((0, rows.width)), rows.channels.select(slice(0))
        )
    else:
        errors_lowered = Errors.of(of_robust, rows.channels.select(kept))
        errors_full = Errors.of(of_full, rows.channels.select(kept))
    return Robustness(
        lowered=fitted.task.robust,
        moved_rms=float(np.sqrt(np.mean(distances**2))),
        moved_max=float(np.max(distances)),
        errors_lowered=errors_lowered,
        errors_full=errors_full,
    )


def _distances(fitted: Fitted, other: Fitted) -> Array:
    """Return the distances between the points that two fits of a model predict at the N measured poses, (N,) [m].

    If no row determines where the base stands, a motion as one body is left out.
    """
    rows = fitted.estimate.problem.rows
    samples = rows.samples
    as_one_body = not any(kind.tells_place for kind in rows.present)
    if as_one_body:
        samples = replace(samples, frame=np.zeros_like(samples.frame))
    points = fitted.kinematics.points(fitted.estimate.x, samples)
    other_points = other.kinematics.points(other.estimate.x, samples)
    displacements = (other_points - points)[:, :, None]
    if as_one_body:
        displacements = without_rigid_motion(points, displacements)
    return np.asarray(np.linalg.norm(displacements[:, :, 0], axis=1))
