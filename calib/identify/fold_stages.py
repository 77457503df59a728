"""The stages of many fits at once, each without some rows of one linearised problem.

What `calib.identify.stage.Stage`, `calib.identify.linear.Linear` and `calib.identify.variance` do for one fit, with the
folds along the first axis of every array. A row that is left out of a fold has the weight 0 there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from calib.identify.estimate import Options
from calib.identify.linear import Linear
from calib.identify.robust import Limits, as_of_a_point, cauchy_weights, norms_of
from calib.identify.rows import Rows
from calib.identify.stage import (
    FEWEST_FREEDOM,
    NOISE_SPREAD,
    SETTLED,
    SETTLED_SIZES,
    Holds,
    Stage,
)
from calib.identify.statistics import Mask
from calib.identify.variance import STEPS_DOWN, STEPS_UP, clipped, inverse

Array = NDArray[np.float64]
Index = NDArray[np.int_]

#: What `numpy.allclose` adds to a share of a number.
_NEARLY_NOTHING = 1e-8

#: Limit of the steps of `sizes_by_reml`.
_STEPS = 30


@dataclass(frozen=True, slots=True, eq=False)
class FoldNormal:
    """`calib.identify.variance.Linearised` of F folds: shapes (F, C, p, p), (F, C, p), (F, C) and (F, C)."""

    H: Array
    g: Array
    yy: Array
    count: Array


@dataclass(frozen=True, slots=True, eq=False)
class FoldStages:
    """`calib.identify.stage.Stage` of F folds.

    Attributes:
        alive: shape (F, N), the rows that are not left out; the others have the weight 0.
        weights: shape (F, N).
        share: shape (F, N).
        noise: shape (F, C).
        sizes: shape (F, K).
    """

    alive: Mask
    weights: Array
    share: Array
    noise: Array
    sizes: Array

    @classmethod
    def first(cls, holds: Holds, alive: Mask, instruments: int) -> FoldStages:
        """As `Stage.first`."""
        count = len(alive)
        return cls(
            alive,
            alive.astype(np.float64),
            np.ones(alive.shape),
            np.ones((count, instruments)),
            np.tile(np.array(holds.start), (count, 1)),
        )

    @property
    def effective(self) -> Array:
        """The weights of the rows, repeats shared out, shape (F, N)."""
        return self.weights * self.share

    def select(self, chosen: Index) -> FoldStages:
        """Those of some folds."""
        return FoldStages(
            self.alive[chosen],
            self.weights[chosen],
            self.share[chosen],
            self.noise[chosen],
            self.sizes[chosen],
        )

    def put(self, chosen: Index, other: FoldStages) -> FoldStages:
        """With those of some folds from elsewhere."""
        result = self.select(np.arange(len(self.alive)))
        result.weights[chosen], result.share[chosen] = other.weights, other.share
        result.noise[chosen], result.sizes[chosen] = other.noise, other.sizes
        return result

    def moved(self, other: FoldStages) -> Array:
        """The largest change of a weight, shape (F,)."""
        return np.asarray(np.abs(self.effective - other.effective).max(axis=1))

    def is_like(self, other: FoldStages) -> Mask:
        """As `Stage.is_like`, shape (F,)."""
        mine = np.concatenate([self.noise, self.sizes], axis=1)
        theirs = np.concatenate([other.noise, other.sizes], axis=1)
        near = np.abs(mine - theirs) <= _NEARLY_NOTHING + SETTLED_SIZES * theirs
        return np.asarray((self.moved(other) < SETTLED) & near.all(axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class AllFolds:
    """What all folds share.

    Attributes:
        linear: The problem.
        holds: What holds the parameters.
        rows: All rows.
        repeats: How repeats of a pose count; see `calib.identify.estimate.Options`.
        products: shape (C, N, (p + 1)^2), [A, y]^T [A, y] of each row and instrument.
        scalars: shape (C, N), numbers of scalars.
        members: shape (K, p), which parameters belong to a family whose size is found.
    """

    linear: Linear
    holds: Holds
    rows: Rows
    repeats: str
    products: Array
    scalars: Array
    members: Array

    @classmethod
    def of(cls, linear: Linear, holds: Holds, rows: Rows, options: Options) -> AllFolds:
        """Multiply out each row once."""
        members = np.array(holds.families, dtype=np.float64).reshape(-1, len(holds.precision))
        repeats = options.repeats if _repeated(rows) else "independent"
        return cls(linear, holds, rows, repeats, *products_of(linear), members)

    def data(self, weights: Array) -> FoldNormal:
        """The normal equations with these weights, shape (F, N)."""
        return normal_of(self.products, self.scalars, weights)

    def precision(self, sizes: Array) -> Array:
        """1 / tau^2 of each parameter, shape (F, p)."""
        return np.asarray((1.0 / sizes**2) @ self.members + self.holds.precision)

    def posterior(self, data: FoldNormal, stages: FoldStages) -> tuple[Array, Array]:
        """Mean and covariance of x, shapes (F, p) and (F, p, p)."""
        return self._posterior(data, stages.noise, self.precision(stages.sizes))

    def _posterior(self, data: FoldNormal, noise: Array, precision: Array) -> tuple[Array, Array]:
        """As `Linearised.posterior`."""
        weight = 1.0 / noise**2
        known = self.linear.known(self.holds.precision, self.holds.centre)
        M = np.sum(weight[:, :, None, None] * data.H, axis=1) + known.H
        M.reshape(len(M), -1)[:, :: M.shape[1] + 1] += precision
        right = np.sum(weight[:, :, None] * data.g, axis=1) + known.g + precision * known.centre
        scale = 1.0 / np.sqrt(M.diagonal(axis1=1, axis2=2) + 1e-300)
        scales = scale[:, :, None] * scale[:, None, :]
        M *= scales
        covariance = np.array([inverse(one) for one in M]) * scales
        return (covariance @ right[:, :, None])[:, :, 0], covariance

    def fit(self, stages: FoldStages, data: FoldNormal | None = None) -> tuple[Array, Array, Array]:
        """As `Linear.fit`: shapes (F, N, D), (F, p, p) and (F,)."""
        data = self.data(stages.effective) if data is None else data
        x, covariance = self.posterior(data, stages)
        paid = np.sum(data.H * covariance[:, None], axis=(2, 3)) / stages.noise**2
        N, D, p = self.linear.A.shape
        predicted = (x @ self.linear.A.reshape(N * D, p).T).reshape(-1, N, D)
        return self.linear.y - predicted, covariance, np.sum(data.count - paid, axis=1)

    def leverage(self, covariance: Array) -> Array:
        """A C A^T of each row, shape (F, N, D, D)."""
        N, D, p = self.linear.A.shape
        wide = (self.linear.A.reshape(N * D, p) @ covariance).reshape(-1, N, D, p)
        return np.asarray(wide @ self.linear.A.transpose(0, 2, 1))

    def scores(self, stages: FoldStages, residual: Array, covariance: Array) -> Array:
        """As `Linear.scores`, shape (F, N)."""
        ones = np.ones((len(residual), 1))
        scale = np.concatenate([stages.noise, ones], axis=1)[:, self.linear.instruments]
        K = self.leverage(covariance) / (scale[:, :, :, None] * scale[:, :, None, :])
        norms = _norms(residual / scale, K, stages.effective)
        scalars = np.broadcast_to(np.sum(self.linear.used, axis=1), norms.shape)
        return as_of_a_point(norms.reshape(-1), scalars.reshape(-1)).reshape(norms.shape)

    def by_median(self, stages: FoldStages) -> FoldStages:
        """As `Stage.by_median`."""
        for _ in range(3):
            data = self.data(stages.effective)
            residual, covariance, _ = self.fit(stages, data)
            K, found = self.leverage(covariance), []
            for c, smallest in enumerate(self.linear.smallest):
                own = self.linear.instruments == c
                square = (stages.noise[:, c] ** 2)[:, None, None, None]
                inside = K * (own[:, :, None] & own[:, None, :]) / square
                norms = _norms(residual * own, inside, stages.effective)
                count = self.scalars[c]
                typical = np.sqrt(chdtri(np.maximum(count, 1.0), 0.5))
                median = _medians(norms / typical, stages.alive & (count > 0.0))
                found.append(np.maximum(median, smallest))
            stages = replace(stages, noise=np.array(found).T)
            residual, covariance, _ = self.fit(stages, data)
            weights = cauchy_weights(self.scores(stages, residual, covariance))
            stages = replace(stages, weights=weights * stages.alive)
        return stages

    def by_likelihood(self, stages: FoldStages, *, robust: bool) -> FoldStages:
        """As `Stage.by_likelihood`."""
        for _ in range(2 if robust else 1):
            if robust:
                stages = replace(stages, weights=self._row_weights(stages))
            stages = self._by_reml(stages)
        return stages

    def _row_weights(self, stages: FoldStages) -> Array:
        """As `Stage._row_weights`, shape (F, N)."""
        residual, covariance, freedom = self.fit(stages)
        scores = self.scores(stages, residual, covariance)
        count = stages.alive.sum(axis=1)
        result = stages.alive.astype(np.float64)
        for f in np.flatnonzero(freedom > FEWEST_FREEDOM):
            found = Limits.of(int(count[f]), float(freedom[f])).weights(scores[f]) * result[f]
            if np.sum(found) > 0.5 * count[f]:
                result[f] = found
        return result

    def _by_reml(self, stages: FoldStages) -> FoldStages:
        """As `sizes_by_reml`."""
        data, C = self.data(stages.effective), stages.noise.shape[1]
        adapts = self.holds.adapts
        members = self.members if adapts else self.members[:0]
        held = self.holds.precision if adapts else self.precision(stages.sizes)
        sizes = stages.sizes if adapts else stages.sizes[:, :0]
        bounds = self.holds.bounds if adapts else ()
        logs = np.log(np.concatenate([stages.noise, sizes], axis=1))
        low = np.log(np.array([*self.linear.smallest, *(low for low, _ in bounds)]))
        high = np.tile(
            np.log(np.array([*(1.0,) * C, *(high for _, high in bounds)])), (len(logs), 1)
        )
        high[:, :C] = logs[:, :C] + np.log(1e6)
        logs = clipped(logs, low, high)
        spread = np.where(np.arange(logs.shape[1]) < C, 1.0 / NOISE_SPREAD**2, 0.0)
        active, last = np.arange(len(logs)), np.zeros_like(logs)
        for _ in range(_STEPS):
            at, top = logs[active], high[active]
            part = FoldNormal(data.H[active], data.g[active], data.yy[active], data.count[active])
            known = held if adapts else held[active]
            score, information = self._score(part, members, known, at, C)
            score -= spread * at
            stays = ((at <= low) & (score < 0)) | ((at >= top) & (score > 0))
            diagonal = information.reshape(len(at), -1)[:, :: at.shape[1] + 1]
            diagonal += spread
            diagonal += 1e-3 * diagonal + 1e-9
            information[stays[:, :, None] | stays[:, None, :]] = 0.0
            score[stays], diagonal[stays] = 0.0, 1.0
            step = np.asarray(np.linalg.solve(information, score[:, :, None])[:, :, 0])
            step = clipped(step, -STEPS_DOWN, STEPS_UP)
            last[active] = np.where(step * last[active] < 0.0, 0.5 * step, step)
            logs[active] = clipped(at + last[active], low, top)
            active = active[np.abs(logs[active] - at).max(axis=1) >= 1e-4]
            if not len(active):
                break
        values = np.exp(logs)
        return replace(stages, noise=values[:, :C], sizes=values[:, C:] if adapts else stages.sizes)

    def _score(
        self, data: FoldNormal, members: Array, held: Array, logs: Array, C: int
    ) -> tuple[Array, Array]:
        """As `calib.identify.variance._score`: shapes (F, C + K) and (F, C + K, C + K)."""
        values = np.exp(logs)
        square, sizes = values[:, :C] ** 2, values[:, C:]
        own = (1.0 / sizes**2) @ members
        m, covariance = self._posterior(data, values[:, :C], held + own)
        HC = (data.H @ covariance[:, None]) / square[:, :, None, None]
        trace = HC.trace(axis1=2, axis2=3)
        Hm = (data.H @ m[:, None, :, None])[:, :, :, 0]
        left = data.yy + np.sum((Hm - 2.0 * data.g) * m[:, None, :], axis=2)
        n = logs.shape[1]
        score, information = np.empty((len(logs), n)), np.empty((len(logs), n, n))
        score[:, :C] = np.maximum(left, 0.0) / square + trace - data.count
        turned = HC.swapaxes(2, 3)
        flat = HC.reshape(len(HC), C, -1)
        information[:, :C, :C] = 2.0 * flat @ turned.reshape(flat.shape).swapaxes(1, 2)
        diagonal = information.reshape(len(logs), -1)[:, :: n + 1]
        diagonal[:, :C] += 2.0 * (data.count - 2.0 * trace)
        if n > C:
            both = np.sum(covariance[:, None] * turned, axis=3)
            variance = covariance.diagonal(axis1=1, axis2=2)
            score[:, C:] = (m**2 + variance) @ members.T / sizes**2 - members.sum(axis=1)
            cross = 2.0 * (both @ members.T) / sizes[:, None, :] ** 2
            information[:, :C, C:], information[:, C:, :C] = cross, cross.swapaxes(1, 2)
            root = np.sqrt(own)
            block = -covariance * (root[:, :, None] * root[:, None, :])
            block.reshape(len(block), -1)[:, :: root.shape[1] + 1] += root > 0.0
            information[:, C:, C:] = 2.0 * (members @ block**2 @ members.T)
        return score, information

    def shared(self, stages: FoldStages) -> FoldStages:
        """As `Stage.sharing`."""
        if self.repeats == "independent":
            return stages
        share = []
        for f in range(len(stages.alive)):
            one = Stage(
                self.holds,
                stages.weights[f],
                stages.share[f],
                tuple(stages.noise[f].tolist()),
                tuple(stages.sizes[f].tolist()),
            )
            share.append(one.sharing(self.linear, self.rows.poses, self.repeats).share)
        return replace(stages, share=np.array(share))


def products_of(linear: Linear) -> tuple[Array, Array]:
    """[A, y]^T [A, y] of each instrument and row, shape (C, N, (p + 1)^2), and numbers of scalars, shape (C, N)."""
    both = np.concatenate([linear.A, linear.y[:, :, None]], axis=2)
    products, scalars = [], []
    for c in range(len(linear.smallest)):
        own = linear.instruments == c
        columns = both if own.all() else both * own[:, :, None]
        products.append((columns.transpose(0, 2, 1) @ columns).reshape(len(both), -1))
        scalars.append(own.sum(axis=1, dtype=np.float64))
    return np.array(products), np.array(scalars)


def normal_of(products: Array, scalars: Array, weights: Array) -> FoldNormal:
    """The normal equations with weights of each fold, shape (F, N)."""
    both = np.stack([weights @ one for one in products], axis=1)
    q = round(products.shape[2] ** 0.5)
    both = both.reshape(len(weights), -1, q, q)
    return FoldNormal(
        both[:, :, :-1, :-1], both[:, :, :-1, -1], both[:, :, -1, -1], weights @ scalars.T
    )


def _repeated(rows: Rows) -> bool:
    """Whether a pose has several rows."""
    return bool(np.bincount(rows.poses).max() > 1)


def _norms(residual: Array, leverage: Array, weights: Array) -> Array:
    """`norms_of` of all folds, shape (F, N)."""
    D = residual.shape[2]
    found = norms_of(residual.reshape(-1, D), leverage.reshape(-1, D, D), weights.reshape(-1))
    return found.reshape(weights.shape)


def _medians(values: Array, counts: Mask) -> Array:
    """The median of the values that count, along the last axis."""
    ordered = np.sort(np.where(counts, values, np.inf), axis=1)
    number = counts.sum(axis=1)
    first = np.arange(len(values))
    return np.asarray(0.5 * (ordered[first, (number - 1) // 2] + ordered[first, number // 2]))
