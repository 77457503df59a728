"""Problem: robot, error model and measurements as one weighted least-squares problem.

    minimise  1/2 [sum_i w_i |W_i r_i(x)|^2 + sum_k (x_k - m_k)^2 / tau_k^2 + sum_c (d_c - d_c(x))^2 / s_c^2]

with residuals r (measured minus predicted), W = 1 / sigma (of poses with a covariance as `Rows.standardise` has it),
normal priors of standard deviation tau on the parameters (mean 0, except at a bound) and known distances d. Linearised
it is y = A x + n: see `calib.fit.estimate.linear`.

Letters of shapes, in all of `calib.fit.estimate`:

    B   fits computed together, which differ in the weights of their rows; the first axis
    C   channels: one for each kind and unit of a scalar (m, then rad, then px), each with its own noise
    N   rows of the table
    D   columns of a residual: as many as the widest kind has scalars; `Rows.channels` gives each entry's unit
    p   parameters: offsets of the robot, of frames and targets, from the registered start, and of cameras and boards,
        in each parameter's unit [m, rad, ...]
    K   families of parameters, each with one prior standard deviation

Sigma is the standard deviation of a scalar as given or assumed before the fit; the noise is the estimated one, in units
of sigma. "In units of sigma" is as `Rows.standardise` has it: of a pose with a covariance the six scalars are made
independent too. "Whitened" is divided by sigma times noise, and times the root of the weight.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.basics.values import Value
from calib.fit.estimate.linear import ComputedColumns, LinearProblem
from calib.fit.estimate.special_cases.arm_size import SizeGauge, find_size_gauge, measures_length
from calib.fit.estimate.special_cases.stop_shares import PARTS
from calib.fit.estimate.special_cases.stops import Stops
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import KnownDistance
from calib.model.kinematics import Kinematics
from calib.model.observability import Observability, analyse
from calib.numerics.solvers import triangle, upper_root
from calib.robot.kernel import over_blocks

#: Noise below this is rounding, and not that of an instrument [m, rad, px].
_SMALLEST_SIGMA = 1e-8

#: The most numbers of a linearisation that are kept in memory (64 MB): of more rows they are computed when needed,
#: which takes no longer than a few uses of them.
_MOST_KEPT = 2**23

#: Up to so many rows a solver gets every scalar; of more it gets a triangle of the same squares. A choice: products and
#: their root take less than half the time of QR, but lose half of its digits; of this many points QR takes 0.1 to
#: 0.3 ms, so that fewer would save little.
_TALL = 256

#: Divisor in place of a distance of zero [m].
_SHORTEST = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Problem(Value):
    """A calibration as numbers: N rows, p parameters."""

    #: The nominal robot under its error model, frames and targets as registered
    kinematics: Kinematics
    #: The measurements
    rows: Rows
    #: (C,), standard deviation of each channel as estimated, in units of its sigma
    noise: Array
    #: (N,), of the rows, between 0 and 1
    weights: Array
    #: (p,), 1 / tau_k^2; 0 for a parameter without prior
    prior_precision: Array
    #: (p,), m_k
    prior_mean: Array
    #: Known distances between frames
    distances: tuple[KnownDistance, ...]
    #: (C,), lowest noise of each channel, in units of its sigma
    smallest_noise: tuple[float, ...]
    #: (C, 3), shares of each channel's variance that targets of a stop have in common, see `Stops`
    stop_shares: Array
    #: Where the robot stood while several targets were measured; None if it never did
    stops: Stops | None = None
    #: The size of the arm, held at the nominal one; None if something measures a length
    gauge: SizeGauge | None = None
    #: Cache of the last linearisation
    _last: list[LinearProblem] = field(default_factory=list, repr=False)

    @classmethod
    def initial(
        cls,
        kinematics: Kinematics,
        rows: Rows,
        distances: tuple[KnownDistance, ...] = (),
    ) -> Problem:
        """Make the problem before any estimate: weights of one, noise as given, no priors.

        Args:
            kinematics: The nominal robot under its error model, frames and targets as registered.
            rows: N rows of measurements.
            distances: Known distances; those between frames that the rows see count.

        Returns:
            The least-squares problem of these rows. The arm's size is not held.
        """
        smallest_noise = _smallest_noise(rows)
        observed = set(rows.samples.frame.tolist())
        p = len(kinematics.model)
        return cls(
            kinematics=kinematics,
            rows=rows,
            noise=np.ones(len(smallest_noise)),
            weights=np.ones(len(rows)),
            prior_precision=np.zeros(p),
            prior_mean=np.zeros(p),
            distances=tuple(d for d in distances if {d.first, d.second} <= observed),
            smallest_noise=smallest_noise,
            stop_shares=np.zeros((len(smallest_noise), len(PARTS))),
            stops=Stops.of(kinematics, rows),
        )

    def with_size_held(self) -> Problem:
        """Return the problem with the arm's size held at the nominal one; unchanged if something measures a length.

        Size is not held either if the parameters cannot make the arm grow, or rows see it grow (`find_size_gauge`).
        """
        if measures_length(self.rows, self.distances):
            return self
        linear = self.linear(np.zeros(self.size))
        residual = linear.residual(linear.x)
        gauge = find_size_gauge(self.kinematics, self.rows, linear.A, residual)
        return replace(self, gauge=gauge, _last=[])  # the linearised problem has no gauge

    def select(self, chosen: Mask) -> Problem:
        """Return the problem of some of the rows, (N,), of which no stop has several targets."""
        return replace(self.with_rows(self.rows.select(chosen)), weights=self.weights[chosen])

    def with_rows(self, rows: Rows) -> Problem:
        """Return the problem of other rows, or of the same ones with other values or given errors.

        Noise and priors stay, and so do weights: if there are other rows, they are the caller's to replace.
        """
        return replace(
            self,
            rows=rows,
            smallest_noise=_smallest_noise(rows),
            stops=Stops.of(self.kinematics, rows),
            _last=[],
        )

    @property
    def size(self) -> int:
        """Number p of parameters."""
        return len(self.kinematics.model)

    @property
    def scales(self) -> Array:
        """Standard deviation of each scalar as estimated, shape (N, D), in the units of the rows' channels."""
        return self.rows.scales_at(self.noise)

    @property
    def noise_by_scalar(self) -> Array:
        """Estimated noise of each scalar in units of its sigma, shape (N, D); 1 where there is no scalar."""
        # An entry without a scalar has the channel -1, the last one here.
        return np.asarray(np.append(self.noise, 1.0)[self.rows.channels.index])

    @property
    def noise_over_sigma(self) -> Array:
        """Estimated standard deviation over the stated or assumed one, of each of C channels, shape (C,).

        It is `noise`, except for channels of poses with a covariance, where that is relative to V, with what the robot
        adds (`Rows.pose_noise`). Of these it is the median over rows of their standard deviations, rms over the axes.
        """
        rows = self.rows
        result = np.array(self.noise)
        if not np.any(rows.correlated):
            return result
        variances = self.scales**2
        for c in np.unique(rows.channels.index[rows.correlated]).tolist():
            of_channel = rows.channels.index == c
            measuring = np.any(of_channel, axis=1)
            mean = np.mean(variances, axis=1, where=of_channel | ~measuring[:, None])
            stated = rows.sigma[rows.channels.units[c]]
            result[c] = np.median((np.sqrt(mean) / stated)[measuring])
        return result

    def residual(self, x: Array) -> Array:
        """Measured minus predicted.

        Args:
            x: shape (p,), offsets [m, rad, ...].

        Returns:
            shape (N, D), in the units of the rows' channels; vectors along the axes of each row's measurement frame;
            not divided by their standard deviations; 0 where nothing was measured.
        """
        return self.rows.residual(self.kinematics.sightings(x, self.rows.samples))

    def prediction_jacobian(self, x: Array) -> Array:
        """Jacobian of the prediction, which is minus that of the residual.

        Args:
            x: shape (p,), offsets [m, rad, ...].

        Returns:
            shape (N, D, p), in the units of the rows' channels per unit of each parameter; not divided by standard
            deviations; 0 where nothing was measured.
        """
        return self.rows.in_units(self.linear(x).A)

    def linear(self, x: Array) -> LinearProblem:
        """Linearise the problem at given parameters.

        Weights, noise and priors have no part in it: copies of the problem that differ in these share the last one.

        Args:
            x: shape (p,), offsets [m, rad, ...].

        Returns:
            Residual and Jacobian at x in units of each scalar's given sigma, and the constraints.
        """
        for last in self._last:
            if np.array_equal(x, last.x):
                return last
        self._last.clear()  # before the next one is made, for memory
        rows = self.rows
        if rows.samples.load is not None and not self.kinematics.model.depends_on_loads:
            rows = replace(rows, samples=replace(rows.samples, load=None))  # not to be copied
        rotation = rows.depends_on_orientation
        shape = (self.size + 1, rows.width, len(rows))

        of_rows = partial(_columns, self.kinematics, rows, x.copy(), rotation)
        columns: Array | ComputedColumns
        if np.any(rows.partner >= 0):  # pairs stay together
            columns = of_rows(slice(0, len(rows)))
        elif np.prod(shape) <= _MOST_KEPT:
            columns = np.concatenate(over_blocks(of_rows, len(rows)), axis=2)
        else:
            columns = ComputedColumns(shape, of_rows)
        of_constraints, C = self.constraints(x)
        linear = LinearProblem(
            x=x.copy(),
            columns=columns,
            channels=rows.channels,
            smallest_noise=self.smallest_noise,
            C=C,
            z=of_constraints + C @ x,
            held=C[-1] if self.gauge is not None else np.zeros(self.size),
            stops=self.stops,
        )
        self._last.append(linear)
        return linear

    def observability(self, x: Array) -> Observability:
        """Analyse which combinations of parameters the rows and known distances determine.

        Rows without weight do not count. Angles and pixels count as lengths, by the ratio of their given sigmas. If the
        arm's size is held, its growth counts as not determined. Priors of internals of instruments count: they are what
        was stated or measured, as the print of a board was; those of the robot are not.

        Args:
            x: shape (p,), offsets [m, rad, ...].

        Returns:
            Rank, condition and singular values of the Jacobian [m per step of the parameter, such as 1 mm or 1 mrad],
            and the combinations of parameters that are not determined.
        """
        model, rows = self.kinematics.model, self.rows
        counts = rows.used & (self.weights > 0.0)[:, None]
        linear = self.linear(x)

        def of_some(part: slice) -> Array:
            """The Jacobian of the scalars that count of some of the rows, (m, p) [m per unit of the parameter]."""
            some = rows.select(part)
            A = linear.columns_of(part)[:-1, : some.width].transpose(2, 1, 0)
            in_sigma = some.in_units(A) / some.scales[:, :, None]
            sigma_of_lengths = some.sigma["m"][:, None, None]
            return np.asarray((in_sigma * sigma_of_lengths)[counts[part, : some.width]])

        if isinstance(linear.columns, ComputedColumns):
            # Of many rows the triangle, which has the same singular values.
            triangles = over_blocks(lambda part: triangle(of_some(part)), len(rows))
            jacobian = triangle(np.concatenate(triangles))
        else:
            jacobian = of_some(slice(None))
        if self.gauge is not None:
            jacobian = self.gauge.without_growth(jacobian)
        sigma = np.array([distance.sigma for distance in self.distances])
        _, whitened = self._distance_residuals(x)
        of_distances = whitened * sigma[:, None]
        internal = [k for k, _ in model.internals]
        of_internals = np.diag(np.sqrt(self.prior_precision))[internal] * np.median(rows.sigma["m"])
        known = np.concatenate([jacobian, of_distances, of_internals])
        count = int(np.sum(counts)) + len(known) - len(jacobian)
        return analyse(known, model.names, model.units, count)

    def constraints(self, x: Array) -> tuple[Array, Array]:
        """Residuals of what is known besides the measured rows: distances between frames, and last an arm's held size.

        Args:
            x: shape (p,), offsets [m, rad, ...].

        Returns:
            Known minus predicted of K constraints, over its sigma, shape (K,), and the Jacobian of the prediction,
            shape (K, p), over sigma too.
        """
        residual, jacobian = self._distance_residuals(x)
        if self.gauge is None:
            return residual, jacobian
        of_size, by_x = self.gauge.constraint(x)
        return np.append(residual, of_size), np.vstack([jacobian, by_x])

    def _distance_residuals(self, x: Array) -> tuple[Array, Array]:
        """Known minus predicted of the known distances, (K,), and the Jacobian of the prediction, (K, p), over sigma.

        They are between the origins c = -R^T t of measurement frames with T_frame_base = (R, t).
        """
        residual = np.empty(len(self.distances))
        jacobian = np.empty((len(self.distances), self.size))
        if not self.distances:
            return residual, jacobian
        displacement, directions = self.kinematics.model.displacements(x)
        frames = len(self.kinematics.T_frame_base)
        T = self.kinematics.T_frame_base @ displacement[:frames]
        origins = -np.einsum("fji,fj->fi", T[:, :3, :3], T[:, :3, 3])
        twists = directions[: 6 * frames].reshape(frames, 6, -1)
        turned = np.cross(twists[:, 3:], origins[:, :, None], axis=1)
        derivatives = -(twists[:, :3] + turned)  # (F, 3, p)
        for k, known in enumerate(self.distances):
            between = origins[known.first] - origins[known.second]
            length = float(np.linalg.norm(between))
            along = between / max(length, _SHORTEST)
            residual[k] = (known.length - length) / known.sigma
            change = derivatives[known.first] - derivatives[known.second]
            jacobian[k] = along @ change / known.sigma
        return residual, jacobian

    def system(self, x: Array) -> tuple[Array, Array]:
        """The whitened residual and its derivative, as a solver takes them.

        Errors that the targets of a stop share are made independent.

        Args:
            x: shape (p,), offsets [m, rad, ...].

        Returns:
            Residual r, shape (m,), and dr/dx, shape (m, p): of the measured scalars, measured minus predicted, then of
            each parameter with a prior, its mean minus the parameter over the prior standard deviation, then of each
            constraint, known minus predicted over its sigma. Of many rows it is a triangle with the same squares and
            products instead.
        """
        with_prior = np.flatnonzero(self.prior_precision)
        root = np.sqrt(self.prior_precision[with_prior])
        of_constraints, slope = self.constraints(x)
        known = np.zeros((len(root) + len(of_constraints), self.size + 1))
        known[np.arange(len(root)), with_prior] = -root
        known[: len(root), -1] = -root * (x - self.prior_mean)[with_prior]
        known[len(root) :, :-1] = -slope
        known[len(root) :, -1] = of_constraints
        linear = self.linear(x)
        if len(self.rows) > _TALL:
            # The triangle R of [J r] = Q R by Cholesky; by QR where the squares in the products are too coarse.
            of_channels = linear.products(self.weights[None], self.stop_shares)[0]
            products = np.tensordot(1.0 / self.noise**2, of_channels, axes=1)
            products[:-1, -1] *= -1.0  # of dr/dx, not of A
            products[-1, :-1] *= -1.0
            both = upper_root(products + known.T @ known)
            if both is not None:
                return both[:, -1], both[:, :-1]
        whitened = self._whitened(linear)
        # By columns in memory, as solvers want it.
        both = np.hstack([whitened, known.T])
        both[:-1, : whitened.shape[1]] *= -1.0
        return both[-1], both[:-1].T

    def _whitened(self, linear: LinearProblem) -> Array:
        """The whitened columns of Jacobian and residual at the M measured scalars, (p + 1, M).

        Of more than `_TALL` rows it is the triangle R of [A r] = Q R, transposed, which has the same products.
        """
        whiten = (np.sqrt(self.weights)[:, None] / self.noise_by_scalar).T
        columns_of = linear.columns_of
        if self.stops is not None and np.any(self.stop_shares):
            columns = columns_of(slice(None)) * whiten
            independent, _ = self.stops.independent(columns, self.weights, self.stop_shares)
            whiten = np.ones(whiten.shape)

            def columns_of(rows: slice) -> Array:
                """The independent columns of some of the rows."""
                return independent[:, :, rows]

        used = self.rows.used.T
        if len(self.weights) <= _TALL:
            return np.asarray((columns_of(slice(None)) * whiten)[:, used])
        factor = whiten * used

        def block_triangle(rows: slice) -> Array:
            """The triangle R of [A r] = Q R, whitened, over some of the rows."""
            block = (columns_of(rows) * factor[:, rows]).reshape(self.size + 1, -1)
            return triangle(block.T)

        triangles = over_blocks(block_triangle, len(self.weights))
        stacked = np.asfortranarray(np.concatenate(triangles))
        return np.asarray(triangle(stacked).T)

    def independent(self, values: Array, weights: Array) -> Array:
        """Transform whitened values so that the errors which targets of a stop share are independent, see `Stops`.

        Args:
            values: shape (N, D, q), residuals or columns of Jacobians in units of the noise, multiplied by the roots of
                the rows' weights.
            weights: shape (N,), these weights.

        Returns:
            shape (N, D, q), in the same units; as they are if no errors are shared.
        """
        if self.stops is None or not np.any(self.stop_shares):
            return values
        columns, _ = self.stops.independent(values.transpose(2, 1, 0), weights, self.stop_shares)
        return np.asarray(columns.transpose(2, 1, 0))


def _columns(
    kinematics: Kinematics, rows: Rows, x: Array, rotation: bool, part: slice | Integers
) -> Array:
    """The columns of some of N rows at x, (p + 1, D, n): Jacobian and residual in units of each scalar's given sigma.

    With ``rotation`` some reading depends on the orientation of its target.
    """
    part_rows = rows.select(part)
    seen = kinematics.linearised(x, part_rows.samples, rotation=rotation)
    columns = np.empty((len(x) + 1, rows.width, len(part_rows)))
    width = part_rows.width
    columns[:, width:] = 0.0  # these rows lack a kind that others have
    of_part = columns[:, :width].transpose(2, 1, 0)
    part_rows.standardise(part_rows.derivative(seen), out=of_part[:, :, :-1])
    of_part[:, :, -1] = part_rows.standardise(part_rows.residual(seen))
    return columns


def _smallest_noise(rows: Rows) -> tuple[float, ...]:
    """The lowest noise of each of C channels that is not rounding, as a multiple of its (median) given sigma."""
    scales = rows.scales
    result = []
    for c in range(len(rows.channels.units)):
        typical = float(np.median(scales[rows.channels.index == c]))
        result.append(_SMALLEST_SIGMA / typical)
    return tuple(result)
