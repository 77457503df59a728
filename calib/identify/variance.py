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
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.linalg.lapack import dpotrf, dtrtri

Array = NDArray[np.float64]
Masks = tuple[NDArray[np.bool_], ...]

#: sigma of each instrument.
Noise = tuple[float, ...] | Array

#: Bounds of the sizes: far outside of what an arm can have.
_SMALLEST, _LARGEST = 1e-7, 0.1

#: How far the logarithm of a size may fall and rise in one step: where nothing supports a size it falls to its bound.
STEPS_DOWN, STEPS_UP = 3.0, 1.0


@dataclass(frozen=True, slots=True)
class Sizes:
    """The sizes of noise and priors.

    Attributes:
        noise: sigma of each instrument, of a scalar of weight 1, as a factor of the sigmas given.
        families: tau of each family, in the order that they were given in, in the parameters' unit.
    """

    noise: tuple[float, ...]
    families: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What is known of the parameters besides the measurements.

    Attributes:
        precision: shape (p,), 1 / tau^2 of priors whose sizes stay; 0 where there is none.
        centre: shape (p,), the means of these priors.
        H: shape (p, p), C^T C of whitened constraints C x = z, the linearised.
        g: shape (p,), C^T z.
        zz: z^T z.
    """

    precision: Array
    centre: Array
    H: Array
    g: Array
    zz: float = 0.0

    @classmethod
    def of(
        cls,
        precision: Array,
        centre: Array | None = None,
        C: Array | None = None,
        z: Array | None = None,
    ) -> Known:
        """From precisions and means, and the rows of constraints."""
        p = len(precision)
        centre = np.zeros(p) if centre is None else centre
        if C is None or z is None or not len(C):
            return cls(precision, centre, np.zeros((p, p)), np.zeros(p))
        return cls(precision, centre, C.T @ C, C.T @ z, float(z @ z))

    def and_families(self, own: Array) -> Known:
        """With zero-mean priors of these precisions on parameters that have none yet."""
        return Known(self.precision + own, self.centre, self.H, self.g, self.zz)

    def square(self, x: Array) -> float:
        """How far x is from what is known, squared, in standard deviations.

        Of the priors term by term: one that holds a parameter at a bound would drown the rest in its rounding.
        """
        of_priors = float(np.sum(self.precision * (x - self.centre) ** 2))
        return of_priors + max(self.zz - 2.0 * float(self.g @ x) + float(x @ self.H @ x), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """Weighted normal equations of the linearised measurements: all that the likelihood needs.

    Attributes:
        H: shape (C, p, p), A_c^T W A_c of each instrument.
        g: shape (C, p), A_c^T W y_c.
        yy: shape (C,), y_c^T W y_c.
        count: shape (C,), number of scalar measurements, by weight.
    """

    H: Array
    g: Array
    yy: Array
    count: Array

    def posterior(self, noise: Noise, known: Known) -> tuple[Array, Array]:
        """Mean and covariance of x.

        Args:
            noise: sigma of each instrument.
            known: All priors.

        Returns:
            shapes (p,) and (p, p); directions that neither data nor prior determine get no share of either.
        """
        M, right = self._equations(noise, known)
        scale = 1.0 / np.sqrt(M.diagonal() + 1e-300)
        scales = scale[:, None] * scale
        C = inverse(M * scales) * scales
        return C @ right, C

    def _equations(self, noise: Noise, known: Known) -> tuple[Array, Array]:
        """The posterior's precision matrix and the right side, shapes (p, p) and (p,)."""
        weight = 1.0 / np.square(noise)
        M = np.tensordot(weight, self.H, 1) if len(weight) > 1 else weight[0] * self.H[0]
        M += known.H
        M.reshape(-1)[:: len(M) + 1] += known.precision  # the diagonal
        return M, np.asarray(weight @ self.g + known.g + known.precision * known.centre)

    def residual_square(self, x: Array) -> Array:
        """|y - A x|^2 of each instrument, weighted, never below 0, shape (C,)."""
        square = self.yy - 2.0 * (self.g @ x) + (self.H @ x) @ x
        return np.asarray(np.maximum(square, 0.0))

    def log_likelihood(self, noise: tuple[float, ...], known: Known, own: Array) -> float:
        """The restricted log likelihood of noise and sizes, but for a constant of the flat parameters.

        -1/2 [sum_c N_c log sigma_c^2 - sum_k log precision_k + log det M + y^T P y], with the posterior's precision M.

        Args:
            noise: sigma of each instrument.
            known: All priors, at their sizes.
            own: shape (p,), the part of the precisions that is a prior's, not a hold on flat parameters.
        """
        M, _ = self._equations(noise, known)
        scale = 1.0 / np.sqrt(np.diag(M) + 1e-300)
        values = np.linalg.eigvalsh(M * np.outer(scale, scale))
        log_det = float(np.sum(np.log(np.maximum(values, 1e-300))) - 2.0 * np.sum(np.log(scale)))
        x, _ = self.posterior(noise, known)
        square = float(np.sum(self.residual_square(x) / np.square(noise))) + known.square(x)
        priors = float(np.sum(np.log(own[own > 0.0])))
        return -0.5 * (2.0 * float(self.count @ np.log(noise)) - priors + log_det + square)


