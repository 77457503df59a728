"""What a fit is worth: errors, cross-validation, intervals. Arrays in, values out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import stdtrit

from calib.model.robot import read_only

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Rows whose joint values differ by less than this are repeats of a pose [rad or m].
_SAME_POSE = 1e-3

#: Up to this number of poses each is left out in turn; above it, a tenth of them at a time.
_LEAVE_ONE_OUT = 60
_FOLDS = 10


@dataclass(frozen=True, slots=True, eq=False)
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


@dataclass(frozen=True, slots=True, eq=False)
class CrossValidation:
    """Errors on rows that the fit did not see.

    Attributes:
        method: ``"leave-one-out"``, ``"leave-one-pose-out"`` where poses were repeated, or ``"10-fold"``.
        folds: Number of fits.
        poses: shape (N,), the pose of each row, see `same_poses`.
        residual: shape (N, 3), measured minus predicted by the fit that had not seen the row [m].
        errors: Of all rows.
        errors_without_outliers: Of the rows that the fit to all rows did not flag.
    """

    method: str
    folds: int
    poses: NDArray[np.int_]
    residual: Array
    errors: Errors
    errors_without_outliers: Errors


def same_poses(joints: Array) -> NDArray[np.int_]:
    """Which pose each row was measured at: repeats of a pose get the same number, from 0 on.

    Args:
        joints: shape (N, n), [rad] or [m]; rows within `_SAME_POSE` of another in every joint are repeats of it.

    Returns:
        shape (N,).
    """
    labels = np.full(len(joints), -1)
    count = 0
    near = cKDTree(joints).query_ball_point(joints, _SAME_POSE, p=np.inf)
    for i, neighbours in enumerate(near):
        if labels[i] < 0:
            repeats = np.array(neighbours)
            labels[repeats[labels[repeats] < 0]] = count
            count += 1
    return labels


def folds(poses: NDArray[np.int_]) -> tuple[str, tuple[Mask, ...]]:
    """Which rows are left out together: all of one pose, or of every tenth pose where there are many.

    Args:
        poses: shape (N,), see `same_poses`.

    Returns:
        The method's name and the masks of the rows left out, each of shape (N,).
    """
    count = int(poses.max()) + 1 if len(poses) else 0
    if count <= _LEAVE_ONE_OUT:
        method = "leave-one-out" if count == len(poses) else "leave-one-pose-out"
        return method, tuple(poses == i for i in range(count))
    return f"{_FOLDS}-fold", tuple(poses % _FOLDS == k for k in range(_FOLDS))


def cross_validate(
    poses: NDArray[np.int_], outliers: Mask, predict_left_out: Callable[[Mask], Array]
) -> CrossValidation:
    """Fit without some rows, look at the error there, and go on until each row was left out once.

    Args:
        poses: shape (N,), the pose of each row; repeats are left out together.
        outliers: shape (N,), the rows flagged by the fit to all of them.
        predict_left_out: Takes the mask of the rows left out, fits the others from the beginning, and gives measured
            minus predicted of the rows left out, shape (sum of the mask, 3), [m].
    """
    method, left_out = folds(poses)
    residual = np.empty((len(poses), 3))
    for mask in left_out:
        residual[mask] = predict_left_out(mask)
    return CrossValidation(
        method=method,
        folds=len(left_out),
        poses=poses,
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
