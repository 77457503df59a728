"""Normal equations of a linear model with normal priors: posterior, and restricted likelihood of noise and priors.

Measurements y = A x + n of C channels, n of variance sigma_c^2 / w for a row of weight w, and priors
x_k ~ N(m_k, 1 / precision_k) have the posterior precision, covariance and mean

    M = sum_c A_c^T W A_c / sigma_c^2 + diag(precision),    C = M^-1,
    x = C (sum_c A_c^T W y_c / sigma_c^2 + precision m)

Parameters of the measurement setup are flat: their prior is too wide to count. The likelihood is restricted: it is
integrated over all parameters (H. D. Patterson, R. Thompson, 1971).

B fits that differ in the weights of their rows are computed together: they are the first axis of all arrays. Letters of
shapes: B fits, C channels, D scalars of a row, N rows, p parameters, K families of parameters. The noise of a channel
is a standard deviation in units of the given sigma.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh
from scipy.linalg.lapack import dpotrf, dtrtri

from calib.basics.arrays import Array, Integers

#: Divisor and logarithm in place of zero.
_TINY = 1e-300

#: A matrix of unit diagonal is inverted by its Cholesky factor if no diagonal entry of that is smaller.
_SINGULAR = 1e-6

#: Eigenvalues below this share of the largest count as zero.
_ZERO_EIGENVALUE = 1e-13


@dataclass(frozen=True, slots=True, eq=False)
class GaussianPriors:
    """Independent priors x_k ~ N(centre_k, 1 / precision_k) of p parameters, known before the fit."""

    #: (B, p) or (p,); 0 for a parameter without prior
    precision: Array
    #: (p,), means
    centre: Array


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """Sums over the rows that B linear fits need, and over constraints C x = z that are known, whitened."""

    #: (B, C, p, p), A_c^T W A_c of each channel, A in units of the given sigma
    H: Array
    #: (B, C, p), A_c^T W y_c
    g: Array
    #: (B, C), y_c^T W y_c
    yy: Array
    #: (B, C), number of scalars, by weight
    count: Array
    #: C^T C, C^T z and z^T z, of shapes (p, p), (p,) and ()
    known: tuple[Array, Array, float]
    #: (p,), row of C of a combination that is held at zero by choice, not by measurement; zeros if there is none
    held: Array
    #: (B,), log determinant of the weighted scalars' covariance over the noise; 0 where scalars are independent of each
    #: other
    log_det: Array | float = 0.0

    def posterior(self, noise: Array, priors: GaussianPriors) -> tuple[Array, Array]:
        """Compute the posterior of the parameters.

        Args:
            noise: shape (B, C), of each channel.
            priors: Normal priors of all p parameters.

        Returns:
            The mean x, shape (B, p), and its covariance, shape (B, p, p); both zero along unobservable directions.
        """
        M, scale = self._scaled_precision(noise, priors)
        covariance = np.array([pseudo_inverse(of_fit) for of_fit in M])
        covariance *= _outer(scale)
        _, Cz, _ = self.known
        weight = 1.0 / np.square(noise)[:, None]
        right = (weight @ self.g)[:, 0] + Cz
        right = right + priors.precision * priors.centre
        mean = covariance @ right[:, :, None]
        return mean[:, :, 0], covariance

    def _scaled_precision(self, noise: Array, priors: GaussianPriors) -> tuple[Array, Array]:
        """Return S M S, shape (B, p, p), of the posterior precision M, and the scale 1 / sqrt(diag M), shape (B, p)."""
        B, C, p, _ = self.H.shape
        CC, _, _ = self.known
        weight = 1.0 / np.square(noise)[:, None]
        of_rows = weight @ self.H.reshape(B, C, p * p)
        M = of_rows.reshape(B, p, p) + CC
        diagonals(M)[...] += priors.precision
        scale = 1.0 / np.sqrt(diagonals(M) + _TINY)
        M *= _outer(scale)
        return M, scale

    def residual_square(self, x: Array) -> Array:
        """Return the weighted sum of squared residuals of each channel, |y - A x|^2 = y^T W y + (H x - 2 g)^T x.

        Args:
            x: shape (B, p), parameters of each fit.

        Returns:
            shape (B, C), in units of the given sigma squared, never below 0.
        """
        column = x[:, None, :, None]
        terms = (self.H @ column - 2.0 * self.g[..., None]) * column
        change = terms[..., 0].sum(axis=2)
        return np.asarray(np.maximum(self.yy + change, 0.0))

    def log_likelihood(
        self,
        noise: Array,
        priors: GaussianPriors,
        family_precision: Array,
    ) -> Array:
        """Compute the restricted log-likelihood of noise and priors, up to a constant of the flat parameters.

        With the covariance V of the scalars in units of the noise and the posterior precision M it is

            -1/2 [sum_c N_c log sigma_c^2 + log det V - sum_k log family_precision_k + log det M + y^T P y]

        where y^T P y are the weighted squares of measurements, constraints and priors at the posterior mean. A
        combination that is held is a condition, not an observation: the prior density that it is zero is divided out.

        Args:
            noise: shape (B, C), of each channel.
            priors: Normal priors of all p parameters.
            family_precision: shape (B, p), prior precision of the parameters that are not flat; 0 for flat ones.

        Returns:
            shape (B,).
        """
        x, _ = self.posterior(noise, priors)
        CC, Cz, zz = self.known
        # The priors' squares term by term: a parameter held at its bound would drown the others in its rounding.
        square = np.sum(priors.precision * (x - priors.centre) ** 2, axis=-1)
        constraints = zz - 2.0 * (x @ Cz) + np.sum((x @ CC) * x, axis=-1)
        square += np.maximum(constraints, 0.0)
        square += np.sum(self.residual_square(x) / np.square(noise), axis=1)

        M, scale = self._scaled_precision(noise, priors)
        eigenvalues = np.maximum(np.linalg.eigvalsh(M), _TINY)
        log_det_M = np.sum(np.log(eigenvalues) - 2.0 * np.log(scale), axis=1)
        proper = family_precision > 0.0
        log_precision = np.log(np.where(proper, family_precision, 1.0))
        log_det_priors = np.sum(log_precision, axis=1)
        log_det_noise = 2.0 * np.sum(self.count * np.log(noise), axis=1)
        held_variance = np.sum(self.held_variance(family_precision), axis=1)
        twice = log_det_noise + self.log_det - log_det_priors + log_det_M + square
        twice -= np.log1p(held_variance)
        return np.asarray(-0.5 * twice)

    def held_variance(self, family_precision: Array) -> Array:
        """Return the prior variance of each term of the held combination, over the square of its tolerance.

        Args:
            family_precision: shape (B, p), prior precision of the parameters that are not flat; 0 for flat ones.

        Returns:
            shape (B, p), 0 for parameters without prior; the sum over p is the combination's variance.
        """
        proper = family_precision > 0.0
        divisor = np.where(proper, family_precision, 1.0)
        return np.where(proper, self.held**2 / divisor, 0.0)

    def without(self, part: NormalEquations) -> NormalEquations:
        """Return the equations without some of the rows, whose own ones are given; the constraints stay."""
        return replace(
            self,
            H=self.H - part.H,
            g=self.g - part.g,
            yy=self.yy - part.yy,
            count=self.count - part.count,
        )

    def times(self, factor: float) -> NormalEquations:
        """Return the equations of rows whose weights are all multiplied by a factor; constraints stay."""
        return replace(
            self,
            H=factor * self.H,
            g=factor * self.g,
            yy=factor * self.yy,
            count=factor * self.count,
        )

    def of_fits(self, which: Integers) -> NormalEquations:
        """Return the equations of some of the B fits, by their indices from 0, shape (b,)."""
        return replace(
            self,
            H=self.H[which],
            g=self.g[which],
            yy=self.yy[which],
            count=self.count[which],
            log_det=np.broadcast_to(self.log_det, len(self.g))[which],
        )


def pseudo_inverse(M: Array) -> Array:
    """Return the inverse of a positive semidefinite matrix, its pseudo-inverse where it is singular.

    Args:
        M: shape (p, p), of unit diagonal.

    Returns:
        shape (p, p).
    """
    if not len(M):  # LAPACK refuses it
        return M
    root, failed = dpotrf(M, lower=1, clean=1)
    if not failed and root.diagonal().min() > _SINGULAR:
        inverse, _ = dtrtri(root, lower=1)
        return np.asarray(inverse.T @ inverse)
    # Divide and conquer does not converge for some matrices.
    values, vectors = eigh(M, driver="ev")
    size = np.abs(values)
    kept = size > _ZERO_EIGENVALUE * np.max(size)
    scaled = vectors[:, kept] / values[kept]
    return np.asarray(scaled @ vectors[:, kept].T)


def _outer(scale: Array) -> Array:
    """Return the products s_i s_j of vectors s, shape (B, p), as matrices of shape (B, p, p)."""
    return scale[:, :, None] * scale[:, None]


def diagonals(M: Array) -> Array:
    """Return a view of the diagonals of matrices (B, p, p), shape (B, p): writing to it changes M."""
    if not M.flags.c_contiguous:
        return np.asarray(np.einsum("bii->bi", M))
    return M.reshape(len(M), -1)[:, :: M.shape[-1] + 1]  # in half the time
