"""Repeats of a pose: their scatter, and how much of the residual they share.

What a model leaves over at a pose is the same in each repeat, the instrument's noise is not:

    e = b + w,  var b = s_b^2 (shared by a pose),  var w = s_w^2,  rho = s_b^2 / (s_b^2 + s_w^2)

Both are found by moments from the mean squares within and between poses (one-way analysis of variance, repeats of
unequal number). A mean of n repeats has the variance s^2 (1 + (n - 1) rho) / n, which weights of 1 / (1 + (n - 1) rho)
for each of them give it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.model.robot import read_only

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Integers = NDArray[np.int_]

#: Of the poses' means so little is left over where the parameters fit them all: what remains is rounding.
_NOTHING_KEPT = 1e-6

#: Degrees of freedom below this are rounding.
_SOME_FREEDOM = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Repeats:
    """Scatter within repeats, and how much of the residual they share.

    Attributes:
        within: shape (G,), standard deviation of a component of a repeat, for each group of components (position,
            orientation), in the residual's unit; NaN without repeats.
        freedoms: shape (G,), its degrees of freedom; 0 without repeats.
        freedom: Their sum.
        rho: Intraclass correlation of all groups together, 0 to 1; 0 without repeats.
    """

    within: Array
    freedoms: Array
    freedom: float
    rho: float


def repeats(
    residual: Array,
    used: Mask,
    poses: Integers,
    weights: Array,
    *,
    groups: Integers | None = None,
    fitted: float = 0.0,
) -> Repeats:
    """Scatter within repeats and their correlation, by the method of moments.

    Args:
        residual: shape (N, D), measured minus predicted, in one unit for each group of components; what is not used
            may be NaN.
        used: shape (N, D), which scalars there are.
        poses: shape (N,), the pose of each row (and its target, set-up: whatever is repeated as a whole).
        weights: shape (N,), robust weights: 0 for outliers, 1 for good rows.
        groups: shape (D,), the group of each component, from 0 on; None: components 0 to 2 are one, 3 to 5 the next.
        fitted: Number of parameters that the fit took from all the scalars. They make the means of poses smaller than
            their errors; without them rho is found too small.

    Returns:
        The scatter about the mean of each pose, which holds whatever the model lacks, and rho.
    """
    groups = np.arange(residual.shape[1]) // 3 if groups is None else groups
    _, pose = np.unique(poses, return_inverse=True)
    w = np.where(used, weights[:, None], 0.0)
    e = np.where(w > 0.0, residual, 0.0)
    # rho is one number for lengths and angles: each group counts in units of its own size.
    e_even = e / _sizes(e, w, groups)[groups]
    moments = _Moments.of(e, w, pose)
    each = [_within(moments.select(groups == g)) for g in range(_count(groups))]
    within, freedoms = (read_only(column) for column in np.reshape(each, (-1, 2)).T)
    rho = _correlation(_Moments.of(e_even, w, pose), fitted)
    return Repeats(within, freedoms, float(freedoms.sum()), rho)


def pose_means(values: Array, weights: Array, poses: Integers) -> tuple[Array, Integers]:
    """Means over the repeats of each pose, as large as one row of the same noise: sum w v / sqrt(sum w).

    With the weights that `calib.identify.stage.Stage.sharing` gives to repeats they have the variance of one row, and
    are independent of each other, however much the repeats share.

    Args:
        values: shape (N, ...), whitened.
        weights: shape (N,), above 0, repeats shared out.
        poses: shape (N,), the pose of each row.

    Returns:
        shape (K, ...), and shape (K,), the first row of each pose.
    """
    _, first, pose = np.unique(poses, return_index=True, return_inverse=True)
    scale = weights / np.sqrt(np.bincount(pose, weights))[pose]
    sums = _by_pose(pose, values.reshape(len(values), -1) * scale[:, None])
    return sums.reshape(len(first), *values.shape[1:]), first


def _count(groups: Integers) -> int:
    """The number of groups."""
    return int(groups.max(initial=-1)) + 1


def _sizes(e: Array, w: Array, groups: Integers) -> Array:
    """Root mean square residual of each group, shape (G,); 1 where it is nothing."""
    result = np.ones(_count(groups))
    for g in range(len(result)):
        chosen = groups == g
        square = float(np.sum(w[:, chosen] * e[:, chosen] ** 2))
        if square > 0.0:
            result[g] = np.sqrt(square / float(np.sum(w[:, chosen])))
    return result


@dataclass(frozen=True, slots=True, eq=False)
class _Moments:
    """Sums over poses for each component, all of shape (D,); expectations in terms of s_w^2 and s_b^2.

    Attributes:
        within: Weighted squares within poses; expected: within_noise s_w^2.
        within_noise: See there.
        freedom: Degrees of freedom within.
        between: Weighted squares of means about the grand mean; expected: between_noise s_w^2 + between_pose s_b^2.
        between_noise: See there.
        between_pose: See there.
        cells: Number of poses.
    """

    within: Array
    within_noise: Array
    freedom: Array
    between: Array
    between_noise: Array
    between_pose: Array
    cells: Array

    @classmethod
    def of(cls, e: Array, w: Array, pose: Integers) -> _Moments:
        """From residuals and weights, shape (N, D)."""
        W, S, mean = _by_pose(pose, w), _by_pose(pose, w**2), _by_pose(pose, w * e)
        there = W > 0.0
        safe = np.where(there, W, 1.0)
        mean = mean / safe
        total = np.maximum(W.sum(axis=0), np.finfo(float).tiny)
        grand = np.sum(W * mean, axis=0) / total
        # With all weights 1: W = S = n, and the textbook's n - 1, k - 1 and (k - 1) n0 appear.
        return cls(
            within=np.sum(w * (e - mean[pose]) ** 2, axis=0),
            within_noise=np.sum(W - S / safe, axis=0),
            freedom=np.sum(np.where(there, W**2 / np.where(there, S, 1.0) - 1.0, 0.0), axis=0),
            between=np.sum(W * (mean - grand) ** 2, axis=0),
            between_noise=np.sum(S / safe, axis=0) - S.sum(axis=0) / total,
            between_pose=W.sum(axis=0) - np.sum(W**2, axis=0) / total,
            cells=np.sum(there, axis=0).astype(np.float64),
        )

    def select(self, chosen: Mask) -> _Moments:
        """Those of some components."""
        return _Moments(
            self.within[chosen],
            self.within_noise[chosen],
            self.freedom[chosen],
            self.between[chosen],
            self.between_noise[chosen],
            self.between_pose[chosen],
            self.cells[chosen],
        )


def _within(m: _Moments) -> tuple[float, float]:
    """Standard deviation within repeats and its degrees of freedom, of components of one size."""
    freedom, noise = float(m.freedom.sum()), float(m.within_noise.sum())
    if freedom < _SOME_FREEDOM or noise <= 0.0:
        return np.nan, 0.0
    return float(np.sqrt(m.within.sum() / noise)), freedom


def _correlation(m: _Moments, fitted: float) -> float:
    """The share of the variance that repeats have in common, 0 to 1."""
    within = _within(m)[0] ** 2
    # A mean for each component is gone in any case; further parameters shrink what is left of the means.
    left = float(np.sum(np.maximum(m.cells - 1.0, 0.0)))
    kept = min((float(m.cells.sum()) - fitted) / left, 1.0) if left > 0.0 else 0.0
    if not np.isfinite(within) or kept < _NOTHING_KEPT:
        return 0.0
    between = float(m.between.sum()) / kept - float(m.between_noise.sum()) * within
    shared = max(between / float(m.between_pose.sum()), 0.0)
    return shared / (shared + within) if shared > 0.0 else 0.0


def _by_pose(pose: Integers, values: Array) -> Array:
    """Sums of rows (N, D) over each pose, shape (K, D)."""
    sums = np.zeros((int(pose.max(initial=-1)) + 1, values.shape[1]))
    np.add.at(sums, pose, values)
    return sums
