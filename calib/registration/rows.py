"""The rows of a table as the arrays of one fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

import calib.data.kinds as registry
from calib.data.kinds import Kind
from calib.model.kinematics import Samples
from calib.numerics.errors import LENGTHS
from calib.units import Array, Integers, Mask

#: The kind's number of rows that hold no measurement themselves: the second rows of pairs.
NONE = -1

#: Number in the column `Rows.instruments` of an entry without a scalar.
_NO_INSTRUMENT = -1

#: The fewest rows of each frame, target and kind in an even sample, if it has room for them.
_FEWEST_OF_EACH = 100


@dataclass(frozen=True, slots=True, eq=False)
class _KindRows:
    """The rows of one kind."""

    #: What these rows measure
    kind: Kind
    #: Their numbers; a slice where all rows are of this kind
    rows: Integers | slice
    #: Columns of the residual that the kind fills
    columns: Integers


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """N rows of measurements; row i sees one target from one frame at one pose of the robot.

    A residual has D = `width` columns: lengths in the first three, angles behind. Not every row fills all of them.
    """

    #: Joint values, frame and target of each row
    samples: Samples
    #: (N,), numbers of `calib.data.kinds`; `NONE` for the second row of a pair
    kinds: Integers
    #: (N, K), as `calib.data.kinds.Kind` says; zero in columns that a kind lacks
    measured: Array
    #: (N,), number of the second row of a pair, at its first row; -1 elsewhere
    partner: Integers
    #: (N,), standard deviation of one length, as given or assumed before the fit [m]
    sigma: Array
    #: (N,), of one angle, as given or assumed before the fit [rad]
    sigma_angle: Array
    #: (N,), rows of one number are repeats: one pose, target, frame and kind
    poses: Integers
    #: (N,), rows of one number are held out together: one pose, and both rows of a pair
    blocks: Integers
    #: (N,), weights that a fit takes as they are, with repeats already shared out; None: the fit estimates them
    weights: Array | None = None
    #: (N,), rows of sole postures, see `calib.estimate.sole_postures`; None: the fit finds them
    sole: Mask | None = None
    #: D, columns of a residual: 6 with angles, 3 with positions, else 1
    width: int = field(init=False)
    #: (N, D), which entries of the residual are measured
    used: Mask = field(init=False, repr=False)
    #: (N, D), which instrument, and so which noise, each scalar has, from 0; -1 for no scalar. Lengths of each kind are
    #: an instrument, in the order of the kinds' numbers, then angles of each kind
    instruments: NDArray[np.int8] = field(init=False, repr=False)
    #: The rows of each kind that occurs, in the order of kinds' numbers
    _by_kind: tuple[_KindRows, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Derive what every evaluation of a fit needs."""
        by_kind = _rows_by_kind(self.kinds)
        width = max((int(part.columns[-1]) + 1 for part in by_kind), default=1)
        instruments = _instruments(by_kind, len(self.kinds), width)
        used = instruments != _NO_INSTRUMENT
        used.setflags(write=False)
        object.__setattr__(self, "width", width)
        object.__setattr__(self, "used", used)
        object.__setattr__(self, "instruments", instruments)
        object.__setattr__(self, "_by_kind", by_kind)

    def __len__(self) -> int:
        """Number of rows N."""
        return len(self.samples)

    @property
    def joints(self) -> Array:
        """Values of the m measured joints, shape (N, m), [rad] or [m]."""
        return self.samples.q

    @property
    def count(self) -> int:
        """Number of measured scalars of all rows."""
        return int(np.sum(self.used))

    @property
    def scales(self) -> Array:
        """Standard deviation of each entry as given or assumed before the fit, shape (N, D), [m] and [rad]."""
        result = np.repeat(self.sigma[:, None], self.width, axis=1)
        result[:, LENGTHS:] = self.sigma_angle[:, None]
        return result

    @property
    def present(self) -> tuple[Kind, ...]:
        """Kinds of these rows, in the order of their numbers."""
        return tuple(part.kind for part in self._by_kind)

    @property
    def checked(self) -> Mask:
        """Rows that other rows can check, shape (N,): all but those of sole postures."""
        if self.sole is None:
            return np.ones(len(self), dtype=bool)
        return ~self.sole

    def where(self, test: Callable[[Kind], bool]) -> Mask:
        """Rows of kinds that pass a test, such as ``lambda kind: kind.position``, shape (N,)."""
        result = np.zeros(len(self), dtype=bool)
        for part in self._by_kind:
            result[part.rows] = test(part.kind)
        return result

    def select(self, which: Mask | slice) -> Rows:
        """Return some of the rows, in their order.

        Args:
            which: shape (N,) or a slice; of a pair both rows or none.

        Returns:
            These rows; partners and instruments are numbered anew.
        """
        chosen = np.arange(len(self))[which]
        if len(chosen) == len(self):
            return self
        partner = self.partner[chosen]
        if np.any(partner >= 0):
            new_number = np.full(len(self), -1)
            new_number[chosen] = np.arange(len(chosen))
            partner = np.where(partner >= 0, new_number[partner], -1)
        return replace(
            self,
            samples=self.samples.select(chosen),
            kinds=self.kinds[chosen],
            measured=self.measured[chosen],
            partner=partner,
            sigma=self.sigma[chosen],
            sigma_angle=self.sigma_angle[chosen],
            poses=self.poses[chosen],
            blocks=self.blocks[chosen],
            weights=None if self.weights is None else self.weights[chosen],
            sole=None if self.sole is None else self.sole[chosen],
        )

    def residual(self, T_frame_target: Array) -> Array:
        """Return measured minus predicted.

        Args:
            T_frame_target: shape (N, 4, 4), predicted pose of each row's target in its frame [m].

        Returns:
            shape (N, D), [m] and [rad]; 0 where nothing was measured.
        """
        result = np.zeros((len(self), self.width))
        numbers = np.arange(len(self))[:, None]
        for part in self._by_kind:
            measured = self.measured[part.rows, : part.kind.size]
            predicted = self._at_kind(part, T_frame_target)
            values = part.kind.residual_of(measured, predicted)
            result[numbers[part.rows], part.columns] = values
        return result

    def derivative(self, T_frame_target: Array, twists: Array) -> Array:
        """Return the Jacobian of the prediction by the parameters: minus that of the residual.

        Args:
            T_frame_target: shape (N, 4, 4), predicted pose of each row's target in its frame [m].
            twists: shape (N, 6, p), motion of the target by each parameter, along the frame's axes; see
                `Kinematics.twists`. (N, 3, p), translations alone, where no kind measures an orientation.

        Returns:
            shape (N, D, p); 0 where nothing was measured.
        """
        shape = (len(self), self.width, twists.shape[2])
        numbers = np.arange(len(self))[:, None]
        result: Array | None = None
        for part in self._by_kind:
            measured = self.measured[part.rows, : part.kind.size]
            predicted = self._at_kind(part, T_frame_target)
            moved = self._at_kind(part, twists)
            values = part.kind.derivative(measured, predicted, moved)
            if values.shape == shape:
                return values  # the only kind, and all columns
            if result is None:
                result = np.zeros(shape)
            result[numbers[part.rows], part.columns] = values
        return np.zeros(shape) if result is None else result

    def as_measured_at(self, T_frame_target: Array) -> Rows:
        """Return the rows with the readings of a perfect instrument.

        Args:
            T_frame_target: shape (N, 4, 4), true pose of each row's target in its frame [m].
        """
        measured = self.measured.copy()
        for part in self._by_kind:
            if part.kind.measure is not None:
                readings = part.kind.measure(self._at_kind(part, T_frame_target))
                measured[part.rows, : part.kind.size] = readings
        return replace(self, measured=measured)

    def _at_kind(self, part: _KindRows, values: Array) -> Array:
        """Values (N, ...) at the n rows of one kind, (n, ...); of a paired kind at both its rows, (n, 2, ...)."""
        if not part.kind.paired:
            return values[part.rows]
        return np.stack([values[part.rows], values[self.partner[part.rows]]], axis=1)

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
        """Mask of the rows that are no outliers, shape (N,).

        Args:
            outliers: shape (N,), flagged rows.

        Returns:
            All rows where outliers are more than half of a frame's: then it is the frame that is wrong.
        """
        kept = self.with_partners(~outliers)
        return kept if self.keeps_frames(kept) else np.ones_like(kept)

    def evenly(self, most: int) -> Mask:
        """Draw about ``most`` rows, the same share of each frame, target and kind; pairs stay whole.

        Drawn at random, with a fixed seed: tables have cycles, and every tenth row may be of one kind of pose.

        Returns:
            Mask of the rows drawn, shape (N,); all where there are no more.
        """
        if len(self) <= most:
            return np.ones(len(self), dtype=bool)
        measuring = np.flatnonzero(self.kinds != NONE)
        labels = np.stack([self.samples.frame, self.samples.target, self.kinds], axis=1)
        _, group, count = np.unique(
            labels[measuring], axis=0, return_inverse=True, return_counts=True
        )
        group = group.reshape(-1)
        fewest = min(_FEWEST_OF_EACH, max(most // len(count), 1))
        quota = np.minimum(count, np.maximum(most * count // max(len(self), 1), fewest))
        drawn = _drawn_of_groups(group, count, quota)
        result = np.zeros(len(self), dtype=bool)
        result[measuring[drawn]] = True
        return self.with_partners(result)

    def parts(self, size: int) -> list[slice]:
        """Split the rows into parts of ``size`` rows; into one part where there are pairs, which stay together."""
        if np.any(self.partner >= 0):
            size = max(len(self), 1)
        return [slice(k, k + size) for k in range(0, len(self), size)]


def _rows_by_kind(kinds: Integers) -> tuple[_KindRows, ...]:
    """The rows of each kind that occurs in ``kinds``, (N,), in the order of their numbers."""
    result = []
    counts = np.bincount(kinds - NONE)[1:]  # `NONE` comes first
    for number in np.flatnonzero(counts).tolist():
        kind = registry.at(number)
        of_kind = kinds == number
        rows = slice(None) if np.all(of_kind) else np.flatnonzero(of_kind)
        columns = np.r_[: kind.lengths, LENGTHS : LENGTHS + kind.angles]
        result.append(_KindRows(kind, rows, columns))
    return tuple(result)


def _instruments(by_kind: tuple[_KindRows, ...], count: int, width: int) -> NDArray[np.int8]:
    """Number of the instrument of each scalar, shape (count, width): lengths of each kind, then angles of each."""
    rows = np.arange(count)[:, None]
    result = np.full((count, width), _NO_INSTRUMENT, dtype=np.int8)
    number = 0
    for angles in (False, True):
        for part in by_kind:
            columns = part.columns[(part.columns >= LENGTHS) == angles]
            if len(columns):
                result[rows[part.rows], columns] = number
                number += 1
    return result


def _drawn_of_groups(group: Integers, count: Integers, quota: Integers) -> Integers:
    """Draw entries of each group at random, with a fixed seed.

    Args:
        group: shape (n,), number of each entry's group, from 0.
        count: shape (G,), number of entries of each group.
        quota: shape (G,), how many of them are drawn.

    Returns:
        Indices of the entries drawn, from 0.
    """
    random = np.random.default_rng(0).random(len(group))
    # Sorted by group, and at random within it, the first entries of each group are drawn.
    order = np.lexsort((random, group))
    ordered_group = group[order]
    first_of_group = np.concatenate([[0], np.cumsum(count)[:-1]])
    rank = np.arange(len(group)) - first_of_group[ordered_group]
    return np.asarray(order[rank < quota[ordered_group]])
