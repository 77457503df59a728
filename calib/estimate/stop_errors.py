"""Stops: targets that are seen while the robot stands still are parts of one rigid body, and share its displacement.

A stop is one standstill of the robot at which several targets are measured; a cell is one of these targets at that
stop, whose repeats it holds. The robot's repeatability and what the model lacks displace that body by a translation and
a rotation about the centroid of its targets, random and independent from stop to stop. A stop's scalars, in units of
their sigma, have the covariance

    V = noise^2 K,        K = kappa I + rho_t J_t J_t^T + rho_r J_r J_r^T,        kappa = 1 - rho_t - rho_r

with the derivatives J_t and J_r of the predicted scalars by that displacement, each scaled to mean square 1 over the
table: noise is the standard deviation of a scalar, rho_t and rho_r are the shares of its variance that the targets of a
stop have in common, and kappa is the share that is independent. With
G = [sqrt(rho_t) J_t, sqrt(rho_r) J_r], as in any mixed model (C. R. Henderson, 1953),

    K^-1 = [I - G (kappa I + G^T G)^-1 G^T] / kappa

The shares are estimated from the residual r of generalised least squares, E[r r^T] = V - A C A^T, by equations that
end where the restricted likelihood is highest (R. D. Anderson, 1973; S. R. Searle, G. Casella, C. E. McCulloch,
Variance Components, 1992): with the derivatives V_i of V by theta, which are noise^2 times kappa, rho_t and rho_r,

    sum_j tr(V^-1 V_i V^-1 V_j) theta_j = tr(V^-1 V_i V^-1 [r r^T + A C A^T])

Repeats of a target at a stop enter with their mean: what repeats share is found by `calib.estimate.stages`. Each
instrument, lengths and angles apart, has shares of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from calib.model.kinematics import Kinematics
from calib.registration.rows import Rows
from calib.registration.same_poses import same_poses
from calib.units import Array, Integers, Mask

#: Columns of a body's translation.
_TRANSLATION = slice(0, 3)

#: Columns of a body's rotation.
_ROTATION = slice(3, 6)

#: The least kappa: no instrument's noise is less than a thousandth of what the targets of a stop share.
_LEAST_UNSHARED = 1e-6

#: With fewer degrees of freedom, of the bodies or of the targets within them, the shares are zero.
_FEWEST_FREEDOM = 12

#: The most iterations for the shares.
_STEPS = 20

#: Shares that change by less than this, relative to kappa, have settled.
_SETTLED = 1e-4

#: Rows whose columns are copied at a time.
_PART = 16_384

#: Divisor in place of zero.
_TINY = 1e-300


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """The moments of an instrument's residual r at S stops, from which its shares are estimated, in any unit."""

    #: (S, 6, 6), J^T J
    M: Array
    #: (S, 6, 6), J^T [r r^T + A C A^T] J
    R: Array
    #: The trace of r r^T + A C A^T, of all stops
    total: float
    #: The number of scalars
    count: float

    def shares(self, rho: Array) -> Array:
        """Estimate the shares of translations and rotations, by iteration.

        Args:
            rho: shape (2,), shares to begin with.

        Returns:
            shape (2,); zero where the degrees of freedom are few.
        """
        bodies = int(np.sum(np.linalg.matrix_rank(self.M, hermitian=True)))
        if min(bodies, self.count - bodies) < _FEWEST_FREEDOM:
            return np.zeros(2)
        for _ in range(_STEPS):
            before = rho
            rho = _shares_of(self._components(rho))
            if np.max(np.abs(rho - before)) < _SETTLED * _unshared(rho):
                break
        return rho

    def _components(self, rho: Array) -> Array:
        """Estimate the variances theta of independent errors, translations and rotations, the last two >= 0.

        Args:
            rho: shape (2,), shares at which the equations are set up.

        Returns:
            theta, shape (3,), in the square of the residual's unit.
        """
        left, right = self._equations(rho)
        free = np.diagonal(left) > 0.0  # no translation moves angles
        while True:
            theta = np.zeros(3)
            theta[free] = np.linalg.solve(left[np.ix_(free, free)], right[free])
            if not np.any(theta[1:] < 0.0):
                return theta
            free[1 + int(np.argmin(theta[1:]))] = False

    def _equations(self, rho: Array) -> tuple[Array, Array]:
        """Set up the equations of the module's text for theta.

        The shares S = diag(rho_t, rho_t, rho_t, rho_r, rho_r, rho_r) give G G^T = J S J^T. With
        T = (kappa I + S M)^-1 and H = T S, K^-1 J = J T and K^-1 = (I - J H J^T) / kappa.

        Args:
            rho: shape (2,), the shares of translations and rotations in the variance of a scalar.

        Returns:
            The traces tr(K^-1 K_i K^-1 K_j), shape (3, 3), where K_i is the derivative of V by theta_i, and the right
            side, shape (3,), in the square of the residual's unit.
        """
        kappa, S, M, R = _unshared(rho), _roots(rho) ** 2, self.M, self.R
        T = np.linalg.inv(kappa * np.eye(6) + S[:, None] * M)
        HM, HR = (T * S) @ M, (T * S) @ R
        left, right = np.zeros((3, 3)), np.zeros(3)
        left[0, 0] = (self.count - 2.0 * _trace(HM) + _trace(HM @ HM)) / kappa**2
        right[0] = (self.total - 2.0 * _trace(HR) + _trace(HM @ HR)) / kappa**2
        MT = M @ T
        TMT = _T(T) @ M @ T
        TRT = _T(T) @ R @ T
        parts = (_TRANSLATION, _ROTATION)
        for k, i in enumerate(parts, 1):
            left[0, k] = left[k, 0] = _trace(TMT[:, i, i])
            left[k, 1:] = [np.sum(MT[:, i, j] ** 2) for j in parts]
            right[k] = _trace(TRT[:, i, i])
        return left, right


