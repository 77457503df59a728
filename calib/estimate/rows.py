"""Rows: the measurements of one fit as arrays, and what each says of the target's pose, by its kind."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

import calib.data.kinds as registry
from calib.data.kinds import Kind
from calib.estimate.statistics import Mask
from calib.model.kinematics import Samples

Array = NDArray[np.float64]
Integers = NDArray[np.int_]

#: The number in place of a kind's of rows that say nothing themselves: the second ones of pairs.
NONE = -1

#: Residuals have their lengths from column 0 on, and their angles from this one.
_ANGLES = 3


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """The rows of one fit."""

    samples: Samples  # Joint values, frame and target of each of N rows
    # shape (N,), numbers of the kinds in the registry `calib.data.kinds`; `NONE` for the second row of a pair
    kinds: Integers
    # shape (N, K), what was measured, as `calib.data.kinds.Kind` says; zero in columns that a row's kind lacks
    measured: Array
    partner: Integers  # shape (N,), the other row of a pair; -1 elsewhere
    sigma: Array  # shape (N,), standard deviation of one length as given or first assumed [m]
    sigma_angle: Array  # shape (N,), of one angle [rad]
    # shape (N,), rows of one number are repeats: one pose, one target, one frame
    poses: Integers
    # shape (N,), rows of one number are left out together: one pose, and both rows of a pair
    blocks: Integers
    width: int = field(init=False)  # Columns of a residual: 6 with angles, 3 with positions, else 1
    # shape (N, width), which columns of each row hold a scalar
    used: Mask = field(init=False, repr=False)
    # Which noise each scalar has, shape (N, width), numbered from 0, lengths first, -1 where no scalar is; and which
    # of these noises are angles, shape (instruments,). Rows of different kinds were measured with different
    # instruments, and lengths and angles of one kind have each a noise of their own
    instruments: tuple[NDArray[np.int8], Mask] = field(init=False, repr=False)
    # The kinds that there are, in the order of their numbers; which rows they have (a slice for all), and in which
    # columns of the residual
    _parts: tuple[_Part, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Work out once what every evaluation of a fit asks for."""
        rows, parts = np.arange(len(self.kinds))[:, None], []
        for k in np.flatnonzero(np.bincount(self.kinds - NONE)[1:]).tolist():
            kind, own = registry.at(k), self.kinds == k
            columns = np.r_[: kind.lengths, _ANGLES : _ANGLES + kind.angles]
            parts.append((kind, slice(None) if np.all(own) else np.flatnonzero(own), columns))
        width = max((int(columns[-1]) + 1 for _, _, columns in parts), default=1)
        index = np.full((len(rows), width), -1, dtype=np.int8)
        number = 0
        for angles in (False, True):
            for _, own, columns in parts:
                wanted = columns[(columns >= _ANGLES) == angles]
                index[rows[own], wanted] = number
                number += bool(len(wanted))
        turned = sum(bool(kind.angles) for kind, _, _ in parts)
        instruments = index, np.arange(number) >= number - turned
        used = index >= 0
        used.setflags(write=False)
        index.setflags(write=False)
        for name, value in (
            ("width", width),
            ("used", used),
            ("instruments", instruments),
            ("_parts", tuple(parts)),
        ):
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.samples)

    @property
    def joints(self) -> Array:
        """Values of the measured joints, shape (N, m), [rad] or [m]."""
        return self.samples.q

    @property
    def count(self) -> int:
        """Number of scalars."""
        return int(np.sum(self.used))

    @property
    def scales(self) -> Array:
        """Standard deviation of each column as given or first assumed, shape (N, width), [m] and [rad]."""
        result = np.repeat(self.sigma[:, None], self.width, axis=1)
        result[:, _ANGLES:] = self.sigma_angle[:, None]
        return result

    def where(self, test: Callable[[Kind], bool]) -> Mask:
        """The rows of kinds that pass a test, such as ``lambda kind: kind.position``, shape (N,)."""
        result = np.zeros(len(self), dtype=bool)
        for kind, own, _ in self._parts:
            result[own] = test(kind)
        return result

    @property
    def present(self) -> tuple[Kind, ...]:
        """The kinds that there are, in the order of their numbers."""
        return tuple(kind for kind, _, _ in self._parts)

    @property
    def points(self) -> Array:
        """Measured positions, shape (N, 3), [m]; zero in rows that measure none."""
        measured = np.pad(self.measured, ((0, 0), (0, max(3 - self.measured.shape[1], 0))))
        return np.where(self.where(lambda kind: kind.position)[:, None], measured[:, :3], 0.0)

    def select(self, which: Mask | slice) -> Rows:
        """Some of the rows, in their order; of a pair both or none."""
        chosen = np.arange(len(self))[which]
        if len(chosen) == len(self):
            return self
        partner = self.partner[chosen]
        position = np.full(len(self) if np.any(partner >= 0) else 1, -1)
        if len(position) == len(self):
            position[chosen] = np.arange(len(chosen))
        return replace(
            self,
            samples=self.samples.select(chosen),
            kinds=self.kinds[chosen],
            measured=self.measured[chosen],
            partner=np.where(partner >= 0, position[partner], -1),
            sigma=self.sigma[chosen],
            sigma_angle=self.sigma_angle[chosen],
            poses=self.poses[chosen],
            blocks=self.blocks[chosen],
        )

    def residual(self, T_frame_target: Array) -> Array:
        """Measured minus predicted, shape (N, width), [m] and [rad]."""
        result = np.zeros((len(self), self.width))
        numbers = np.arange(len(self))[:, None]
        for kind, own, columns in self._parts:
            seen = self._seen(kind, own, T_frame_target)
            result[numbers[own], columns] = kind.residual_of(self.measured[own, : kind.size], seen)
        return result

    def derivative(self, T_frame_target: Array, twists: Array) -> Array:
        """The derivative of what is predicted, minus that of the residual, shape (N, width, p).

        ``twists``, shape (N, 6, p), are the targets', linear then angular, along the frame's axes, see
        `calib.model.kinematics.Kinematics.twists`; shape (N, 3, p) does where no kind measures an orientation.
        """
        shape, numbers = (len(self), self.width, twists.shape[2]), np.arange(len(self))[:, None]
        result: Array | None = None
        for kind, own, columns in self._parts:
            T, moved = (self._seen(kind, own, values) for values in (T_frame_target, twists))
            found = kind.derivative(self.measured[own, : kind.size], T, moved)
            if found.shape == shape:
                return found  # the only kind, and all columns
            result = np.zeros(shape) if result is None else result
            result[numbers[own], columns] = found
        return np.zeros(shape) if result is None else result

    def as_measured_at(self, T_frame_target: Array) -> Rows:
        """The rows with what a perfect instrument reads at these poses, shape (N, 4, 4), [m]."""
        measured = self.measured.copy()
        for kind, own, _ in self._parts:
            if kind.measure is not None:
                measured[own, : kind.size] = kind.measure(self._seen(kind, own, T_frame_target))
        return replace(self, measured=measured)

    def _seen(self, kind: Kind, own: Integers | slice, values: Array) -> Array:
        """The values of the rows of one kind; of a paired kind those of both its rows."""
        if not kind.paired:
            return values[own]
        return np.stack([values[own], values[self.partner[own]]], axis=1)


