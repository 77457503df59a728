"""The rows of a table as the arrays of one fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from calib.basics.arrays import Array, Integers, Mask
from calib.basics.channels import Channels, channels_of, residual_unit
from calib.basics.values import ReadOnlyMapping
from calib.data.kinds import Kind
from calib.model.internals import InternalValues
from calib.model.kinematics import Samples, Sightings, SightingsOrPoses
from calib.numerics.correlated_noise import POSE, PoseNoise, standardisers

#: Index of the kind of rows that hold no measurement themselves: the second rows of pairs.
NONE = -1

#: Scale of stated covariances, and what the robot adds, until a fit estimates them.
USUAL_POSE_NOISE = PoseNoise(
    scale=1.0,
    position=residual_unit("m").repeatability,
    orientation=residual_unit("rad").repeatability,
    joint=residual_unit("rad").repeatability,
)

#: The fewest rows of each frame, target and kind in an even sample, if it has room for them.
_FEWEST_OF_EACH = 100


@dataclass(frozen=True, slots=True, eq=False)
class _CorrelatedRows:
    """The n rows whose six scalars have a covariance, see `calib.numerics.correlated_noise`."""

    #: (n,), their numbers
    rows: Integers
    #: (n, 6, 6), V: their stated covariances with the noise of poses [m^2, m rad, rad^2]
    V: Array
    #: (n, 6, 6), transformations that make their errors independent, of variance 1
    W: Array
    #: (n, 6, 6), the inverse of these
    inverse: Array


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """N rows of measurements; row i sees one target from one frame at one pose of the robot.

    A residual has D = `width` columns, as many as the widest kind has scalars; column j of a row holds the scalar j of
    its kind, in the unit that `channels` says: [m], [rad] or [px].
    """

    #: Joint values, frame and target of each row
    samples: Samples
    #: The kinds that rows may have
    kinds: tuple[Kind, ...]
    #: (N,), index of each row's kind in ``kinds``; `NONE` for the second row of a pair
    kind: Integers
    #: (N, K), as `calib.data.kinds.Kind` says; 0 in columns that a kind lacks
    measured: Array
    #: (N,), number of the second row of a pair, at its first row; -1 at all other rows
    partner: Integers
    #: (N,), standard deviation of one scalar in each unit of `calib.basics.channels.RESIDUAL_UNITS`, by its symbol, as
    #: given or assumed before the fit; of rows with a covariance that of C, rms over the axes
    sigma: Mapping[str, Array]
    #: (N,), rows of one number are repeats: one pose, target, frame and kind
    poses: Integers
    #: (N,), rows of one number are held out together: one pose, and both rows of a pair
    blocks: Integers
    #: (N,), weights that a fit takes as they are, with repeats already shared out; None: the fit estimates them
    weights: Array | None = None
    #: (N, 6, 6), stated covariance of a measured pose's error: position [m] and rotation vector [rad], along the axes
    #: of the frame; NaN in rows without one, whose scalars are independent; None: no row has one
    covariances: Array | None = None
    #: Scale of these covariances, and what the robot adds to them
    pose_noise: PoseNoise = USUAL_POSE_NOISE
    #: (N, 6, 6), J_q J_q^T with the Jacobian J_q of the target's pose by the joints that turn, along the axes of the
    #: frame too [m^2, m, 1]; None: errors of joints do not count
    by_joints: Array | None = None
    #: (N, D), the channel of each entry of the residual: its kind and unit, and so its noise
    channels: Channels = field(init=False)
    #: Each kind that occurs, in the order of ``kinds``, with the numbers of its rows; a slice if all are of one kind
    _by_kind: tuple[tuple[Kind, Integers | slice], ...] = field(init=False, repr=False)
    #: Rows with a covariance, and the transformations of their scalars; None: no row has one
    _correlated: _CorrelatedRows | None = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Derive what every evaluation of a fit needs."""
        object.__setattr__(self, "sigma", ReadOnlyMapping(self.sigma))
        units = [kind.units for kind in self.kinds]
        vector_units = [kind.vector_units for kind in self.kinds]
        object.__setattr__(self, "channels", channels_of(units, vector_units, self.kind))
        by_kind: list[tuple[Kind, Integers | slice]] = []
        for k, kind in enumerate(self.kinds):
            of_kind = self.kind == k
            if np.any(of_kind):
                rows = slice(None) if np.all(of_kind) else np.flatnonzero(of_kind)
                by_kind.append((kind, rows))
        object.__setattr__(self, "_by_kind", tuple(by_kind))

        correlated = None
        stated = self.covariances
        if stated is not None:
            has_covariance = np.isfinite(stated[:, 0, 0]) & self.where(
                lambda kind: kind.may_have_covariance
            )
            chosen = np.flatnonzero(has_covariance)
            if len(chosen):
                by_joints = np.zeros(stated.shape) if self.by_joints is None else self.by_joints
                V = self.pose_noise.covariances(stated[chosen], by_joints[chosen])
                W = standardisers(V)
                correlated = _CorrelatedRows(chosen, V, W, np.asarray(np.linalg.inv(W)))
        object.__setattr__(self, "_correlated", correlated)

    def __len__(self) -> int:
        """Number of rows N."""
        return len(self.samples)

    @property
    def joints(self) -> Array:
        """Values of the m measured joints, shape (N, m), [rad] or [m]."""
        return self.samples.q

    @property
    def width(self) -> int:
        """Columns D of a residual: the largest number of scalars of a row."""
        return self.channels.width

    @property
    def used(self) -> Mask:
        """True for the entries of the residual that are measured, shape (N, D)."""
        return self.channels.used

    @property
    def correlated(self) -> Mask:
        """Rows that are poses with a stated covariance, even a diagonal one, shape (N,)."""
        result = np.zeros(len(self), dtype=bool)
        if self._correlated is not None:
            result[self._correlated.rows] = True
        return result

    @property
    def channel_kinds(self) -> tuple[Kind, ...]:
        """Kind of each channel, in their order; the unit of each is in ``channels.units``."""
        result = []
        for c in range(len(self.channels.units)):
            first_row = int(np.argmax(np.any(self.channels.index == c, axis=1)))
            result.append(self.kinds[self.kind[first_row]])
        return tuple(result)

    @property
    def count(self) -> int:
        """Number of measured scalars of all rows."""
        return int(np.sum(self.used))

    @property
    def scales(self) -> Array:
        """Standard deviation of each entry as given or assumed before the fit, shape (N, D), in its unit.

        Of rows with a covariance it is the root of the diagonal of V, with ``pose_noise``, which the fit estimates.
        Entries where nothing was measured have that of the row's lengths [m].
        """
        result = np.repeat(self.sigma["m"][:, None], self.width, axis=1)
        for unit in self.channels.present:
            result = np.where(self.channels.where(unit), self.sigma[unit][:, None], result)
        if self._correlated is not None:
            variances = np.diagonal(self._correlated.V, axis1=1, axis2=2)
            result[self._correlated.rows, :POSE] = np.sqrt(variances)
        return result

    def standardise(self, values: Array, out: Array | None = None) -> Array:
        """Return values of the scalars in units of their standard deviations as given or assumed.

        Those of rows with a covariance are multiplied by W instead, which makes their errors independent; see
        `calib.numerics.correlated_noise`.

        Args:
            values: Residuals or derivatives, shape (N, D) or (N, D, q), in the units of ``channels``.
            out: shape (N, D, q), where the result is written; None: in memory of its own.

        Returns:
            Of the same shape as the values, without unit.
        """
        by_row = values.reshape(len(self), self.width, -1)
        result = np.multiply(by_row, (1.0 / self.scales)[:, :, None], out=out)
        if self._correlated is not None:
            chosen, W = self._correlated.rows, self._correlated.W
            result[chosen, :POSE] = W @ by_row[chosen, :POSE]
        return np.asarray(result.reshape(values.shape))

    def in_units(self, standardised: Array) -> Array:
        """Return values of the scalars in the units of ``channels``: the inverse of `standardise`.

        Args:
            standardised: shape (N, D) or (N, D, q), without unit.

        Returns:
            Of the same shape.
        """
        by_row = standardised.reshape(len(self), self.width, -1)
        result = by_row * self.scales[:, :, None]
        if self._correlated is not None:
            chosen, inverse = self._correlated.rows, self._correlated.inverse
            result[chosen, :POSE] = inverse @ by_row[chosen, :POSE]
        return np.asarray(result.reshape(standardised.shape))

    def scales_at(self, noise: Array) -> Array:
        """Return the standard deviation of each entry at estimated noise.

        Args:
            noise: shape (C,), of each channel, in units of the given sigma.

        Returns:
            shape (N, D), in the units of ``channels``.
        """
        # An entry without a scalar has the channel -1, the last one here.
        by_entry = np.append(noise, 1.0)[self.channels.index]
        result = by_entry * self.scales
        if self._correlated is not None:
            chosen, inverse = self._correlated.rows, self._correlated.inverse
            factors = inverse * by_entry[chosen, None, :POSE]
            result[chosen, :POSE] = np.linalg.norm(factors, axis=2)
        return np.asarray(result)

    @property
    def depends_on_orientation(self) -> bool:
        """True if the residual of some row depends on the orientation of its target, not on its position alone."""
        return any(kind.depends_on_orientation for kind in self.present)

    @property
    def present(self) -> tuple[Kind, ...]:
        """Kinds that some row has, in the order of ``kinds``."""
        return tuple(kind for kind, _ in self._by_kind)

    @property
    def is_image(self) -> Mask:
        """Rows that are points of a board in images, shape (N,)."""
        return self.where(lambda kind: kind.is_image)

    @property
    def has_views(self) -> Mask:
        """Rows of which many together, those of one view, determine the pose of the target, shape (N,)."""
        return self.where(lambda kind: kind.internals is not None)

    def where(self, test: Callable[[Kind], bool]) -> Mask:
        """Rows of kinds that pass a test, such as ``lambda kind: kind.position``, shape (N,)."""
        result = np.zeros(len(self), dtype=bool)
        for kind, rows in self._by_kind:
            result[rows] = test(kind)
        return result

    def select(self, which: Mask | Integers | slice) -> Rows:
        """Return some of the rows.

        Args:
            which: A mask of shape (N,), indices in any order, or a slice; of a pair both rows or none.

        Returns:
            These rows; partners and channels get new numbers.
        """
        chosen: Integers | slice
        if isinstance(which, slice):
            chosen = which
            count = len(range(*which.indices(len(self))))
            is_whole = count == len(self) and which.step in (None, 1)
        else:
            given = np.asarray(which)
            numbers: Integers = (
                np.flatnonzero(given) if given.dtype == bool else given.astype(np.int_)
            )
            is_whole = len(numbers) == len(self) and np.array_equal(numbers, np.arange(len(self)))
            chosen = numbers
        if is_whole:
            return self
        partner = self.partner[chosen]
        if np.any(partner >= 0):
            new_number = np.full(len(self), -1)
            new_number[chosen] = np.arange(len(partner))
            partner = np.where(partner >= 0, new_number[partner], -1)
        return replace(
            self,
            samples=self.samples.select(chosen),
            kind=self.kind[chosen],
            measured=self.measured[chosen],
            partner=partner,
            sigma={unit: sigma[chosen] for unit, sigma in self.sigma.items()},
            poses=self.poses[chosen],
            blocks=self.blocks[chosen],
            weights=None if self.weights is None else self.weights[chosen],
            covariances=None if self.covariances is None else self.covariances[chosen],
            by_joints=None if self.by_joints is None else self.by_joints[chosen],
        )

    def residual(self, sightings: SightingsOrPoses) -> Array:
        """Return measured minus predicted.

        Args:
            sightings: Predicted poses of the N targets in their frames and the internals of their instruments, or these
                poses alone, shape (N, 4, 4) [m]: then the internals are those of ``samples``.

        Returns:
            shape (N, D), in the units of ``channels``; 0 where nothing was measured.
        """
        seen = sightings if isinstance(sightings, Sightings) else Sightings(sightings)
        result = np.zeros((len(self), self.width))
        for kind, rows in self._by_kind:
            measured = self.measured[rows, : kind.size]
            poses = self._at_kind(kind, rows, seen.T_frame_target)
            internals = self._internals_at(kind, rows, seen)
            result[rows, : len(kind.units)] = kind.residual_of(measured, poses, internals)
        return result

    def derivative(self, sightings: Sightings) -> Array:
        """Return the Jacobian of the prediction by the parameters: minus that of the residual.

        Args:
            sightings: Poses of the N targets and their motions by each of p parameters; and the internals of their
                instruments, with the parameters that change them.

        Returns:
            shape (N, D, p), in the units of ``channels`` per unit of each parameter; 0 where nothing was measured.
        """
        assert sightings.twists is not None, "sightings without motions"
        shape = (len(self), self.width, sightings.twists.shape[2])
        result: Array | None = None
        for kind, rows in self._by_kind:
            measured = self.measured[rows, : kind.size]
            poses = self._at_kind(kind, rows, sightings.T_frame_target)
            moved = self._at_kind(kind, rows, sightings.twists)
            internals = self._internals_at(kind, rows, sightings)
            of_kind = kind.derivative_of(measured, poses, moved, internals)
            if of_kind.shape == shape:
                return of_kind  # the only kind, and all columns
            if result is None:
                result = np.zeros(shape)
            result[rows, : len(kind.units)] = of_kind
        return np.zeros(shape) if result is None else result

    def derivative_by_internals(self, sightings: Sightings) -> Array:
        """Return the derivative of the prediction by each of the c internals of a row's instrument.

        Args:
            sightings: Poses of the N targets, and the internals of their instruments.

        Returns:
            shape (N, D, c), in the units of ``channels`` per unit of each; 0 in rows whose instrument has none.
        """
        assert self.samples.internals is not None, "instruments without internals"
        result = np.zeros((len(self), self.width, self.samples.internals.shape[1]))
        for kind, rows in self._by_kind:
            internals = self._internals_at(kind, rows, sightings)
            if internals is not None:
                measured = self.measured[rows, : kind.size]
                poses = self._at_kind(kind, rows, sightings.T_frame_target)
                at_rest = np.zeros((len(measured), 6, 1))
                _, of_kind = kind.derivative(measured, poses, at_rest, internals.values)
                result[rows, : len(kind.units)] = of_kind
        return result

    def points(self, T_frame_target: Array) -> Array:
        """Return the measured point of each row: its target's origin, or a corner of the board.

        Args:
            T_frame_target: shape (N, 4, 4), predicted pose of each row's target in its frame [m].

        Returns:
            shape (N, 3), in the row's measurement frame [m].
        """
        result: Array = T_frame_target[:, :3, 3].copy()
        for kind, rows in self._by_kind:
            if kind.internals is not None and self.samples.internals is not None:
                on_target = kind.internals.points(self.samples.internals[rows])
                turned = np.einsum("nij,nj->ni", T_frame_target[rows, :3, :3], on_target)
                result[rows] += turned
        return result

    def lengths_per_unit(self, sightings: Sightings) -> Array:
        """Return the length at the measured point that a unit of a row's reading is, such as of a pixel.

        Args:
            sightings: Poses of the N targets, and the internals of their instruments.

        Returns:
            shape (N,) [m per unit]; NaN in rows whose instrument has no internals.
        """
        points = self.points(sightings.T_frame_target)
        result = np.full(len(self), np.nan)
        for kind, rows in self._by_kind:
            internals = self._internals_at(kind, rows, sightings)
            if kind.internals is not None and internals is not None:
                result[rows] = kind.internals.lengths(points[rows], internals.values)
        return result

    def as_measured_at(self, T_frame_target: Array) -> Rows:
        """Return the rows with the readings of a perfect instrument in place of what was measured.

        Args:
            T_frame_target: shape (N, 4, 4), true pose of each row's target in its frame [m].

        Returns:
            The rows; those of kinds whose target is held, such as a ball in a socket, stay as they are.
        """
        measured = self.measured.copy()
        for kind, rows in self._by_kind:
            if kind.measure is not None:
                poses = self._at_kind(kind, rows, T_frame_target)
                internals = self._internals_at(kind, rows, Sightings(T_frame_target))
                measured[rows, : kind.size] = kind.readings_at(poses, internals)
        return replace(self, measured=measured)

    def _internals_at(
        self, kind: Kind, rows: Integers | slice, sightings: Sightings
    ) -> InternalValues | None:
        """Internals of the instrument at the n rows of one kind, by their numbers, (n,); None if it has none."""
        if kind.internals is None:
            return None
        if sightings.internals is not None:
            return sightings.internals.select(rows)
        assert self.samples.internals is not None
        return InternalValues.fixed(self.samples.internals[rows])

    def _at_kind(self, kind: Kind, rows: Integers | slice, values: Array) -> Array:
        """Values (N, ...) at the n rows of one kind, (n, ...); of a paired kind at both its rows, (n, 2, ...)."""
        if not kind.paired:
            return values[rows]
        return np.stack([values[rows], values[self.partner[rows]]], axis=1)

    def with_partners(self, kept: Mask) -> Mask:
        """Extend a mask of rows, (N,), by the second rows of their pairs, shape (N,)."""
        result: Mask = kept.copy()
        result[self.partner[kept & (self.partner >= 0)]] = True
        return result

    def keeps_frames(self, kept: Mask) -> bool:
        """True if a mask of rows, (N,), keeps at least half of the rows of each frame."""
        count = np.bincount(self.samples.frame)
        kept_count = np.bincount(self.samples.frame, kept, len(count))
        return bool(np.all(2 * kept_count >= count))

    def without(self, outliers: Mask) -> Mask:
        """Mask of the rows that are not outliers, (N,), given those that are flagged, (N,).

        All rows if outliers are more than half of a frame's: then it is the frame that is wrong.
        """
        kept = self.with_partners(~outliers)
        return kept if self.keeps_frames(kept) else np.ones_like(kept)

    def evenly(self, most: int) -> Mask:
        """Draw about ``most`` rows, the same share of each frame, target and kind, but a few of each; pairs stay whole.

        Drawn at random, with a fixed seed: tables have cycles, and every tenth row may be of one kind of pose.

        Returns:
            Mask of the rows drawn, shape (N,); of all if there are no more.
        """
        if len(self) <= most:
            return np.ones(len(self), dtype=bool)
        measuring = np.flatnonzero(self.kind != NONE)
        # One number for each frame, target and kind, in their order.
        frame, target, kind = self.samples.frame, self.samples.target, self.kind
        label = (frame * (target.max() + 1) + target) * len(self.kinds) + kind
        _, group, count = np.unique(label[measuring], return_inverse=True, return_counts=True)
        fewest = min(_FEWEST_OF_EACH, max(most // len(count), 1))
        quota = np.minimum(count, np.maximum(most * count // max(len(self), 1), fewest))
        random = np.random.default_rng(0).random(len(group))
        result = np.zeros(len(self), dtype=bool)
        # Sorted by group; within it those of the smallest random numbers are drawn.
        order = np.argsort(group, kind="stable")
        for of_group, size in zip(np.split(order, np.cumsum(count)[:-1]), quota, strict=True):
            drawn = of_group[np.argpartition(random[of_group], size - 1)[:size]]
            result[measuring[drawn]] = True
        return self.with_partners(result)
