"""The problem linearised: its normal equations, fits and scores are matrix algebra, without the robot.

At x0 the residual is r and the Jacobian of the prediction A, both in units of each scalar's given sigma, so that

    residual(x) = r - A (x - x0) = y - A x        with y = r + A x0

B fits that differ in the weights of their rows are computed together. Letters of shapes: see `calib.estimate.problem`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.estimate.stop_errors import Stops
from calib.numerics.likelihood import GaussianPriors, NormalEquations
from calib.numerics.scores import deleted_norms, point_scores
from calib.robot.kernel import over_blocks
from calib.units import Array, Mask

#: Normal equations that are kept, because stages ask for the same ones again.
_KEPT = 3


class _Kept(NamedTuple):
    """Normal equations that were computed, and for which weights and shares of stops."""

    #: (B, N)
    weights: Array
    #: (C, 2) or (B, C, 2)
    rho: Array
    equations: NormalEquations

    def is_for(self, weights: Array, rho: Array) -> bool:
        """True if they are those of weights (B, N) and shares rho."""
        return np.array_equal(self.weights, weights) and np.array_equal(self.rho, rho)


@dataclass(frozen=True, slots=True, eq=False)
class LinearProblem:
    """N rows of D scalars linearised at x, by p parameters, in units of each scalar's given sigma."""

    #: (p,), x0, where the problem is linearised
    x: Array
    # (p + 1, D, N): the Jacobian A of the prediction, and behind it the residual r at x0
    columns: Array
    #: (N, D), which scalars were measured
    used: Mask
    # (N, D), which noise each scalar has, from 0; -1 where there is none
    instruments: NDArray[np.int8]
    # (C,), lowest noise of each instrument, in units of the given sigma
    smallest_noise: tuple[float, ...]
    #: (K, p), rows of constraints C x = z, whitened: known distances, last what is held
    C: Array
    #: (K,), value of each constraint
    z: Array
    #: (p,), see `NormalEquations.held`
    held: Array
    #: Where the robot stood while several targets were measured
    stops: Stops | None = None
    #: The latest first
    _cache: list[_Kept] = field(init=False, repr=False, default_factory=list)

    def __len__(self) -> int:
        """Number of rows N."""
        return int(self.columns.shape[2])

    @property
    def A(self) -> Array:
        """Jacobian of the prediction, shape (N, D, p), in units of each scalar's given sigma."""
        return np.asarray(self.columns[:-1].transpose(2, 1, 0))

    def noise_by_scalar(self, noise: Array) -> Array:
        """Return the noise of each scalar.

        Args:
            noise: shape (B, C), of each instrument, in units of the given sigma.

        Returns:
            shape (B, N, D); 1 where there is no scalar.
        """
        without_instrument = np.ones((len(noise), 1))
        return np.hstack([noise, without_instrument])[:, self.instruments]

    def residual(self, x: Array) -> Array:
        """Return the residual y - A x of the linear model.

        Args:
            x: shape (p,), or (B, p) for B fits.

        Returns:
            shape (N, D) or (B, N, D), in units of each scalar's given sigma.
        """
        count, D, N = self.columns.shape
        flat = self.columns.reshape(count, D * N)
        residual = flat[-1] - (x - self.x) @ flat[:-1]
        return np.asarray(residual.reshape(*x.shape[:-1], D, N).swapaxes(-1, -2))

    def select(self, mask: Mask) -> LinearProblem:
        """Return the problem of some of the rows, by a mask (N,); constraints stay."""
        return replace(
            self,
            columns=self.columns[:, :, mask],
            used=self.used[mask],
            instruments=self.instruments[mask],
            stops=None if self.stops is None else self.stops.select(mask),
        )

    def normal_equations(self, weights: Array, rho: Array) -> NormalEquations:
        """Return the normal equations of B fits, the latest of which are kept.

        Args:
            weights: shape (B, N), of the rows.
            rho: shape (C, 2) or (B, C, 2), shares of each instrument's variance that the targets of a stop have in
                common; see `calib.estimate.stop_errors`.
        """
        for kept in self._cache:
            if kept.is_for(weights, rho):
                return kept.equations
        equations = self._sum_normal_equations(weights, rho)
        latest = _Kept(weights.copy(), rho.copy(), equations)
        self._cache[:] = [latest, *self._cache[: _KEPT - 1]]
        return equations

    def _sum_normal_equations(self, weights: Array, rho: Array) -> NormalEquations:
        """The normal equations; arguments as of `normal_equations`."""
        p, B, C = len(self.x), len(weights), len(self.smallest_noise)
        products = np.zeros((B, C, p + 1, p + 1))
        count = np.zeros((B, C))
        for c in range(C):
            of_instrument = np.equal(self.instruments.T, c)
            count[:, c] = weights @ of_instrument.sum(axis=0, dtype=np.float64)
            products[:, c] = self._weighted_products(np.sqrt(weights), of_instrument)
        log_det: Array | float = 0.0
        if self.stops is not None and np.any(rho):
            shares = np.broadcast_to(rho, (B, C, 2))
            changes, log_det = self.stops.corrections(self.columns, weights, shares)
            products += changes
        # These are products of [A r]; those of [A y] with y = r + A x0 follow.
        H, g, rr = products[..., :p, :p], products[..., :p, p], products[..., p, p]
        Hx = H @ self.x
        known = (self.C.T @ self.C, self.C.T @ self.z, float(self.z @ self.z))
        yy = rr + (2.0 * g + Hx) @ self.x
        return NormalEquations(H, g + Hx, yy, count, known, self.held, log_det)

    def _weighted_products(self, root_weights: Array, of_instrument: Mask) -> Array:
        """[A r]^T W [A r] over the scalars of one instrument, shape (B, p + 1, p + 1).

        Args:
            root_weights: shape (B, N), square roots of the rows' weights.
            of_instrument: shape (D, N), which scalars are of the instrument.
        """
        columns_with_any = np.flatnonzero(of_instrument.any(axis=1))
        first = columns_with_any.min(initial=len(of_instrument))
        last = columns_with_any.max(initial=-1)
        scalars = slice(first, last + 1)
        factor = root_weights[:, None] * of_instrument[scalars]

        def product(rows: slice) -> Array:
            columns = self.columns[:, scalars, rows]
            of_fits = []
            for factor_of_fit in factor[:, :, rows]:
                part = (columns * factor_of_fit).reshape(len(columns), -1)
                of_fits.append(part @ part.T)
            return np.array(of_fits)

        return np.asarray(np.sum(over_blocks(product, len(self)), axis=0))

    def fit(
        self, weights: Array, rho: Array, noise: Array, priors: GaussianPriors
    ) -> tuple[Array, Array, Array]:
        """Fit the parameters B times, at given weights, noise and priors.

        Args:
            weights: shape (B, N), of the rows.
            rho: shape (C, 2) or (B, C, 2), shares of stops.
            noise: shape (B, C), of each instrument, in units of the given sigma.
            priors: Of all p parameters.

        Returns:
            x, shape (B, p), its covariance, shape (B, p, p), and the degrees of freedom left for the noise, shape (B,).
        """
        equations = self.normal_equations(weights, rho)
        x, covariance = equations.posterior(noise, priors)
        spent = np.sum(equations.H * covariance[:, None], axis=(2, 3)) / np.square(noise)
        return x, covariance, np.sum(equations.count - spent, axis=1)

    def scores(self, x: Array, covariance: Array, weights: Array, noise: Array) -> Array:
        """Score the rows by their deleted residuals; see `calib.numerics.scores`.

        Args:
            x: shape (B, p), of each fit.
            covariance: shape (B, p, p), of x.
            weights: shape (B, N), of the rows in each fit; 0 for held-out rows.
            noise: shape (B, C), of each instrument, in units of the given sigma.

        Returns:
            shape (B, N), >= 0, in standard deviations. Rows of more or fewer scalars are scored by what three scalars
                of the same probability would have.
        """
        norms = self.norms(x, covariance, weights, 1.0 / self.noise_by_scalar(noise))
        return point_scores(norms, np.sum(self.used, axis=1))

    def norms(self, x: Array, covariance: Array, weights: Array, factors: Array) -> Array:
        """Compute the norms of the rows' deleted residuals; arguments as of `calib.numerics.scores.deleted_norms`.

        Args:
            x: shape (B, p), of each fit.
            covariance: shape (B, p, p), of x.
            weights: shape (B, N), of the rows in each fit.
            factors: shape (B or 1, N, D), by which residuals in units of the given sigma are multiplied.
        """
        return deleted_norms(self.residual(x), self.A, covariance, weights, factors)

    def stop_shares(self, x: Array, covariance: Array, weights: Array, rho: Array) -> Array:
        """Estimate, from the residuals of B fits, the shares of variance that the targets of a stop have in common.

        Args:
            x: shape (B, p), of each fit.
            covariance: shape (B, p, p), of x.
            weights: shape (B, N), of the rows in each fit.
            rho: shape (B, C, 2), shares to begin with, those of the fits.

        Returns:
            shape (B, C, 2), of translations and rotations; 0 without stops.
        """
        result = np.zeros(rho.shape)
        if self.stops is None:
            return result
        for b, c in np.ndindex(*rho.shape[:2]):
            moments = self.stops.moments(self.columns, weights[b], c, x[b] - self.x, covariance[b])
            result[b, c] = moments.shares(rho[b, c])
        return result