#: A kind, its rows and its columns, see `Rows`.
_Part = tuple[Kind, Integers | slice, Integers]


def evenly(rows: Rows, most: int) -> Mask:
    """All rows, or about so many, the same share of each frame, target and kind, shape (N,); whole pairs.

    Which ones is drawn at random, always alike: tables have cycles, and every tenth row may be of one kind of pose.
    """
    if len(rows) <= most:
        return np.ones(len(rows), dtype=bool)
    told = np.flatnonzero(rows.kinds != NONE)
    seen = np.stack([rows.samples.frame, rows.samples.target, rows.kinds], axis=1)[told]
    _, view, count = np.unique(seen, axis=0, return_inverse=True, return_counts=True)
    view = view.reshape(-1)
    fewest = min(100, max(most // len(count), 1))
    quota = np.minimum(count, np.maximum(most * count // max(len(rows), 1), fewest))
    order = np.lexsort((np.random.default_rng(0).random(len(told)), view))
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    place = np.arange(len(told)) - first[view[order]]
    result = np.zeros(len(rows), dtype=bool)
    result[told[order[place < quota[view[order]]]]] = True
    return with_partners(rows, result)


def whole_blocks(rows: Rows, size: int) -> Iterator[Mask]:
    """The rows in parts of about so many, repeats of a pose and pairs together, as masks of shape (N,)."""
    order = np.argsort(rows.blocks, kind="stable")
    ends = np.flatnonzero(np.diff(rows.blocks[order], append=-1)) + 1
    first = 0
    while first < len(rows):
        last = int(ends[np.searchsorted(ends, min(first + size, len(rows)))])
        mask = np.zeros(len(rows), dtype=bool)
        mask[order[first:last]] = True
        yield mask
        first = last


def with_partners(rows: Rows, kept: Mask) -> Mask:
    """The rows that are kept and the second rows of their pairs, shape (N,)."""
    result: Mask = kept.copy()
    result[rows.partner[kept & (rows.partner >= 0)]] = True
    return result


def keeps_frames(rows: Rows, kept: Mask) -> bool:
    """Whether half of each set-up's rows or more are kept."""
    every = np.bincount(rows.samples.frame)
    return bool(np.all(2 * np.bincount(rows.samples.frame, kept, len(every)) >= every))


def without_outliers(rows: Rows, outliers: Mask) -> Mask:
    """The rows to register with, shape (N,): not the outliers, unless they are more than half of a set-up's rows."""
    kept = ~outliers
    return with_partners(rows, kept if keeps_frames(rows, kept) else ~np.zeros_like(kept))
