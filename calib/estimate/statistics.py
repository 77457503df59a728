"""Statistics of rows: errors, what repeats of a pose share, and which rows do not belong to the others.

Repeats: e = b + w with var b = s_b^2 shared by a pose and var w = s_w^2 its own; rho = s_b^2 / (s_b^2 + s_w^2) by
moments from the mean squares within and between poses. Outliers: with the leverage K = A C A^T of a row of weight 1,
whitened, score^2 = r^T (I + (1 - w) K)^-1 (I - w K)^-1 r, the squared deleted residual over its covariance; score^2 / d
follows F(d, dof) for a good row of d scalars. Scores are told as those of three scalars, so that one limit serves a
table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtrc, chdtri, fdtri, stdtrit

from calib.robot.kernel import over_blocks
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
    poses: Integers  # (N,), from 0, rows of one number are of one pose or of one pair, and held out together
    residual: Array  # (N, D), measured minus predicted by the fit without the row [m], [rad]
    errors: Errors  # Of all rows
    errors_without_outliers: Errors  # Of the rows that the fit to all rows did not flag


def interval_factor(freedom: float, level: float = 0.95) -> float:
    """How many standard deviations the two-sided interval of a probability reaches: Student's t."""
    return float(stdtrit(max(freedom, 1.0), 0.5 + level / 2.0))


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


#: A good row keeps its full weight with this probability; and that with which any row of a clean table is flagged.
_FULL, _FALSE_ALARM = 0.99, 0.01

#: A row that leaves less than this of a direction to the others carries it nearly alone; and the scalars of a point,
#: for which scores are told.
_CARRIED, _POINT = 1e-4, 3


@dataclass(frozen=True, slots=True)
class Limits:
    """Scores between which the weight falls from 1 to 0; of one table or of several, shape (B, 1)."""

    full: Array  # Below it a row counts in full
    flagged: Array  # Above it a row does not count and is named as an outlier

    @classmethod
    def of(cls, rows: ArrayLike, freedom: ArrayLike) -> Limits:
        """The limits for a table."""
        freedom, clean = np.maximum(freedom, 1.0), 1.0 - _FALSE_ALARM / np.maximum(rows, 10)
        return cls(*(np.sqrt(3.0 * fdtri(3.0, freedom, p)) for p in (_FULL, clean)))

    def weights(self, scores: Array) -> Array:
        """Redescending weights: 1, then falling linearly in influence to 0, of the scores' shape."""
        fall = (self.flagged - scores) / (self.flagged - self.full)
        return np.where(scores <= self.full, 1.0, np.clip(fall, 0.0, 1.0))


def deleted_norms(
    residual: Array, jacobian: Array, covariance: Array, weights: Array, factors: Array
) -> Array:
    """How far each row lies from what the others predict, in standard deviations, shape (B, N); see the module's text.

    residual (B, N, D) and jacobian (N, D, p) are in units of each scalar's sigma, and multiplied by factors (B or 1, N,
    D); covariance (B, p, p), weights (B, N).
    """
    norms = np.empty(weights.shape)

    def work(own: slice) -> None:
        A, f = jacobian[own], factors[:, own]
        n, D, p = A.shape
        spread = (A.reshape(n * D, p) @ covariance).reshape(-1, n, D, p)
        K = (spread @ A.swapaxes(1, 2)) * (f[..., None] * f[..., None, :])
        norms[:, own] = _norms_of(residual[:, own] * f, K, weights[:, own])

    over_blocks(work, weights.shape[1])
    return norms


def _norms_of(r: Array, K: Array, w: Array) -> Array:
    """The norms of residuals (B, N, D), with the leverages K (B, N, D, D) and weights (B, N).

    Where a row carries nearly all that is known of a direction, by the eigenvalues of K, none beyond 1 / w.
    """
    w, trace = w[..., None], np.trace(K, axis1=-2, axis2=-1)
    risky = ~(w[..., 0] * trace < 1.0 - _CARRIED) | (K.max(axis=(-2, -1)) > 1.0 / _CARRIED)
    kept = np.eye(K.shape[-1]) - w[..., None] * np.where(risky[..., None, None], 0.0, K)
    spread = kept + (1.0 - w[..., None]) * (K @ kept)
    square = np.sum(r * np.linalg.solve(spread, r[..., None])[..., 0], axis=-1)
    if risky.any():
        values, vectors = np.linalg.eigh(K[risky])
        along, w = np.einsum("nij,ni->nj", vectors, r[risky]), w[risky]
        spread = (1.0 + (1.0 - w) * values) * np.maximum(1.0 - w * values, 1e-9)
        square[risky] = np.sum(along**2 / spread, axis=1)
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def as_of_a_point(row_scores: Array, scalars: NDArray[np.int_]) -> Array:
    """The scores (..., N) that three scalars would have at the same chi-squared probability; 0 without scalars."""
    result: Array = row_scores.copy()
    result[..., scalars == 0] = 0.0
    for d in np.unique(scalars):
        if d in (0, _POINT):
            continue
        own = scalars == d
        farthest = np.sqrt(chdtri(d, 1e-200))  # beyond it the tail is too thin to be inverted
        inner = np.minimum(row_scores[..., own], farthest)
        same = np.sqrt(chdtri(_POINT, chdtrc(d, inner**2)))
        result[..., own] = same + (row_scores[..., own] - inner)
    return result


def median_noise(row_scores: Array, used: Mask, kept: Mask) -> Array:
    """The noise that makes the median score (B, N) of the rows kept what it is for normal noise, shape (B,)."""
    scalars = np.sum(used, axis=1)
    typical = np.sqrt(chdtri(np.maximum(np.arange(used.shape[1] + 1), 1), 0.5))[scalars]
    there = kept & (scalars > 0)
    ordered = np.sort(np.where(there, row_scores / typical, np.inf), axis=1)
    count = there.sum(axis=1)[:, None]
    middle = np.hstack([(count - 1) // 2, count // 2])
    return np.asarray(np.take_along_axis(ordered, middle, axis=1).mean(axis=1))
