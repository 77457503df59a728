"""Stops: targets that are seen while the robot stands still are parts of one rigid body, and share its displacement.

A stop is one standstill of the robot at which several targets are measured; a cell is one of these targets at that
stop, whose repeats it holds. The robot's repeatability and what the model lacks displace that body by a translation and
a rotation about the centroid of its targets; and each joint that turns misses its reading, by the steps of its encoder,
play or a servo's error. All are random and independent from stop to stop. A stop's scalars, in units of their sigma,
have the covariance

    V = noise^2 K,        K = kappa I + rho_t J_t J_t^T + rho_r J_r J_r^T + rho_q J_q J_q^T

with the Jacobians J_t, J_r and J_q of the predicted scalars by translation, rotation and joints, each scaled so that
the mean diagonal entry of J J^T over the table is 1: noise is the standard deviation of a scalar, rho_t, rho_r and
rho_q are the shares of its variance that the targets of a stop have in common, and the share kappa = 1 - rho_t - rho_r
- rho_q is independent. With G = [sqrt(rho_t) J_t, sqrt(rho_r) J_r, sqrt(rho_q) J_q], as in any mixed model (C. R.
Henderson, 1953),

    K^-1 = [I - G (kappa I + G^T G)^-1 G^T] / kappa

Joints move the targets on one link as the body itself: J_q = [J_t J_r] L, and G = [J_t J_r] D^1/2 of six columns has
the same G G^T, with the covariance D = diag(rho_t, rho_r) + rho_q L L^T of the body's displacement.

A stop at which the robot was off as a whole, as hardly any other was, is thrown out whole. Its score is the norm of the
displacement of its body, measured minus predicted by a fit without the stop, in standard deviations of what V and that
fit lead to expect (`Stops.displacements`); for a good stop the square over d', the number of its directions, follows
F(d', freedom).

The shares are estimated from the residuals of a fit by `calib.fit.estimate.special_cases.stop_shares`. Repeats of a
target at a stop enter with their mean: what repeats share is found by `calib.fit.estimate.stages`. Each channel has
shares of its own.

`Problem` finds the `Stops` of a table. They have a part in the estimate at three places: `independent` in the normal
equations and in what a solver sees, `estimate_shares` in each stage, and `displacements` in the scores.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from calib.basics.arrays import Array, Integers, Mask
from calib.fit.estimate.special_cases.stop_shares import (
    BODY,
    JOINTS,
    PARTS,
    TINY,
    Moments,
    covariances,
    transposed,
    unshared,
)
from calib.fit.registration.labels import same_poses
from calib.fit.registration.rows import Rows
from calib.model.kinematics import Kinematics, Samples, Sightings
from calib.model.parameter_sets import error_model

#: Rows whose columns are copied at a time.
_PART = 16_384

#: Relative difference of squares below which errors of the joints move nothing but bodies.
_OF_BODY = 1e-9

#: Directions of a body whose squared singular value is below this share of the largest are rounding.
_RANK_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Stops:
    """The rows of stops at which several targets were measured: n rows, in M cells of one target at one of S stops."""

    #: (n,), their indices in the table of N rows, from 0, cell by cell and stop by stop
    rows: Integers
    #: (n,), rows of one number are of one cell
    cells: Integers
    #: (n,), rows of one number are of one stop
    stops: Integers
    #: (n, D, 6 + j), Jacobian of each scalar by the body's displacement: translations, rotations, joints. Of each
    #: channel the sum of squares over each of the three has mean 1
    J: Array
    #: (n, D), index of the channel of each scalar, from 0; -1 where there is no scalar
    channel: NDArray[np.int8]
    #: (C, K, d, d), see `displacements_by_joints`, by the number of the stop
    by_joints: Array
    #: (M,), index of the first row of each cell, among these n rows
    _first_row: Integers = field(init=False, repr=False)
    #: (S,), index of the first cell of each stop, among the M cells
    _first_cell: Integers = field(init=False, repr=False)
    #: (n,), index of each row's cell, from 0
    _cell_of_row: Integers = field(init=False, repr=False)
    #: (M,), index of each cell's stop, from 0
    _stop_of_cell: Integers = field(init=False, repr=False)
    #: Of stops of k cells each: their indices, (s,), and those of their scalars, (s, D k), in (D, M), flat
    _batches: tuple[tuple[Integers, Integers], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Find where cells and stops begin among the n rows, which are sorted by stop and, within it, by cell."""
        new_stop = np.diff(self.stops) != 0
        begins_cell = np.append(True, (np.diff(self.cells) != 0) | new_stop)
        begins_stop = np.append(True, np.diff(self.stops[begins_cell]) != 0)
        object.__setattr__(self, "_first_row", np.flatnonzero(begins_cell))
        object.__setattr__(self, "_first_cell", np.flatnonzero(begins_stop))
        object.__setattr__(self, "_cell_of_row", np.cumsum(begins_cell) - 1)
        object.__setattr__(self, "_stop_of_cell", np.cumsum(begins_stop) - 1)
        M = len(self._first_row)
        sizes = np.diff(self._first_cell, append=M)
        first_of_scalar = M * np.arange(self.J.shape[1])
        batches = []
        for size in np.unique(sizes):
            stops = np.flatnonzero(sizes == size)
            cells = self._first_cell[stops, None] + np.arange(size)
            scalars = (cells[:, None] + first_of_scalar[:, None]).reshape(len(stops), -1)
            batches.append((stops, scalars))
        object.__setattr__(self, "_batches", tuple(batches))

    @classmethod
    def of(cls, kinematics: Kinematics, rows: Rows) -> Stops | None:
        """Find the stops of a table at which several targets were measured.

        The rows of a stop are of one pose, one measurement frame and one kind, which measures positions, or points in
        images.

        Args:
            kinematics: The nominal robot under its error model, frames and targets as registered; it gives the pose of
                each row's target at zero parameters, from which the centroid of each body and the lever arms follow.
            rows: N rows of measurements.

        Returns:
            The rows of these stops; None if no stop has several targets.
        """
        stop = _number_stops(rows)
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
        derivative = of_stops.derivative(Sightings(T_frame_target, twists))
        J = np.zeros((len(of_stops), rows.width, twists.shape[2]))
        J[:, : of_stops.width] = of_stops.standardise(derivative)
        channel = rows.channels.index[chosen]
        J = of_unit_size(J, channel, weight)
        order = np.lexsort((of_stops.poses, stop))
        return cls(
            rows=np.flatnonzero(chosen)[order],
            cells=of_stops.poses[order],
            stops=stop[order],
            J=J[order],
            channel=channel[order],
            by_joints=displacements_by_joints(J, stop, channel),
        )

    def select(self, mask: Mask) -> Stops | None:
        """Return the stops of some of the table's rows, (N,), even those with one target left; None if there are none.

        Their ``rows`` are indices in the table of these rows. Derivatives keep their scale.
        """
        kept = mask[self.rows]
        numbers = (np.cumsum(mask) - 1)[self.rows]
        if not np.any(kept):
            return None
        return replace(self._some(kept), rows=numbers[kept])

    def drawn(self, count: Array) -> Stops:
        """Return the stops of a bootstrap sample, in which each was drawn several times, or not at all.

        The caller multiplies the rows' weights by ``count``. A row of twice the weight has half the variance, and so
        must the displacement that it shares: derivatives are divided by sqrt(count).

        Args:
            count: shape (N,), how many times the stop of each of the table's rows was drawn.

        Returns:
            The same stops with other derivatives J, which are 0 for those not drawn.
        """
        often = count[self.rows, None, None]
        shrunk = self.J / np.sqrt(np.maximum(often, 1))
        return replace(self, J=np.where(often > 0, shrunk, 0.0))

    def independent(self, columns: Array, weights: Array, rho: Array) -> tuple[Array, float]:
        """Multiply the columns of whitened scalars by the root of K^-1, so that these are independent of each other.

        With G^T G / kappa = Q diag(s^2 - 1) Q^T,

            K^-1/2 = [I - G Q diag(1 / (s + s^2)) Q^T G^T / kappa] / sqrt(kappa)

        This changes the weighted means over the repeats of a target at a stop; differences between repeats stay.

        Args:
            columns: shape (q, D, N), q columns of the table's scalars, such as Jacobian and residual, in units of the
                noise, and times the square roots of the weights.
            weights: shape (N,), of the table's rows, >= 0: the variance of a row's scalars is divided by its weight.
            rho: shape (C, 3), shares rho_t, rho_r and rho_q of each of C channels.

        Returns:
            shape (q, D, N), in the same units, rows that are not of a stop as they are; and log det K over all stops
            and channels.
        """
        result: Array = columns.copy()
        log_det = 0.0
        channels = np.flatnonzero(np.any(rho > 0.0, axis=1)).tolist()
        for stops in self._parts():
            w = weights[stops.rows]
            weight_of_cell = np.maximum(np.add.reduceat(w, stops._first_row), TINY)
            root_share = np.sqrt(w / weight_of_cell[stops._cell_of_row])
            for c in channels:
                if not stops._has_repeats and np.all(stops.channel == c):
                    # The rows are the cells, and all of their scalars count: they need not be copied first.
                    _, J, count = stops._means(columns[:0, :, stops.rows], w, c)
                    N = columns.shape[2]
                    place = N * np.arange(columns.shape[1])[:, None] + stops.rows
                    log_det += stops._make_independent(result, place.ravel(), J, count, c, rho[c])
                    continue
                Y = columns[:, :, stops.rows]
                means, independent, of_channel = stops._independent_means(Y, w, c, rho[c])
                change = independent - means
                if stops._has_repeats:
                    change = change[:, :, stops._cell_of_row] * root_share
                result[:, :, stops.rows] += change
                log_det += of_channel
        return result, log_det

    @property
    def _numbers(self) -> Integers:
        """The number of each stop, (S,)."""
        return self.stops[self._first_row[self._first_cell]]

    @property
    def stop_of_row(self) -> Integers:
        """Index of the stop of each of the n rows, (n,), from 0."""
        return np.asarray(self._stop_of_cell[self._cell_of_row])

    def weights_of_stops(self, weights: Array) -> Array:
        """Return the sum of the weights of each stop's rows in B fits, (B, S); ``weights``, (B, N), are the table's."""
        first = self._first_row[self._first_cell]
        return np.asarray(np.add.reduceat(weights[:, self.rows], first, axis=1))

    def displacements(self, columns: Array, weights: Array, noise: Array, rho: Array) -> Array:
        """Reduce the scalars of each stop to the directions in which its body can be displaced.

        With the means X over repeats, the Jacobian J by translations and rotations, and K^-1/2 J = U diag(s) Q^T, they
        are U^T K^-1/2 X: independent of each other, and of the variance 1 if X is noise.

        Args:
            columns: shape (q, D, N), q columns of the table's scalars, in units of each scalar's given sigma.
            weights: shape (N,), of the table's rows, >= 0.
            noise: shape (C,), of each of C channels, in the same units.
            rho: shape (C, 3), shares of each channel.

        Returns:
            shape (S, 6 C, q), 0 in directions that no scalar of a stop has.
        """
        parts = []
        for stops in self._parts():
            w = weights[stops.rows]
            Y = columns[:, :, stops.rows] * np.sqrt(w)
            body = stops.J.transpose(2, 1, 0)[BODY] * np.sqrt(w)
            of_channels = []
            for c in range(len(noise)):
                both = np.concatenate([body, Y / noise[c]])
                _, independent, _ = stops._independent_means(both, w, c, rho[c])
                sums = stops._sums_of_products(independent[BODY], independent)
                squares, Q = np.linalg.eigh(sums[..., BODY])
                present = squares > _RANK_TOLERANCE * np.maximum(squares[:, -1:], TINY)
                scale = present / np.sqrt(np.where(present, squares, 1.0))
                of_channels.append(scale[:, :, None] * (transposed(Q) @ sums[..., BODY.stop :]))
            parts.append(np.concatenate(of_channels, axis=1))
        return np.concatenate(parts)

    def estimate_shares(
        self, columns: Array, change: Array, covariance: Array, weights: Array, rho: Array
    ) -> Array:
        """Estimate, from the residuals of B fits, the shares of variance that the targets of a stop have in common.

        Args:
            columns: shape (p + 1, D, N), of the table's scalars: the Jacobian A of the prediction by p parameters and,
                last, the residual, in units of the given sigma.
            change: shape (B, p), each fit's solution relative to the parameters where the residual was taken.
            covariance: shape (B, p, p), of the solution.
            weights: shape (B, N), of the rows in each fit.
            rho: shape (B, C, 3), shares to begin with.

        Returns:
            shape (B, C, 3), each from 0 to 1.
        """
        result = np.zeros(rho.shape)
        for b, c in np.ndindex(*rho.shape[:2]):
            parts = []
            for stops in self._parts():
                w = weights[b, stops.rows]
                Y = columns[:, :, stops.rows] * np.sqrt(w)
                parts.append(stops._moments(Y, w, c, change[b], covariance[b]))
            result[b, c] = Moments.joined(parts).shares(rho[b, c])
        return result

    def _moments(self, Y: Array, weights: Array, c: int, change: Array, C: Array) -> Moments:
        """The moments of one fit's residual in the channel of index c, from which its shares are estimated.

        Y, (p + 1, D, n), are Jacobian and residual at the n rows of stops, in units of the given sigma and times the
        roots of the rows' weights, (n,). The fit's solution has the covariance C, (p, p), and is at the change, (p,),
        from where the residual was taken.
        """
        means, J, count = self._means(Y, weights, c)
        A = means[:-1].reshape(len(C), -1)
        r = means[-1] - (change @ A).reshape(means.shape[1:])
        sums = self._sums_of_products(J, np.concatenate([J, means[:-1], r[None]]))
        directions = len(J)
        by_joints = self.by_joints[c, self._numbers]
        J_J = sums[..., :directions]
        J_A = sums[..., directions:-1]
        J_r = sums[..., -1:]
        R = J_r @ transposed(J_r) + J_A @ C @ transposed(J_A)
        total = float(np.sum(r**2) + np.sum((A @ A.T) * C))
        return Moments(J_J, R, by_joints, total, float(np.sum(count)))

    def _independent_means(
        self, Y: Array, weights: Array, c: int, rho: Array
    ) -> tuple[Array, Array, float]:
        """The means of M cells in one channel, (q, D, M), the same times K^-1/2, and log det K over all stops.

        A cell holds the repeats of one target at one stop; K is the covariance of a stop's means in units of noise. Y,
        (q, D, n), are columns at the n rows of stops, in units of their noise and times the roots of the rows' weights,
        (n,), of the channel of index c, and rho, (3,), are the shares of the channel's variance; see `_means`.
        """
        means, J, count = self._means(Y, weights, c)
        independent = means.copy()
        log_det = self._make_independent(independent, np.arange(count.size), J, count, c, rho)
        return means, independent, log_det

    def _make_independent(
        self, columns: Array, place: Integers, J: Array, count: Array, c: int, rho: Array
    ) -> float:
        """Multiply columns, (q, D, N), of the channel of index c by K^-1/2 in place, and return log det K of all stops.

        Of a scalar in (D, M), flat, ``place`` is the index in (D, N), flat. J, (d, D, M), and the numbers (D, M) are
        those of `_means`.
        """
        kappa = unshared(rho)
        root = np.sqrt(kappa)
        squares, Q = np.linalg.eigh(covariances(rho, self.by_joints[c, self._numbers]))
        roots = np.sqrt(np.maximum(squares, 0.0) / kappa)[:, None]
        to_G = (Q * roots) @ transposed(Q)  # symmetric
        J = J.reshape(len(J), -1)
        flat = columns.reshape(len(columns), -1)
        log_det = float(np.sum(count) * np.log(kappa))
        for stops, scalars in self._batches:
            of_stops = to_G[stops] @ J[:, scalars].transpose(1, 0, 2)
            squares, Q = np.linalg.eigh(of_stops @ transposed(of_stops))
            s = np.sqrt(1.0 + np.maximum(squares, 0.0))[:, None]  # (S, 1, d)
            at = place[scalars]
            X = flat[:, at]
            sums = of_stops @ X.transpose(1, 2, 0)
            shared = (Q / (s + s**2)) @ (transposed(Q) @ sums)  # (S, d, q)
            X -= (transposed(shared) @ of_stops).transpose(1, 0, 2)
            X /= root
            flat[:, at] = X
            log_det += 2.0 * float(np.sum(np.log(s)))
        return log_det

    def _means(self, Y: Array, weights: Array, c: int) -> tuple[Array, Array, Array]:
        """Average one channel's scalars over M cells: columns, (q, D, M), J, (d, D, M), and their number, (D, M).

        A cell holds the repeats of one target at one stop. A mean is sum w X / sqrt(sum w) over the repeats, with the
        weights w, (n,), of the rows, so that it has the variance of one row of weight 1; it is 0 if all these weights
        are 0. The number is sum w, but at most 1. All are zero for scalars of other channels. ``Y``, (q, D, n), is
        sqrt(w) X.
        """
        of_channel = c == self.channel.T
        total = np.add.reduceat(weights, self._first_row)
        count = of_channel[:, self._first_row] * np.minimum(total, 1.0)
        directions = self.by_joints.shape[-1]
        J = self.J[:, :, :directions].transpose(2, 1, 0) * (np.sqrt(weights) * of_channel)
        if not self._has_repeats:
            return Y if np.all(of_channel) else Y * of_channel, J, count
        root = np.sqrt(weights / np.maximum(total, TINY)[self._cell_of_row]) * of_channel
        means = np.add.reduceat(Y * root, self._first_row, axis=2)
        return means, np.add.reduceat(J * root, self._first_row, axis=2), count

    def _sums_of_products(self, left: Array, right: Array) -> Array:
        """Sum the products of columns, (a, D, M) and (b, D, M), over the scalars of each stop, (S, a, b)."""
        result = np.empty((len(self._first_cell), len(left), len(right)))
        for stops, scalars in self._batches:
            of_left = left.reshape(len(left), -1)[:, scalars].transpose(1, 0, 2)
            of_right = right.reshape(len(right), -1)[:, scalars].transpose(1, 2, 0)
            result[stops] = of_left @ of_right
        return result

    @property
    def _has_repeats(self) -> bool:
        """True if any cell holds several rows."""
        return len(self._first_row) < len(self.rows)

    def _parts(self) -> list[Stops]:
        """Divide the n rows into parts of about `_PART` rows, for memory; the rows of a stop stay together."""
        if len(self.rows) <= _PART:
            return [self]
        first = self._first_row[self._first_cell][self._stop_of_cell][self._cell_of_row]
        part = first // _PART
        return [self._some(part == k) for k in np.unique(part)]

    def _some(self, kept: Mask) -> Stops:
        """Return some of the n rows of stops, (n,); their indices in the table, and the numbers of stops, stay."""
        return Stops(
            rows=self.rows[kept],
            cells=self.cells[kept],
            stops=self.stops[kept],
            J=self.J[kept],
            channel=self.channel[kept],
            by_joints=self.by_joints,
        )


