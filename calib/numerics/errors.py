"""Errors of a set of rows: the figures that are reported."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.robot.robot import read_only
from calib.units import Array, Integers, Mask


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Errors of a set of rows, as in the paper's Tables 4 and 5: of lengths, and of angles where there are any."""

    n: int  # Number of rows with a measured length
    max: float  # Largest error, the norm of measured minus predicted [m]; NaN where n = 0, as all that follows
    mean: float  # Mean of the norms [m]
    rms: float  # Root mean square of the norms [m]
    mean_axis: Array  # (3,), mean signed error along x, y, z [m]; NaN where not all rows have three coordinates
    rms_axis: Array  # (3,), likewise
    span_axis: Array  # (3,), largest minus smallest signed error along x, y, z, likewise
    n_angle: int = 0  # Number of rows with a measured orientation
    max_angle: float = np.nan  # Largest angle between measured and predicted [rad]; NaN without any
    mean_angle: float = np.nan  # Mean of these angles [rad]
    rms_angle: float = np.nan  # Their root mean square [rad]

    @classmethod
    def of(cls, residual: Array, used: Mask | None = None) -> Errors:
        """From residuals, measured minus predicted, (N, D); used, (N, D), says which scalars were measured.

        Example:
            >>> errors = Errors.of(np.array([[3e-3, 4e-3, 0.0], [0.0, 0.0, 0.0]]))
            >>> round(errors.mean, 6), round(errors.rms, 6)
            (0.0025, 0.003536)
        """
        used = np.ones(residual.shape, dtype=bool) if used is None else used
        there, turned = np.any(used[:, :3], axis=1), np.any(used[:, 3:], axis=1)
        lengths, axes = residual[there, :3], [np.full(3, np.nan)] * 3
        if residual.shape[1] >= 3 and np.any(there) and np.all(used[there, :3]):
            mean, rms = lengths.mean(axis=0), np.sqrt(np.mean(lengths**2, axis=0))
            axes = [mean, rms, np.ptp(lengths, axis=0)]
        figures = {"mean_axis": axes[0], "rms_axis": axes[1], "span_axis": axes[2]}
        found: dict[str, Any] = {name: read_only(values) for name, values in figures.items()}
        for of, rows in (("", lengths), ("_angle", residual[turned, 3:])):
            norms = np.linalg.norm(rows, axis=1)
            some = norms if len(norms) else np.array([np.nan])
            rms = np.sqrt(np.mean(some**2))
            values = zip(("max", "mean", "rms"), (some.max(), some.mean(), rms), strict=True)
            found |= {f"n{of}": len(norms)} | {name + of: float(one) for name, one in values}
        return cls(**found)


@dataclass(frozen=True, slots=True, eq=False)
class CrossValidation:
    """Errors on rows that the fit did not see."""

    method: str  # ``"leave-one-out"``, ``"leave-one-pose-out"``, ``"leave-one-station-out"``, ``"10-fold"``, ...
    folds: int  # Number of fits
    poses: Integers  # (N,), from 0: rows of one number are of one pose or of one pair, and held out together
    residual: Array  # (N, D), measured minus predicted by the fit without the row [m], [rad]
    errors: Errors  # Of all rows
    errors_without_outliers: Errors  # Of the rows that the fit to all rows did not flag
