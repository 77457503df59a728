"""Robust weights: which rows do not belong to the others, and what repeats of a pose count for.

A row is judged by how far it lies from what the *other* rows predict, in units of that prediction's own standard
deviation, so that a row with leverage cannot hide. With K = A C A^T, the leverage of a row of weight 1, whitened,

    score^2 = r^T (I + (1 - w) K)^-1 (I - w K)^-1 r

which is the squared deleted residual over its covariance, and score^2 / d follows F(d, dof) for a good row of d
scalars. Scores are told as those of three scalars, whatever d is, so that one limit serves a whole table.

What a model leaves over at a pose is the same in each repeat, the instrument's noise is not:

    e = b + w,  var b = s_b^2 (shared by a pose),  var w = s_w^2,  rho = s_b^2 / (s_b^2 + s_w^2)

Both are found by moments from the mean squares within and between poses (one-way analysis of variance, repeats of
unequal number). A mean of n repeats has the variance s^2 (1 + (n - 1) rho) / n, which weights of 1 / (1 + (n - 1) rho)
for each of them give it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtrc, chdtri, fdtri

from calib.robot.kernel import over_blocks
from calib.robot.robot import read_only

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Integers = NDArray[np.int_]

#: A good row keeps its full weight with this probability.
_FULL = 0.99

#: The probability that any row at all of a clean table is flagged.
_FALSE_ALARM = 0.01

#: A row that leaves less than this of a direction to the others carries it nearly alone.
_CARRIED = 1e-4

#: Identities by their size, of the scalars that a row may have.
_IDENTITIES = tuple(np.eye(d)[:, :, None] for d in range(7))

#: The scalars of a point, for which scores are told.
_POINT = 3


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

    residual, shape (B, N, D), of B fits, and jacobian, shape (N, D, p), are in units of each scalar's sigma, and
    multiplied by factors, shape (B or 1, N, D); covariance has the shape (B, p, p), weights (B, N).
    """
    norms = np.empty(weights.shape)

    def work(own: slice) -> None:
        A = jacobian[own].transpose(2, 1, 0)
        p, D, n = A.shape
        spread = (covariance @ A.reshape(p, D * n)).reshape(-1, p, D, n)
        leverage: Array = np.empty((D, D, len(norms), n))
        for i in range(D):
            row = np.einsum("bpn,pjn->jbn", spread[:, :, i], A[:, : i + 1])
            leverage[i, : i + 1], leverage[: i + 1, i] = row, row
        f = factors[:, own].transpose(2, 0, 1)
        r = (residual[:, own].transpose(2, 0, 1) * f).reshape(D, -1)
        leverage *= f * f[:, None]
        found = _norms_of(r, leverage.reshape(D, D, -1), weights[:, own].ravel())
        norms[:, own] = found.reshape(-1, n)

    over_blocks(work, weights.shape[1])
    return norms


def _norms_of(r: Array, K: Array, w: Array) -> Array:
    """The norms of residuals, shape (D, B), with the leverages K, shape (D, D, B), and weights, shape (B,).

    (I + (1 - w) K) (I - w K) is symmetric and solved as it stands; where a row carries nearly all that is known of a
    direction, by the eigenvalues of K, none of which may then pass 1 / w.
    """
    kept = _IDENTITIES[len(r)] - w * K
    spread = kept + (1.0 - w) * np.einsum("ijb,jkb->ikb", K, kept)
    with np.errstate(all="ignore"):
        _, square = _eliminated(spread, r.copy())
    trace = np.einsum("iib->b", K)
    # The product of 1 - w k over the eigenvalues k of K is at most its smallest factor, and at least 1 - w trace K.
    if not np.all(w * trace < 1.0 - _CARRIED):
        with np.errstate(all="ignore"):
            left, _ = _eliminated(kept, np.zeros_like(r))
        risky = ~(left >= _CARRIED) | (K.max(axis=(0, 1), initial=0.0) > 1.0 / _CARRIED)
        if risky.any():
            square[risky] = _squares_by_eigenvalues(r[:, risky].T, K[:, :, risky].T, w[risky])
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def _eliminated(M: Array, r: Array) -> tuple[Array, Array]:
    """The determinants of symmetric matrices, shape (D, D, B), and r^T M^-1 r; both arguments are overwritten."""
    determinant, square = np.ones(r.shape[1]), np.zeros(r.shape[1])
    for j in range(len(r)):
        pivot = M[j, j]
        determinant *= pivot
        square += r[j] ** 2 / pivot
        if j + 1 < len(r):
            ratio = M[j + 1 :, j] / pivot
            M[j + 1 :, j + 1 :] -= ratio[:, None] * M[j, j + 1 :]
            r[j + 1 :] -= ratio * r[j]
    return determinant, square


def _squares_by_eigenvalues(residual: Array, leverage: Array, weights: Array) -> Array:
    """The squares of the norms with 1 - w k kept above 0, of shapes (N, D), (N, D, D) and (N,)."""
    values, vectors = np.linalg.eigh(leverage)
    along = np.einsum("nij,ni->nj", vectors, residual)
    w = weights[:, None]
    spread = (1.0 + (1.0 - w) * values) * np.maximum(1.0 - w * values, 1e-9)
    return np.asarray(np.sum(along**2 / spread, axis=1))


def scores(
    residual: Array, jacobian: Array, covariance: Array, weights: Array, used: Mask
) -> Array:
    """The score of each row of one fit, shape (N,): `deleted_norms` told as those of a point; 0 without scalars."""
    every = np.ones((1, *residual.shape))
    norms = deleted_norms(residual[None], jacobian, covariance[None], weights[None], every)[0]
    return as_of_a_point(norms, np.sum(used, axis=1))


