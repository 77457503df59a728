"""Errors of rows, and what repeats of a pose tell: arrays in, values out.

What a model leaves over at a pose is the same in each repeat, the instrument's noise is not:

    e = b + w,  var b = s_b^2 (shared by a pose),  var w = s_w^2,  rho = s_b^2 / (s_b^2 + s_w^2)

Both are found by moments from the mean squares within and between poses (one-way analysis of variance, repeats of
unequal number). A mean of n repeats has the variance s^2 (1 + (n - 1) rho) / n, which weights of 1 / (1 + (n - 1) rho)
for each of them give it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from calib.robot.robot import read_only

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Integers = NDArray[np.int_]


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
    max_angle: float = (
        np.nan
    )  # Largest angle between measured and predicted orientation [rad]; NaN where n_angle = 0
    mean_angle: float = np.nan  # Mean of these angles [rad]
    rms_angle: float = np.nan  # Their root mean square [rad]

    @classmethod
    def of(cls, residual: Array, used: Mask | None = None) -> Errors:
        """From residuals, measured minus predicted, shape (N, D); used, of this shape: which scalars were measured.

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

    method: str  # ``"leave-one-out"``, ``"leave-one-pose-out"``, ``"leave-one-set-up-out"``, ``"10-fold"``, ...
    folds: int  # Number of fits
    poses: Integers  # (N,), the pose of each row, see `calib.estimate.rows.same_poses`
    residual: (
        Array  # (N, D), measured minus predicted by the fit that had not seen the row [m], [rad]
    )
    errors: Errors  # Of all rows
    errors_without_outliers: Errors  # Of the rows that the fit to all rows did not flag


def interval_factor(freedom: float, level: float = 0.95) -> float:
    """How many standard deviations the two-sided interval of a probability reaches: Student's t.

    Example:
        >>> round(interval_factor(1e6), 3)
        1.96
    """
    return float(stdtrit(max(freedom, 1.0), 0.5 + level / 2.0))


@dataclass(frozen=True, slots=True, eq=False)
class Repeats:
    """Scatter within repeats and how much of the residual they share; of G groups: position and orientation."""

    within: Array  # (G,), standard deviation of a component of a repeat, in the residual's unit; NaN without repeats
    freedoms: Array  # (G,), its degrees of freedom; 0 without repeats
    freedom: float  # Their sum
    rho: float  # Intraclass correlation of all groups together, 0 to 1; 0 without repeats


def repeats(
    residual: Array, used: Mask, poses: Integers, weights: Array, *, fitted: float = 0.0
) -> Repeats:
    """Scatter within repeats, which holds whatever the model lacks, and their correlation, by the method of moments.

    residual, shape (N, D), is measured minus predicted, lengths in columns 0 to 2 and angles behind; used, of its
    shape, says which there are. poses, shape (N,), is what is repeated as a whole, weights are robust ones, 0 for
    outliers. fitted is the number of parameters that the fit took from all scalars: they make the means of poses
    smaller than their errors, and without them rho is found too small.
    """
    _, pose = np.unique(poses, return_inverse=True)
    w = np.where(used, weights[:, None], 0.0)
    e = np.where(w > 0.0, residual, 0.0)
    moments, size, each = _moments(e, w, pose), np.ones(e.shape[1]), []
    for own in (slice(0, 3), slice(3, None))[: 1 + (e.shape[1] > 3)]:
        each.append(_within(moments[:, own].sum(axis=1)))
        # rho is one number for lengths and angles: each group counts in units of its own size.
        square = float(np.sum(w[:, own] * e[:, own] ** 2))
        size[own] = np.sqrt(square / float(np.sum(w[:, own]))) if square > 0.0 else 1.0
    within, freedoms = (read_only(column) for column in np.array(each).T)
    m = _moments(e / size, w, pose).sum(axis=1)
    noise = _within(m)[0] ** 2
    *_, between, of_noise, of_poses, cells, left = m.tolist()
    # A mean for each component is gone in any case; further parameters shrink what is left of the means.
    kept = min((cells - fitted) / left, 1.0) if left > 0.0 else 0.0
    shared = 0.0
    if (
        np.isfinite(noise) and kept >= 1e-6
    ):  # else the parameters fit the means: what remains is rounding
        shared = max((between / kept - of_noise * noise) / of_poses, 0.0)
    rho = shared / (shared + noise) if shared > 0.0 else 0.0
    return Repeats(within, freedoms, float(freedoms.sum()), rho)


def pose_means(values: Array, weights: Array, poses: Integers) -> tuple[Array, Integers]:
    """Means over the repeats of each pose, as large as one row of the same noise: sum w v / sqrt(sum w).

    With the weights that `calib.estimate.stages.Stage.sharing` gives to repeats they have the variance of one row, and
    are independent of each other, however much the repeats share. values, shape (N, ...), are whitened; weights, shape
    (N,), above 0, repeats shared out.

    Returns:
        shape (K, ...), and shape (K,), the first row of each pose.
    """
    _, first, pose = np.unique(poses, return_index=True, return_inverse=True)
    scale = weights / np.sqrt(np.bincount(pose, weights))[pose]
    sums = _by_pose(pose, values.reshape(len(values), -1) * scale[:, None])
    return sums.reshape(len(first), *values.shape[1:]), first


def _moments(e: Array, w: Array, pose: Integers) -> Array:
    """Sums over poses for each component of residuals and weights of shape (N, D), shape (8, D).

    The weighted squares within poses, their expectation over s_w^2, their degrees of freedom; the weighted squares of
    means about the grand mean, their expectations over s_w^2 and over s_b^2; the number of poses, and that less one.
    """
    W, S, mean = _by_pose(pose, w), _by_pose(pose, w**2), _by_pose(pose, w * e)
    there = W > 0.0
    safe = np.where(there, W, 1.0)
    mean = mean / safe
    total = np.maximum(W.sum(axis=0), np.finfo(float).tiny)
    grand = np.sum(W * mean, axis=0) / total
    cells = np.sum(there, axis=0)
    # With all weights 1: W = S = n, and the textbook's n - 1, k - 1 and (k - 1) n0 appear.
    return np.array(
        [
            np.sum(w * (e - mean[pose]) ** 2, axis=0),
            np.sum(W - S / safe, axis=0),
            np.sum(np.where(there, W**2 / np.where(there, S, 1.0) - 1.0, 0.0), axis=0),
            np.sum(W * (mean - grand) ** 2, axis=0),
            np.sum(S / safe, axis=0) - S.sum(axis=0) / total,
            W.sum(axis=0) - np.sum(W**2, axis=0) / total,
            cells,
            np.maximum(cells - 1.0, 0.0),
        ]
    )


def _within(m: Array) -> tuple[float, float]:
    """Standard deviation within repeats and its degrees of freedom, from sums of moments of components of one size."""
    square, noise, freedom = m[:3]
    known = freedom >= 1e-9 and noise > 0.0  # less is rounding
    return (float(np.sqrt(square / noise)), float(freedom)) if known else (np.nan, 0.0)


def _by_pose(pose: Integers, values: Array) -> Array:
    """Sums of rows (N, D) over each pose, shape (K, D)."""
    return np.stack([np.bincount(pose, column) for column in values.T], axis=1)
