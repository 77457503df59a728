"""Reference fits: fits whose weights and scores decide which rows are outliers for another fit.

Where a model lacks something, its residuals at some good rows may be far larger than at others, and robust weights
would drop these rows. A larger model explains them. Which of two fits has the better weights is decided by errors on
held-out rows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.estimate.fitting import Fitted, fit
from calib.registration.rows import Rows
from calib.robot.urdf_tree import read_only
from calib.selection.candidates import held_out_rms
from calib.selection.ladder import determinable_families, model_name
from calib.selection.linear_folds import linear_cross_validation


def explains_more_rows(reference: Fitted, fitted: Fitted) -> bool:
    """Tell if a reference fit explains rows that another fit calls outliers.

    A small model may look good only because it drops them. The reference explains more where its outliers are a proper
    subset of the other's and, with only these set aside, it predicts held-out rows better.

    Args:
        reference: Fit with its own weights.
        fitted: Fit of another model to the same rows, with its own weights.
    """
    outliers = fitted.estimate.outliers
    in_both = outliers & reference.estimate.outliers
    if np.array_equal(in_both, outliers):
        return False
    if not np.array_equal(in_both, reference.estimate.outliers):
        return False
    by_fitted = held_out_rms(linear_cross_validation(fitted, in_both))
    by_reference = held_out_rms(linear_cross_validation(reference, in_both))
    return by_reference < by_fitted


def with_better_weights(fitted: Fitted, rows: Rows, reference: Fitted) -> Fitted:
    """Return the fit with its own weights or those of a reference fit, whichever predict held-out rows better.

    Rows that both fits call outliers are set aside in the comparison. If the reference predicts the others better than
    the fit does, a row counts as an outlier only where both fits call it one.

    Args:
        fitted: Fit with its own weights.
        rows: The N rows that it was fitted to.
        reference: Fit of another model to these rows.

    Returns:
        One of the two fits of the model; its scores are at most the reference's if that predicts better.
    """
    refitted = fit(fitted.task, rows, reference=reference)
    in_both = fitted.estimate.outliers & reference.estimate.outliers
    by_fitted = held_out_rms(linear_cross_validation(fitted, in_both))
    by_refitted = held_out_rms(linear_cross_validation(refitted, in_both))
    by_reference = held_out_rms(linear_cross_validation(reference, in_both))
    chosen = refitted if by_refitted < by_fitted else fitted
    estimate = chosen.estimate
    scores = estimate.scores
    if by_reference < by_fitted:
        # In units of the chosen fit's own limit.
        of_reference = reference.estimate.scores * estimate.flag_limit
        scores = np.minimum(scores, of_reference / reference.estimate.flag_limit)
    return replace(chosen, estimate=replace(estimate, scores=read_only(scores)))


def fit_with_all_families(fitted: Fitted, rows: Rows) -> Fitted:
    """Fit a geometry together with all families of non-geometric errors that the rows can determine.

    Args:
        fitted: Fit of the geometry, from whose registration the new one starts.
        rows: Rows to fit, with the loads on the joints.
    """
    task = fitted.task
    name = model_name(str(task.model), determinable_families(task, rows))
    return fit(replace(task, model=name, allow_absent=True), rows, registered=fitted.setup)
