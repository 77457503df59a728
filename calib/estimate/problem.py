"""Problem: robot, error model and measurements as one weighted least-squares problem.

    minimise  1/2 sum_i w_i |r_i(x) / sigma_i|^2 + 1/2 sum_k (x_k - m_k)^2 / tau_k^2
              + 1/2 sum_c (d_c - d_c(x))^2 / s_c^2

with the residuals r_i, measured minus predicted, of `calib.estimate.rows`, normal priors of size tau_k on the offsets
(their mean m_k is 0, but for a parameter that is held at a bound), and known distances d_c between what two set-ups
hold the target in.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from calib.estimate.robust import as_of_a_point, deleted_norms
from calib.estimate.rows import Rows, whole_blocks
from calib.estimate.setup import KnownDistance
from calib.estimate.solvers import triangle
from calib.estimate.statistics import Mask
from calib.estimate.variance import Known, Linearised
from calib.model.kinematics import Kinematics
from calib.robot.kernel import over_blocks

Array = NDArray[np.float64]

#: Below this the noise is no instrument's but rounding [m, rad].
SMALLEST_SIGMA = 1e-8

#: Rows whose twists are held at a time.
_PART = 16_384

#: Up to so many rows a solver sees every scalar.
_TALL = 1024

#: Columns of a residual that are lengths; angles are behind them.
_LENGTHS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """A calibration as numbers."""

    kinematics: Kinematics  # The nominal robot under its error model
    rows: Rows  # The measurements
    scales: Array  # shape (N, D), standard deviation of each scalar, [m] and [rad]
    weights: Array  # shape (N,), of the rows, between 0 and 1
    precision: Array  # shape (p,), 1 / tau_k^2; 0 for a parameter without prior
    centre: Array  # shape (p,), the priors' means
    distances: tuple[KnownDistance, ...]  # Known distances between frames
    # Smallest noise believed of each instrument, in units of its sigma as given
    smallest: tuple[float, ...]
    _last: list[Linear] = field(default_factory=list, repr=False)

    @classmethod
    def first(
        cls, kinematics: Kinematics, rows: Rows, distances: tuple[KnownDistance, ...] = ()
    ) -> Problem:
        """All rows in full, the noise as given, no priors."""
        ones, nothing = np.ones(len(rows)), np.zeros(len(kinematics.model))
        scales, (instruments, _) = rows.scales, rows.instruments
        smallest = tuple(
            SMALLEST_SIGMA / float(np.median(scales[instruments == c]))
            for c in range(int(instruments.max()) + 1)
        )
        return cls(kinematics, rows, scales, ones, nothing, nothing, distances, smallest)

    @property
    def size(self) -> int:
        """The number of parameters p."""
        return len(self.kinematics.model)

    def reweighted(self, weights: Array, scales: Array, precision: Array, centre: Array) -> Problem:
        """The same problem with other weights, noise and priors."""
        return replace(self, weights=weights, scales=scales, precision=precision, centre=centre)

    def residual(self, x: Array) -> Array:
        """Measured minus predicted, shape (N, D), [m] and [rad]."""
        return self.rows.residual(self.kinematics.poses(x, self.rows.samples))

    def residual_and_jacobian(self, x: Array) -> tuple[Array, Array]:
        """Measured minus predicted, shape (N, D), and the derivative of the *prediction*, shape (N, D, p)."""
        linear, scales = self.linear(x), self.rows.scales
        return linear.residual(x) * scales, linear.A * scales[:, :, None]

    def linear(self, x: Array) -> Linear:
        """The problem linearised at x, in units of each scalar's sigma as given.

        The last one is kept, because solvers and the stages between them often ask twice at the same x. Weights, noise
        and priors do not enter it, so that a problem and its reweighted copies share one.
        """
        if self._last and np.array_equal(x, self._last[0].x):
            return self._last[0]
        self._last.clear()
        rows, scales = self.rows, self.rows.scales.T
        columns = np.empty((self.size + 1, rows.width, len(rows)))
        rotation = rows.width > _LENGTHS
        for own in parts_of(rows):
            part = rows.select(own)
            poses, twists = self.kinematics.twists(x, part.samples, rotation=rotation)
            scale = scales[: part.width, own]
            if part.width < rows.width:  # these rows lack a kind that others have
                columns[:, part.width :, own] = 0.0
            derivative = part.derivative(poses, twists).transpose(2, 1, 0)
            columns[:-1, : part.width, own] = derivative / scale
            columns[-1][: part.width, own] = part.residual(poses).T / scale
        r, C = self.constraints(x)
        found = Linear(
            x.copy(), columns, rows.used, rows.instruments[0], self.smallest, C, r + C @ x
        )
        self._last.append(found)
        return found

    def known_slopes(self, x: Array) -> Array:
        """The derivative of the known distances, shape (K, p): they tell of parameters as rows do."""
        sigma = np.array([known.sigma for known in self.distances])
        return np.asarray(self.constraints(x)[1] * sigma[:, None])

    def constraints(self, x: Array) -> tuple[Array, Array]:
        """Known minus predicted distances, over their sigma, shape (K,), and the derivative of the prediction, (K, p).

        A point held at the origin of frame f stands at c_f = -R^T t in the base, with T_frame_base = (R, t).
        """
        if not self.distances:
            return np.zeros(0), np.zeros((0, self.size))
        displacement, directions = self.kinematics.model.displacements(x)
        frames = len(self.kinematics.T_frame_base)
        T = self.kinematics.T_frame_base @ displacement[:frames]
        c = -np.einsum("fji,fj->fi", T[:, :3, :3], T[:, :3, 3])
        S = directions[: 6 * frames].reshape(frames, 6, -1)
        dc = -(S[:, :3] + np.cross(S[:, 3:], c[:, :, None], axis=1))
        r, J = np.empty(len(self.distances)), np.empty((len(self.distances), self.size))
        for k, known in enumerate(self.distances):
            between = c[known.first] - c[known.second]
            length = float(np.linalg.norm(between))
            along = between / max(length, 1e-12)
            r[k] = (known.length - length) / known.sigma
            J[k] = along @ (dc[known.first] - dc[known.second]) / known.sigma
        return r, J

    def system(self, x: Array) -> tuple[Array, Array]:
        """The whitened residual and its own derivative, with a row for each prior and each known distance.

        Returns:
            shape (M + priors + distances,) and shape (M + priors + distances, p); see the module's equation. Of the M
            scalars those of column 0 come first, of all rows, then those of column 1. Of many rows M is p + 1: numbers
            whose squares and products are those of all scalars.
        """
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
        """[A r] of the measured scalars in units of their noise, shape (p + 1, M); R of [A r] = Q R for many rows."""
        whiten = (np.sqrt(self.weights)[:, None] * (self.rows.scales / self.scales)).T
        used = self.rows.used.T
        if len(self.weights) <= _TALL:
            return np.asarray((columns * whiten)[:, used])

        factor = whiten * used

        def work(own: slice) -> Array:
            return triangle((columns[:, :, own] * factor[:, own]).reshape(len(columns), -1).T)

        parts = over_blocks(work, len(self.weights))
        return np.asarray(triangle(np.asfortranarray(np.concatenate(parts))).T)

    def paper_system(self, nominal: Array, unit: Array, X: Array) -> tuple[Array, Array]:
        """The paper's error e_i = |dP_i|^2 [mm^2] and its derivative, at its absolute parameters X.

        nominal, shape (p,), are the nominal values [m, rad]; unit is 1e3 for a length and 1 for an angle; X is in mm
        and rad.

        Returns:
            shape (N,), [mm^2], and shape (N, p).
        """
        residual, jacobian = self.residual_and_jacobian(X / unit - nominal)
        residual_mm, jacobian_mm = 1e3 * residual, 1e3 * jacobian / unit
        e = np.sum(residual_mm**2, axis=1)
        return e, -2.0 * np.einsum("ij,ijk->ik", residual_mm, jacobian_mm)


def parts_of(rows: Rows) -> Iterator[slice | Mask]:
    """The rows in parts whose twists are held at a time; both rows of a pair are in one."""
    if len(rows) <= _PART or not np.any(rows.partner >= 0):
        return (slice(k, min(k + _PART, len(rows))) for k in range(0, len(rows), _PART))
    return whole_blocks(rows, _PART)


#: Normal equations that are kept.
_KEPT = 3


@dataclass(frozen=True, slots=True, eq=False)
class Linear:
    """The problem linearised at x: the residual at x + s is r - A s, in units of each scalar's sigma as given.

    It is fitted with several sets of weights at a time, see `calib.estimate.variance`: B of them.
    """

    x: Array  # shape (p,)
    # shape (p + 1, D, N), A and behind it r; samples last, as `calib.robot.kernel` has them
    columns: Array
    used: Mask  # shape (N, D), which scalars there are
    instruments: NDArray[np.int8]  # shape (N, D), which noise each has; -1 for none
    smallest: tuple[float, ...]  # Smallest noise believed of each instrument, in units of its sigma
    C: Array  # shape (K, p), of the known distances, whitened
    z: Array  # shape (K,), what C x should be
    _parts: tuple[tuple[slice, Array | None], ...] = field(init=False, repr=False)
    _told: list[tuple[Array, Linearised]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Find the columns of each instrument's scalars, and where not all rows have them, which do, shape (d, N)."""
        parts = []
        for c in range(len(self.smallest)):
            own = np.equal(self.instruments.T, c)
            there = np.flatnonzero(own.any(axis=1))
            at = slice(int(there[0]), int(there[-1]) + 1) if len(there) else slice(0, 0)
            parts.append((at, None if own[at].all() else own[at].astype(np.float64)))
        object.__setattr__(self, "_parts", tuple(parts))
        object.__setattr__(self, "_told", [])

    def __len__(self) -> int:
        """Number of rows."""
        return int(self.columns.shape[2])

    @property
    def A(self) -> Array:
        """The derivative of the prediction, shape (N, D, p)."""
        return np.asarray(self.columns[:-1].transpose(2, 1, 0))

    def known(self, precision: Array, centre: Array) -> Known:
        """Priors of given precision and mean, and the known distances."""
        return Known.of(precision, centre, self.C, self.z)

    def noise_of(self, noise: Array) -> Array:
        """The noise of each scalar, shape (B, N, D), of each instrument's, shape (B, C); 1 where there is no scalar."""
        return np.hstack([noise, np.ones((len(noise), 1))])[:, self.instruments]

    def residual(self, x: Array) -> Array:
        """What x, shape (B, p) or (p,), leaves over, shape (B, N, D) or (N, D)."""
        count, D, N = self.columns.shape
        flat = self.columns.reshape(count, D * N)
        found = flat[-1] - (x - self.x) @ flat[:-1]
        return np.asarray(found.reshape(*x.shape[:-1], D, N).swapaxes(-1, -2))

    def select(self, mask: Mask) -> Linear:
        """The problem of some of the rows; known distances stay."""
        return replace(
            self,
            columns=self.columns[:, :, mask],
            used=self.used[mask],
            instruments=self.instruments[mask],
        )

    def data(self, weights: Array) -> Linearised:
        """The normal equations with these weights, shape (B, N); the last ones are kept, for stages ask again."""
        for known, told in self._told:
            if np.array_equal(known, weights):
                return told
        told = self._data(weights)
        self._told[:] = [(weights.copy(), told), *self._told[: _KEPT - 1]]
        return told

    def _data(self, weights: Array) -> Linearised:
        """The normal equations."""
        p, (B, N) = len(self.x), weights.shape
        both = np.zeros((B, len(self._parts), p + 1, p + 1))
        count = np.zeros((B, len(self._parts)))
        root = np.sqrt(weights)
        for c, (at, there) in enumerate(self._parts):
            factor = root[:, None] if there is None else there * root[:, None]

            def product(own: slice, at: slice = at, factor: Array = factor) -> Array:
                columns, f = self.columns[:, at, own], factor[:, :, own]
                parts = ((columns * one).reshape(p + 1, -1) for one in f)
                return np.array([part @ part.T for part in parts])

            both[:, c] = np.sum(over_blocks(product, N), axis=0)
            scalars = np.full(N, at.stop - at.start) if there is None else there.sum(axis=0)
            count[:, c] = weights @ scalars
        # [A r] are at hand; what is asked for is [A y] with y = r + A x.
        H, g, rr = both[..., :p, :p], both[..., :p, p], both[..., p, p]
        Hx = H @ self.x
        return Linearised(H, g + Hx, rr + (2.0 * g + Hx) @ self.x, count)

    def fit(self, weights: Array, noise: Array, known: Known) -> tuple[Array, Array, Array]:
        """The linear fit with these weights, shape (B, N), noise, shape (B, C), and priors.

        Returns:
            x, shape (B, p); its covariance, shape (B, p, p); and the degrees of freedom, shape (B,): scalars, by
            weight, minus the parameters that they have to pay for.
        """
        data = self.data(weights)
        x, covariance = data.posterior(noise, known)
        paid = np.sum(data.H * covariance[:, None], axis=(2, 3)) / np.square(noise)
        return x, covariance, np.sum(data.count - paid, axis=1)

    def scores(self, x: Array, covariance: Array, weights: Array, noise: Array) -> Array:
        """How far each row lies from what the others predict, shape (B, N)."""
        factors = 1.0 / self.noise_of(noise)
        found = deleted_norms(self.residual(x), self.A, covariance, weights, factors)
        return as_of_a_point(found, np.sum(self.used, axis=1))

    def norms(self, x: Array, covariance: Array, weights: Array, instrument: int) -> Array:
        """`deleted_norms` of one instrument's scalars in units of the sigma given, shape (B, N)."""
        own = (self.instruments == instrument).astype(np.float64)
        return deleted_norms(self.residual(x), self.A, covariance, weights, own[None])
