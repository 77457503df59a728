"""The problem linearised: its normal equations, fits and scores are matrix algebra, without the robot.

At x0 the residual is r and the Jacobian of the prediction A, both in units of each scalar's given sigma, so that

    residual(x) = r - A (x - x0) = y - A x        with y = r + A x0

B fits that differ in the weights of their rows are computed together. For the letters of shapes see
`calib.fit.estimate.problem`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib.basics.arrays import Array, Mask
from calib.basics.channels import Channels
from calib.basics.values import Value
from calib.fit.estimate.stop_errors import Stops
from calib.numerics.likelihood import GaussianPriors, NormalEquations
from calib.numerics.scores import deleted_norms, point_scores
from calib.robot.kernel import over_blocks

#: Normal equations that are kept, because stages ask for the same ones again.
_KEPT = 3


class _Kept(NamedTuple):
    """Normal equations that were computed, and for which weights and shares of stops."""

    #: (B, N), of the rows in B fits
    weights: Array
    #: (C, 3) or (B, C, 3), shares of each instrument's variance that the targets of a stop have in common
    rho: Array
    #: What follows from them
    equations: NormalEquations

    def is_for(self, weights: Array, rho: Array) -> bool:
        """True if these normal equations were computed for these weights and shares, equal to the last bit.

        Args:
            weights: shape (B, N), of N rows in B fits.
            rho: shape (C, 3) or (B, C, 3), shares of each instrument's variance that the targets of a stop have in
                common.

        Returns:
            False where any of them differs, or has another shape.
        """
        return np.array_equal(self.weights, weights) and np.array_equal(self.rho, rho)


@dataclass(frozen=True, slots=True, eq=False)
class LinearProblem(Value):
    """N rows of D scalars linearised at x, by p parameters, in units of each scalar's given sigma."""

    #: (p,), x0, where the problem is linearised
    x: Array
    #: (p + 1, D, N): the Jacobian A of the prediction, and behind it the residual r at x0
    columns: Array
    #: (N, D), the kind and the unit of each scalar: its instrument, and so its noise
    channels: Channels
    #: (C,), lowest noise of each instrument, in units of the given sigma
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
        """Number N of the rows of measurements."""
        return int(self.columns.shape[2])

    @property
    def used(self) -> Mask:
        """True for the scalars that were measured, shape (N, D)."""
        return self.channels.used

    @property
    def instruments(self) -> NDArray[np.int8]:
        """Index of the instrument of each scalar, its channel, from 0; -1 where there is no scalar; shape (N, D)."""
        return self.channels.index

    @property
    def A(self) -> Array:
        """Jacobian of the prediction by the p parameters, where the problem is linearised.

        Returns:
            shape (N, D, p), of the D scalars of N rows, in units of each scalar's given sigma per unit of the
            parameter; 0 for scalars that were not measured.
        """
        return np.asarray(self.columns[:-1].transpose(2, 1, 0))

    def noise_by_scalar(self, noise: Array) -> Array:
        """Return the noise of each scalar, a measured component of a row's residual: that of its instrument.

        Args:
            noise: shape (B, C), standard deviation of each of C instruments in B fits, as multiple of the given sigma.

        Returns:
            shape (B, N, D), of the D scalars of N rows, likewise; 1 where there is no scalar.
        """
        # An entry without a scalar has the instrument -1, the last one here.
        without_instrument = np.ones((len(noise), 1))
        return np.hstack([noise, without_instrument])[:, self.instruments]

    def residual(self, x: Array) -> Array:
        """Return measured minus predicted by the linear model, r - A (x - x0).

        `columns`, shape (p + 1, D, N), has the Jacobian A of the prediction and, behind it, the residual r at x0, which
        is the field `x`, shape (p,), where the problem is linearised.

        Args:
            x: shape (p,), or (B, p) for B fits: the parameters themselves [m, rad, ...], not their change from x0.

        Returns:
            shape (N, D) or (B, N, D), of the D scalars of N rows, in units of each scalar's given sigma.
        """
        count, D, N = self.columns.shape
        flat = self.columns.reshape(count, D * N)
        residual = flat[-1] - (x - self.x) @ flat[:-1]
        return np.asarray(residual.reshape(*x.shape[:-1], D, N).swapaxes(-1, -2))

    def select(self, mask: Mask) -> LinearProblem:
        """Return the problem of some of the rows.

        Args:
            mask: shape (N,), True for the rows to keep, in their order.

        Returns:
            The linearised problem of these rows, with the same parameters and constraints.
        """
        return replace(
            self,
            columns=self.columns[:, :, mask],
            channels=self.channels.select(mask),
            stops=None if self.stops is None else self.stops.select(mask),
        )

    def normal_equations(self, weights: Array, rho: Array) -> NormalEquations:
        """Return the normal equations of B fits, the latest three of which are kept, as callers need the same again.

        Args:
            weights: shape (B, N), of the N rows in each fit; the variance of a row is divided by its weight.
            rho: shape (C, 3) or (B, C, 3), shares of each instrument's variance that the targets of a stop have in
                common, by translation, rotation and joints; see `calib.fit.estimate.stop_errors`.

        Returns:
            A^T W A, shape (B, C, p, p), A^T W y, (B, C, p), and y^T W y, (B, C), of each fit and instrument, with the
            Jacobian A of the prediction and y = r + A x0, in units of the given sigma; the number of scalars by weight,
            (B, C); and the constraints.
        """
        for kept in self._cache:
            if kept.is_for(weights, rho):
                return kept.equations
        equations = self._sum_normal_equations(weights, rho)
        latest = _Kept(weights.copy(), rho.copy(), equations)
        self._cache[:] = [latest, *self._cache[: _KEPT - 1]]
        return equations

    def _sum_normal_equations(self, weights: Array, rho: Array) -> NormalEquations:
        """The normal equations of B fits, summed over the rows.

        Uses `columns`, shape (p + 1, D, N), the Jacobian A and the residual r in units of the given sigma, and `stops`,
        the standstills at which several targets are measured; None where there are none.

        Args:
            weights: shape (B, N), of the N rows in each fit; the variance of a row is divided by its weight.
            rho: shape (C, 3) or (B, C, 3), shares of each of C instruments' variance that the targets of a stop have in
                common, by translation, rotation and joints.

        Returns:
            A^T W A, shape (B, C, p, p), A^T W y, (B, C, p), and y^T W y, (B, C), of each fit and instrument, with y = r
            + A x0, in units of the given sigma; the number of scalars by weight, (B, C); log determinants, (B,), of the
            scalars' covariance over the noise; and the constraints.
        """
        products, count = self._sums_of_independent_rows(weights)
        log_det: Array | float = 0.0
        if self.stops is not None and np.any(rho):
            shares = np.broadcast_to(rho, (*count.shape, rho.shape[-1]))
            changes, log_det = self.stops.corrections(self.columns, weights, shares)
            products = products + changes
        return self._equations_of(products, count, log_det)

    def _sums_of_independent_rows(self, weights: Array) -> tuple[Array, Array]:
        """The products [A r]^T W [A r] of each instrument's scalars, and their number, if rows are independent.

        A is the Jacobian of the prediction, r the residual where the problem is linearised, both in units of sigma.

        Args:
            weights: shape (B, N), of the N rows in B fits.

        Returns:
            The products, shape (B, C, p + 1, p + 1), and the number of scalars by weight, shape (B, C).
        """
        fits_and_instruments = (len(weights), len(self.smallest_noise))
        size = len(self.columns)
        products = np.zeros((*fits_and_instruments, size, size))
        count = np.zeros(fits_and_instruments)
        for c in range(len(self.smallest_noise)):
            of_instrument = np.equal(self.instruments.T, c)
            scalars = of_instrument.sum(axis=0, dtype=np.float64)
            count[:, c] = weights @ scalars
            products[:, c] = self._weighted_products(np.sqrt(weights), of_instrument)
        return products, count

    def _equations_of(
        self,
        products: Array,
        count: Array,
        log_det: Array | float,
    ) -> NormalEquations:
        """The normal equations of A x = y, with y = r + A x0, from the products of [A r].

        Uses the fields `x`, shape (p,), which is x0, and the whitened constraints C x = z: `C`, shape (K, p), and `z`,
        shape (K,); `held`, shape (p,), is the row of C that keeps the arm's size, zeros where it is measured.

        Args:
            products: shape (B, C, p + 1, p + 1), [A r]^T W [A r] of each of C instruments in B fits, with the residual
                r at x0, in units of the given sigma.
            count: shape (B, C), number of scalars, by weight.
            log_det: shape (B,), log determinant of the weighted scalars' covariance over the noise; 0.0 where they are
                independent.

        Returns:
            A^T W A, shape (B, C, p, p), A^T W y, (B, C, p), and y^T W y, (B, C), of each fit and instrument, with
            ``count`` and ``log_det``; and of the constraints C^T C, C^T z and z^T z.
        """
        p = len(self.x)
        H = products[..., :p, :p]
        g = products[..., :p, p]
        rr = products[..., p, p]
        Hx = H @ self.x
        yy = rr + (2.0 * g + Hx) @ self.x
        known = (self.C.T @ self.C, self.C.T @ self.z, float(self.z @ self.z))
        return NormalEquations(H, g + Hx, yy, count, known, self.held, log_det)

    def _weighted_products(self, root_weights: Array, of_instrument: Mask) -> Array:
        """The products [A r]^T W [A r] over the scalars of one instrument.

        A is the Jacobian of the prediction, r the residual where the problem is linearised, both in units of sigma.

        Args:
            root_weights: shape (B, N), square roots of the weights of N rows in B fits.
            of_instrument: shape (D, N), which of the D scalars of each row are of the instrument.

        Returns:
            shape (B, p + 1, p + 1).
        """
        with_any = np.flatnonzero(of_instrument.any(axis=1))
        first = with_any.min(initial=len(of_instrument))
        last = with_any.max(initial=-1)
        scalars = slice(first, last + 1)
        factor = root_weights[:, None] * of_instrument[scalars]

        def product(rows: slice) -> Array:
            """The products [A r]^T W [A r] over some of the rows.

            Args:
                rows: Slice of the N rows.

            Returns:
                shape (B, p + 1, p + 1), of each of B fits.
            """
            columns = self.columns[:, scalars, rows]
            of_fits = []
            for factor_of_fit in factor[:, :, rows]:
                part = (columns * factor_of_fit).reshape(len(columns), -1)
                of_fits.append(part @ part.T)
            return np.array(of_fits)

        of_blocks = over_blocks(product, len(self))
        return np.asarray(np.sum(of_blocks, axis=0))

    def fit(
        self,
        weights: Array,
        rho: Array,
        noise: Array,
        priors: GaussianPriors,
    ) -> tuple[Array, Array, Array]:
        """Fit the parameters B times, at given weights, noise and priors.

        Args:
            weights: shape (B, N), of the N rows in each fit.
            rho: shape (C, 3) or (B, C, 3), shares of each instrument's variance that the targets of a stop have in
                common, by translation, rotation and joints.
            noise: shape (B, C), standard deviation of each of C instruments, as a multiple of the given sigma.
            priors: Independent normal priors of all p parameters: precision, shape (B, p) or (p,), and mean, (p,).

        Returns:
            x, shape (B, p), the parameters themselves, not their change [m, rad, ...]; its covariance, shape (B, p, p);
            and the degrees of freedom left for the noise, shape (B,): scalars by weight, less those that the fit spent.
        """
        equations = self.normal_equations(weights, rho)
        x, covariance = equations.posterior(noise, priors)
        spent = np.sum(equations.H * covariance[:, None], axis=(2, 3)) / np.square(noise)
        freedom = np.sum(equations.count - spent, axis=1)
        return x, covariance, freedom

    def scores(self, x: Array, covariance: Array, weights: Array, noise: Array) -> Array:
        """Score the rows by their deleted residuals; see `calib.numerics.scores`.

        Args:
            x: shape (B, p), parameters of each of B fits [m, rad, ...].
            covariance: shape (B, p, p), of x.
            weights: shape (B, N), of the N rows in each fit; 0 for rows that it did not use.
            noise: shape (B, C), standard deviation of each of C instruments, as a multiple of the given sigma.

        Returns:
            shape (B, N), >= 0, in standard deviations. Rows of more or fewer scalars are scored by what three scalars
            of the same probability would have.
        """
        factors = 1.0 / self.noise_by_scalar(noise)
        norms = self.norms(x, covariance, weights, factors)
        scalars = np.sum(self.used, axis=1)
        return point_scores(norms, scalars)

    def norms(self, x: Array, covariance: Array, weights: Array, factors: Array) -> Array:
        """Compute the norms of the rows' deleted residuals: measured minus predicted by a fit without the row.

        Args:
            x: shape (B, p), parameters of each of B fits [m, rad, ...], not their change from where the problem is
                linearised.
            covariance: shape (B, p, p), of x, in the products of the parameters' units.
            weights: shape (B, N), of the N rows in each fit; 0 for rows that it did not use.
            factors: shape (B or 1, N, D), by which residuals in units of the given sigma are multiplied: 1 over the
                noise of each scalar, or 0 for scalars that do not count.

        Returns:
            shape (B, N), >= 0, in standard deviations of such a residual, where ``factors`` are 1 over the noise.
        """
        return deleted_norms(self.residual(x), self.A, covariance, weights, factors)

    def stop_shares(self, x: Array, covariance: Array, weights: Array, rho: Array) -> Array:
        """Estimate, from the residuals of B fits, the shares of variance that the targets of a stop have in common.

        A stop is a standstill of the robot at which several targets are measured (`stops`; None where there is none).
        Uses `columns`, shape (p + 1, D, N), Jacobian and residual in units of the given sigma, taken at the parameters
        `x`.

        Args:
            x: shape (B, p), parameters of each fit [m, rad, ...], not their change.
            covariance: shape (B, p, p), of x, in the products of the parameters' units.
            weights: shape (B, N), of the N rows in each fit.
            rho: shape (B, C, 3), shares of each of C instruments to begin with, those of the fits.

        Returns:
            shape (B, C, 3), shares by translations and rotations of the body that the targets are on and by the joints,
            from 0 to 1; 0 where no stop has several targets.
        """
        result = np.zeros(rho.shape)
        if self.stops is None:
            return result
        for b, c in np.ndindex(*rho.shape[:2]):
            change = x[b] - self.x
            moments = self.stops.moments(self.columns, weights[b], c, change, covariance[b])
            result[b, c] = moments.shares(rho[b, c])
        return result
