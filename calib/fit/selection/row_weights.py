"""Weights of the rows: a fit compared with fits of other weights, which decide which rows are outliers.

If a model lacks something, its residuals at some good rows may be far larger than at others, and robust weights would
drop these rows. A larger model, the reference fit, explains them. Which of two fits has the better weights is decided
by errors on held-out rows. And robust weights rest on the belief that a few rows are accidents: `compare_weights` shows
the fit with every row in full beside the one with lowered weights.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.basics.arrays import Mask, read_only
from calib.errors import MeasurementError
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.registration.rows import Rows
from calib.fit.selection.candidates import determinable_families, held_out_rms, model_name
from calib.fit.selection.cross_validation import linear_cross_validation
from calib.model.families import family_of
from calib.numerics.errors import Errors
from calib.numerics.rigid_motion import without_rigid_motion


def explains_more_rows(reference: Fitted, fitted: Fitted) -> bool:
    """Return whether a reference fit explains rows that another fit calls outliers.

    A small model may look good only because it drops them. The reference explains more if its outliers are a proper
    subset of the other's and, with only these set aside, it predicts held-out rows better.

    Args:
        reference: Fit with its own weights.
        fitted: Fit of another model to the same rows, with its own weights.
    """
    outliers = fitted.estimate.outliers
    outliers_of_reference = reference.estimate.outliers
    in_both = outliers & outliers_of_reference
    if np.array_equal(in_both, outliers):
        return False
    if not np.array_equal(in_both, outliers_of_reference):
        return False
    return _held_out_rms(reference, in_both) < _held_out_rms(fitted, in_both)


def _held_out_rms(fitted: Fitted, outliers: Mask) -> float:
    """Return the rms error of a fit on held-out rows of its linearised problem, without some outliers, True in (N,).

    It is in the first unit measured: [m] if any length was.
    """
    return held_out_rms(linear_cross_validation(fitted, outliers))


def with_better_weights(fitted: Fitted, rows: Rows, reference: Fitted) -> Fitted:
    """Return the fit with its own weights or those of a reference fit, whichever predict held-out rows better.

    Rows that both fits call outliers are set aside in the comparison. If the reference predicts the others better than
    the fit does, a row counts as an outlier only if both fits call it one.

    Args:
        fitted: Fit with its own weights.
        rows: The N rows that it was fitted to.
        reference: Fit of another model to these rows, with its own weights.

    Returns:
        One of the two fits of the model; its scores are at most the reference's if that predicts better, both as
        shares of the limit from which on a fit flags a row.
    """
    refitted = fit(fitted.task, rows, reference=reference, near=fitted.near)
    in_both = fitted.estimate.outliers & reference.estimate.outliers
    by_fitted = _held_out_rms(fitted, in_both)
    by_refitted = _held_out_rms(refitted, in_both)
    by_reference = _held_out_rms(reference, in_both)
    chosen = refitted if by_refitted < by_fitted else fitted
    scores = chosen.estimate.scores
    if by_reference < by_fitted:
        # Each fit has a limit of its own.
        scaled = reference.estimate.scores * chosen.estimate.flag_limit
        scores = np.minimum(scores, scaled / reference.estimate.flag_limit)
    estimate = replace(chosen.estimate, scores=read_only(scores))
    return replace(chosen, estimate=estimate)


def fit_with_all_families(fitted: Fitted, rows: Rows) -> Fitted:
    """Fit a geometry together with all usual families of non-geometric errors that the rows can determine.

    Args:
        fitted: Fit of the geometry, from whose registration the new one starts.
        rows: Rows to fit, with the loads on the joints.

    Returns:
        The fit, with its own weights, of the model such as ``"dh+compliance+gain"``; names of parameters in the cell
        that this lacks are passed over.
    """
    offered = determinable_families(fitted.task, rows)
    families = tuple(family for family in offered if not family_of(family).rarity)
    model = model_name(str(fitted.task.model), families)
    task = replace(fitted.task, model=model, allow_absent=True)
    return fit(task, rows, registered=fitted.setup, near=fitted.near)


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

    Returns:
        How far predictions move (where no row tells where the base stands, apart from a motion as one body), and the
        held-out errors of both fits at the rows that ``fitted`` did not flag; without rows if all are of one pose.
    """
    rows = fitted.estimate.problem.rows
    task = replace(fitted.task, robust=not fitted.task.robust)
    other = fit(task, replace(rows, weights=None), registered=fitted.setup, near=fitted.near)

    # Distances between the points that both fits predict. If no row determines where the base stands, a motion of all
    # points as one body is left out.
    samples = rows.samples
    as_one_body = not any(kind.tells_place for kind in rows.present)
    if as_one_body:
        samples = replace(samples, frame=np.zeros_like(samples.frame))
    points = fitted.kinematics.points(fitted.estimate.x, samples)
    other_points = other.kinematics.points(other.estimate.x, samples)
    displacements = (other_points - points)[:, :, None]
    if as_one_body:
        displacements = without_rigid_motion(points, displacements)
    distances = np.linalg.norm(displacements[:, :, 0], axis=1)

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