def _shares_of(theta: Array) -> Array:
    """Return the shares rho, shape (2,), of the last two of three variances, shape (3,) and >= 0 but for the first.

    Their sum is at most 1 - `_LEAST_UNSHARED`.
    """
    shares = theta[1:] / max(float(np.sum(theta)), _TINY)
    return np.asarray(shares / max(float(np.sum(shares)) / (1.0 - _LEAST_UNSHARED), 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class Stops:
    """The rows of stops at which several targets were measured: K rows, in M cells of one target at one of S stops."""

    #: (K,), their numbers in the table, cell by cell and stop by stop
    rows: Integers
    #: (K,), rows of one number are of one cell
    cells: Integers
    #: (K,), rows of one number are of one stop
    stops: Integers
    #: (K, D, 6), Jacobian of each scalar by the body's displacement, of mean square 1
    J: Array
    #: (K, D), which noise each scalar has, from 0; -1 for none
    instruments: NDArray[np.int8]
    #: (M,), of each cell, among these rows
    _first_row: Integers = field(init=False, repr=False)
    #: (S,), of each stop, among the cells
    _first_cell: Integers = field(init=False, repr=False)
    #: (K,), from 0
    _cell_of_row: Integers = field(init=False, repr=False)
    #: (M,), from 0
    _stop_of_cell: Integers = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Find where cells and stops begin, among rows in their order."""
        new_stop = np.diff(self.stops) != 0
        begins_cell = np.append(True, (np.diff(self.cells) != 0) | new_stop)
        begins_stop = np.append(True, np.diff(self.stops[begins_cell]) != 0)
        object.__setattr__(self, "_first_row", np.flatnonzero(begins_cell))
        object.__setattr__(self, "_first_cell", np.flatnonzero(begins_stop))
        object.__setattr__(self, "_cell_of_row", np.cumsum(begins_cell) - 1)
        object.__setattr__(self, "_stop_of_cell", np.cumsum(begins_stop) - 1)

    @classmethod
    def of(cls, kinematics: Kinematics, rows: Rows) -> Stops | None:
        """Find the stops of a table; None where no stop has several targets.

        A stop's rows are of one pose, one frame and one kind, which measures a position.

        Args:
            kinematics: The nominal robot, frames and targets as registered: where the bodies are.
            rows: N rows.
        """
        stop = _stop_of_rows(rows)
        if stop is None:
            return None
        chosen = stop >= 0
        stop = stop[chosen]
        of_stops = rows.select(chosen)
        T_frame_target = kinematics.poses(np.zeros(len(kinematics.model)), of_stops.samples)
        # Repeats of a target are one point of the body.
        weight = 1.0 / np.bincount(of_stops.poses)[of_stops.poses]
        twists = _twists_of_bodies(T_frame_target[:, :3, 3], stop, weight)
        derivative = of_stops.derivative(T_frame_target, twists)
        J = np.zeros((len(of_stops), rows.width, 6))
        J[:, : of_stops.width] = derivative / of_stops.scales[:, :, None]
        instruments = rows.instruments[chosen]
        J = _of_unit_size(J, instruments, weight)
        order = np.lexsort((of_stops.poses, stop))
        return cls(
            rows=np.flatnonzero(chosen)[order],
            cells=of_stops.poses[order],
            stops=stop[order],
            J=J[order],
            instruments=instruments[order],
        )

    def select(self, mask: Mask) -> Stops | None:
        """Return the stops of some of the table's rows, by a mask (N,), numbered anew; None where there are none."""
        kept = mask[self.rows]
        numbers = (np.cumsum(mask) - 1)[self.rows]
        return replace(self._some(kept), rows=numbers[kept]) if np.any(kept) else None

    def drawn(self, count: Array) -> Stops:
        """Return the stops of a bootstrap sample.

        The caller multiplies the rows' weights by ``count``. A row of twice the weight has half the variance, and so
        must the displacement that it shares.

        Args:
            count: shape (N,), how often the stop of each of the table's rows was drawn; 0: not at all.
        """
        often = count[self.rows, None, None]
        return replace(self, J=np.where(often > 0, self.J / np.sqrt(np.maximum(often, 1)), 0.0))

    def corrections(self, columns: Array, weights: Array, rho: Array) -> tuple[Array, Array]:
        """Correct the normal equations of independent rows for what stops share; also the log determinants.

        Args:
            columns: shape (q, D, N), of the table's scalars, in units of their sigma.
            weights: shape (B, N), of its rows: the variance of a row's scalars is divided by its weight.
            rho: shape (B, C, 2), the shares of each of C instruments, of translations and of rotations.

        Returns:
            X^T (K^-1 - I) X with the weighted columns X of each instrument, shape (B, C, q, q); log det K, shape (B,).
        """
        B, C, _ = rho.shape
        changes, log_det = np.zeros((B, C, len(columns), len(columns))), np.zeros(B)
        for stops in self._parts():
            X = stops._rows_of(columns)
            for b, c in np.argwhere(np.any(rho > 0.0, axis=2)).tolist():
                change, log_terms = stops._correction(X, weights[b], c, rho[b, c])
                changes[b, c] += change
                for term in log_terms:
                    log_det[b] += term
        return changes, log_det

    def _correction(
        self, X: Array, weights: Array, c: int, rho: Array
    ) -> tuple[Array, tuple[float, float]]:
        """Correct the normal equations of one instrument.

        Args:
            X: shape (K, D, q), columns of these rows, in units of their sigma.
            weights: shape (N,), of the table's rows.
            c: The instrument's number, from 0.
            rho: shape (2,), its shares.

        Returns:
            X^T (K^-1 - I) X with the weighted columns, shape (q, q); two terms whose sum is log det K.
        """
        means, J, count = self._means(X, weights, c)
        kappa, G = _unshared(rho), J * _roots(rho)
        root = np.linalg.cholesky(np.eye(6) + self._sums(_T(G) @ G) / kappa)
        shared = np.linalg.solve(root, self._sums(_T(G) @ means) / kappa)
        shared = shared.reshape(-1, X.shape[2])
        flat = means.reshape(-1, X.shape[2])
        change = (1.0 / kappa - 1.0) * (flat.T @ flat) - shared.T @ shared
        of_unshared = np.sum(count) * np.log(kappa)
        of_shared = 2.0 * np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)))
        return change, (float(of_unshared), float(of_shared))

    def independent(self, columns: Array, weights: Array, rho: Array) -> Array:
        """Multiply the columns of whitened scalars by the root of K^-1, so that these are independent of each other.

        With G^T G / kappa = Q diag(s^2 - 1) Q^T,

            K^-1/2 = [I - G Q diag(1 / (s + s^2)) Q^T G^T / kappa] / sqrt(kappa)

        Args:
            columns: shape (q, D, N), in units of the noise, and times the roots of the weights.
            weights: shape (N,), of the table's rows.
            rho: shape (C, 2), the shares of each instrument.

        Returns:
            shape (q, D, N).
        """
        result: Array = columns.copy()
        for stops in self._parts():
            w = weights[stops.rows]
            cell = stops._cell_of_row
            X = stops._rows_of(columns) / np.sqrt(np.maximum(w, _TINY))[:, None, None]
            for c in np.flatnonzero(np.any(rho > 0.0, axis=1)).tolist():
                change = stops._change_of_means(X, weights, c, rho[c])
                weight_of_cell = np.maximum(np.add.reduceat(w, stops._first_row), _TINY)
                root = np.sqrt(w / weight_of_cell[cell])
                changes = change[cell] * root[:, None, None]
                result[:, :, stops.rows] += changes.transpose(2, 1, 0)
        return result

    def _change_of_means(self, X: Array, weights: Array, c: int, rho: Array) -> Array:
        """Return what must be added to the cells' means so that those of a stop are independent: (K^-1/2 - I) means.

        Args:
            X: shape (K, D, q), columns of these rows, in units of their noise.
            weights: shape (N,), of the table's rows: the variance of a row's scalars is divided by its weight.
            c: The instrument's number, from 0.
            rho: shape (2,), its shares of translations and rotations; K has the kappa that they leave.

        Returns:
            shape (M, D, q), in units of the noise; zero for scalars of other instruments.
        """
        means, J, _ = self._means(X, weights, c)
        kappa = _unshared(rho)
        G = J * _roots(rho) / np.sqrt(kappa)
        squares, Q = np.linalg.eigh(self._sums(_T(G) @ G))
        s = np.sqrt(1.0 + np.maximum(squares, 0.0))[:, None]
        shared = (Q / (s + s**2)) @ (_T(Q) @ self._sums(_T(G) @ means))
        independent = (means - G @ shared[self._stop_of_cell]) / np.sqrt(kappa)
        return np.asarray(independent - means)

    def moments(self, columns: Array, weights: Array, c: int, x: Array, C: Array) -> Moments:
        """Compute the moments of a fit's residual for one instrument.

        Args:
            columns: shape (p + 1, D, N), the derivative A of the prediction and the residual, in units of sigma.
            weights: shape (N,), of the rows.
            c: The instrument's number, from 0.
            x: shape (p,), the solution, relative to where the residual of ``columns`` was taken.
            C: shape (p, p), its covariance.

        Returns:
            Moments of all stops, in units of sigma.
        """
        M, R, total, count = [], [], 0.0, 0.0
        for stops in self._parts():
            means, J, measured = stops._means(stops._rows_of(columns), weights, c)
            A = means[..., :-1]
            r = means[..., -1:] - A @ x[:, None]
            sums = stops._sums(_T(J) @ np.concatenate([J, A, r], axis=2))
            J_A, J_r = sums[..., 6:-1], sums[..., -1:]
            M.append(sums[..., :6])
            R.append(J_r @ _T(J_r) + J_A @ C @ _T(J_A))
            total += float(np.sum(r**2) + np.sum((A @ C) * A))
            count += float(np.sum(measured))
        return Moments(np.concatenate(M), np.concatenate(R), total, count)

    def _means(self, X: Array, weights: Array, c: int) -> tuple[Array, Array, Array]:
        """Average an instrument's scalars over each cell; zero for scalars of other instruments.

        Repeats are summed with their weights, and scaled so that the sum has the variance of one row of weight 1.

        Args:
            X: shape (K, D, q), columns of these rows.
            weights: shape (N,), of the table's rows.
            c: The instrument's number, from 0.

        Returns:
            Means of the columns, shape (M, D, q), of the Jacobian by the body, shape (M, D, 6), and numbers of scalars,
            shape (M, D).
        """
        w = weights[self.rows, None]
        of_instrument = self.instruments == c
        total = np.add.reduceat(w, self._first_row)
        scale = 1.0 / np.sqrt(np.maximum(total, _TINY))
        both = np.concatenate([X, self.J], axis=2) * (w * of_instrument)[:, :, None]
        both = np.add.reduceat(both, self._first_row) * scale[:, :, None]
        count = of_instrument[self._first_row] * np.minimum(total, 1.0)
        return both[..., :-6], both[..., -6:], count

    def _sums(self, values: Array) -> Array:
        """Sum values (M, ...) over the cells of each stop, shape (S, ...)."""
        return np.asarray(np.add.reduceat(values, self._first_cell))

    def _rows_of(self, columns: Array) -> Array:
        """Return the columns (q, D, N) of these rows, shape (K, D, q)."""
        return np.ascontiguousarray(columns[:, :, self.rows].transpose(2, 1, 0))

    def _parts(self) -> list[Stops]:
        """Return the stops in parts of about `_PART` rows, each stop whole."""
        if len(self.rows) <= _PART:
            return [self]
        first = self._first_row[self._first_cell][self._stop_of_cell][self._cell_of_row]
        part = first // _PART
        return [self._some(part == k) for k in np.unique(part)]

    def _some(self, kept: Mask) -> Stops:
        """Return the stops of some of these rows, by a mask (K,); numbers in the table stay."""
        return Stops(
            rows=self.rows[kept],
            cells=self.cells[kept],
            stops=self.stops[kept],
            J=self.J[kept],
            instruments=self.instruments[kept],
        )


