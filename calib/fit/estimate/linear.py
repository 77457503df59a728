"""The problem linearised: its normal equations, fits and scores are matrix algebra, without the robot.

At x0 the residual is r and the Jacobian of the prediction A, both in units of each scalar's given sigma, so that

    residual(x) = r - A (x - x0) = y - A x        with y = r + A x0

B fits that differ in the weights of their rows are computed together. For the letters of shapes see
`calib.fit.estimate.problem`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.basics.channels import Channels
from calib.basics.values import Value
from calib.fit.estimate.special_cases.stop_shares import PARTS
from calib.fit.estimate.special_cases.stops import Stops
from calib.numerics.likelihood import GaussianPriors, NormalEquations
from calib.numerics.scores import deleted_norms, point_scores
from calib.robot.kernel import over_blocks, sum_over_blocks

#: Number of normal equations to cache; stages ask for the same ones again.
_CACHED = 3

#: The most weights of several fits that are cached with their equations (32 MB): folds of many rows are not asked for
#: again.
_MOST_CACHED = 2**22

#: Divisor in place of zero.
_TINY = 1e-300


@dataclass(frozen=True, slots=True, eq=False)
class ComputedColumns(Value):
    """Columns of so many rows that they are not kept, but computed again for each block whenever they are needed."""

    #: (p + 1, D, N)
    shape: tuple[int, int, int]
    #: Maps n rows, a slice or their indices, to their columns, shape (p + 1, D, n)
    of_rows: Callable[[slice | Integers], Array]


@dataclass(frozen=True, slots=True, eq=False)
class LinearProblem(Value):
    """N rows of D scalars linearised at x, by p parameters, in units of each scalar's given sigma."""

    #: (p,), x0, where the problem is linearised
    x: Array
    #: (p + 1, D, N): the Jacobian A of the prediction and, last, the residual r at x0
    columns: Array | ComputedColumns
    #: (N, D), the channel of each scalar: its kind and unit, and so its noise
    channels: Channels
    #: (C,), lowest noise of each channel, in units of the given sigma
    smallest_noise: tuple[float, ...]
    #: (K, p), rows of constraints C x = z, whitened: known distances, last what is held
    C: Array
    #: (K,), value of each constraint
    z: Array
    #: (p,), see `NormalEquations.held`
    held: Array
    #: Where the robot stood while several targets were measured; None if it never did
    stops: Stops | None = None
    #: Products and normal equations, with the weights and shares of stops that they are for; the latest first
    _cache: list[tuple[Array, Array, tuple[Array, NormalEquations]]] = field(
        init=False, repr=False, default_factory=list
    )

    def __len__(self) -> int:
        """Number N of the rows of measurements."""
        return int(self.columns.shape[2])

    @property
    def used(self) -> Mask:
        """True for the scalars that were measured, shape (N, D)."""
        return self.channels.used

    @property
    def A(self) -> Array:
        """Jacobian of the prediction by the parameters at x0, shape (N, D, p); 0 for scalars that were not measured."""
        return np.asarray(self.columns_of(slice(None))[:-1].transpose(2, 1, 0))

    def columns_of(self, rows: slice) -> Array:
        """Return the columns of some of the rows, shape (p + 1, D, n); of all, shape (p + 1, D, N), by ``slice(None)``.

        Of many rows ask for blocks, see `over_blocks`: all of them may take more memory than there is.
        """
        if isinstance(self.columns, ComputedColumns):
            return self.columns.of_rows(rows)
        return self.columns[:, :, rows]

    def noise_by_scalar(self, noise: Array) -> Array:
        """Return the noise of each scalar: that of its channel.

        Args:
            noise: shape (B, C), of each channel, in units of the given sigma.

        Returns:
            shape (B, N, D), in the same units; 1 where there is no scalar.
        """
        # An entry without a scalar has the channel -1, the last one here.
        without_channel = np.ones((len(noise), 1))
        return np.hstack([noise, without_channel])[:, self.channels.index]

    def reduced_jacobian(self) -> Array:
        """Return the Jacobian of the measured scalars, shape (M, p); if columns are not kept, one of the same products.

        The latter is R = S V^T, shape (p + 1, p), with [A r]^T [A r] = V S^2 V^T.
        """
        if not isinstance(self.columns, ComputedColumns):
            return np.asarray(self.A[self.used])
        unshared = np.zeros((len(self.smallest_noise), len(PARTS)))
        products = self.products(np.ones((1, len(self))), unshared)
        values, vectors = np.linalg.eigh(products[0].sum(axis=0))
        return np.asarray((np.sqrt(np.maximum(values, 0.0)) * vectors).T[:, :-1])

    def residual(self, x: Array) -> Array:
        """Return measured minus predicted by the linear model, r - A (x - x0).

        Args:
            x: shape (p,), or (B, p) for B fits: the parameters themselves [m, rad, ...], not their change from x0.

        Returns:
            shape (N, D) or (B, N, D), in units of each scalar's given sigma.
        """
        if not isinstance(self.columns, ComputedColumns):
            return self.residual_of(x, slice(None))
        of_blocks = over_blocks(partial(self.residual_of, x), len(self), in_threads=True)
        return np.concatenate(of_blocks, axis=-2)

    def residual_of(self, x: Array, rows: slice) -> Array:
        """Return what `residual` returns of some of the rows, shape (n, D) or (B, n, D)."""
        columns = self.columns_of(rows)
        flat = columns.reshape(len(columns), -1)
        residual = flat[-1] - (x - self.x) @ flat[:-1]
        return np.asarray(residual.reshape(*x.shape[:-1], *columns.shape[1:]).swapaxes(-1, -2))

    def select(self, mask: Mask) -> LinearProblem:
        """Return the problem of some of the rows, (N,), in their order, with the same constraints."""
        return replace(
            self,
            columns=self._select(mask),
            channels=self.channels.select(mask),
            stops=None if self.stops is None else self.stops.select(mask),
        )

    def _select(self, mask: Mask) -> Array:
        """The columns of some of the rows, (N,), in their order."""
        if not isinstance(self.columns, ComputedColumns):
            return self.columns[:, :, mask]

        chosen = np.flatnonzero(mask)
        of_rows = self.columns.of_rows

        def of_block(rows: slice) -> Array:
            """Those of a block of the chosen rows."""
            return of_rows(chosen[rows])

        return np.concatenate(over_blocks(of_block, len(chosen)), axis=2)

    def normal_equations(self, weights: Array, stop_shares: Array) -> NormalEquations:
        """Return the normal equations of B fits, of A x = y with y = r + A x0.

        Args:
            weights: shape (B, N), of the rows in each fit; the variance of a row is divided by its weight.
            stop_shares: shape (C, 3) or (B, C, 3), what the targets of a stop have in common, see `Stops`.

        Returns:
            The equations of the B fits, with those of each of C channels apart, in units of the given sigma, and with
            the constraints.
        """
        return self._sums(weights, stop_shares)[1]

    def products(self, weights: Array, stop_shares: Array) -> Array:
        """Return the products [A r]^T W [A r] of each channel for B fits, from which the normal equations are made.

        Args:
            weights: shape (B, N), of the rows in each fit.
            stop_shares: shape (C, 3) or (B, C, 3), what the targets of a stop have in common.

        Returns:
            shape (B, C, p + 1, p + 1), in units of the given sigma.
        """
        return self._sums(weights, stop_shares)[0]

    def _sums(self, weights: Array, stop_shares: Array) -> tuple[Array, NormalEquations]:
        """The results of `products` and `normal_equations`, from the cache if they are there."""
        shares_count = np.any(stop_shares)
        for of_weights, of_shares, sums in self._cache:
            same_shares = (
                np.array_equal(of_shares, stop_shares) if shares_count else not np.any(of_shares)
            )
            if not same_shares:
                continue
            if np.array_equal(of_weights, weights):
                return sums
            if same_shares and not shares_count and len(of_weights) == len(weights) == 1:
                # Of weights that are all multiplied by one factor, sums are too.
                factor = np.sum(weights) / max(float(np.sum(of_weights)), _TINY)
                if np.allclose(factor * of_weights, weights, rtol=1e-12, atol=0.0):
                    products, equations = sums
                    return factor * products, equations.times(factor)
        root_weights = np.sqrt(weights)
        log_det = np.zeros(len(weights))
        of_channels = self._of_channels()
        if self.stops is None or not shares_count:

            def of_block(rows: slice) -> Array:
                """The products over some of the rows."""
                return _products(self.columns_of(rows), root_weights[:, rows], of_channels, rows)

            products = sum_over_blocks(of_block, len(self))
        else:
            shape = (len(weights), len(of_channels), *stop_shares.shape[-1:])
            shares = np.broadcast_to(stop_shares, shape)
            columns = self.columns_of(slice(None))
            of_fits = []
            for b, root in enumerate(root_weights):
                independent, log_det[b] = self.stops.independent(
                    columns * root, weights[b], shares[b]
                )
                unit = np.ones((1, len(self)))
                of_fits.append(_products(independent, unit, of_channels, slice(None))[0])
            products = np.array(of_fits)
        return self._keep(weights, stop_shares, products, log_det, of_channels)

    def _of_channels(self) -> list[Mask]:
        """The scalars of each channel, True in masks (D, N)."""
        return [np.equal(self.channels.index.T, c) for c in range(len(self.smallest_noise))]

    def _keep(
        self,
        weights: Array,
        stop_shares: Array,
        products: Array,
        log_det: Array,
        of_channels: Sequence[Mask],
    ) -> tuple[Array, NormalEquations]:
        """Make normal equations of products (B, C, p + 1, p + 1), and cache both with what they are for."""
        count = weights @ np.array([mask.sum(axis=0) for mask in of_channels]).T
        p = len(self.x)
        H = products[..., :p, :p]
        g = products[..., :p, p]
        rr = products[..., p, p]
        Hx = H @ self.x
        yy = rr + (2.0 * g + Hx) @ self.x
        known = (self.C.T @ self.C, self.C.T @ self.z, float(self.z @ self.z))
        equations = NormalEquations(H, g + Hx, yy, count, known, self.held, log_det)
        if len(weights) == 1 or weights.size <= _MOST_CACHED:
            latest = (weights.copy(), stop_shares.copy(), (products, equations))
            self._cache[:] = [latest, *self._cache[: _CACHED - 1]]
        return products, equations

    def fit(
        self,
        weights: Array,
        stop_shares: Array,
        noise: Array,
        priors: GaussianPriors,
    ) -> tuple[Array, Array, Array]:
        """Fit the parameters B times, at given weights, noise and priors.

        Args:
            weights: shape (B, N), of the rows in each fit.
            stop_shares: shape (C, 3) or (B, C, 3), what the targets of a stop have in common.
            noise: shape (B, C), of each channel, in units of the given sigma.
            priors: Independent normal priors of all p parameters.

        Returns:
            x, shape (B, p), the parameters themselves, not their change [m, rad, ...]; its covariance, shape (B, p, p);
            and the degrees of freedom left for the noise, shape (B,): scalars by weight, less those that the fit spent.
        """
        equations = self.normal_equations(weights, stop_shares)
        x, covariance = equations.posterior(noise, priors)
        spent = np.sum(equations.H * covariance[:, None], axis=(2, 3)) / np.square(noise)
        freedom = np.sum(equations.count - spent, axis=1)
        return x, covariance, freedom

    def scores(self, x: Array, covariance: Array, weights: Array, noise: Array) -> Array:
        """Score the rows by their deleted residuals; see `calib.numerics.scores`.

        Args:
            x: shape (B, p), parameters of each of B fits [m, rad, ...].
            covariance: shape (B, p, p), of x.
            weights: shape (B, N), of the rows in each fit; 0 for rows that it did not use.
            noise: shape (B, C), of each channel, in units of the given sigma.

        Returns:
            shape (B, N), >= 0, in standard deviations. Rows of more or fewer scalars are scored by what three scalars
            of the same probability would have.
        """
        score = self._scorer(x, covariance, weights, noise)
        scored = over_blocks(lambda rows: score(rows)[0], len(self), in_threads=True)
        return np.concatenate(scored, axis=1)

    def weigh_by_scores(
        self,
        x: Array,
        covariance: Array,
        weights: Array,
        noise: Array,
        weight_of: Callable[[Array, slice], Array],
        *,
        shared: bool,
    ) -> Array:
        """Weight the rows by their scores; in the same pass form the normal equations of these weights, for the cache.

        Args:
            x: shape (B, p), parameters of each of B fits [m, rad, ...].
            covariance: shape (B, p, p), of x.
            weights: shape (B, N), of the rows in each fit.
            noise: shape (B, C), of each channel, in units of the given sigma.
            weight_of: Maps the scores of a slice of the rows, (B, n), to their weights in the next fit, (B, n).
            shared: Whether targets of a stop share errors: their normal equations are not sums over single rows.

        Returns:
            The next weights, shape (B, N).
        """
        score = self._scorer(x, covariance, weights, noise)
        of_channels = self._of_channels()
        next_weights = np.empty(weights.shape)

        def of_block(rows: slice) -> Array:
            """Weigh some of the rows, and return their products."""
            scores, columns = score(rows)
            next_weights[:, rows] = weight_of(scores, rows)
            if shared:
                return np.zeros(0)
            return _products(columns, np.sqrt(next_weights[:, rows]), of_channels, rows)

        products = sum_over_blocks(of_block, len(self))
        if not shared:
            unshared = np.zeros((len(self.smallest_noise), len(PARTS)))
            log_det = np.zeros(len(weights))
            self._keep(next_weights, unshared, products, log_det, of_channels)
        return next_weights

    def _scorer(
        self, x: Array, covariance: Array, weights: Array, noise: Array
    ) -> Callable[[slice], tuple[Array, Array]]:
        """The function of a slice of n rows that returns their scores, (B, n), and columns, (p + 1, D, n)."""
        # An entry without a scalar has the channel -1, the last one here.
        factors = 1.0 / np.hstack([noise, np.ones((len(noise), 1))])

        def score(rows: slice) -> tuple[Array, Array]:
            """Score some of the rows."""
            channel = self.channels.index[rows].T
            columns = self.columns_of(rows)
            norms = self._norms(columns, x, covariance, weights[:, rows], factors[:, channel])
            return point_scores(norms, np.sum(channel >= 0, axis=0)), columns

        return score

    def stop_scores(
        self,
        x: Array,
        covariance: Array,
        weights: Array,
        noise: Array,
        shares: Array,
        in_fit: Mask,
    ) -> tuple[Array, Integers]:
        """Score stops as a whole, by how far a fit without the stop finds its body displaced; see `Stops`.

        Args:
            x: shape (B, p), parameters of each of B fits [m, rad, ...].
            covariance: shape (B, p, p), of x, with what the targets of a stop share.
            weights: shape (B, N), of the rows in the body of their stop.
            noise: shape (B, C), of each channel, in units of the given sigma.
            shares: shape (B, C, 3), of the noise, that targets of a stop have in common.
            in_fit: shape (B, S), whether each fit used the stop, with these weights.

        Returns:
            The scores of S stops, shape (B, S), >= 0, converted to those of points; and the numbers of directions in
            which the bodies can be displaced, shape (B, S).
        """
        assert self.stops is not None
        columns = self.columns_of(slice(None))
        scores = np.zeros(in_fit.shape)
        directions = np.zeros(in_fit.shape, dtype=np.int_)
        for b in range(len(x)):
            displaced = self.stops.displacements(columns, weights[b], noise[b], shares[b])
            A = displaced[..., :-1]
            r = displaced[..., -1] - A @ (x[b] - self.x)
            unit = np.ones((1, *r.T.shape))
            stop_weights = in_fit[b, None].astype(np.float64)
            norms = deleted_norms(
                r.T[None], A.transpose(2, 1, 0), covariance[b, None], stop_weights, unit
            )
            directions[b] = np.sum(np.any(displaced != 0.0, axis=2), axis=1)
            scores[b] = point_scores(norms, directions[b])[0]
        return scores, directions

    def norms(self, x: Array, covariance: Array, weights: Array, factors: Array) -> Array:
        """Compute the norms of the rows' deleted residuals: measured minus predicted by a fit without the row.

        Args:
            x: shape (B, p), parameters of each of B fits [m, rad, ...].
            covariance: shape (B, p, p), of x.
            weights: shape (B, N), of the rows in each fit; 0 for rows that it did not use.
            factors: shape (B or 1, N, D), by which residuals in units of the given sigma are multiplied: 1 over the
                noise of each scalar, or 0 for scalars that do not count.

        Returns:
            shape (B, N), >= 0, in standard deviations of such a residual, if ``factors`` are 1 over the noise.
        """
        norms = np.empty(weights.shape)

        def work(rows: slice) -> None:
            """Fill in the norms of some of the rows."""
            of_rows = factors[:, rows].swapaxes(1, 2)
            columns = self.columns_of(rows)
            norms[:, rows] = self._norms(columns, x, covariance, weights[:, rows], of_rows)

        over_blocks(work, len(self))
        return norms

    def _norms(
        self, columns: Array, x: Array, covariance: Array, weights: Array, factors: Array
    ) -> Array:
        """The norms, (B, n), of rows with these columns, (p + 1, D, n), and factors, (B or 1, D, n), as of `norms`."""
        flat = columns.reshape(len(columns), -1)
        residual = flat[-1] - (x - self.x) @ flat[:-1]
        by_row = residual.reshape(len(x), *columns.shape[1:])
        return deleted_norms(by_row, columns[:-1], covariance, weights, factors)


def _products(
    columns: Array, root_weights: Array, of_channels: Sequence[Mask], rows: slice
) -> Array:
    """The products [A r]^T W [A r] of n rows over the scalars of each channel, for B fits, (B, C, p + 1, p + 1).

    [A r] are columns (p + 1, D, n); W has the weights of these rows, whose roots are given, (B, n), for the scalars of
    each channel, True in (D, N).
    """
    size = len(columns)
    result = np.empty((len(root_weights), len(of_channels), size, size))
    for c, of_channel in enumerate(of_channels):
        in_channel = of_channel[:, rows]
        with_any = np.flatnonzero(in_channel.any(axis=1))
        first = with_any.min(initial=0)
        scalars = slice(first, with_any.max(initial=-1) + 1)
        for b, root in enumerate(root_weights):
            factor = root * in_channel[scalars]
            part = (columns[:, scalars] * factor).reshape(size, -1)
            result[b, c] = part @ part.T
    return result
