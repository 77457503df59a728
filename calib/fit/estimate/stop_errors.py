"""Stops: targets that are seen while the robot stands still are parts of one rigid body, and share its displacement.

A stop is one standstill of the robot at which several targets are measured; a cell is one of these targets at that
stop, whose repeats it holds. The robot's repeatability and what the model lacks displace that body by a translation and
a rotation about the centroid of its targets; and each joint that turns misses its reading, by the steps of its encoder,
play or a servo's error. All are random and independent from stop to stop. A stop's scalars, in units of their sigma,
have the covariance

    V = noise^2 K,        K = kappa I + rho_t J_t J_t^T + rho_r J_r J_r^T + rho_q J_q J_q^T

with the Jacobians J_t, J_r and J_q of the predicted scalars by translation, rotation and joints, together d directions,
each scaled so that the mean diagonal entry of J J^T over the table is 1: noise is the standard deviation of a scalar,
rho_t, rho_r and rho_q are the shares of its variance that the targets of a stop have in common, and the share
kappa = 1 - rho_t - rho_r - rho_q is independent. With G = [sqrt(rho_t) J_t, sqrt(rho_r) J_r, sqrt(rho_q) J_q], as in
any mixed model (C. R. Henderson, 1953),

    K^-1 = [I - G (kappa I + G^T G)^-1 G^T] / kappa

The shares are estimated from the residuals of a fit by `calib.fit.estimate.stop_shares`. Repeats of a target at a stop
enter with their mean: what repeats share is found by `calib.fit.estimate.stages`. Each instrument, lengths and angles
apart, has shares of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from calib.basics.arrays import Array, Integers, Mask
from calib.fit.estimate.stop_bodies import (
    of_unit_size,
    stop_of_rows,
    twists_of_bodies,
    twists_of_joints,
)
from calib.fit.estimate.stop_shares import TINY, Moments, root_shares, transposed, unshared
from calib.fit.registration.rows import Rows
from calib.model.kinematics import Kinematics

#: Rows whose columns are copied at a time.
_PART = 16_384


@dataclass(frozen=True, slots=True, eq=False)
class _CellMeans:
    """Means of one instrument's scalars over M cells: a cell is one target at one stop, with its repeats.

    Each is the weighted sum over the repeats over the square root of the sum of their weights, so that it has the
    variance of one row of weight 1; zero for scalars of other instruments.
    """

    #: (M, D, q), of given columns of the scalars, in their unit
    columns: Array
    #: (M, D, d), of the Jacobian of each scalar by d directions: translation (3) and rotation (3) of the stop's body,
    #: the joints
    J: Array
    #: (M, D), number of scalars: 1, or the sum of the rows' weights where that is less; 0 for other instruments
    count: Array


@dataclass(frozen=True, slots=True, eq=False)
class _IndependentMeans:
    """Means X of one instrument's scalars over M cells, and K^-1/2 X, which are independent of each other."""

    #: (M, D, q), X, in units of the noise
    columns: Array
    #: (M, D, q), K^-1/2 X
    independent: Array
    #: log det K over all stops
    log_det: float


