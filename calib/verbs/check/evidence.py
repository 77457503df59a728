"""Evidence: what has moved, by the numbers of a few stops, and how surely.

The n whitened numbers y are multivariate t with nu degrees of freedom, those of the result's noise, if nothing has
moved. A cause displaces something by x, of zero mean and the standard deviation s in each direction (a turn is that at
the end of a lever); s is one of `SIZES`, all equally probable. With the singular value decomposition U l V^T of the
derivative of y by x, the likelihood ratio to "nothing" (A. Zellner, 1971, for the t) is

    B(s) = prod_j (1 + s^2 l_j^2)^-1/2  [(nu + |y|^2) / (nu + q)]^((nu + n) / 2)
    q = |y|^2 - sum_j w_j (u_j . y)^2,        w_j = s^2 l_j^2 / (1 + s^2 l_j^2)

B averaged over s, times the prior of the cause, is its weight; the weights add up to the evidence T that anything has
moved. T is compared with its distribution if nothing has, which is drawn: the probability of a false alarm is `LEVEL`
whatever the priors are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from calib.basics.arrays import Array
from calib.basics.values import Value

#: Standard deviations of a displacement, from what a tracker sees to what anybody sees [m].
SIZES = (3e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2)

#: Probability that something is said to have moved if nothing has.
LEVEL = 0.005

#: Draws of the distribution if nothing has moved, and their seed: a p-value of `LEVEL` is known to a tenth of it.
_DRAWS = 20_000
_SEED = 4805

#: Singular values below this, of a displacement of 1 m, are rounding.
_ROUNDING = 1e-6

#: Steps of the bisection for a length that is noticed: to 1 %.
_HALVINGS = 6

#: Beyond so many degrees of freedom the t is a normal distribution.
_MOST = 1e7


@dataclass(frozen=True, slots=True, eq=False)
class Directions(Value):
    """The displacements of one cause as they show in n whitened numbers: U l V^T."""

    #: (n, r), left singular vectors
    U: Array
    #: (r,), of 1 m
    singular: Array
    #: (r, c), right singular vectors, as rows
    V: Array
    #: Weight of the cause before anything is measured
    prior: float

    @classmethod
    def of(cls, derivative: Array, prior: float) -> Directions:
        """Decompose the derivative of n whitened numbers by c displacements, (n, c)."""
        U, singular, V = np.linalg.svd(derivative, full_matrices=False)
        kept = singular > _ROUNDING * max(1.0, float(singular.max(initial=0.0)))
        return cls(U[:, kept], singular[kept], V[kept], prior)


def log_weights(causes: Sequence[Directions], y: Array, freedom: float) -> Array:
    """Return the logarithm of each cause's weight over that of "nothing", by size.

    Args:
        causes: K causes.
        y: (n, M), M sets of n whitened numbers.
        freedom: Degrees of freedom of their scale.

    Returns:
        shape (K, S, M); its `logsumexp` over the second axis is the logarithm of the cause's weight.
    """
    nu = min(max(freedom, 1.0), _MOST)
    total = np.sum(y**2, axis=0)
    half = 0.5 * (nu + len(y))
    result = np.empty((len(causes), len(SIZES), y.shape[1]))
    for k, cause in enumerate(causes):
        squares = (cause.U.T @ y) ** 2
        for i, size in enumerate(SIZES):
            ratio = (size * cause.singular) ** 2
            q = total - (ratio / (1.0 + ratio)) @ squares
            fit = half * (np.log1p(total / nu) - np.log1p(np.maximum(q, 0.0) / nu))
            result[k, i] = fit - 0.5 * np.sum(np.log1p(ratio)) + np.log(cause.prior / len(SIZES))
    return result


@dataclass(frozen=True, slots=True, eq=False)
class EvidenceTest(Value):
    """The distribution of the evidence if nothing has moved."""

    #: The causes whose weights are added up
    causes: tuple[Directions, ...]
    #: Degrees of freedom of the noise
    freedom: float
    #: (M,), drawn, sorted
    null: Array

    @classmethod
    def of(cls, causes: Sequence[Directions], numbers: int, freedom: float) -> EvidenceTest:
        """Draw the distribution of the evidence of n ``numbers``; the same draws each time."""
        draws = _draw(np.random.default_rng(_SEED), numbers, _DRAWS, freedom)
        weights = log_weights(causes, draws, freedom)
        return cls(tuple(causes), freedom, np.sort(logsumexp(weights, axis=(0, 1))))

    def p_value(self, evidence: float) -> float:
        """Return the probability of so much evidence, a logarithm, or more if nothing has moved."""
        above = len(self.null) - np.searchsorted(self.null, evidence, side="left")
        return float((1 + above) / (1 + len(self.null)))

    @property
    def limit(self) -> float:
        """The evidence, a logarithm, beyond which something is said to have moved."""
        return float(np.quantile(self.null, 1.0 - LEVEL))

    def detected_length(self, direction: Array, share: float = 0.95, draws: int = 1000) -> float:
        """Return the length in a direction, (n,), at which a share of displacements is noticed, in standard deviations.

        Args:
            direction: Of the whitened numbers, of length 1.
            share: How many of them.
            draws: Number of draws.
        """
        noise = _draw(np.random.default_rng(_SEED + 1), len(direction), draws, self.freedom)
        limit = self.limit

        def noticed(length: float) -> float:
            """Return the share of displacements of a length that is noticed."""
            weights = log_weights(self.causes, noise + length * direction[:, None], self.freedom)
            return float(np.mean(logsumexp(weights, axis=(0, 1)) > limit))

        high = 4.0
        while noticed(high) < share:
            high *= 2.0
        low = 0.5 * high
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if noticed(middle) < share else (low, middle)
        return high


def _draw(rng: np.random.Generator, numbers: int, count: int, freedom: float) -> Array:
    """Draw sets of whitened numbers without any displacement, (numbers, count)."""
    z = rng.standard_normal((numbers, count))
    if freedom >= _MOST:
        return z
    nu = max(freedom, 1.0)
    return np.asarray(z / np.sqrt(rng.chisquare(nu, count) / nu))


def estimate(cause: Directions, y: Array, freedom: float) -> tuple[Array, Array]:
    """Estimate the displacement of a cause by its posterior, over all sizes.

    Args:
        cause: The cause, of c displacements.
        y: (n,), the whitened numbers.
        freedom: Degrees of freedom of their scale.

    Returns:
        Mean (c,) and covariance (c, c) [m].
    """
    by_size = log_weights([cause], y[:, None], freedom)[0, :, 0]
    share = np.exp(by_size - logsumexp(by_size))
    u = cause.U.T @ y
    c = cause.V.shape[1]
    means, covariances = [], []
    nu = min(max(freedom, 1.0), _MOST)
    for size in SIZES:
        ratio = (size * cause.singular) ** 2
        a = u * ratio / (1.0 + ratio) / cause.singular
        q = float(y @ y - np.sum(u**2 * ratio / (1.0 + ratio)))
        scale = (nu + q) / (nu + len(y))
        # What the numbers do not show keeps its prior.
        unseen = np.eye(c) - cause.V.T @ cause.V
        variance = size**2 / (1.0 + ratio)
        means.append(cause.V.T @ a)
        covariances.append(scale * (cause.V.T * variance) @ cause.V + size**2 * unseen)
    mean = np.einsum("s,sc->c", share, np.array(means))
    apart = np.array(means) - mean
    inside = np.einsum("s,scd->cd", share, np.array(covariances))
    return mean, inside + np.einsum("s,sc,sd->cd", share, apart, apart)
