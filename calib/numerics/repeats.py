"""Repeats of a pose: the scatter within them, and how much of the residual they share.

A scalar of repeat i of pose k has the error

    e_ki = b_k + w_ki,        var b = s_b^2,        var w = s_w^2,        rho = s_b^2 / (s_b^2 + s_w^2)

where b is shared by all repeats of the pose and w is each one's own; rho is their intraclass correlation. Both
variances follow from the mean squares within and between poses (one-way analysis of
variance with unequal groups, by moments).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.numerics.errors import LENGTHS
from calib.robot.robot import read_only
from calib.units import Array, Integers, Mask
from calib.values.pickling import Value

#: Degrees of freedom below this are rounding: no pose was repeated.
_NO_FREEDOM = 1e-9

#: Where the fit leaves a smaller share of the scatter between poses, its parameters reproduce the means of all poses.
_MEANS_FITTED = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Repeats(Value):
    """Scatter within repeats, of lengths and of angles (G = 1 or 2 groups), and the correlation of repeats."""

    #: (G,), standard deviation of a component of a repeat, in the residual's unit; NaN without repeats
    within: Array
    #: (G,), its degrees of freedom; 0 without repeats
    freedoms: Array
    #: Intraclass correlation of all groups together, 0 to 1; 0 without repeats
    rho: float

    @property
    def freedom(self) -> float:
        """Degrees of freedom of all groups together."""
        return float(self.freedoms.sum())


class _Moments(NamedTuple):
    """Sums over the poses from which s_w^2 and s_b^2 are estimated, of one component or added up over several."""

    #: Weighted squares about the mean of each pose
    within: float
    #: Expectation of `within` where s_w^2 is 1
    within_noise: float
    #: Degrees of freedom of `within`
    within_freedom: float
    #: Weighted squares of the means about the grand mean
    between: float
    #: Share of s_w^2 in the expectation of `between`
    between_noise: float
    #: Share of s_b^2 in the expectation of `between`
    between_shared: float
    #: Number of poses with a measured scalar
    poses: float
    #: Number of these poses less one
    between_freedom: float

    def scatter(self) -> tuple[float, float]:
        """Standard deviation s_w, NaN without repeats, and its degrees of freedom, 0 without repeats."""
        if self.within_freedom >= _NO_FREEDOM and self.within_noise > 0.0:
            variance = self.within / self.within_noise
            return float(np.sqrt(variance)), float(self.within_freedom)
        return np.nan, 0.0

    def correlation(self, fitted: float) -> float:
        """Intraclass correlation rho, where a fit took its parameters from the means of poses.

        Args:
            fitted: Number of parameters of the fit. Beyond a mean for each component they make the means of poses
                smaller than the errors that these share.
        """
        noise = self.scatter()[0] ** 2
        kept = 0.0
        if self.between_freedom > 0.0:
            kept = min((self.poses - fitted) / self.between_freedom, 1.0)
        if not np.isfinite(noise) or kept < _MEANS_FITTED:
            return 0.0
        excess = self.between / kept - self.between_noise * noise
        shared = max(excess / self.between_shared, 0.0)
        return shared / (shared + noise) if shared > 0.0 else 0.0


def scatter_of_repeats(
    residual: Array,
    used: Mask,
    poses: Integers,
    weights: Array,
    *,
    fitted: float = 0.0,
) -> Repeats:
    """Estimate the scatter within repeats, which does not depend on the model, and the correlation of repeats.

    Args:
        residual: shape (N, D), measured minus predicted of each row; lengths [m] in the first three columns, angles
            [rad] behind.
        used: shape (N, D), which entries were measured.
        poses: shape (N,), rows of one number are repeats.
        weights: shape (N,), robust weights, 0 for outliers.
        fitted: Number of parameters that the fit took from all scalars.

    Returns:
        Scatter of lengths, and of angles where there are any, and the intraclass correlation rho.
    """
    _, pose = np.unique(poses, return_inverse=True)
    w = np.where(used, weights[:, None], 0.0)
    e = np.where(w > 0.0, residual, 0.0)
    groups = _groups(e.shape[1])
    within, freedoms = _scatter_of_groups(_moments(e, w, pose), groups)
    # rho is one number for lengths and angles: each group counts in units of its own rms.
    relative = e / _rms_of_groups(e, w, groups)
    together = _Moments(*_moments(relative, w, pose).sum(axis=1).tolist())
    return Repeats(within, freedoms, together.correlation(fitted))


def _groups(width: int) -> list[slice]:
    """The columns of lengths, and those of angles where a residual of ``width`` columns has any."""
    if width > LENGTHS:
        return [slice(0, LENGTHS), slice(LENGTHS, None)]
    return [slice(0, LENGTHS)]


def _scatter_of_groups(moments: Array, groups: list[slice]) -> tuple[Array, Array]:
    """Estimate the scatter within repeats for each group of columns.

    Args:
        moments: shape (8, D), the fields of `_Moments` for each column of the residual.
        groups: G groups of columns.

    Returns:
        The standard deviation of a component, NaN without repeats, and its degrees of freedom, both of shape (G,).
    """
    scatter = []
    for group in groups:
        of_group = _Moments(*moments[:, group].sum(axis=1).tolist())
        scatter.append(of_group.scatter())
    std, freedoms = np.array(scatter).T
    return read_only(std), read_only(freedoms)


def _rms_of_groups(e: Array, w: Array, groups: list[slice]) -> Array:
    """Weighted rms residual of its group for each column, shape (D,); 1 where all are zero.

    Args:
        e: shape (N, D), residuals, 0 where nothing was measured.
        w: shape (N, D), weights; 0 where nothing was measured.
        groups: Groups of columns, which cover all of them.
    """
    rms = np.ones(e.shape[1])
    for group in groups:
        square = float(np.sum(w[:, group] * e[:, group] ** 2))
        if square > 0.0:
            rms[group] = np.sqrt(square / float(np.sum(w[:, group])))
    return rms


def pose_means(values: Array, weights: Array, poses: Integers) -> tuple[Array, Integers]:
    """Average repeats so that each mean has the variance of one row: sum w v / sqrt(sum w).

    Args:
        values: shape (N, ...), whitened.
        weights: shape (N,), > 0, those that `calib.estimate.stages.Stage.sharing` gives to repeats.
        poses: shape (N,), rows of one number are repeats.

    Returns:
        The means of K poses, shape (K, ...), independent of each other, and the first row of each pose, (K,).
    """
    _, first, pose = np.unique(poses, return_index=True, return_inverse=True)
    scale = weights / np.sqrt(np.bincount(pose, weights))[pose]
    flat = values.reshape(len(values), -1) * scale[:, None]
    sums = _sum_by_pose(pose, flat)
    return sums.reshape(len(first), *values.shape[1:]), first


def _moments(e: Array, w: Array, pose: Integers) -> Array:
    """The fields of `_Moments` for each component, shape (8, D).

    Args:
        e: shape (N, D), residuals, 0 where w is.
        w: shape (N, D), weights; 0 where nothing was measured.
        pose: shape (N,), the pose of each row, from 0.
    """
    sum_w = _sum_by_pose(pose, w)
    sum_w2 = _sum_by_pose(pose, w**2)
    measured = sum_w > 0.0
    divisor = np.where(measured, sum_w, 1.0)
    mean = _sum_by_pose(pose, w * e) / divisor
    total = np.maximum(sum_w.sum(axis=0), np.finfo(float).tiny)
    grand_mean = np.sum(sum_w * mean, axis=0) / total
    count = np.sum(measured, axis=0)
    freedom = sum_w**2 / np.where(measured, sum_w2, 1.0) - 1.0
    # With all weights 1: sum_w = sum_w2 = n, and the textbook's n - 1, k - 1 and (k - 1) n0 appear.
    return np.array(
        [
            np.sum(w * (e - mean[pose]) ** 2, axis=0),
            np.sum(sum_w - sum_w2 / divisor, axis=0),
            np.sum(np.where(measured, freedom, 0.0), axis=0),
            np.sum(sum_w * (mean - grand_mean) ** 2, axis=0),
            np.sum(sum_w2 / divisor, axis=0) - sum_w2.sum(axis=0) / total,
            sum_w.sum(axis=0) - np.sum(sum_w**2, axis=0) / total,
            count,
            np.maximum(count - 1.0, 0.0),
        ]
    )


def _sum_by_pose(pose: Integers, values: Array) -> Array:
    """Sums of rows (N, D) over each of K poses, shape (K, D)."""
    return np.stack([np.bincount(pose, column) for column in values.T], axis=1)