def _stop_of_rows(rows: Rows) -> Integers | None:
    """Number the stop of each row, shape (N,); -1 for rows of stops with one target; None where all are such."""
    target = rows.samples.target
    if not len(rows) or target.min() == target.max():
        return None
    # The two poses of a pair are one block.
    pose = same_poses(rows.joints) if np.any(rows.partner >= 0) else rows.blocks
    labels = np.column_stack([pose, rows.samples.frame, rows.kinds])
    stop = np.unique(labels, axis=0, return_inverse=True)[1].reshape(-1)
    stop_of_target = np.unique(np.column_stack([stop, target]), axis=0)[:, 0]
    several = np.bincount(stop_of_target)[stop] > 1
    chosen = several & rows.where(lambda kind: kind.position)
    return np.where(chosen, stop, -1) if np.any(chosen) else None


def _unshared(rho: Array) -> float:
    """Return the share kappa of a scalar's variance that is independent of the other targets of its stop."""
    return float(max(1.0 - np.sum(rho), _LEAST_UNSHARED))


def _roots(rho: Array) -> Array:
    """Return the square root of the share of each direction of a displacement, shape (6,)."""
    return np.repeat(np.sqrt(rho), 3)


def _T(M: NDArray[np.floating]) -> Array:
    """The transposed matrices."""
    return np.asarray(M.swapaxes(-1, -2))


