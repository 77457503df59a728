"""Problem: robot, error model and measurements as one weighted least-squares problem.

    minimise  1/2 [sum_i w_i |r_i(x) / sigma_i|^2 + sum_k (x_k - m_k)^2 / tau_k^2 + sum_c (d_c - d_c(x))^2 / s_c^2]

with residuals r, normal priors of size tau on the offsets (mean 0, but at a bound) and known distances d. Linearised
it is y = A x + n. Sizes tau_f of x_k ~ N(0, tau_f^2) and sigma_c of each instrument maximise its restricted marginal
likelihood (REML: H. D. Patterson, R. Thompson, 1971); frame and target are flat. With posterior covariance C, mean m
and H_c = A_c^T A_c

    dL/dlog tau_f = sum_k (m_k^2 + C_kk) / tau_f^2 - n_f,
    dL/dlog sigma_c = |y - A m|_c^2 / sigma_c^2 + tr(H_c C) / sigma_c^2 - N_c

B fits that differ in the weights of their rows are worked on together: they are the first axis of arrays.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from calib.estimate.gauge import TOLERANCE, SizeGauge, measures_length, size_gauge
from calib.estimate.linear import Linear
from calib.estimate.stop_errors import Stops
from calib.model.kinematics import Kinematics
from calib.model.observability import Observability, analyse
from calib.numerics.errors import LENGTHS
from calib.numerics.solvers import triangle
from calib.registration.known_distances import KnownDistance
from calib.registration.rows import Rows
from calib.robot.kernel import over_blocks
from calib.units import Array

#: Below this the noise is no instrument's but rounding [m, rad].
_SMALLEST_SIGMA = 1e-8


#: Rows whose twists are held at a time, and rows up to which a solver sees every scalar.
PART, _TALL = 16_384, 1024


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """A calibration as numbers."""

    kinematics: Kinematics  # The nominal robot under its error model
    rows: Rows  # The measurements
    scales: Array  # (N, D), standard deviation of each scalar, [m] and [rad]
    weights: Array  # (N,), of the rows, between 0 and 1
    precision: Array  # (p,), 1 / tau_k^2; 0 for a parameter without prior
    centre: Array  # (p,), the priors' means
    distances: tuple[KnownDistance, ...]  # Known distances between frames
    smallest: tuple[float, ...]  # Smallest noise believed of each instrument, in units of its sigma
    rho: Array  # (C, 2), share of each instrument's variance that targets of a stop have in common
    gauge: SizeGauge | None = None  # The size of the arm, where nothing measures a length
    stops: Stops | None = None  # Where several targets were seen
    _last: list[Linear] = field(default_factory=list, repr=False)

    @classmethod
    def first(
        cls, kinematics: Kinematics, rows: Rows, distances: tuple[KnownDistance, ...] = ()
    ) -> Problem:
        """All rows in full, the noise as given, no priors; known distances count between frames that rows see."""
        ones, nothing, scales = np.ones(len(rows)), np.zeros(len(kinematics.model)), rows.scales
        own = (rows.instruments == c for c in range(int(rows.instruments.max()) + 1))
        smallest = tuple(_SMALLEST_SIGMA / float(np.median(scales[mask])) for mask in own)
        seen = set(rows.samples.frame.tolist())
        distances = tuple(d for d in distances if {d.first, d.second} <= seen)
        rho, stops = np.zeros((len(smallest), 2)), Stops.of(kinematics, rows)
        start = (kinematics, rows, scales, ones, nothing, nothing, distances, smallest, rho)
        return cls(*start, stops=stops)

    def with_size_held(self) -> Problem:
        """The problem with the arm's size held at the nominal one, where nothing measures a length."""
        if measures_length(self.rows, self.distances):
            return self
        linear = self.linear(np.zeros(self.size))
        residual = linear.residual(linear.x)
        return replace(self, gauge=size_gauge(self.kinematics, self.rows, linear.A, residual))

    @property
    def size(self) -> int:
        """The number of parameters p."""
        return len(self.kinematics.model)

    def residual(self, x: Array) -> Array:
        """Measured minus predicted, shape (N, D), [m] and [rad]."""
        return self.rows.residual(self.kinematics.poses(x, self.rows.samples))

    def jacobian(self, x: Array) -> Array:
        """The derivative of the *prediction*, shape (N, D, p)."""
        return np.asarray(self.linear(x).A * self.rows.scales[:, :, None])

    def linear(self, x: Array) -> Linear:
        """The problem linearised at x, in units of each scalar's sigma as given; reweighted copies share the last."""
        if self._last and np.array_equal(x, self._last[0].x):
            return self._last[0]
        self._last.clear()
        rows, scales = self.rows, self.rows.scales.T
        columns = np.empty((self.size + 1, rows.width, len(rows)))
        for own in rows.parts(PART):
            part = rows.select(own)
            poses, twists = self.kinematics.twists(x, part.samples, rotation=rows.width > LENGTHS)
            width, scale = part.width, scales[: part.width, own]
            if width < rows.width:  # these rows lack a kind that others have
                columns[:, width:, own] = 0.0
            columns[:-1, :width, own] = part.derivative(poses, twists).transpose(2, 1, 0) / scale
            columns[-1][:width, own] = part.residual(poses).T / scale
        r, C = self.constraints(x)
        held = C[-1] if self.gauge is not None else np.zeros(self.size)
        made = (columns, rows.used, rows.instruments, self.smallest, C, r + C @ x, held, self.stops)
        self._last.append(Linear(x.copy(), *made))
        return self._last[0]

    def observability(self, x: Array) -> Observability:
        """What rows that count and known distances tell apart at x; angles as lengths, by their standard deviations."""
        model, rows = self.kinematics.model, self.rows
        counts = rows.used & ((self.weights > 0.0) | ~rows.checked)[:, None]
        seen = (self.linear(x).A * rows.scales[:, :1, None])[counts]
        if (
            self.gauge is not None
        ):  # growth changes what is measured by shares of the residuals, which tell nothing
            growth = self.gauge.growth
            seen = seen - np.outer(seen @ growth, growth) / (growth @ growth)
        sigma = np.array([known.sigma for known in self.distances])
        known = self._between(x)[1] * sigma[:, None]
        return analyse(np.concatenate([seen, known]), model.names, model.units)

    def constraints(self, x: Array) -> tuple[Array, Array]:
        """What is known besides the rows, minus what is predicted, over its sigma, (K,).

        These are the known distances, and last the size of the arm, if it is held. Also returned is the derivative of
        the prediction, (K, p).
        """
        r, J = self._between(x)
        if self.gauge is None:
            return r, J
        held = self.gauge.held / TOLERANCE
        return np.append(r, -held @ x), np.vstack([J, held])

    def _between(self, x: Array) -> tuple[Array, Array]:
        """Known minus predicted distances over their sigma, (K,), and the derivative of the prediction, (K, p).

        A point held at the origin of frame f stands at c_f = -R^T t in the base, with T_frame_base = (R, t).
        """
        r, J = np.empty(len(self.distances)), np.empty((len(self.distances), self.size))
        if not self.distances:
            return r, J
        displacement, directions = self.kinematics.model.displacements(x)
        frames = len(self.kinematics.T_frame_base)
        T = self.kinematics.T_frame_base @ displacement[:frames]
        c = -np.einsum("fji,fj->fi", T[:, :3, :3], T[:, :3, 3])
        S = directions[: 6 * frames].reshape(frames, 6, -1)
        dc = -(S[:, :3] + np.cross(S[:, 3:], c[:, :, None], axis=1))
        for k, known in enumerate(self.distances):
            between = c[known.first] - c[known.second]
            length = float(np.linalg.norm(between))
            along = between / max(length, 1e-12)
            r[k] = (known.length - length) / known.sigma
            J[k] = along @ (dc[known.first] - dc[known.second]) / known.sigma
        return r, J

    def system(self, x: Array) -> tuple[Array, Array]:
        """The whitened residual and its own derivative, with a row for each prior and each known distance."""
        held = np.flatnonzero(self.precision)
        root = np.sqrt(self.precision[held])
        between, slope = self.constraints(x)
        rows = self._whitened(self.linear(x).columns)
        measured = rows.shape[1]
        last = measured + len(held)
        # By columns in memory, as solvers want it.
        both = np.zeros((self.size + 1, last + len(between)))
        both[:-1, :measured], both[-1, :measured] = -rows[:-1], rows[-1]
        both[held, measured + np.arange(len(held))] = -root
        both[-1, measured:last] = -root * (x - self.centre)[held]
        both[:-1, last:], both[-1, last:] = -slope.T, between
        return both[-1], both[:-1].T

    def _whitened(self, columns: Array) -> Array:
        """[A r] of the M scalars, by columns, in units of their noise, (p + 1, M); R of [A r] = Q R for many rows."""
        whiten = (np.sqrt(self.weights)[:, None] * (self.rows.scales / self.scales)).T
        if self.stops is not None and np.any(self.rho):
            columns = self.stops.independent(columns * whiten, self.weights, self.rho)
            whiten = np.ones(whiten.shape)
        used = self.rows.used.T
        if len(self.weights) <= _TALL:
            return np.asarray((columns * whiten)[:, used])
        factor = whiten * used

        def work(own: slice) -> Array:
            return triangle((columns[:, :, own] * factor[:, own]).reshape(len(columns), -1).T)

        parts = over_blocks(work, len(self.weights))
        return np.asarray(triangle(np.asfortranarray(np.concatenate(parts))).T)

    def independent(self, values: Array, weights: Array) -> Array:
        """Whitened values (N, D, q), with these weights (N,) of the rows, less what the targets of a stop share."""
        if self.stops is None or not np.any(self.rho):
            return values
        columns = self.stops.independent(values.transpose(2, 1, 0), weights, self.rho)
        return np.asarray(columns.transpose(2, 1, 0))

    def paper_system(self, nominal: Array, unit: Array, X: Array) -> tuple[Array, Array]:
        """The paper's error e_i = |dP_i|^2 [mm^2], (N,), and its derivative, (N, p), at X = (nominal + x) unit."""
        x = X / unit - nominal
        r, J = 1e3 * self.linear(x).residual(x) * self.rows.scales, 1e3 * self.jacobian(x) / unit
        return np.sum(r**2, axis=1), -2.0 * np.einsum("ij,ijk->ik", r, J)
