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

The shares are estimated from the residuals of a fit by `calib.estimate.stop_shares`. Repeats of a target at a stop
enter with their mean: what repeats share is found by `calib.estimate.stages`. Each instrument, lengths and angles
apart, has shares of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from calib.estimate.stop_bodies import of_unit_size, stop_of_rows, twists_of_bodies
from calib.estimate.stop_shares import TINY, Moments, root_shares, transposed, unshared
from calib.model.kinematics import Kinematics
from calib.registration.rows import Rows
from calib.units import Array, Integers, Mask

#: Rows whose columns are copied at a time.
_PART = 16_384


@dataclass(frozen=True, slots=True, eq=False)
class _CellMeans:
    """Means of one instrument's scalars over M cells: a cell is one target at one stop, with its repeats.

    Each is scaled so that it has the variance of one row of weight 1; zero for scalars of other instruments.
    """

    #: (M, D, q), of given columns of the scalars
    columns: Array
    #: (M, D, 6), of the derivative of each scalar by the body's displacement
    J: Array
    #: (M, D), number of scalars: 1, less where the rows have little weight, or 0
    count: Array


@dataclass(frozen=True, slots=True, eq=False)
class Stops:
    """The rows of stops at which several targets were measured: K rows, in M cells of one target at one of S stops."""

    #: (K,), their indices in the table of N rows, from 0, cell by cell and stop by stop
    rows: Integers
    #: (K,), rows of one number are of one cell
    cells: Integers
    #: (K,), rows of one number are of one stop
    stops: Integers
    #: (K, D, 6), Jacobian of each scalar by the body's displacement, of mean square 1
    J: Array
    #: (K, D), index of the instrument, and so of the noise, of each scalar, from 0; -1 where there is no scalar
    instruments: NDArray[np.int8]
    #: (M,), index of the first row of each cell, among these K rows
    _first_row: Integers = field(init=False, repr=False)
    #: (S,), index of the first cell of each stop, among the M cells
    _first_cell: Integers = field(init=False, repr=False)
    #: (K,), index of each row's cell, from 0
    _cell_of_row: Integers = field(init=False, repr=False)
    #: (M,), index of each cell's stop, from 0
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
        """Find the stops of a table at which several targets were measured.

        A stop is one standstill of the robot. Its rows are of one pose, one frame and one kind, which measures a
        position; its targets are parts of one rigid body.

        Args:
            kinematics: The nominal robot under its error model, frames and targets as registered: where the bodies are.
            rows: N rows of measurements: joint values, frame and target of each, and the measured scalars.

        Returns:
            The rows of these stops with the derivatives of their scalars by the body's displacement; None where no stop
            has several targets.
        """
        stop = stop_of_rows(rows)
        if stop is None:
            return None
        chosen = stop >= 0
        stop = stop[chosen]
        of_stops = rows.select(chosen)
        nominal = np.zeros(len(kinematics.model))
        T_frame_target = kinematics.poses(nominal, of_stops.samples)
        # Repeats of a target are one point of the body.
        weight = 1.0 / np.bincount(of_stops.poses)[of_stops.poses]
        twists = twists_of_bodies(T_frame_target[:, :3, 3], stop, weight)
        derivative = of_stops.derivative(T_frame_target, twists)
        J = np.zeros((len(of_stops), rows.width, 6))
        J[:, : of_stops.width] = derivative / of_stops.scales[:, :, None]
        instruments = rows.instruments[chosen]
        J = of_unit_size(J, instruments, weight)
        order = np.lexsort((of_stops.poses, stop))
        return cls(
            rows=np.flatnonzero(chosen)[order],
            cells=of_stops.poses[order],
            stops=stop[order],
            J=J[order],
            instruments=instruments[order],
        )

    def select(self, mask: Mask) -> Stops | None:
        """Return the stops (standstills at which several targets are measured) of some of the table's rows.

        Args:
            mask: shape (N,), which rows of the table are kept.

        Returns:
            The stops; their rows have the indices, from 0, that they have in the table of the kept rows. None where no
            row of a stop is kept.
        """
        kept = mask[self.rows]
        numbers = (np.cumsum(mask) - 1)[self.rows]
        if not np.any(kept):
            return None
        return replace(self._some(kept), rows=numbers[kept])

    def drawn(self, count: Array) -> Stops:
        """Return the stops (standstills at which several targets are measured) of a bootstrap sample.

        The caller multiplies the rows' weights by ``count``. A row of twice the weight has half the variance, and so
        must the displacement that it shares.

        Args:
            count: shape (N,), how often the stop of each of the table's rows was drawn; 0: not at all.

        Returns:
            The same stops, with the derivatives of their scalars by the body's displacement divided by sqrt(count); 0
            for stops that were not drawn.
        """
        often = count[self.rows, None, None]
        shrunk = self.J / np.sqrt(np.maximum(often, 1))
        return replace(self, J=np.where(often > 0, shrunk, 0.0))

    def corrections(self, columns: Array, weights: Array, rho: Array) -> tuple[Array, Array]:
        """Correct the normal equations of independent rows for what the targets of a stop share.

        The targets that are measured at one standstill of the robot (a stop) share the displacement of their body. With
        the derivatives J_t and J_r of their scalars by its translation and rotation, the scalars have the covariance
        noise^2 K, where K = kappa I + rho_t J_t J_t^T + rho_r J_r J_r^T and kappa = 1 - rho_t - rho_r.

        Args:
            columns: shape (q, D, N), q columns of the table's scalars, D of each of N rows, such as Jacobian and
                residual, in units of their sigma.
            weights: shape (B, N), of its rows in B fits: the variance of a row's scalars is divided by its weight.
            rho: shape (B, C, 2), the shares of each of C instruments, of translations and of rotations.

        Returns:
            X^T (K^-1 - I) X with the weighted columns X of each instrument, shape (B, C, q, q); log det K, shape (B,).
        """
        q = len(columns)
        changes = np.zeros((*rho.shape[:2], q, q))
        log_det = np.zeros(len(rho))
        shares_any = np.argwhere(np.any(rho > 0.0, axis=2)).tolist()
        for stops in self._parts():
            X = stops._rows_of(columns)
            for b, c in shares_any:
                change, log_terms = stops._correction(X, weights[b], c, rho[b, c])
                changes[b, c] += change
                for term in log_terms:
                    log_det[b] += term
        return changes, log_det

    def _correction(
        self,
        X: Array,
        weights: Array,
        c: int,
        rho: Array,
    ) -> tuple[Array, tuple[float, float]]:
        """Correct the normal equations of one instrument in one fit for what the targets of a stop share.

        K = kappa I + G G^T is the covariance of the scalars of a stop (a standstill at which several targets are
        measured) over the noise squared, with G = [sqrt(rho_t) J_t, sqrt(rho_r) J_r].

        Args:
            X: shape (K, D, q), columns of the scalars of these K rows, in units of their sigma.
            weights: shape (N,), of the table's N rows: the variance of a row's scalars is divided by its weight.
            c: The instrument's index, from 0.
            rho: shape (2,), its shares of translations and of rotations.

        Returns:
            X^T (K^-1 - I) X with the weighted columns, shape (q, q); two terms whose sum is log det K.
        """
        means = self._means(X, weights, c)
        kappa = unshared(rho)
        G = means.J * root_shares(rho)
        GG = self._sums(transposed(G) @ G)
        root = np.linalg.cholesky(np.eye(6) + GG / kappa)
        G_X = self._sums(transposed(G) @ means.columns)
        shared = np.linalg.solve(root, G_X / kappa)
        change = _change_of_products(means.columns, shared, kappa)
        of_unshared = np.sum(means.count) * np.log(kappa)
        of_shared = 2.0 * np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)))
        return change, (float(of_unshared), float(of_shared))

    def independent(self, columns: Array, weights: Array, rho: Array) -> Array:
        """Multiply the columns of whitened scalars by the root of K^-1, so that these are independent of each other.

        The targets that are measured at one standstill of the robot (a stop) share the displacement of their body, so
        that their scalars have the covariance noise^2 K, K = kappa I + G G^T, with the shares kappa of independent
        errors and G = [sqrt(rho_t) J_t, sqrt(rho_r) J_r] of translation and rotation. With
        G^T G / kappa = Q diag(s^2 - 1) Q^T,

            K^-1/2 = [I - G Q diag(1 / (s + s^2)) Q^T G^T / kappa] / sqrt(kappa)

        Args:
            columns: shape (q, D, N), q columns of the scalars of the table's N rows, such as Jacobian and residual, in
                units of the noise, and times the roots of the weights.
            weights: shape (N,), of the table's rows.
            rho: shape (C, 2), the shares of each of C instruments, of translations and of rotations.

        Returns:
            shape (q, D, N), in the same units; rows that are of no stop as they are.
        """
        result: Array = columns.copy()
        instruments = np.flatnonzero(np.any(rho > 0.0, axis=1)).tolist()
        for stops in self._parts():
            w = weights[stops.rows]
            root_weights = np.sqrt(np.maximum(w, TINY))
            X = stops._rows_of(columns) / root_weights[:, None, None]
            weight_of_cell = np.maximum(np.add.reduceat(w, stops._first_row), TINY)
            root_share = np.sqrt(w / weight_of_cell[stops._cell_of_row])
            for c in instruments:
                change = stops._change_of_means(X, weights, c, rho[c])
                changes = change[stops._cell_of_row] * root_share[:, None, None]
                result[:, :, stops.rows] += changes.transpose(2, 1, 0)
        return result

    def _change_of_means(self, X: Array, weights: Array, c: int, rho: Array) -> Array:
        """Return what must be added to the cells' means so that those of a stop are independent: (K^-1/2 - I) means.

        A cell is one target at one standstill of the robot (a stop), with its repeats; K is the covariance of a stop's
        scalars over the noise squared, kappa I + G G^T.

        Args:
            X: shape (K, D, q), columns of the scalars of these K rows, in units of their noise.
            weights: shape (N,), of the table's N rows: the variance of a row's scalars is divided by its weight.
            c: The instrument's index, from 0.
            rho: shape (2,), its shares of translations and rotations; what they leave of 1 is independent.

        Returns:
            shape (M, D, q), of M cells, in units of the noise; zero for scalars of other instruments.
        """
        means = self._means(X, weights, c)
        kappa = unshared(rho)
        G = means.J * root_shares(rho) / np.sqrt(kappa)
        squares, Q = np.linalg.eigh(self._sums(transposed(G) @ G))
        s = np.sqrt(1.0 + np.maximum(squares, 0.0))[:, None]
        G_means = self._sums(transposed(G) @ means.columns)
        shared = (Q / (s + s**2)) @ (transposed(Q) @ G_means)
        independent = (means.columns - G @ shared[self._stop_of_cell]) / np.sqrt(kappa)
        return np.asarray(independent - means.columns)

    def moments(self, columns: Array, weights: Array, c: int, x: Array, C: Array) -> Moments:
        """Compute the moments of a fit's residual for one instrument.

        Args:
            columns: shape (p + 1, D, N), of the scalars of the table's N rows: the derivative A of the prediction by p
                parameters, and behind it the residual, measured minus predicted, in units of sigma.
            weights: shape (N,), of the rows.
            c: The instrument's index, from 0.
            x: shape (p,), the solution, relative to where the residual of ``columns`` was taken.
            C: shape (p, p), its covariance.

        Returns:
            Moments of all stops, in units of sigma.
        """
        parts = []
        for stops in self._parts():
            means = stops._means(stops._rows_of(columns), weights, c)
            parts.append(stops._moments_of(means, x, C))
        return Moments.joined(parts)

    def _moments_of(self, means: _CellMeans, x: Array, C: Array) -> Moments:
        """Compute the moments of a fit's residual from the means of these stops' cells.

        Args:
            means: Means of one instrument's scalars over the cells; their columns are the derivative A of the
                prediction by p parameters, and behind it the residual, in units of sigma.
            x: shape (p,), the solution, relative to where the residual was taken.
            C: shape (p, p), its covariance.

        Returns:
            Moments of these stops, in units of sigma.
        """
        A = means.columns[..., :-1]
        r = means.columns[..., -1:] - A @ x[:, None]
        sums = self._sums(transposed(means.J) @ np.concatenate([means.J, A, r], axis=2))
        J_J = sums[..., :6]
        J_A = sums[..., 6:-1]
        J_r = sums[..., -1:]
        R = J_r @ transposed(J_r) + J_A @ C @ transposed(J_A)
        total = float(np.sum(r**2) + np.sum((A @ C) * A))
        return Moments(J_J, R, total, float(np.sum(means.count)))

    def _means(self, X: Array, weights: Array, c: int) -> _CellMeans:
        """Average an instrument's scalars over each cell, which is one target at one stop, with its repeats.

        Repeats are summed with their weights, and scaled so that the sum has the variance of one row of weight 1.

        Args:
            X: shape (K, D, q), columns of the scalars of these K rows.
            weights: shape (N,), of the table's N rows.
            c: The instrument's index, from 0.

        Returns:
            Means, in the unit of X, of the columns and of the derivative by the body's displacement, and numbers of
            scalars; all zero for scalars of other instruments.
        """
        w = weights[self.rows, None]
        of_instrument = self.instruments == c
        total = np.add.reduceat(w, self._first_row)
        scale = 1.0 / np.sqrt(np.maximum(total, TINY))
        weight = (w * of_instrument)[:, :, None]
        weighted = np.concatenate([X, self.J], axis=2) * weight
        means = np.add.reduceat(weighted, self._first_row) * scale[:, :, None]
        count = of_instrument[self._first_row] * np.minimum(total, 1.0)
        return _CellMeans(means[..., :-6], means[..., -6:], count)

    def _sums(self, values: Array) -> Array:
        """Sum values over the cells of each stop: over the targets that are measured at one standstill.

        Args:
            values: shape (M, ...), of each of M cells (one target at one stop, with its repeats), in their order.

        Returns:
            shape (S, ...), of each of S stops.
        """
        return np.asarray(np.add.reduceat(values, self._first_cell))

    def _rows_of(self, columns: Array) -> Array:
        """Return the columns of the K rows of stops, which are some of the table's N rows.

        Args:
            columns: shape (q, D, N), q columns of the D scalars of each of the table's N rows.

        Returns:
            shape (K, D, q), contiguous, in the order of `rows`.
        """
        return np.ascontiguousarray(columns[:, :, self.rows].transpose(2, 1, 0))

    def _parts(self) -> list[Stops]:
        """Divide the K rows into parts of about `_PART` rows, for memory; the rows of a stop stay together.

        Returns:
            The parts, in the order of the K rows; this object alone where it has few rows.
        """
        if len(self.rows) <= _PART:
            return [self]
        first = self._first_row[self._first_cell][self._stop_of_cell][self._cell_of_row]
        part = first // _PART
        return [self._some(part == k) for k in np.unique(part)]

    def _some(self, kept: Mask) -> Stops:
        """Return some of the K rows of stops; their indices in the table stay.

        Args:
            kept: shape (K,), which of these K rows to keep.

        Returns:
            The kept rows, in their order, with their cells and stops.
        """
        return Stops(
            rows=self.rows[kept],
            cells=self.cells[kept],
            stops=self.stops[kept],
            J=self.J[kept],
            instruments=self.instruments[kept],
        )


def _change_of_products(means: Array, shared: Array, kappa: float) -> Array:
    """The change of normal equations by what stops share: X^T (K^-1 - I) X.

    With the Cholesky factor L of I + G^T G / kappa, K^-1 = I / kappa - Z^T Z where Z = L^-1 G^T / kappa.

    Args:
        means: shape (M, D, q), columns X of the scalars, averaged over cells.
        shared: shape (S, 6, q), Z X of each of S stops.
        kappa: The share of a scalar's variance that is independent of the other targets of its stop.

    Returns:
        shape (q, q), in units of X squared.
    """
    columns = means.shape[2]
    X = means.reshape(-1, columns)
    ZX = shared.reshape(-1, columns)
    return np.asarray((1.0 / kappa - 1.0) * (X.T @ X) - ZX.T @ ZX)
