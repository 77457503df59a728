"""Repeats of a pose: their own scatter, and what they share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.robot.robot import read_only
from calib.units import Array, Integers, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Repeats:
    """Scatter within repeats and how much of the residual they share; of G groups: position and orientation."""

    within: Array  # (G,), standard deviation of a component of a repeat, in the residual's unit; NaN without repeats
    freedoms: Array  # (G,), its degrees of freedom; 0 without repeats
    rho: float  # Intraclass correlation of all groups together, 0 to 1; 0 without repeats

    @property
    def freedom(self) -> float:
        """The degrees of freedom of all groups."""
        return float(self.freedoms.sum())


def repeats(
    residual: Array, used: Mask, poses: Integers, weights: Array, *, fitted: float = 0.0
) -> Repeats:
    """Scatter within repeats, which holds whatever the model lacks, and their correlation.

    Of residuals (N, D) with robust weights (N,). fitted is the number of parameters that the fit took from all scalars:
    they make the means of poses smaller than their errors.
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
    # Else the parameters fit the means: what remains is rounding.
    if np.isfinite(noise) and kept >= 1e-6:
        shared = max((between / kept - of_noise * noise) / of_poses, 0.0)
    rho = shared / (shared + noise) if shared > 0.0 else 0.0
    return Repeats(within, freedoms, rho)


def pose_means(values: Array, weights: Array, poses: Integers) -> tuple[Array, Integers]:
    """Means over repeats, sum w v / sqrt(sum w), (K, ...), and the first row of each, (K,).

    Of whitened values (N, ...), with the weights (N,) > 0 that `calib.estimate.stages.Stage.sharing` gives to repeats,
    the means have the variance of one row and are independent of each other.
    """
    _, first, pose = np.unique(poses, return_index=True, return_inverse=True)
    scale = weights / np.sqrt(np.bincount(pose, weights))[pose]
    sums = _by_pose(pose, values.reshape(len(values), -1) * scale[:, None])
    return sums.reshape(len(first), *values.shape[1:]), first


def _moments(e: Array, w: Array, pose: Integers) -> Array:
    """Sums over poses for each component of residuals and weights (N, D), shape (8, D).

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
