"""How large the errors and the noise are: sizes of the priors from the data.

Every parameter of a family has the prior N(0, tau_f^2); frame and target are flat. The sizes tau_f and the noise
sigma maximise the restricted marginal likelihood (REML: H. D. Patterson, R. Thompson, 1971) of the linearised
measurements

    y = A x + n,    x_k ~ N(0, tau_f(k)^2),    n ~ N(0, sigma^2)

so that a family that the data do not support shrinks to nothing, and what poses cannot tell apart is shared out by
size instead of running away. With C the posterior covariance and m the posterior mean of x, the score is

    dL/dlog tau_f = sum_k (m_k^2 + C_kk) / tau_f^2 - n_f,
    dL/dlog sigma = |y - A m|^2 / sigma^2 + tr(H C) / sigma^2 - N,      H = A^T A

and its expected (Fisher) information has a closed form in C too: a handful of p x p products an iteration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Bounds of the sizes, [m or rad] and as a share of the noise's unit: far outside of what an arm can have.
_SMALLEST, _LARGEST = 1e-7, 0.1


@dataclass(frozen=True, slots=True)
class Sizes:
    """The sizes of noise and priors.

    Attributes:
        noise: sigma, standard deviation of one coordinate of a row of weight 1 [m], or the factor of the sigmas given.
        families: tau of each family, in the order that they were given in [m or rad].
    """

    noise: float
    families: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """Weighted normal equations of the linearised measurements: all that the likelihood needs.

    Attributes:
        H: shape (p, p), A^T W A.
        g: shape (p,), A^T W y.
        yy: y^T W y.
        count: Number of scalar measurements, by weight.
    """

    H: Array
    g: Array
    yy: float
    count: float

    @classmethod
    def of(cls, A: Array, y: Array, weights: Array) -> Linearised:
        """From rows.

        Args:
            A: shape (N, 3, p), derivative of the prediction, in units of the row's sigma.
            y: shape (N, 3), residual at x = 0 of the linearised model, likewise.
            weights: shape (N,), between 0 and 1.
        """
        root = np.sqrt(weights)[:, None]
        flat = (A * root[:, :, None]).reshape(-1, A.shape[2])
        target = (y * root).ravel()
        H: Array = flat.T @ flat
        return cls(H, flat.T @ target, float(target @ target), float(3.0 * np.sum(weights)))

    def posterior(self, noise: float, precision: Array) -> tuple[Array, Array]:
        """Mean and covariance of x.

        Args:
            noise: sigma.
            precision: shape (p,), 1 / tau^2 of each parameter, 0 where flat.

        Returns:
            shapes (p,) and (p, p); directions that neither data nor prior determine get no share of either.
        """
        scale = 1.0 / np.sqrt(np.diag(self.H) / noise**2 + precision + 1e-300)
        M = (self.H / noise**2 + np.diag(precision)) * np.outer(scale, scale)
        C = _inverse(M) * np.outer(scale, scale)
        return C @ (self.g / noise**2), C

    def residual_square(self, x: Array) -> float:
        """|y - A x|^2, weighted, never below 0."""
        return max(self.yy - 2.0 * float(self.g @ x) + float(x @ self.H @ x), 0.0)


def sizes_by_reml(
    data: Linearised,
    families: tuple[NDArray[np.bool_], ...],
    start: Sizes,
    *,
    smallest_noise: float,
    noise_spread: float = np.inf,
    known: Array | None = None,
    iterations: int = 30,
) -> Sizes:
    """The sizes that maximise the restricted marginal likelihood, by damped Fisher scoring on their logarithms.

    Args:
        data: The linearised measurements.
        families: For each family which parameters belong to it, shape (p,).
        start: Where to begin.
        smallest_noise: Lower bound of sigma.
        noise_spread: How far sigma may be from 1, as the standard deviation of a normal prior on log sigma. It decides
            where rows are too few to tell noise from error, and is not felt where they are not.
        known: shape (p,), precision of priors whose sizes are given and stay.
        iterations: Limit; a few are enough from a good start.
    """
    logs = np.log(np.array([start.noise, *start.families]))
    known = np.zeros(len(data.g)) if known is None else known
    lowest = np.log(np.array([smallest_noise] + [_SMALLEST] * len(families)))
    highest = np.log(np.array([1e6 * start.noise] + [_LARGEST] * len(families)))
    logs = np.clip(logs, lowest, highest)
    for _ in range(iterations):
        score, information = _score(data, families, known, logs)
        score[0] -= logs[0] / noise_spread**2
        information[0, 0] += 1.0 / noise_spread**2
        # A family at its lower bound with a score that points below it stays there.
        free = ~((logs <= lowest) & (score < 0)) & ~((logs >= highest) & (score > 0))
        if not np.any(free):
            break
        part = information[np.ix_(free, free)]
        part = part + np.diag(1e-3 * np.diag(part) + 1e-9)
        step = np.zeros_like(logs)
        step[free] = np.clip(np.linalg.solve(part, score[free]), -1.0, 1.0)
        moved = np.clip(logs + step, lowest, highest)
        done = np.max(np.abs(moved - logs)) < 1e-4
        logs = moved
        if done:
            break
    values = np.exp(logs)
    return Sizes(float(values[0]), tuple(float(v) for v in values[1:]))


def precision_of(
    families: tuple[NDArray[np.bool_], ...], sizes: tuple[float, ...], p: int
) -> Array:
    """1 / tau^2 of each parameter, shape (p,); 0 for those of no family."""
    precision = np.zeros(p)
    for members, size in zip(families, sizes, strict=True):
        precision[members] = 1.0 / size**2
    return precision


def _inverse(M: Array) -> Array:
    """The inverse of a positive semidefinite matrix of unit diagonal; its pseudo-inverse where it is singular."""
    try:
        root = np.asarray(np.linalg.cholesky(M))
    except np.linalg.LinAlgError:
        root = np.zeros_like(M)
    if np.min(np.diag(root), initial=1.0) > 1e-6:
        inverse = np.asarray(np.linalg.inv(root))
        return np.asarray(inverse.T @ inverse)
    return np.asarray(np.linalg.pinv(M, rcond=1e-13, hermitian=True))


def _score(
    data: Linearised, families: tuple[NDArray[np.bool_], ...], known: Array, logs: Array
) -> tuple[Array, Array]:
    """Gradient of the log likelihood in log sizes, and its expected information."""
    values = np.exp(logs)
    noise, sizes = float(values[0]), values[1:]
    precision = known + precision_of(families, tuple(sizes), len(data.g))
    m, C = data.posterior(noise, precision)
    HC = (data.H @ C) / noise**2
    trace = float(np.trace(HC))
    k = len(families)
    indices = [np.flatnonzero(members) for members in families]
    score, information = np.empty(k + 1), np.empty((k + 1, k + 1))
    score[0] = data.residual_square(m) / noise**2 + trace - data.count
    information[0, 0] = 2.0 * (data.count - 2.0 * trace + float(np.sum(HC * HC.T)))
    variance, both = np.diag(C), np.einsum("ij,ji->i", C, HC)
    for i, own in enumerate(indices):
        score[i + 1] = float(np.sum(m[own] ** 2 + variance[own])) / sizes[i] ** 2 - len(own)
        information[0, i + 1] = information[i + 1, 0] = (
            2.0 * float(np.sum(both[own])) / sizes[i] ** 2
        )
        for j, others in enumerate(indices):
            block = -C[own[:, None], others] / (sizes[i] * sizes[j])
            if i == j:
                block = block + np.eye(len(block))
            information[i + 1, j + 1] = 2.0 * float(np.sum(block**2))
    return score, information
