"""The linearised problem."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from calib.estimate.stop_errors import Stops
from calib.numerics.likelihood import GaussianPriors, NormalEquations
from calib.numerics.scores import deleted_norms, point_scores
from calib.robot.kernel import over_blocks
from calib.units import Array, Mask

#: NormalEquations equations that are kept.
_KEPT = 3


@dataclass(frozen=True, slots=True, eq=False)
class Linear:
    """The problem linearised at x: the residual at x + s is r - A s, in units of each scalar's sigma as given."""

    x: Array  # (p,)
    columns: Array  # (p + 1, D, N), A and behind it r
    used: Mask  # (N, D), which scalars there are
    instruments: NDArray[np.int8]  # (N, D), which noise each has; -1 for none
    smallest: tuple[float, ...]  # Smallest noise believed of each instrument, in units of its sigma
    C: Array  # (K, p), of the known distances and of what is held, whitened
    z: Array  # (K,), what C x should be
    held: Array  # (p,), see `NormalEquations`
    stops: Stops | None = None  # Where several targets were seen
    _made: list[tuple[Array, Array, NormalEquations]] = field(
        init=False, repr=False, default_factory=list
    )

    def __len__(self) -> int:
        """Number of rows."""
        return int(self.columns.shape[2])

    @property
    def A(self) -> Array:
        """The derivative of the prediction, shape (N, D, p)."""
        return np.asarray(self.columns[:-1].transpose(2, 1, 0))

    def noise_of(self, noise: Array) -> Array:
        """Of each scalar, shape (B, N, D), with that of each instrument, shape (B, C); 1 where there is no scalar."""
        return np.hstack([noise, np.ones((len(noise), 1))])[:, self.instruments]

    def residual(self, x: Array) -> Array:
        """What x, shape (B, p) or (p,), leaves over, shape (B, N, D) or (N, D)."""
        count, D, N = self.columns.shape
        flat = self.columns.reshape(count, D * N)
        found = flat[-1] - (x - self.x) @ flat[:-1]
        return np.asarray(found.reshape(*x.shape[:-1], D, N).swapaxes(-1, -2))

    def select(self, mask: Mask) -> Linear:
        """The problem of some of the rows; known distances stay."""
        columns, instruments = self.columns[:, :, mask], self.instruments[mask]
        stops = None if self.stops is None else self.stops.select(mask)
        return replace(
            self, columns=columns, used=self.used[mask], instruments=instruments, stops=stops
        )

    def data(self, weights: Array, rho: Array) -> NormalEquations:
        """The normal equations with these weights, (B, N), and shares of stops, (C, 2) or (B, C, 2).

        The last ones are kept, for stages ask again.
        """
        for last, shares, made in self._made:
            if np.array_equal(last, weights) and np.array_equal(shares, rho):
                return made
        p, (B, N), C = len(self.x), weights.shape, len(self.smallest)
        both, count, root = np.zeros((B, C, p + 1, p + 1)), np.zeros((B, C)), np.sqrt(weights)
        for c in range(C):
            own = np.equal(self.instruments.T, c)
            count[:, c] = weights @ own.sum(axis=0, dtype=np.float64)
            there = np.flatnonzero(own.any(axis=1))
            at = slice(there.min(initial=len(own)), there.max(initial=-1) + 1)
            factor = root[:, None] * own[at]

            def product(own: slice, at: slice = at, factor: Array = factor) -> Array:
                columns, f = self.columns[:, at, own], factor[:, :, own]
                parts = ((columns * one).reshape(p + 1, -1) for one in f)
                return np.array([part @ part.T for part in parts])

            both[:, c] = np.sum(over_blocks(product, N), axis=0)
        log_det: Array | float = 0.0
        if self.stops is not None and np.any(rho):
            shares = np.broadcast_to(rho, (B, C, 2))
            changes, log_det = self.stops.corrections(self.columns, weights, shares)
            both += changes
        # [A r] are at hand; what is asked for is [A y] with y = r + A x.
        H, g, rr = both[..., :p, :p], both[..., :p, p], both[..., p, p]
        Hx, known = H @ self.x, (self.C.T @ self.C, self.C.T @ self.z, float(self.z @ self.z))
        made = NormalEquations(
            H, g + Hx, rr + (2.0 * g + Hx) @ self.x, count, known, self.held, log_det
        )
        self._made[:] = [(weights.copy(), rho.copy(), made), *self._made[: _KEPT - 1]]
        return made

    def fit(
        self, weights: Array, rho: Array, noise: Array, priors: GaussianPriors
    ) -> tuple[Array, Array, Array]:
        """The linear fit with weights, shares of stops, noise and priors.

        Returns:
            x (B, p), its covariance (B, p, p), degrees of freedom (B,).
        """
        data = self.data(weights, rho)
        x, covariance = data.posterior(noise, priors)
        paid = np.sum(data.H * covariance[:, None], axis=(2, 3)) / np.square(noise)
        return x, covariance, np.sum(data.count - paid, axis=1)

    def scores(self, x: Array, covariance: Array, weights: Array, noise: Array) -> Array:
        """How far each row lies from what the others predict, shape (B, N)."""
        found = self.norms(x, covariance, weights, 1.0 / self.noise_of(noise))
        return point_scores(found, np.sum(self.used, axis=1))

    def norms(self, x: Array, covariance: Array, weights: Array, factors: Array) -> Array:
        """`deleted_norms` at x, shape (B, p)."""
        return deleted_norms(self.residual(x), self.A, covariance, weights, factors)

    def shares(self, x: Array, covariance: Array, weights: Array, rho: Array) -> Array:
        """The shares of stops that the residuals of fits x, (B, p), tell, shape (B, C, 2), from those of the fits."""
        result = np.zeros(rho.shape)
        if self.stops is None:
            return result
        for b, c in np.ndindex(*rho.shape[:2]):
            step, C = x[b] - self.x, covariance[b]
            moments = self.stops.moments(self.columns, weights[b], c, step, C)
            result[b, c] = moments.shares(rho[b, c])
        return result