def sizes_by_reml(
    data: Linearised,
    families: Masks,
    start: Sizes,
    *,
    smallest_noise: tuple[float, ...],
    noise_spread: float = np.inf,
    known: Known | None = None,
    bounds: tuple[tuple[float, float], ...] | None = None,
    iterations: int = 30,
) -> Sizes:
    """The sizes that maximise the restricted marginal likelihood, by damped Fisher scoring on their logarithms.

    Args:
        data: The linearised measurements.
        families: For each family which parameters belong to it, shape (p,).
        start: Where to begin.
        smallest_noise: Lower bound of each sigma.
        noise_spread: How far a sigma may be from 1, as the standard deviation of a normal prior on log sigma. It
            decides where rows are too few to tell noise from error, and is not felt where they are not.
        known: Priors whose sizes are given and stay, and constraints.
        bounds: Smallest and largest size of each family.
        iterations: Limit; a few are enough from a good start.
    """
    logs = np.log(np.array([*start.noise, *start.families]))
    C = len(start.noise)
    p = data.g.shape[1]
    known = Known.of(np.zeros(p)) if known is None else known
    bounds = ((_SMALLEST, _LARGEST),) * len(families) if bounds is None else bounds
    lowest = np.log(np.array([*smallest_noise, *(low for low, _ in bounds)]))
    highest = np.log(np.array([*(1e6 * s for s in start.noise), *(high for _, high in bounds)]))
    logs = clipped(logs, lowest, highest)
    members = np.array(families, dtype=np.float64).reshape(-1, p)
    of_noise = np.arange(len(logs)) < C
    spread = np.where(of_noise, 1.0 / noise_spread**2, 0.0)
    last = np.zeros_like(logs)
    for _ in range(iterations):
        score, information = _score(data, members, known, logs, C)
        score -= spread * logs
        diagonal = information.reshape(-1)[:: len(logs) + 1]
        diagonal += spread
        # A family at its lower bound with a score that points below it stays there.
        held = ((logs <= lowest) & (score < 0)) | ((logs >= highest) & (score > 0))
        if held.all():
            break
        diagonal += 1e-3 * diagonal + 1e-9
        information[held], information[:, held], score[held] = 0.0, 0.0, 0.0
        diagonal[held] = 1.0
        step: Array = clipped(
            np.asarray(np.linalg.solve(information, score)), -STEPS_DOWN, STEPS_UP
        )
        # The expected information may be too small by half: then full steps overshoot, to and fro.
        last = np.where(step * last < 0.0, 0.5 * step, step)
        moved = clipped(logs + last, lowest, highest)
        done = np.abs(moved - logs).max() < 1e-4
        logs = moved
        if done:
            break
    values = np.exp(logs)
    return Sizes(tuple(values[:C].tolist()), tuple(values[C:].tolist()))


def clipped(values: Array, low: Array | float, high: Array | float) -> Array:
    """`numpy.clip` without what it does besides."""
    return np.asarray(np.minimum(np.maximum(values, low), high))


def precision_of(families: Masks, sizes: tuple[float, ...], p: int) -> Array:
    """1 / tau^2 of each parameter, shape (p,); 0 for those of no family."""
    precision = np.zeros(p)
    for members, size in zip(families, sizes, strict=True):
        precision[members] = 1.0 / size**2
    return precision


def inverse(M: Array) -> Array:
    """The inverse of a positive semidefinite matrix of unit diagonal; its pseudo-inverse where it is singular."""
    if not len(M):  # LAPACK refuses it
        return M
    root, failed = dpotrf(M, lower=1, clean=1)
    if not failed and root.diagonal().min(initial=1.0) > 1e-6:
        inverse, _ = dtrtri(root, lower=1)
        return np.asarray(inverse.T @ inverse)
    try:
        return np.asarray(np.linalg.pinv(M, rcond=1e-13, hermitian=True))
    except np.linalg.LinAlgError:
        # Divide and conquer does not converge for some finite singular matrices; QR iterations do.
        return _pseudo_inverse_by_qr(M)


def _pseudo_inverse_by_qr(M: Array) -> Array:
    """The pseudo-inverse of a symmetric matrix, by LAPACK's QR iterations: slower, and a little less exact."""
    values, vectors = eigh(M, driver="ev")
    kept = np.abs(values) > 1e-13 * np.max(np.abs(values), initial=0.0)
    return np.asarray((vectors[:, kept] / values[kept]) @ vectors[:, kept].T)


def _score(
    data: Linearised, families: Masks | Array, known: Known, logs: Array, C: int
) -> tuple[Array, Array]:
    """Gradient of the log likelihood in log sizes, and its expected information."""
    members = np.asarray(families, dtype=np.float64).reshape(len(families), data.g.shape[1])
    values = np.exp(logs)
    noise, sizes = values[:C], values[C:]
    own_precision = (1.0 / sizes**2) @ members
    m, covariance = data.posterior(noise, known.and_families(own_precision))
    square = noise**2
    HC = (data.H @ covariance) / square[:, None, None]
    trace = np.trace(HC, axis1=1, axis2=2)
    score, information = np.empty(len(logs)), np.empty((len(logs), len(logs)))
    score[:C] = data.residual_square(m) / square + trace - data.count
    flat = HC.reshape(C, -1)
    crossed = flat @ HC.transpose(0, 2, 1).reshape(C, -1).T
    information[:C, :C] = 2.0 * crossed
    information.reshape(-1)[: C * len(logs) : len(logs) + 1] += 2.0 * (data.count - 2.0 * trace)
    if len(members):
        both = (covariance * HC.transpose(0, 2, 1)).sum(axis=2)
        score[C:] = members @ (m**2 + covariance.diagonal()) / sizes**2 - members.sum(axis=1)
        information[:C, C:] = 2.0 * (both @ members.T) / sizes**2
        information[C:, :C] = information[:C, C:].T
        root = np.sqrt(own_precision)  # 1 / tau, 0 for those of no family
        block = covariance * (-root[:, None] * root)
        block.reshape(-1)[:: len(root) + 1] += root > 0.0
        information[C:, C:] = 2.0 * (members @ block**2 @ members.T)
    return score, information
