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


@dataclass(frozen=True, slots=True, eq=False)
class Repeats:
    """Scatter within repeats, for each group of components (position, orientation).

    Attributes:
        within: shape (G,), standard deviation of a component of a repeat, in the residual's unit; NaN without repeats.
        freedom: shape (G,), its degrees of freedom; 0 without repeats.
        rho: shape (G,), intraclass correlation, 0 to 1; 0 without repeats.
        groups: shape (D,), the group of each component.
    """

    within: Array
    freedom: Array
    rho: Array
    groups: Integers

    def weights(self, used: Mask, poses: Integers) -> Array:
        """What each scalar counts, 1 / (1 + (n - 1) rho) with n repeats of it, 0 where it is not used.

        Args:
            used: shape (N, D), which scalars there are.
            poses: shape (N,), the pose of each row.

        Returns:
            shape (N, D).
        """
        _, pose = np.unique(poses, return_inverse=True)
        counts = _by_pose(pose, used.astype(np.float64))[pose]
        weights = 1.0 / (1.0 + np.maximum(counts - 1.0, 0.0) * self.rho[self.groups])
        result: Array = np.where(used, weights, 0.0)
        return result


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
        residual: shape (N, D), measured minus predicted, in any one unit for each group of components; what is not
            used may be NaN.
        used: shape (N, D), which scalars there are.
        poses: shape (N,), the pose of each row (and its target, set-up: whatever is repeated as a whole).
        weights: shape (N,), robust weights: 0 for outliers, 1 for good rows.
        groups: shape (D,), the group of each component, from 0 on; None: components 0 to 2 are one, 3 to 5 the next.
        fitted: Number of parameters that the fit took from all the scalars. They make the means of poses smaller than
            their errors; without them rho is found too small.

    Returns:
        Within a component no more than the mean of each pose is taken out for the scatter, so that it holds whatever
        the model lacks.
    """
    groups = np.arange(residual.shape[1]) // 3 if groups is None else groups
    _, pose = np.unique(poses, return_inverse=True)
    w = np.where(used, weights[:, None], 0.0)
    moments = _Moments.of(np.where(w > 0.0, residual, 0.0), w, pose)
    found = [moments.select(groups == g) for g in range(int(groups.max(initial=-1)) + 1)]
    cells = sum(float(np.sum(m.cells)) for m in found)
    taken = [fitted * float(np.sum(m.cells)) / max(cells, 1.0) for m in found]
    estimates = [_estimate(m, t) for m, t in zip(found, taken, strict=True)]
    within, freedom, rho = (read_only(column) for column in np.reshape(estimates, (-1, 3)).T)
    return Repeats(within, freedom, rho, _frozen(groups))


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


def _estimate(m: _Moments, fitted: float) -> tuple[float, float, float]:
    """Standard deviation within, its degrees of freedom, and rho, of components of one size."""
    freedom, noise = float(m.freedom.sum()), float(m.within_noise.sum())
    if freedom < 1e-9 or noise <= 0.0:
        return np.nan, 0.0, 0.0
    within = float(m.within.sum()) / noise
    # A mean for each component is gone in any case; the other parameters shrink what is left of the means.
    left = float(np.sum(np.maximum(m.cells - 1.0, 0.0)))
    kept = (float(m.cells.sum()) - fitted) / left if left > 0.0 else 0.0
    kept = min(kept, 1.0)
    poses = kept * float(m.between_pose.sum())
    if poses <= 0.0:
        return np.sqrt(within), freedom, 0.0
    shared = (float(m.between.sum()) - kept * float(m.between_noise.sum()) * within) / poses
    total = max(shared, 0.0) + within
    return np.sqrt(within), freedom, max(shared, 0.0) / total if total > 0.0 else 0.0


def _by_pose(pose: Integers, values: Array) -> Array:
    """Sums of rows (N, D) over each pose, shape (K, D)."""
    sums = np.zeros((int(pose.max(initial=-1)) + 1, values.shape[1]))
    np.add.at(sums, pose, values)
    return sums


def _frozen(labels: Integers) -> Integers:
    """A copy that cannot be written to."""
    copy = np.array(labels, dtype=np.int_)
    copy.setflags(write=False)
    return copy
