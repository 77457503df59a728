"""Repeats of a pose: the scatter within them, and how much of the residual they share.

A scalar of repeat i of pose k has the error

    e_ki = b_k + w_ki,        var b = s_b^2,        var w = s_w^2,        rho = s_b^2 / (s_b^2 + s_w^2)

where b is shared by all repeats of the pose and w is each one's own; rho is their intraclass correlation. Both
variances follow from the mean squares within and between poses (one-way analysis of variance with unequal groups, by
moments).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calib.basics.arrays import Array, Integers
from calib.basics.channels import Channels
from calib.basics.values import Value, keep_read_only

#: Degrees of freedom below this are rounding: no pose was repeated.
_NO_FREEDOM = 1e-9

#: A fit that leaves a smaller share of the scatter between poses reproduces the means of all poses.
_MEANS_FITTED = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Repeats(Value):
    """Scatter within repeats in each unit that was measured, and the correlation of repeats."""

    #: Standard deviation of a scalar of a repeat by its unit, in that unit; NaN without repeats
    within: Mapping[str, float]
    #: Its degrees of freedom by the same units; 0 without repeats
    freedoms: Mapping[str, float]
    #: Intraclass correlation in all units together, 0 to 1; 0 without repeats
    rho: float

    def __post_init__(self) -> None:
        """Keep copies that cannot be changed."""
        keep_read_only(self, "within", "freedoms")

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the scatter within repeats, in all units together."""
        return float(sum(self.freedoms.values()))


class _Moments(NamedTuple):
    """Sums over the poses, added up over components, from which s_w^2 and s_b^2 are estimated."""

    #: Weighted squares about the mean of each pose
    within: float
    #: Expectation of `within` if s_w^2 is 1
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

    @classmethod
    def of(cls, e: Array, w: Array, pose: Integers) -> _Moments:
        """Sum over poses the residuals e (N, D) with weights w (N, D), 0 where nothing counts; ``pose`` (N,) from 0."""
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
        by_component = np.array(
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
        return cls(*by_component.sum(axis=1).tolist())

    def scatter(self) -> tuple[float, float]:
        """Return the standard deviation s_w and its degrees of freedom; NaN and 0 without repeats."""
        if self.within_freedom >= _NO_FREEDOM and self.within_noise > 0.0:
            variance = self.within / self.within_noise
            return float(np.sqrt(variance)), float(self.within_freedom)
        return np.nan, 0.0

    def correlation(self, fitted: float) -> float:
        """Return the intraclass correlation rho, 0 to 1, after a fit took ``fitted`` parameters from means of poses.

        Beyond a mean for each component they make these means smaller than the errors that repeats share.
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
    channels: Channels,
    poses: Integers,
    weights: Array,
    *,
    fitted: float = 0.0,
) -> Repeats:
    """Estimate the scatter within repeats, which does not depend on the model, and the correlation of repeats.

    Args:
        residual: shape (N, D), measured minus predicted of each row, in the units of its channels.
        channels: Unit of each entry of the residual, and which were measured.
        poses: shape (N,), rows with the same number are repeats.
        weights: shape (N,), robust weights, 0 for outliers.
        fitted: Number of parameters that the fit took from all scalars.

    Returns:
        Scatter in each unit that was measured, and the intraclass correlation rho.
    """
    _, pose = np.unique(poses, return_inverse=True)
    w = np.where(channels.used, weights[:, None], 0.0)
    e = np.where(w > 0.0, residual, 0.0)
    within, freedoms = {}, {}
    # rho is one number for all units: residuals are divided by the weighted rms of their unit.
    relative = np.zeros_like(e)
    for unit in channels.present:
        of_unit = channels.where(unit)
        e_unit = np.where(of_unit, e, 0.0)
        w_unit = np.where(of_unit, w, 0.0)
        within[unit], freedoms[unit] = _Moments.of(e_unit, w_unit, pose).scatter()
        square = float(np.sum(w_unit * e**2))
        weighted_rms = np.sqrt(square / float(np.sum(w_unit))) if square > 0.0 else 1.0
        relative += e_unit / weighted_rms
    together = _Moments.of(relative, w, pose)
    return Repeats(within, freedoms, together.correlation(fitted))


def pose_means(values: Array, weights: Array, poses: Integers) -> tuple[Array, Integers]:
    """Average repeats so that each mean has the variance of one row: sum w v / sqrt(sum w).

    Args:
        values: shape (N, ...), whitened.
        weights: shape (N,), > 0, those that `calib.fit.estimate.stages.Stage.by_repeats` gives to repeats.
        poses: shape (N,), rows with the same number are repeats.

    Returns:
        The means of K poses, shape (K, ...), independent of each other, and the first row of each pose, (K,).
    """
    _, first, pose = np.unique(poses, return_index=True, return_inverse=True)
    scale = weights / np.sqrt(np.bincount(pose, weights))[pose]
    flat = values.reshape(len(values), -1) * scale[:, None]
    sums = _sum_by_pose(pose, flat)
    return sums.reshape(len(first), *values.shape[1:]), first


def _sum_by_pose(pose: Integers, values: Array) -> Array:
    """Return the sums of ``values`` (N, D) over each of K poses, (K, D); ``pose`` (N,) is 0 to K - 1."""
    return np.stack([np.bincount(pose, column) for column in values.T], axis=1)
