"""Normal equations and the restricted likelihood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh
from scipy.linalg.lapack import dpotrf, dtrtri

from calib.units import Array


@dataclass(frozen=True, slots=True, eq=False)
class Priors:
    """What is known of parameters beforehand: x_k ~ N(centre_k, 1 / precision_k)."""

    precision: Array  # (B, p) or (p,); 0 where there is none
    centre: Array  # (p,)


@dataclass(frozen=True, slots=True, eq=False)
class Normal:
    """Weighted normal equations of the measurements, and those of known constraints C x = z, whitened."""

    H: Array  # (B, C, p, p), A_c^T W A_c of each instrument
    g: Array  # (B, C, p), A_c^T W y_c
    yy: Array  # (B, C), y_c^T W y_c
    count: Array  # (B, C), number of scalar measurements, by weight
    known: tuple[Array, Array, float]  # C^T C, C^T z and z^T z
    held: Array  # (p,), the row of C of a combination that is held at zero by choice, not by measurement; else zeros
    log_det: Array | float = (
        0.0  # (B,), of the weighted scalars' covariance, in units of the noise: stops share errors
    )

    def posterior(self, noise: Array, priors: Priors) -> tuple[Array, Array]:
        """Mean (B, p) and covariance (B, p, p) of x, none of what nothing tells, at each instrument's sigma, (B, C)."""
        scaled, scale = self._scaled(noise, priors)
        right = (1.0 / np.square(noise)[:, None] @ self.g)[:, 0] + self.known[1]
        right = right + priors.precision * priors.centre
        C = np.array([inverse(M) for M in scaled]) * (scale[:, :, None] * scale[:, None])
        return (C @ right[:, :, None])[:, :, 0], C

    def _scaled(self, noise: Array, priors: Priors) -> tuple[Array, Array]:
        """The posterior's precision matrix M with a diagonal of ones, and the root of what it was divided by."""
        B, C, p, _ = self.H.shape
        weight = 1.0 / np.square(noise)[:, None]
        M = (weight @ self.H.reshape(B, C, p * p)).reshape(B, p, p) + self.known[0]
        diagonal(M)[...] += priors.precision
        scale = 1.0 / np.sqrt(diagonal(M) + 1e-300)
        return M * (scale[:, :, None] * scale[:, None]), scale

    def residual_square(self, x: Array) -> Array:
        """|y - A x|^2 of each instrument, weighted, never below 0, shape (B, C)."""
        x = x[:, None, :, None]
        square = self.yy + ((self.H @ x - 2.0 * self.g[..., None]) * x)[..., 0].sum(axis=2)
        return np.asarray(np.maximum(square, 0.0))

    def log_likelihood(self, noise: Array, priors: Priors, own: Array) -> Array:
        """The restricted log likelihood of noise and sizes, but for a constant of the flat parameters, shape (B,).

        -1/2 [sum_c N_c log sigma_c^2 + log det K - sum_k log own_k + log det M + y^T P y], with the covariance K of the
        scalars in units of the noise, the posterior's precision M and ``own``, (B, p), the precision of the parameters
        that are not flat. A combination that is held is a condition,
        not an observation: the prior's density of it being zero is divided out.
        """
        scaled, scale = self._scaled(noise, priors)
        values = np.linalg.eigvalsh(scaled)
        log_det = np.sum(np.log(np.maximum(values, 1e-300)) - 2.0 * np.log(scale), axis=1)
        x, _ = self.posterior(noise, priors)
        H, g, zz = self.known
        # Of the priors term by term: one that holds a parameter at a bound would drown the rest in its rounding.
        square = np.sum(priors.precision * (x - priors.centre) ** 2, axis=-1)
        square += np.maximum(zz - 2.0 * (x @ g) + np.sum((x @ H) * x, axis=-1), 0.0)
        square += np.sum(self.residual_square(x) / np.square(noise), axis=1)
        of_priors = np.sum(np.log(np.where(own > 0.0, own, 1.0)), axis=1)
        of_noise = 2.0 * np.sum(self.count * np.log(noise), axis=1)
        of_held = np.log1p(np.sum(self.held_variance(own), axis=1))
        return np.asarray(-0.5 * (of_noise + self.log_det - of_priors + log_det + square - of_held))

    def held_variance(self, own: Array) -> Array:
        """The prior variance of each term of the combination that is held, over its tolerance squared, shape (B, p)."""
        return np.where(own > 0.0, self.held**2 / np.where(own > 0.0, own, 1.0), 0.0)


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


def diagonal(M: Array) -> Array:
    """The diagonals of matrices, shape (B, p), to be written to."""
    return np.asarray(np.einsum("bii->bi", M))
