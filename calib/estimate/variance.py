"""How large the errors and the noise are: sizes of the priors from the data.

Every parameter of a family has the prior N(0, tau_f^2); frame and target are flat. The sizes tau_f and the noise
sigma_c of each instrument maximise the restricted marginal likelihood (REML: H. D. Patterson, R. Thompson, 1971) of
the linearised measurements

    y = A x + n,    x_k ~ N(0, tau_f(k)^2),    n ~ N(0, sigma_c^2)

so that a family that the data do not support shrinks to nothing, and what poses cannot tell apart is shared out by
size instead of running away. With C the posterior covariance and m the posterior mean of x, the score is

    dL/dlog tau_f = sum_k (m_k^2 + C_kk) / tau_f^2 - n_f,
    dL/dlog sigma_c = |y - A m|_c^2 / sigma_c^2 + tr(H_c C) / sigma_c^2 - N_c,      H_c = A_c^T A_c

and its expected (Fisher) information has a closed form in C too: a handful of p x p products an iteration.

Several problems are worked on at a time, that differ in the weights of their rows, such as those without one fold each:
B of them are the first axis of every array. A fit is one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.linalg.lapack import dpotrf, dtrtri

Array = NDArray[np.float64]

#: Bounds of the sizes: far outside of what an arm can have.
_SMALLEST, _LARGEST = 1e-7, 0.1

#: How far the logarithm of a size may fall and rise in one step: where nothing supports a size it falls to its bound.
STEPS_DOWN, STEPS_UP = 3.0, 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What is known of the parameters besides the measurements."""

    precision: Array  # shape (B, p) or (p,), 1 / tau^2 of priors; 0 where there is none
    centre: Array  # shape (p,), the means of these priors
    H: Array  # shape (p, p), C^T C of whitened constraints C x = z, the linearised
    g: Array  # shape (p,), C^T z
    zz: float = 0.0  # z^T z

    @classmethod
    def of(
        cls,
        precision: Array,
        centre: Array | None = None,
        C: Array | None = None,
        z: Array | None = None,
    ) -> Known:
        """From precisions and means, and the rows of constraints."""
        p = precision.shape[-1]
        centre = np.zeros(p) if centre is None else centre
        if C is None or z is None or not len(C):
            return cls(precision, centre, np.zeros((p, p)), np.zeros(p))
        return cls(precision, centre, C.T @ C, C.T @ z, float(z @ z))

    def square(self, x: Array) -> Array:
        """How far x, shape (B, p), is from what is known, squared, in standard deviations, shape (B,).

        Of the priors term by term: one that holds a parameter at a bound would drown the rest in its rounding.
        """
        of_priors = np.sum(self.precision * (x - self.centre) ** 2, axis=-1)
        square = self.zz - 2.0 * (x @ self.g) + np.sum((x @ self.H) * x, axis=-1)
        return np.asarray(of_priors + np.maximum(square, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """Weighted normal equations of the linearised measurements: all that the likelihood needs."""

    H: Array  # shape (B, C, p, p), A_c^T W A_c of each instrument
    g: Array  # shape (B, C, p), A_c^T W y_c
    yy: Array  # shape (B, C), y_c^T W y_c
    count: Array  # shape (B, C), number of scalar measurements, by weight

    def at(self, which: NDArray[np.int_]) -> Linearised:
        """Some of the problems."""
        return Linearised(self.H[which], self.g[which], self.yy[which], self.count[which])

    def posterior(self, noise: Array, known: Known) -> tuple[Array, Array]:
        """Mean and covariance of x, shapes (B, p) and (B, p, p), at the sigma of each instrument, shape (B, C).

        Directions that neither data nor prior determine get no share of either.
        """
        M, right = self._equations(noise, known)
        scale = 1.0 / np.sqrt(_diagonal(M) + 1e-300)
        scales = scale[:, :, None] * scale[:, None]
        C = np.array([inverse(one) for one in M * scales]) * scales
        return (C @ right[:, :, None])[:, :, 0], C

    def _equations(self, noise: Array, known: Known) -> tuple[Array, Array]:
        """The posterior's precision matrix and the right side, shapes (B, p, p) and (B, p)."""
        B, C, p, _ = self.H.shape
        weight = 1.0 / np.square(noise)[:, None]
        M = (weight @ self.H.reshape(B, C, p * p)).reshape(B, p, p)
        M += known.H
        _diagonal(M)[...] += known.precision
        return M, (weight @ self.g)[:, 0] + known.g + known.precision * known.centre

    def residual_square(self, x: Array) -> Array:
        """|y - A x|^2 of each instrument, weighted, never below 0, shape (B, C)."""
        x = x[:, None, :, None]
        square = self.yy + ((self.H @ x - 2.0 * self.g[..., None]) * x)[..., 0].sum(axis=2)
        return np.asarray(np.maximum(square, 0.0))

    def log_likelihood(self, noise: Array, known: Known, own: Array) -> Array:
        """The restricted log likelihood of noise and sizes, but for a constant of the flat parameters, shape (B,).

        -1/2 [sum_c N_c log sigma_c^2 - sum_k log precision_k + log det M + y^T P y], with the posterior's precision M.
        """
        M, _ = self._equations(noise, known)
        scale = 1.0 / np.sqrt(_diagonal(M) + 1e-300)
        values = np.linalg.eigvalsh(M * scale[:, :, None] * scale[:, None])
        log_det = np.sum(np.log(np.maximum(values, 1e-300)) - 2.0 * np.log(scale), axis=1)
        x, _ = self.posterior(noise, known)
        square = np.sum(self.residual_square(x) / np.square(noise), axis=1) + known.square(x)
        priors = np.sum(np.log(np.where(own > 0.0, own, 1.0)), axis=1)
        of_noise = 2.0 * np.sum(self.count * np.log(noise), axis=1)
        return np.asarray(-0.5 * (of_noise - priors + log_det + square))


def sizes_by_reml(
    data: Linearised,
    families: NDArray[np.bool_],
    noise: Array,
    sizes: Array,
    *,
    smallest_noise: tuple[float, ...],
    noise_spread: float = np.inf,
    known: Known | None = None,
    bounds: tuple[tuple[float, float], ...] | None = None,
    iterations: int = 30,
) -> tuple[Array, Array]:
    """The sizes that maximise the restricted marginal likelihood, by damped Fisher scoring on their logarithms.

    families, shape (K, p), says which parameters belong to each; noise, shape (B, C), of each instrument over the
    sigma given, and sizes, shape (B, K), are where to begin, with a smallest noise of each instrument and bounds of
    each family's size. noise_spread is how far a sigma may be from 1, as the standard deviation of a normal prior on
    log sigma: it decides where rows are too few to tell noise from error, and is not felt where they are not. known
    are priors that stay.

    Returns:
        Noise and sizes, of the same shapes.
    """
    C, p = data.g.shape[1:]
    known = Known.of(np.zeros(p)) if known is None else known
    bounds = ((_SMALLEST, _LARGEST),) * len(families) if bounds is None else bounds
    start = np.hstack([noise, sizes])
    lowest = np.log(np.array([*smallest_noise, *(low for low, _ in bounds)]))
    highest = np.log(
        np.hstack([1e6 * noise, np.tile([high for _, high in bounds], (len(noise), 1))])
    )
    logs = np.clip(np.log(start), lowest, highest)
    members = np.asarray(families, dtype=np.float64).reshape(-1, p)
    spread = np.where(np.arange(start.shape[1]) < C, 1.0 / noise_spread**2, 0.0)
    last = np.zeros_like(logs)
    going = np.arange(len(logs))
    for _ in range(iterations):
        at, high = logs[going], highest[going]
        held_by = (
            known if known.precision.ndim == 1 else replace(known, precision=known.precision[going])
        )
        score, information = _score(data.at(going), members, held_by, at)
        score -= spread * at
        diagonal = _diagonal(information)
        diagonal += spread
        diagonal += 1e-3 * diagonal + 1e-9
        # A family at its lower bound with a score that points below it stays there.
        held = ((at <= lowest) & (score < 0)) | ((at >= high) & (score > 0))
        score[held] = 0.0
        information[held[:, :, None] | held[:, None]] = 0.0
        diagonal[held] = 1.0
        step = np.linalg.solve(information, score[:, :, None])[:, :, 0]
        step = np.clip(step, -STEPS_DOWN, STEPS_UP)
        # The expected information may be too small by half: then full steps overshoot, to and fro.
        last[going] = step = np.where(step * last[going] < 0.0, 0.5 * step, step)
        logs[going] = moved = np.clip(at + step, lowest, high)
        going = going[np.abs(moved - at).max(axis=1) >= 1e-4]
        if not len(going):
            break
    values = np.exp(logs)
    return values[:, :C], values[:, C:]


def inverse(M: Array) -> Array:
    """The inverse of a positive semidefinite matrix of unit diagonal; its pseudo-inverse where it is singular."""
    if not len(M):  # LAPACK refuses it
        return M
    root, failed = dpotrf(M, lower=1, clean=1)
    if not failed and root.diagonal().min(initial=1.0) > 1e-6:
        inverse, _ = dtrtri(root, lower=1)
        return np.asarray(inverse.T @ inverse)
    values, vectors = eigh(M, driver="ev")  # divide and conquer does not converge for some of them
    kept = np.abs(values) > 1e-13 * np.max(np.abs(values), initial=0.0)
    return np.asarray((vectors[:, kept] / values[kept]) @ vectors[:, kept].T)


def _diagonal(M: Array) -> Array:
    """The diagonals of matrices, shape (B, p), to be written to."""
    found: Array = np.einsum("bii->bi", M)
    return found


def _score(data: Linearised, members: Array, known: Known, logs: Array) -> tuple[Array, Array]:
    """Gradient of the log likelihood in log sizes, and its expected information."""
    B, C, p = data.g.shape
    values = np.exp(logs)
    noise, sizes = values[:, :C], values[:, C:]
    own = (1.0 / sizes**2) @ members
    m, covariance = data.posterior(noise, replace(known, precision=known.precision + own))
    HC = (data.H @ covariance[:, None]) / np.square(noise)[:, :, None, None]
    turned = HC.swapaxes(2, 3)
    trace = np.trace(HC, axis1=2, axis2=3)
    score, information = np.empty(logs.shape), np.empty((*logs.shape, logs.shape[1]))
    score[:, :C] = data.residual_square(m) / np.square(noise) + trace - data.count
    crossed = HC.reshape(B, C, p * p) @ turned.reshape(B, C, p * p).swapaxes(1, 2)
    information[:, :C, :C] = 2.0 * crossed
    _diagonal(information)[:, :C] += 2.0 * (data.count - 2.0 * trace)
    if len(members):
        both = (covariance[:, None] * turned).sum(axis=3)
        square = (m**2 + _diagonal(covariance)) @ members.T
        score[:, C:] = square / sizes**2 - members.sum(axis=1)
        information[:, :C, C:] = 2.0 * (both @ members.T) / sizes[:, None] ** 2
        information[:, C:, :C] = information[:, :C, C:].swapaxes(1, 2)
        root = np.sqrt(own)  # 1 / tau, 0 for those of no family
        block = covariance * (-root[:, :, None] * root[:, None])
        _diagonal(block)[...] += root > 0.0
        information[:, C:, C:] = 2.0 * (members @ block**2 @ members.T)
    return score, information