def _number_stops(rows: Rows) -> Integers | None:
    """Number the stop of each row, (N,), not all numbers being used; None if no stop has several targets.

    The number is -1 for rows of a stop with one target, or of a kind that measures neither positions nor points in
    images.
    """
    measured_point = rows.poses  # of one frame, target and corner at one pose
    if not len(rows) or _count_numbers(measured_point) == _count_numbers(rows.blocks):
        return None
    # The two poses of a pair are one block.
    pose = same_poses(rows.joints) if np.any(rows.partner >= 0) else rows.blocks
    labels = np.column_stack([pose, rows.samples.frame, rows.kind])
    stop = np.unique(labels, axis=0, return_inverse=True)[1].reshape(-1)
    stop_and_point = np.unique(np.column_stack([stop, measured_point]), axis=0)
    points_of_stop = np.bincount(stop_and_point[:, 0])
    several = points_of_stop[stop] > 1
    chosen = several & rows.where(lambda kind: kind.position or kind.is_image)
    if not np.any(chosen):
        return None
    return np.where(chosen, stop, -1)


def _count_numbers(labels: Integers) -> int:
    """Return how many different numbers, all >= 0, labels (N,) have."""
    return int(np.count_nonzero(np.bincount(labels)))


def twists_of_bodies(origins: Array, points: Array, stops: Integers, counts: Array) -> Array:
    """Differentiate the poses of targets by the displacements of their bodies, which turn about their centroids.

    Args:
        origins: shape (K, 3), position of the origin of each row's target in its measurement frame [m].
        points: shape (K, 3), position of the measured point of each of K rows in its measurement frame, which is the
            target's origin or a corner of a board [m].
        stops: shape (K,), points of one number are of one body at one stop.
        counts: shape (K,), weight of each point in its body's centroid, > 0.

    Returns:
        shape (K, 6, 6), twist of the target at each point along the frame's axes, linear then angular along the rows,
        by a unit of each direction of its body's displacement along the columns: three translations along these axes
        [m], three rotations about them [rad].
    """
    body = np.unique(stops, return_inverse=True)[1].reshape(-1)
    sums = np.stack([np.bincount(body, counts * column) for column in points.T], axis=1)
    centroids = sums / np.bincount(body, counts)[:, None]
    lever = origins - centroids[body]
    twists = np.zeros((len(points), 6, 6))
    twists[:] = np.eye(6)
    # Column k is e_k x lever.
    twists[:, :3, 3:] = transposed(np.cross(np.eye(3), lever[:, None]))
    return twists


