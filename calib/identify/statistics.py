"""What a fit is worth: errors, cross-validation, intervals. Arrays in, values out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from calib.model.robot import read_only

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Up to this number of rows each row is left out in turn; above it, a tenth of the rows at a time.
_LEAVE_ONE_OUT = 60
_FOLDS = 10


@dataclass(frozen=True, slots=True)
class Errors:
    """Position errors of a set of rows, as in the paper's Tables 4 and 5.

    Attributes:
        n: Number of rows.
        max: Largest error, the norm of measured minus predicted [m]; NaN where n = 0, as all that follows.
        mean: Mean of the norms [m].
        rms: Root mean square of the norms [m].
        mean_axis: shape (3,), mean signed error along x, y, z [m].
        rms_axis: shape (3,), [m].
        span_axis: shape (3,), largest minus smallest signed error along x, y, z [m].
    """

    n: int
    max: float
    mean: float
    rms: float
    mean_axis: Array
    rms_axis: Array
    span_axis: Array

    @classmethod
    def of(cls, residual: Array) -> Errors:
        """From residuals, measured minus predicted, shape (N, 3), [m].

        Example:
            >>> errors = Errors.of(np.array([[3e-3, 4e-3, 0.0], [0.0, 0.0, 0.0]]))
            >>> round(errors.mean, 6), round(errors.rms, 6)
            (0.0025, 0.003536)
        """
        if len(residual) == 0:
            nothing = read_only(np.full(3, np.nan))
            return cls(0, np.nan, np.nan, np.nan, nothing, nothing, nothing)
        norms = np.linalg.norm(residual, axis=1)
        return cls(
            n=len(norms),
            max=float(norms.max()),
            mean=float(norms.mean()),
            rms=float(np.sqrt(np.mean(norms**2))),
            mean_axis=read_only(residual.mean(axis=0)),
            rms_axis=read_only(np.sqrt(np.mean(residual**2, axis=0))),
            span_axis=read_only(np.ptp(residual, axis=0)),
        )


@dataclass(frozen=True, slots=True)
class CrossValidation:
    """Errors on rows that the fit did not see.

    Attributes:
        method: ``"leave-one-out"`` or ``"10-fold"``.
        folds: Number of fits.
        residual: shape (N, 3), measured minus predicted by the fit that had not seen the row [m].
        errors: Of all rows.
        errors_without_outliers: Of the rows that the fit to all rows did not flag.
    """

    method: str
    folds: int
    residual: Array
    errors: Errors
    errors_without_outliers: Errors


def folds(rows: int) -> tuple[str, tuple[Mask, ...]]:
    """Which rows are left out together: one each, or every tenth where there are many.

    Args:
        rows: Number of rows.

    Returns:
        The method's name and the masks of the rows left out, each of shape (rows,).
    """
    index = np.arange(rows)
    if rows <= _LEAVE_ONE_OUT:
        return "leave-one-out", tuple(index == i for i in range(rows))
    return f"{_FOLDS}-fold", tuple(index % _FOLDS == k for k in range(_FOLDS))


def cross_validate(
    rows: int, outliers: Mask, predict_left_out: Callable[[Mask], Array]
) -> CrossValidation:
    """Fit without some rows, look at the error there, and go on until each row was left out once.

    Args:
        rows: Number of rows.
        outliers: shape (rows,), the rows flagged by the fit to all of them.
        predict_left_out: Takes the mask of the rows left out, fits the others from the beginning, and gives measured
            minus predicted of the rows left out, shape (sum of the mask, 3), [m].
    """
    method, left_out = folds(rows)
    residual = np.empty((rows, 3))
    for mask in left_out:
        residual[mask] = predict_left_out(mask)
    return CrossValidation(
        method=method,
        folds=len(left_out),
        residual=read_only(residual),
        errors=Errors.of(residual),
        errors_without_outliers=Errors.of(residual[~outliers]),
    )


def interval_factor(freedom: float, level: float = 0.95) -> float:
    """How many standard deviations the two-sided interval reaches: Student's t.

    Args:
        freedom: Degrees of freedom of the noise's estimate.
        level: Probability that the interval holds the true value.

    Example:
        >>> round(interval_factor(1e6), 3)
        1.96
    """
    return float(stdtrit(max(freedom, 1.0), 0.5 + level / 2.0))
