"""Error figures of a set of rows, as in the paper's Tables 4 and 5, and those of cross-validation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.robot.robot import read_only
from calib.units import Array, Integers, Mask

#: Columns of a residual that hold lengths; those of angles follow.
LENGTHS = 3


def rms(values: Array) -> float:
    """Root mean square over all entries, in their unit."""
    return float(np.sqrt(np.mean(values**2)))


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Error figures of a set of rows: of lengths, and of angles where there are any."""

    #: Number of rows with a measured length
    n: int
    #: Largest error, the norm of a row's residual [m]; NaN where n = 0, as all that follow
    max: float
    #: Mean of the norms [m]
    mean: float
    #: Root mean square of the norms [m]
    rms: float
    #: (3,), mean residual along x, y, z [m]; NaN unless all rows have three coordinates
    mean_axis: Array
    #: (3,), root mean square of the residual along x, y, z [m]; NaN likewise
    rms_axis: Array
    #: (3,), largest minus smallest residual along x, y, z [m]; NaN likewise
    span_axis: Array
    #: Number of rows with a measured orientation
    n_angle: int = 0
    #: Largest angle between measured and predicted [rad]; NaN without any
    max_angle: float = np.nan
    #: Mean of these angles [rad]
    mean_angle: float = np.nan
    #: Their root mean square [rad]
    rms_angle: float = np.nan

    @classmethod
    def of(cls, residual: Array, used: Mask | None = None) -> Errors:
        """Summarise the residuals of N rows.

        Args:
            residual: shape (N, D), measured minus predicted: lengths [m] in the first three
                columns, rotation vectors [rad] in those behind; 0 where nothing was measured.
            used: shape (N, D), which entries were measured; None for all.

        Returns:
            Figures over rows with a measured length, and over those with a measured angle.

        Example:
            >>> errors = Errors.of(np.array([[3e-3, 4e-3, 0.0], [0.0, 0.0, 0.0]]))
            >>> round(errors.mean, 6), round(errors.rms, 6)
            (0.0025, 0.003536)
        """
        if used is None:
            used = np.ones(residual.shape, dtype=bool)
        has_length = np.any(used[:, :LENGTHS], axis=1)
        has_angle = np.any(used[:, LENGTHS:], axis=1)
        lengths = residual[has_length, :LENGTHS]
        angles = residual[has_angle, LENGTHS:]
        # A mean along an axis needs that axis in every row.
        three = residual.shape[1] >= LENGTHS and np.any(has_length)
        if not (three and np.all(used[has_length, :LENGTHS])):
            by_axis = np.full((LENGTHS, 3), np.nan)
        else:
            by_axis = _figures_by_axis(lengths)
        largest, mean, root_mean_square = _figures_of_norms(lengths)
        largest_angle, mean_angle, rms_angle = _figures_of_norms(angles)
        return cls(
            n=len(lengths),
            max=largest,
            mean=mean,
            rms=root_mean_square,
            mean_axis=read_only(by_axis[0]),
            rms_axis=read_only(by_axis[1]),
            span_axis=read_only(by_axis[2]),
            n_angle=len(angles),
            max_angle=largest_angle,
            mean_angle=mean_angle,
            rms_angle=rms_angle,
        )


def _figures_by_axis(lengths: Array) -> Array:
    """Mean, root mean square and span of vectors (n, 3) along each axis, shape (3, 3)."""
    mean = lengths.mean(axis=0)
    root_mean_square = np.sqrt(np.mean(lengths**2, axis=0))
    return np.array([mean, root_mean_square, np.ptp(lengths, axis=0)])


def _figures_of_norms(vectors: Array) -> tuple[float, float, float]:
    """Largest norm of vectors (n, d), mean and root mean square of the norms; NaN where n = 0."""
    norms = np.linalg.norm(vectors, axis=1)
    if not len(norms):
        return np.nan, np.nan, np.nan
    return float(norms.max()), float(norms.mean()), rms(norms)


@dataclass(frozen=True, slots=True, eq=False)
class CrossValidation:
    """Errors on held-out rows: each row is predicted by a fit without it."""

    #: ``"leave-one-out"``, ``"leave-one-pose-out"``, ``"leave-one-station-out"``, ``"10-fold"``, ...
    method: str
    #: Number of fits
    folds: int
    #: (N,), from 0: rows of one number are of one pose or one pair, and held out together
    poses: Integers
    #: (N, D), measured minus predicted by the fit without the row [m], [rad]
    residual: Array
    #: Of all rows
    errors: Errors
    #: Of the rows that the fit to all rows did not flag
    errors_without_outliers: Errors
