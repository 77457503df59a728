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
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.linalg.lapack import dpotrf, dtrtri

from calib.estimate.gauge import TOLERANCE, SizeGauge, measures_length, size_gauge
from calib.estimate.rows import LENGTHS, Rows
from calib.estimate.setup import KnownDistance
from calib.estimate.solvers import triangle
from calib.estimate.statistics import as_of_a_point, deleted_norms
from calib.estimate.stop_errors import Stops
from calib.model.kinematics import Kinematics
from calib.model.observability import Observability, analyse
from calib.robot.kernel import over_blocks
from calib.units import Array, Mask

#: How far a size's logarithm may fall and rise in a step, how often; a rise in likelihood that is none; equations kept.
_STEP_DOWN, _STEP_UP, _ITERATIONS, _NO_RISE, _KEPT = 3.0, 1.0, 30, 1e-12, 3


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
    held: Array  # (p,), see `Normal`
    stops: Stops | None = None  # Where several targets were seen
    _made: list[tuple[Array, Array, Normal]] = field(init=False, repr=False, default_factory=list)

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

    def data(self, weights: Array, rho: Array) -> Normal:
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
        made = Normal(H, g + Hx, rr + (2.0 * g + Hx) @ self.x, count, known, self.held, log_det)
        self._made[:] = [(weights.copy(), rho.copy(), made), *self._made[: _KEPT - 1]]
        return made

    def fit(
        self, weights: Array, rho: Array, noise: Array, priors: Priors
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
        return as_of_a_point(found, np.sum(self.used, axis=1))

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


def prior_std_by_reml(
    data: Normal,
    families: Mask,
    noise: Array,
    prior_std: Array,
    priors: Priors,
    *,
    smallest_noise: tuple[float, ...],
    bounds: tuple[tuple[float, float], ...],
    noise_spread: float = np.inf,
) -> tuple[Array, Array]:
    """Noise (B, C) and sizes (B, K) that maximise the likelihood, by damped Fisher scoring on their logarithms.

    families, (K, p), says which parameters belong to each; noise and sizes are where to begin. noise_spread is the
    standard deviation of a normal prior on log sigma, which decides where rows are too few to tell noise from error.
    """
    C = noise.shape[1]
    lowest = np.log(np.array([*smallest_noise, *(low for low, _ in bounds)]))
    highest = np.tile([high for _, high in bounds], (len(noise), 1))
    highest = np.log(np.hstack([1e6 * noise, highest]))
    logs = np.clip(np.log(np.hstack([noise, prior_std])), lowest, highest)
    members = np.asarray(families, dtype=np.float64).reshape(-1, data.g.shape[2])
    spread = np.where(np.arange(logs.shape[1]) < C, 1.0 / noise_spread**2, 0.0)
    last, going = np.zeros_like(logs), np.arange(len(logs))
    precision = np.broadcast_to(priors.precision, (len(logs), members.shape[1]))
    for _ in range(_ITERATIONS):
        at, high = logs[going], highest[going]
        H, g, yy, count = (values[going] for values in (data.H, data.g, data.yy, data.count))
        some = Normal(H, g, yy, count, data.known, data.held)
        score, information = _score(some, members, Priors(precision[going], priors.centre), at)
        score -= spread * at
        pivots = diagonal(information)
        pivots += spread
        pivots += 1e-3 * pivots + 1e-9
        # A family at its lower bound with a score that points below it stays there.
        held = ((at <= lowest) & (score < 0)) | ((at >= high) & (score > 0))
        score[held] = 0.0
        information[held[:, :, None] | held[:, None]] = 0.0
        pivots[held] = 1.0
        step = np.linalg.solve(information, score[:, :, None])[:, :, 0]
        step = np.clip(step, -_STEP_DOWN, _STEP_UP)
        # Where a size vanishes nothing tells how small it is: steps that raise the likelihood no more are not taken.
        step[np.abs(np.sum(step * score, axis=1)) < _NO_RISE] = 0.0
        # The expected information may be too small by half: then full steps overshoot, to and fro.
        last[going] = step = np.where(step * last[going] < 0.0, 0.5 * step, step)
        logs[going] = moved = np.clip(at + step, lowest, high)
        going = going[np.abs(moved - at).max(axis=1) >= 1e-4]
        if not len(going):
            break
    values = np.exp(logs)
    return values[:, :C], values[:, C:]


def _score(data: Normal, members: Array, priors: Priors, logs: Array) -> tuple[Array, Array]:
    """Gradient of the log likelihood in log sizes, and its expected information."""
    B, C, p = data.g.shape
    values = np.exp(logs)
    noise, prior_std = values[:, :C], values[:, C:]
    own = (1.0 / prior_std**2) @ members
    m, covariance = data.posterior(noise, Priors(priors.precision + own, priors.centre))
    HC = (data.H @ covariance[:, None]) / np.square(noise)[:, :, None, None]
    turned = HC.swapaxes(2, 3)
    trace = np.trace(HC, axis1=2, axis2=3)
    score, information = np.empty(logs.shape), np.empty((*logs.shape, logs.shape[1]))
    score[:, :C] = data.residual_square(m) / np.square(noise) + trace - data.count
    crossed = HC.reshape(B, C, p * p) @ turned.reshape(B, C, p * p).swapaxes(1, 2)
    information[:, :C, :C] = 2.0 * crossed
    diagonal(information)[:, :C] += 2.0 * (data.count - 2.0 * trace)
    if len(members):
        both = (covariance[:, None] * turned).sum(axis=3)
        square = (m**2 + diagonal(covariance)) @ members.T
        score[:, C:] = square / prior_std**2 - members.sum(axis=1)
        of_held = data.held_variance(own)
        score[:, C:] += (of_held @ members.T) / (1.0 + of_held.sum(axis=1, keepdims=True))
        information[:, :C, C:] = 2.0 * (both @ members.T) / prior_std[:, None] ** 2
        information[:, C:, :C] = information[:, :C, C:].swapaxes(1, 2)
        root = np.sqrt(own)  # 1 / tau, 0 for those of no family
        block = covariance * (-root[:, :, None] * root[:, None])
        diagonal(block)[...] += root > 0.0
        information[:, C:, C:] = 2.0 * (members @ block**2 @ members.T)
    return score, information


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
