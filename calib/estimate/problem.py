"""Problem: robot, error model and measurements as one weighted least-squares problem.

    minimise  1/2 sum_i w_i |r_i(x) / sigma_i|^2 + 1/2 sum_k (x_k - m_k)^2 / tau_k^2 + 1/2 sum_c (d_c - d_c(x))^2 /
    s_c^2

with residuals r, normal priors of size tau on the offsets (mean 0, but at a bound) and known distances d.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from calib.estimate.likelihood import Linear
from calib.estimate.rows import LENGTHS, Rows
from calib.estimate.setup import KnownDistance
from calib.estimate.solvers import triangle
from calib.estimate.statistics import Array
from calib.model.kinematics import Kinematics
from calib.robot.kernel import over_blocks

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
    smallest: tuple[
        float, ...
    ]  # Smallest noise believed of each instrument, in units of its sigma as given
    _last: list[Linear] = field(default_factory=list, repr=False)

    @classmethod
    def first(
        cls, kinematics: Kinematics, rows: Rows, distances: tuple[KnownDistance, ...] = ()
    ) -> Problem:
        """All rows in full, the noise as given, no priors."""
        ones, nothing = np.ones(len(rows)), np.zeros(len(kinematics.model))
        scales, number = rows.scales, rows.instruments
        smallest = tuple(
            _SMALLEST_SIGMA / float(np.median(scales[number == c]))
            for c in range(int(number.max()) + 1)
        )
        return cls(kinematics, rows, scales, ones, nothing, nothing, distances, smallest)

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
        """The problem linearised at x, in units of each scalar's sigma as given; the last one is kept.

        Weights, noise and priors do not enter it, so that a problem and its reweighted copies share one.
        """
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
        at = x.copy()
        found = Linear(at, columns, rows.used, rows.instruments, self.smallest, C, r + C @ x)
        self._last.append(found)
        return found

    def known_slopes(self, x: Array) -> Array:
        """The derivative of the known distances, shape (K, p): they tell of parameters as rows do."""
        sigma = np.array([known.sigma for known in self.distances])
        return np.asarray(self.constraints(x)[1] * sigma[:, None])

    def constraints(self, x: Array) -> tuple[Array, Array]:
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
        """The whitened residual and its own derivative, with a row for each prior and each known distance.

        Of the M scalars those of column 0 come first, of all rows, then those of column 1. Of many rows M is p + 1:
        numbers whose squares and products are those of all scalars.
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
        """The paper's error e_i = |dP_i|^2 [mm^2], shape (N,), and its derivative, (N, p), at absolute parameters X.

        X is in mm and rad; nominal, shape (p,), in m and rad; unit is 1e3 for a length and 1 for an angle.
        """
        x = X / unit - nominal
        residual_mm = 1e3 * self.linear(x).residual(x) * self.rows.scales
        slopes_mm = 1e3 * self.jacobian(x) / unit
        return np.sum(residual_mm**2, axis=1), -2.0 * np.einsum(
            "ij,ijk->ik", residual_mm, slopes_mm
        )