@dataclass(frozen=True, slots=True, eq=False)
class Stops:
    """The rows of stops at which several targets were measured: n rows, in M cells of one target at one of S stops."""

    #: (n,), their indices in the table of N rows, from 0, cell by cell and stop by stop
    rows: Integers
    #: (n,), rows of one number are of one cell
    cells: Integers
    #: (n,), rows of one number are of one stop
    stops: Integers
    #: (n, D, d), Jacobian of each scalar by the body's displacement: translations, rotations, joints. Of each
    #: instrument the sum of squares over each of the three has mean 1
    J: Array
    #: (n, D), index of the instrument, and so of the noise, of each scalar, from 0; -1 where there is no scalar
    instruments: NDArray[np.int8]
    #: (M,), index of the first row of each cell, among these n rows
    _first_row: Integers = field(init=False, repr=False)
    #: (S,), index of the first cell of each stop, among the M cells
    _first_cell: Integers = field(init=False, repr=False)
    #: (n,), index of each row's cell, from 0
    _cell_of_row: Integers = field(init=False, repr=False)
    #: (M,), index of each cell's stop, from 0
    _stop_of_cell: Integers = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Find where cells and stops begin among the n rows, which are sorted by stop and, within it, by cell.

        From `cells` and `stops`, shape (n,), the numbers of each row's cell and stop, sets the indices, from 0, of the
        first row of each of M cells, of the first cell of each of S stops, of each row's cell, and of each cell's stop.
        """
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

        A stop is one standstill of the robot. Its rows are of one pose, one measurement frame and one kind, which
        measures a position; its targets are parts of one rigid body. A cell is one target at one stop, with its
        repeats.

        Args:
            kinematics: The nominal robot under its error model, frames and targets as registered; it gives the pose of
                each row's target at zero parameters, of which the centroid of each body and the lever arms are taken.
            rows: N rows of measurements of up to D scalars: joint values, frame and target of each (``rows.samples``),
                numbers that repeats share (``rows.poses``), given sigmas (``rows.scales``, shape (N, D), [m] and
                [rad]), and the instrument of each scalar (``rows.channels.index``, shape (N, D)).

        Returns:
            The n rows of these stops, by cell and stop, with the derivatives of their scalars by the displacement of
            the stop's body, shape (n, D, d): three translations, three rotations about the centroid of its targets,
            along the measurement frame's axes, and the joints that turn. Each instrument's derivatives by translations,
            by rotations and by joints are scaled so that their sum of squares has mean 1 over its scalars. None where
            no stop has several targets.
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
        points = of_stops.points(T_frame_target)
        of_body = twists_of_bodies(T_frame_target[:, :3, 3], points, stop, weight)
        of_joints = twists_of_joints(kinematics, of_stops.samples)
        twists = np.concatenate([of_body, of_joints], axis=2)
        derivative = of_stops.derivative(T_frame_target, twists)
        J = np.zeros((len(of_stops), rows.width, twists.shape[2]))
        J[:, : of_stops.width] = of_stops.standardised(derivative)
        instruments = rows.channels.index[chosen]
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

        Uses ``rows``, shape (n,), indices of the stops' rows in the table, from 0.

        Args:
            mask: shape (N,), True for rows of the table that are kept.

        Returns:
            The stops of the kept rows, even those with one target left; their ``rows`` are the indices, from 0, in the
            table of the kept rows. Derivatives keep their scale. None where no row of a stop is kept.
        """
        kept = mask[self.rows]
        numbers = (np.cumsum(mask) - 1)[self.rows]
        if not np.any(kept):
            return None
        return replace(self._some(kept), rows=numbers[kept])

    def drawn(self, count: Array) -> Stops:
        """Return the stops (standstills at which several targets are measured) of a bootstrap sample of the stops.

        The caller multiplies the rows' weights by ``count``. A row of twice the weight has half the variance, and so
        must the displacement that it shares. Of the fields it changes `J`, shape (n, D, d), the derivatives of the
        scalars of n rows by the displacement of their stop's body.

        Args:
            count: shape (N,), how many times the stop of each of the table's rows was drawn; 0: not at all.

        Returns:
            The same stops, with these derivatives divided by sqrt(count); 0 for stops that were not drawn.
        """
        often = count[self.rows, None, None]
        shrunk = self.J / np.sqrt(np.maximum(often, 1))
        return replace(self, J=np.where(often > 0, shrunk, 0.0))

    def corrections(self, columns: Array, weights: Array, rho: Array) -> tuple[Array, Array]:
        """Correct the normal equations of independent rows for what the targets of a stop share.

        The targets that are measured at one standstill of the robot (a stop) share the displacement of their body. With
        the derivatives J_t, J_r and J_q of their scalars by its translation and rotation and by the joints, the scalars
        have the covariance noise^2 K, with K as at the head of this module. Only the means
        over the repeats of a target at a stop share it: weighted sums over the square root of the sum of weights, X.

        Args:
            columns: shape (q, D, N), q columns of the table's scalars, D of each of N rows, such as Jacobian and
                residual, in units of each scalar's given sigma.
            weights: shape (B, N), of its rows in B fits, >= 0: the variance of a row's scalars is divided by its
                weight.
            rho: shape (B, C, 3), shares rho_t, rho_r and rho_q of the variance of each of C instruments; where all are
                0 there is nothing to correct.

        Returns:
            What is to be added to the products of each fit and instrument: X^T (K^-1 - I) X over all stops, with the
            means X of its scalars, shape (B, C, q, q), in units of the columns squared; and log det K over all stops
            and instruments, shape (B,).
        """
        q = len(columns)
        changes = np.zeros((*rho.shape[:2], q, q))
        log_det = np.zeros(len(rho))
        shares_any = np.argwhere(np.any(rho > 0.0, axis=2)).tolist()
        for stops in self._parts():
            X = stops._rows_of(columns)  # (n, D, q)
            for b, c in shares_any:
                change, of_instrument = stops._correction(X, weights[b], c, rho[b, c])
                changes[b, c] += change
                log_det[b] += of_instrument
        return changes, log_det

    def _correction(
        self,
        X: Array,
        weights: Array,
        c: int,
        rho: Array,
    ) -> tuple[Array, float]:
        """Correct the normal equations of one instrument in one fit for what the targets of a stop share.

        K = kappa I + G G^T is the covariance of the scalars of a stop (a standstill at which several targets are
        measured) over the noise squared, with G and kappa as at the head of this module: the derivatives of the scalars
        by translation and rotation of the body that the targets are on, and by the joints, times the roots of the
        shares.

        Args:
            X: shape (n, D, q), q columns (of the Jacobian, and the residual) of the D scalars of the n rows of these S
                stops, in the order of the field `rows`, in units of the given sigma.
            weights: shape (N,), of the table's N rows, >= 0: the variance of a row's scalars is divided by its weight.
                Rows of weight 0 have no part.
            c: The instrument's index, from 0.
            rho: shape (3,), the shares of translations, rotations and joints in the variance of its scalars.

        Returns:
            X^T (K^-1 - I) X, shape (q, q), in units of X squared, summed over the stops, where X are the means of the
            instrument's scalars over the repeats of a target at a stop; and log det K, over all stops.
        """
        means = self._independent_means(X, weights, c, rho)
        independent = means.independent.reshape(-1, X.shape[2])
        unweighted = means.columns.reshape(-1, X.shape[2])
        # By whitened scalars: K^-1 - I itself loses its digits where kappa is small.
        change = independent.T @ independent - unweighted.T @ unweighted
        return change, means.log_det

    def independent(self, columns: Array, weights: Array, rho: Array) -> Array:
        """Multiply the columns of whitened scalars by the root of K^-1, so that these are independent of each other.

        The targets that are measured at one standstill of the robot (a stop) share the displacement of their body, so
        that their scalars have the covariance noise^2 K, K = kappa I + G G^T, with the share kappa of
        independent errors, and G = [sqrt(rho_t) J_t, sqrt(rho_r) J_r, sqrt(rho_q) J_q]. With G^T G / kappa
        = Q diag(s^2 - 1) Q^T,

            K^-1/2 = [I - G Q diag(1 / (s + s^2)) Q^T G^T / kappa] / sqrt(kappa)

        This changes the weighted means over the repeats of a target at a stop; differences between repeats stay.

        Args:
            columns: shape (q, D, N), q columns (such as Jacobian and residual) of the D scalars of the table's N rows,
                in units of the estimated noise, and times the square roots of the weights.
            weights: shape (N,), of the table's rows, >= 0.
            rho: shape (C, 3), the shares of translations, rotations and joints in the variance of each of C
                instruments.

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
                means = stops._independent_means(X, weights, c, rho[c])
                change = means.independent - means.columns
                changes = change[stops._cell_of_row] * root_share[:, None, None]
                result[:, :, stops.rows] += changes.transpose(2, 1, 0)
        return result

    def _independent_means(self, X: Array, weights: Array, c: int, rho: Array) -> _IndependentMeans:
        """Multiply the cells' means by K^-1/2, so that those of a stop are independent.

        A cell is one target at one standstill of the robot (a stop), with its repeats; K is the covariance of a stop's
        scalars over the noise squared, kappa I + G G^T, with kappa and G as at the head of this module.

        Args:
            X: shape (n, D, q), q columns of the D scalars of the n rows of these stops, in the order of the field
                `rows`, in units of their noise, not multiplied by the roots of the weights.
            weights: shape (N,), of the table's N rows, >= 0: the variance of a row's scalars is divided by its weight.
            c: The instrument's index, from 0.
            rho: shape (3,), the shares of translations, rotations and joints in the variance of its scalars.

        Returns:
            The means of M cells before and after, in units of the noise, zero for scalars of other instruments, and
            log det K. The means have the variance of one row of weight 1: weighted sums over the square root of the sum
            of weights.
        """
        means = self._means(X, weights, c)  # of M cells: columns (M, D, q), J (M, D, d)
        kappa = unshared(rho)
        G = means.J * root_shares(rho, means.J.shape[2]) / np.sqrt(kappa)
        squares, Q = np.linalg.eigh(self._sums(transposed(G) @ G))
        s = np.sqrt(1.0 + np.maximum(squares, 0.0))[:, None]  # (S, 1, d)
        of_stops = self._sums(transposed(G) @ means.columns)  # over the cells of each, (S, d, q)
        shared = (Q / (s + s**2)) @ (transposed(Q) @ of_stops)
        independent = (means.columns - G @ shared[self._stop_of_cell]) / np.sqrt(kappa)
        log_det = np.sum(means.count) * np.log(kappa) + 2.0 * np.sum(np.log(s))
        return _IndependentMeans(means.columns, independent, float(log_det))

    def moments(self, columns: Array, weights: Array, c: int, x: Array, C: Array) -> Moments:
        """Compute the moments of a fit's residual, from which the shares of an instrument's variance are estimated.

        The residual r is averaged over the repeats of each target at each stop (a standstill at which several targets
        are measured), and J are the derivatives of the scalars by the displacement of the stop's body.

        Args:
            columns: shape (p + 1, D, N), of the D scalars of the table's N rows: the derivative A of the prediction by
                p parameters, and behind it the residual, measured minus predicted, in units of the given sigma.
            weights: shape (N,), of the rows, >= 0: the variance of a row's scalars is divided by its weight.
            c: The instrument's index, from 0.
            x: shape (p,), the solution, relative to the parameters where the residual of ``columns`` was taken [m, rad,
                ...].
            C: shape (p, p), its covariance, in the products of the parameters' units.

        Returns:
            J^T J and J^T [r r^T + A C A^T] J of each of S stops, both of shape (S, d, d); the trace of r r^T + A C A^T
            over all stops; and the number of scalars. Residuals are in units of the given sigma.
        """
        parts = []
        for stops in self._parts():
            means = stops._means(stops._rows_of(columns), weights, c)
            parts.append(stops._moments_of(means, x, C))
        return Moments.joined(parts)

    def _moments_of(self, means: _CellMeans, x: Array, C: Array) -> Moments:
        """Compute the moments of a fit's residual from the means of these stops' cells (one target at one stop each).

        A cell is one target at one standstill of the robot (a stop), with its repeats. Sums over the cells of each stop
        are taken by ``_sums``, which maps (M, ...) of M cells to (S, ...) of S stops.

        Args:
            means: Means of one instrument's scalars over M cells, each with the variance of one row of weight 1:
                ``means.columns``, shape (M, D, p + 1), the derivative A of the prediction by p parameters, and behind
                it the residual at some parameters, measured minus predicted, in units of the given sigma; ``means.J``,
                shape (M, D, d), the derivative by the displacement of the stop's body; ``means.count``, shape (M, D),
                the number of scalars.
            x: shape (p,), the solution, relative to the parameters where the residual was taken [m, rad, ...].
            C: shape (p, p), its covariance, in the products of the parameters' units.

        Returns:
            With the residual r at the solution: J^T J and J^T [r r^T + A C A^T] J of each of these S stops, both of
            shape (S, d, d); the trace of r r^T + A C A^T over all of them; and the number of scalars. In units of sigma
            squared.
        """
        A = means.columns[..., :-1]
        r = means.columns[..., -1:] - A @ x[:, None]
        # Over the cells of each stop, (S, d, d + p + 1).
        sums = self._sums(transposed(means.J) @ np.concatenate([means.J, A, r], axis=2))
        directions = means.J.shape[2]
        J_J = sums[..., :directions]
        J_A = sums[..., directions:-1]
        J_r = sums[..., -1:]
        R = J_r @ transposed(J_r) + J_A @ C @ transposed(J_A)
        total = float(np.sum(r**2) + np.sum((A @ C) * A))
        return Moments(J_J, R, total, float(np.sum(means.count)))

    def _means(self, X: Array, weights: Array, c: int) -> _CellMeans:
        """Average an instrument's scalars over each of M cells, which is one target at one stop, with its repeats.

        A mean is sum w X / sqrt(sum w) over the repeats, with their weights w, so that it has the variance of one row
        of weight 1; it is 0 where all these weights are 0.

        Args:
            X: shape (n, D, q), q columns of the D scalars of the n rows of these stops, in the order of the field
                `rows`.
            weights: shape (N,), of the table's N rows, >= 0.
            c: The instrument's index, from 0.

        Returns:
            Means of X, ``columns``, shape (M, D, q), in the unit of X; of the derivative by the displacement of the
            stop's body, ``J``, shape (M, D, d), without unit; and ``count``, shape (M, D), which is sum w, but at most
            1. All are zero for scalars of other instruments.
        """
        w = weights[self.rows, None]
        of_instrument = self.instruments == c
        total = np.add.reduceat(w, self._first_row)
        scale = 1.0 / np.sqrt(np.maximum(total, TINY))
        weight = (w * of_instrument)[:, :, None]
        weighted = np.concatenate([X, self.J], axis=2) * weight
        means = np.add.reduceat(weighted, self._first_row) * scale[:, :, None]
        count = of_instrument[self._first_row] * np.minimum(total, 1.0)
        columns = X.shape[2]
        return _CellMeans(means[..., :columns], means[..., columns:], count)

    def _sums(self, values: Array) -> Array:
        """Sum values over the cells of each stop: over the targets that are measured at one standstill.

        Uses `_first_cell`, shape (S,), the index of the first cell of each stop, from 0.

        Args:
            values: shape (M, ...), of each of M cells (one target at one stop, with its repeats), stop by stop.

        Returns:
            shape (S, ...), of each of S stops.
        """
        return np.asarray(np.add.reduceat(values, self._first_cell))

    def _rows_of(self, columns: Array) -> Array:
        """Return the columns of the n rows of stops, which are some of the table's N rows.

        Args:
            columns: shape (q, D, N), q columns of the D scalars of each of the table's N rows.

        Returns:
            shape (n, D, q), contiguous, in the order of `rows`, which are the indices of these rows in the table, from
            0.
        """
        return np.ascontiguousarray(columns[:, :, self.rows].transpose(2, 1, 0))

    def _parts(self) -> list[Stops]:
        """Divide the n rows into parts of about 16384 rows (`_PART`), for memory; the rows of a stop stay together.

        Returns:
            The parts, in the order of the n rows; this object alone where it has few rows.
        """
        if len(self.rows) <= _PART:
            return [self]
        first = self._first_row[self._first_cell][self._stop_of_cell][self._cell_of_row]
        part = first // _PART
        return [self._some(part == k) for k in np.unique(part)]

    def _some(self, kept: Mask) -> Stops:
        """Return some of the n rows of stops; their indices in the table, and the numbers of cells and stops, stay.

        Args:
            kept: shape (n,), which of these n rows to keep.

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
