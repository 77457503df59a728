"""Cross-validation: how well a fit predicts rows that it has not used.

Each fold of rows is held out in turn and predicted by a fit to the others. The nominal robot is treated alike: what
the fit estimates of frames and targets is registered for it, without the fold.
"""

from __future__ import annotations

from calib.basics.arrays import Mask
from calib.basics.jobs import Progress
from calib.fit.estimate.fitting import Fitted, fit
from calib.fit.estimate.task import Task
from calib.fit.registration.registration import ENOUGH, nominal_setup
from calib.fit.registration.rows import Rows
from calib.fit.selection.folds import Folds
from calib.fit.selection.held_out import held_out_residual, residual_after_registration
from calib.fit.selection.linear_folds import held_out_residuals_linear
from calib.numerics.errors import CrossValidation


def cross_validation(
    fitted: Fitted, outliers: Mask, progress: Progress | None = None
) -> CrossValidation:
    """Cross-validate the calibrated robot: hold out each fold in turn and predict it by a fit to the other rows.

    A fold is fitted on the problem linearised at the fit to all rows if that is accurate, else from the beginning.

    Args:
        fitted: Fit to all N rows.
        outliers: True for the rows to leave out of registrations and of the errors without outliers, shape (N,).
        progress: Called after each fold with the number of folds done and of all; None: nothing is called.

    Returns:
        Residuals of the N rows, measured minus predicted without their fold, shape (N, D), in the units of the rows'
        channels, and their errors.

    Raises:
        MeasurementError: All rows are of one pose, or the others are too few for a fit.
    """
    rows = fitted.estimate.problem.rows
    folds = Folds.of_task(fitted.task, rows)
    by_linear_problem = held_out_residuals_linear(fitted, folds.masks, outliers)
    residuals = []
    for k, mask in enumerate(folds.masks):
        residual = by_linear_problem.get(k)
        if residual is None:
            without_fold = fit(fitted.task, rows.select(~mask))
            residual = held_out_residual(without_fold, rows, mask, outliers)
        residuals.append(residual)
        if progress is not None:
            progress(k + 1, len(folds.masks))
    return folds.join(rows, residuals, outliers)


def nominal_cross_validation(task: Task, rows: Rows, outliers: Mask) -> CrossValidation:
    """Cross-validate the nominal robot: frames and targets that a fit estimates are registered without each fold.

    Args:
        task: The fit of the calibrated robot, which says what is estimated.
        rows: The N rows that were fitted.
        outliers: True for the rows that have no part in registrations and in the errors without outliers, shape (N,).

    Returns:
        Residuals of the N rows, measured minus predicted by the nominal robot, shape (N, D), in the units of the rows'
        channels, and their errors.

    Raises:
        MeasurementError: All rows are of one pose, or the others are too few for the registration.
    """
    folds = Folds.of_task(task, rows)
    setup = task.setup.with_estimated_not_given()
    T_base_tip = task.robot.poses(rows.joints)
    good = rows.evenly(ENOUGH) & rows.without(outliers)
    residuals = []
    for mask in folds.masks:
        used = ~mask & good
        registered = nominal_setup(T_base_tip[used], setup, rows.select(used))
        T_held_out = T_base_tip[mask]
        residual = residual_after_registration(T_held_out, registered, rows, mask, used, outliers)
        residuals.append(residual)
    return folds.join(rows, residuals, outliers)
