"""Reference fits: fits whose weights and scores decide which rows are outliers for another fit.

If a model lacks something, its residuals at some good rows may be far larger than at others, and robust weights would
drop these rows. A larger model explains them. Which of two fits has the better weights is decided by errors on held-out
rows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.basics.arrays import Mask, read_only
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.registration.rows import Rows
from calib.fit.selection.candidates import held_out_rms
from calib.fit.selection.ladder import determinable_families, model_name
from calib.fit.selection.linear_folds import linear_cross_validation


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
    """Return the rms error of a fit on held-out rows of its linearised problem, with some rows, (N,), set aside."""
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
    refitted = fit(fitted.task, rows, reference=reference)
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
    """Fit a geometry together with all families of non-geometric errors that the rows can determine.

    Args:
        fitted: Fit of the geometry, from whose registration the new one starts.
        rows: Rows to fit, with the loads on the joints.

    Returns:
        The fit, with its own weights, of the model such as ``"dh+compliance+gain"``.
    """
    families = determinable_families(fitted.task, rows)
    model = model_name(str(fitted.task.model), families)
    task = replace(fitted.task, model=model, allow_absent=True)
    return fit(task, rows, registered=fitted.setup)