def twists_of_joints(kinematics: Kinematics, samples: Samples) -> Array:
    """Differentiate the poses of targets by the joints that turn: the nominal robot misses a stop by their errors.

    Joints that slide are left out: their errors, in another unit, are translations of the body.

    Args:
        kinematics: The nominal robot, and frames and targets as registered.
        samples: K samples of it.

    Returns:
        shape (K, 6, j), twist of the target along the frame's axes, linear [m] then angular [rad], by a radian of each
        of j joints.
    """
    zeros = error_model(
        kinematics.robot,
        "zeros",
        frame=dict.fromkeys(map(str, range(len(kinematics.T_frame_base))), ()),
        target=False,
        targets=[str(k) for k in range(len(kinematics.T_tip_target))],
    )
    turning = [k for k, parameter in enumerate(zeros.parameters) if parameter.unit == "rad"]
    of_zeros = replace(kinematics, model=zeros)
    _, twists = of_zeros.twists(np.zeros(len(zeros)), samples)
    return twists[:, :, turning]


def displacements_by_joints(J: Array, stops: Integers, channel: NDArray[np.int8]) -> Array:
    """Find the covariances of the displacements of bodies by errors of the joints of unit variance.

    Errors of the joints move the targets on one link as one body: J_q = J_b L, with the Jacobians J_q by the joints and
    J_b by the six directions of the body. Then their part of the covariance is J_q J_q^T = J_b (L L^T) J_b^T, and six
    directions are enough. Targets of one stop on several links, as on two hands, need the joints as further directions.

    Args:
        J: shape (n, D, 6 + j), Jacobian of the scalars of n rows by displacements: body, then j joints.
        stops: shape (n,), number of each row's stop, from 0, below K.
        channel: shape (n, D), index of each scalar's channel, from 0, below C; -1 where there is no scalar.

    Returns:
        shape (C, K, d, d), L L^T in each channel, d = 6; or, with d = 6 + j, the identity among the joints.
    """
    count = int(stops.max()) + 1
    directions = J.shape[2]
    result = []
    for c in range(int(channel.max()) + 1):
        products = np.zeros((count, directions, directions))
        for first in range(0, len(J), _PART):
            part = slice(first, first + _PART)
            of_channel = J[part] * (channel[part] == c)[:, :, None]
            np.add.at(products, stops[part], transposed(of_channel) @ of_channel)
        by_body = products[:, BODY, JOINTS]
        L = np.linalg.pinv(products[:, BODY, BODY], _RANK_TOLERANCE, hermitian=True) @ by_body
        explained = np.sum(by_body * L)
        if np.trace(products[:, JOINTS, JOINTS].sum(axis=0)) > (1.0 + _OF_BODY) * explained:
            joints = np.diag(np.r_[np.zeros(BODY.stop), np.ones(directions - BODY.stop)])
            shape = (int(channel.max()) + 1, count, directions, directions)
            return np.broadcast_to(joints, shape)
        result.append(L @ transposed(L))
    return np.array(result)


def of_unit_size(J: Array, channel: NDArray[np.int8], counts: Array) -> Array:
    """Scale Jacobians by displacements of bodies to unit mean square: translations, rotations, and joints apart.

    After this a translation whose three components have the variance 1 each moves a channel's scalars with a mean
    variance of 1, and so does a rotation, and so do errors of the joints.

    Args:
        J: shape (K, D, d), Jacobian of the scalars of each of K rows, in units of their sigma, by its body's
            displacement: three translations [m], three rotations [rad], the joints [rad].
        channel: shape (K, D), index of each scalar's channel, from 0; -1 for no scalar.
        counts: shape (K,), weight of each row in the mean.

    Returns:
        shape (K, D, d); 0 where there is no scalar, or the part moves none of a channel's.
    """
    result = np.zeros(J.shape)
    for c in range(int(channel.max()) + 1):
        of_channel = channel == c
        weight = counts[:, None] * of_channel
        for part in PARTS:
            square = float(np.sum(weight[:, :, None] * J[:, :, part] ** 2))
            if square > 0.0:
                scale = np.sqrt(np.sum(weight) / square)
                result[:, :, part] += scale * of_channel[:, :, None] * J[:, :, part]
    return result