def _trace(M: Array) -> float:
    """The sum of the traces of matrices."""
    return float(np.einsum("sii->", M))


def _twists_of_bodies(points: Array, stops: Integers, counts: Array) -> Array:
    """Differentiate points (K, 3) by the displacement of their bodies, shape (K, 6, 6) [m, rad].

    Bodies turn about the centroids of their points, each of weight ``counts``, (K,).
    """
    body = np.unique(stops, return_inverse=True)[1].reshape(-1)
    sums = np.stack([np.bincount(body, counts * column) for column in points.T], axis=1)
    lever = points - (sums / np.bincount(body, counts)[:, None])[body]
    twists = np.zeros((len(points), 6, 6))
    twists[:] = np.eye(6)
    # Column k is e_k x lever.
    twists[:, :3, 3:] = _T(np.cross(np.eye(3), lever[:, None]))
    return twists


def _of_unit_size(J: Array, instruments: NDArray[np.int8], counts: Array) -> Array:
    """Scale Jacobians by displacements of bodies so that their effect has mean square 1.

    Each instrument's Jacobians by translations, and those by rotations, have a scale of their own.

    Args:
        J: shape (K, D, 6).
        instruments: shape (K, D), number of each scalar's instrument; -1 for none.
        counts: shape (K,), weight of each row in the mean.
    """
    result = np.zeros(J.shape)
    for c in range(int(instruments.max()) + 1):
        of_instrument = instruments == c
        weight = counts[:, None] * of_instrument
        for part in (_TRANSLATION, _ROTATION):
            square = float(np.sum(weight[:, :, None] * J[:, :, part] ** 2))
            if square > 0.0:
                scale = np.sqrt(np.sum(weight) / square)
                result[:, :, part] += scale * of_instrument[:, :, None] * J[:, :, part]
    return result