def as_of_a_point(row_scores: Array, scalars: Integers) -> Array:
    """The scores, shape (..., N), that three scalars would have at the same probability.

    By the chi-squared distribution as far as its tail can be computed, and by the same step beyond.
    """
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


def median_noise(row_scores: Array, used: Mask, kept: Mask | None = None) -> Array:
    """The noise that makes the median score what it is for normal noise, shape (B,): outliers cannot move it."""
    scalars = np.sum(used, axis=1)
    typical = np.sqrt(chdtri(np.maximum(np.arange(used.shape[1] + 1), 1), 0.5))[scalars]
    there = np.broadcast_to(scalars > 0 if kept is None else kept & (scalars > 0), row_scores.shape)
    ordered = np.sort(np.where(there, row_scores / typical, np.inf), axis=1)
    count = there.sum(axis=1)[:, None]
    middle = np.hstack([(count - 1) // 2, count // 2])
    return np.asarray(np.take_along_axis(ordered, middle, axis=1).mean(axis=1))


def cauchy_weights(row_scores: Array) -> Array:
    """1 / (1 + (s / 3.4)^2): never quite 0, for the first rounds, while the fit may still be wrong for all rows."""
    return np.asarray(1.0 / (1.0 + (row_scores / 3.4) ** 2))


@dataclass(frozen=True, slots=True, eq=False)
class Repeats:
    """Scatter within repeats, and how much of the residual they share."""

    # shape (G,), standard deviation of a component of a repeat, for each group of components (position, orientation),
    # in the residual's unit; NaN without repeats
    within: Array
    freedoms: Array  # shape (G,), its degrees of freedom; 0 without repeats
    freedom: float  # Their sum
    rho: float  # Intraclass correlation of all groups together, 0 to 1; 0 without repeats


def repeats(
    residual: Array, used: Mask, poses: Integers, weights: Array, *, fitted: float = 0.0
) -> Repeats:
    """Scatter within repeats and their correlation, by the method of moments.

    residual, shape (N, D), is measured minus predicted, components 0 to 2 in one unit and those from 3 on in one;
    used, of its shape, says which there are, the others may be NaN. poses, shape (N,), is what is repeated as a whole,
    weights are robust ones, 0 for outliers. fitted is the number of parameters that the fit took from all scalars:
    they make the means of poses smaller than their errors, and without them rho is found too small.

    Returns:
        The scatter about the mean of each pose, which holds whatever the model lacks, and rho.
    """
    _, pose = np.unique(poses, return_inverse=True)
    w = np.where(used, weights[:, None], 0.0)
    e = np.where(w > 0.0, residual, 0.0)
    moments, size = _moments(e, w, pose), np.ones(e.shape[1])
    each = []
    for own in (slice(0, 3), slice(3, None))[: 1 + (e.shape[1] > 3)]:
        each.append(_within(moments[:, own].sum(axis=1)))
        # rho is one number for lengths and angles: each group counts in units of its own size.
        square = float(np.sum(w[:, own] * e[:, own] ** 2))
        size[own] = np.sqrt(square / float(np.sum(w[:, own]))) if square > 0.0 else 1.0
    within, freedoms = (read_only(column) for column in np.array(each).T)
    rho = _correlation(_moments(e / size, w, pose).sum(axis=1), fitted)
    return Repeats(within, freedoms, float(freedoms.sum()), rho)


def pose_means(values: Array, weights: Array, poses: Integers) -> tuple[Array, Integers]:
    """Means over the repeats of each pose, as large as one row of the same noise: sum w v / sqrt(sum w).

    With the weights that `calib.estimate.stage.Stage.sharing` gives to repeats they have the variance of one row, and
    are independent of each other, however much the repeats share.

    values, shape (N, ...), are whitened; weights, shape (N,), above 0, repeats shared out.

    Returns:
        shape (K, ...), and shape (K,), the first row of each pose.
    """
    _, first, pose = np.unique(poses, return_index=True, return_inverse=True)
    scale = weights / np.sqrt(np.bincount(pose, weights))[pose]
    sums = _by_pose(pose, values.reshape(len(values), -1) * scale[:, None])
    return sums.reshape(len(first), *values.shape[1:]), first


def _moments(e: Array, w: Array, pose: Integers) -> Array:
    """Sums over poses for each component of residuals and weights of shape (N, D), shape (8, D).

    With s_w^2 of the noise and s_b^2 of what repeats share: the weighted squares within poses, their expectation over
    s_w^2, and their degrees of freedom; the weighted squares of means about the grand mean, their expectations over
    s_w^2 and over s_b^2; the number of poses, and that of poses but for the grand mean.
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
    # Less than this is rounding.
    return (
        (float(np.sqrt(square / noise)), float(freedom))
        if freedom >= 1e-9 and noise > 0.0
        else (np.nan, 0.0)
    )


def _correlation(m: Array, fitted: float) -> float:
    """The share of the variance that repeats have in common, 0 to 1."""
    within = _within(m)[0] ** 2
    *_, between, of_noise, of_poses, cells, left = m.tolist()
    # A mean for each component is gone in any case; further parameters shrink what is left of the means.
    kept = min((cells - fitted) / left, 1.0) if left > 0.0 else 0.0
    if (
        not np.isfinite(within) or kept < 1e-6
    ):  # the parameters fit them all: what remains is rounding
        return 0.0
    shared = max((between / kept - of_noise * within) / of_poses, 0.0)
    return shared / (shared + within) if shared > 0.0 else 0.0


def _by_pose(pose: Integers, values: Array) -> Array:
    """Sums of rows (N, D) over each pose, shape (K, D)."""
    return np.stack([np.bincount(pose, column) for column in values.T], axis=1)
