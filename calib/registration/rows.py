"""The rows of a table as the arrays of one fit, and which of them repeat a pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

import calib.data.kinds as registry
from calib.data.kinds import Kind
from calib.model.kinematics import Samples
from calib.units import Array, Integers, Mask

#: The kind's number of rows that hold no measurement themselves: the second rows of pairs.
NONE = -1


#: Columns of a residual that hold lengths; those of angles follow.
LENGTHS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """The rows of one fit."""

    samples: Samples  # Joint values, frame and target of each of N rows
    kinds: Integers  # (N,), numbers of `calib.data.kinds`; `NONE` for the second row of a pair
    measured: Array  # (N, K), as `calib.data.kinds.Kind` says; zero in columns that a kind lacks
    partner: Integers  # (N,), the other row of a pair; -1 elsewhere
    sigma: Array  # (N,), standard deviation of one length as given or first assumed [m]
    sigma_angle: Array  # (N,), of one angle [rad]
    poses: Integers  # (N,), rows of one number are repeats: one pose, one target, one frame
    blocks: Integers  # (N,), rows of one number are left out together: one pose, and both rows of a pair
    weights: Array | None = (
        None  # (N,), to be used as they are, repeats shared out; None: to be found
    )
    sole: Mask | None = None  # (N,), see `calib.estimate.sole_postures`; None: to be found
    width: int = field(init=False)  # Columns of a residual: 6 with angles, 3 with positions, else 1
    used: Mask = field(init=False, repr=False)  # (N, width), which columns hold a scalar
    # (N, width), the number of each scalar's noise, -1 for none: of each kind's lengths, then of each kind's angles
    instruments: NDArray[np.int8] = field(init=False, repr=False)
    # The kinds that there are; which rows they have (a slice for all), and in which columns of the residual
    _parts: tuple[tuple[Kind, Integers | slice, Integers], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Work out once what every evaluation of a fit needs."""
        rows, parts = np.arange(len(self.kinds))[:, None], []
        for k in np.flatnonzero(np.bincount(self.kinds - NONE)[1:]).tolist():
            kind, of_kind = registry.at(k), self.kinds == k
            columns = np.r_[: kind.lengths, LENGTHS : LENGTHS + kind.angles]
            parts.append(
                (kind, slice(None) if np.all(of_kind) else np.flatnonzero(of_kind), columns)
            )
        width = max((int(columns[-1]) + 1 for _, _, columns in parts), default=1)
        index, number = np.full((len(rows), width), -1, dtype=np.int8), 0
        for angles in (False, True):
            for _, of_kind, columns in parts:
                wanted = columns[(columns >= LENGTHS) == angles]
                index[rows[of_kind], wanted] = number
                number += bool(len(wanted))
        used = index >= 0
        used.setflags(write=False)
        values = {"width": width, "used": used, "instruments": index, "_parts": tuple(parts)}
        for name, value in values.items():
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
        result[:, LENGTHS:] = self.sigma_angle[:, None]
        return result

    @property
    def present(self) -> tuple[Kind, ...]:
        """The kinds that there are, in the order of their numbers."""
        return tuple(kind for kind, _, _ in self._parts)

    @property
    def checked(self) -> Mask:
        """Which rows other rows can check, because they are not of a sole posture, shape (N,)."""
        return np.ones(len(self), dtype=bool) if self.sole is None else ~self.sole

    def where(self, test: Callable[[Kind], bool]) -> Mask:
        """The rows of kinds that pass a test, such as ``lambda kind: kind.position``, shape (N,)."""
        result = np.zeros(len(self), dtype=bool)
        for kind, of_kind, _ in self._parts:
            result[of_kind] = test(kind)
        return result

    def select(self, which: Mask | slice) -> Rows:
        """Some of the rows, in their order; of a pair both or none."""
        chosen = np.arange(len(self))[which]
        if len(chosen) == len(self):
            return self
        partner = self.partner[chosen]
        if np.any(partner >= 0):
            position = np.full(len(self), -1)
            position[chosen] = np.arange(len(chosen))
            partner = np.where(partner >= 0, position[partner], -1)
        names = ["kinds", "measured", "sigma", "sigma_angle", "poses", "blocks"]
        names += [name for name in ("weights", "sole") if getattr(self, name) is not None]
        return replace(
            self,
            samples=self.samples.select(chosen),
            partner=partner,
            **{name: getattr(self, name)[chosen] for name in names},
        )

    def residual(self, T_frame_target: Array) -> Array:
        """Measured minus predicted, shape (N, width), [m] and [rad]."""
        result, numbers = np.zeros((len(self), self.width)), np.arange(len(self))[:, None]
        for kind, of_kind, columns in self._parts:
            seen = self._seen(kind, of_kind, T_frame_target)
            result[numbers[of_kind], columns] = kind.residual_of(
                self.measured[of_kind, : kind.size], seen
            )
        return result

    def derivative(self, T_frame_target: Array, twists: Array) -> Array:
        """The derivative of what is predicted, minus that of the residual, shape (N, width, p).

        ``twists``, (N, 6, p) or (N, 3, p) where no kind measures an orientation, are those of `Kinematics.twists`.
        """
        shape, numbers = (len(self), self.width, twists.shape[2]), np.arange(len(self))[:, None]
        result: Array | None = None
        for kind, of_kind, columns in self._parts:
            T, moved = (self._seen(kind, of_kind, values) for values in (T_frame_target, twists))
            found = kind.derivative(self.measured[of_kind, : kind.size], T, moved)
            if found.shape == shape:
                return found  # the only kind, and all columns
            result = np.zeros(shape) if result is None else result
            result[numbers[of_kind], columns] = found
        return np.zeros(shape) if result is None else result

    def as_measured_at(self, T_frame_target: Array) -> Rows:
        """The rows with what a perfect instrument reads at these poses, shape (N, 4, 4), [m]."""
        measured = self.measured.copy()
        for kind, of_kind, _ in self._parts:
            if kind.measure is not None:
                measured[of_kind, : kind.size] = kind.measure(
                    self._seen(kind, of_kind, T_frame_target)
                )
        return replace(self, measured=measured)

    def _seen(self, kind: Kind, of_kind: Integers | slice, values: Array) -> Array:
        """The values of the rows of one kind; of a paired kind those of both its rows."""
        if not kind.paired:
            return values[of_kind]
        return np.stack([values[of_kind], values[self.partner[of_kind]]], axis=1)

    def with_partners(self, kept: Mask) -> Mask:
        """The rows that are kept and the second rows of their pairs, shape (N,)."""
        result: Mask = kept.copy()
        result[self.partner[kept & (self.partner >= 0)]] = True
        return result

    def keeps_frames(self, kept: Mask) -> bool:
        """Whether at least half of the rows of each set-up are kept."""
        every = np.bincount(self.samples.frame)
        return bool(np.all(2 * np.bincount(self.samples.frame, kept, len(every)) >= every))

    def without(self, outliers: Mask) -> Mask:
        """The rows that are no outliers, shape (N,); all rows if outliers are more than half of a set-up."""
        kept = self.with_partners(~outliers)
        return kept if self.keeps_frames(kept) else np.ones_like(kept)

    def evenly(self, most: int) -> Mask:
        """About ``most`` of the rows, the same share of each frame, target and kind, shape (N,); pairs stay whole.

        Drawn at random, with a fixed seed: tables have cycles, and every tenth row may be of one kind of pose.
        """
        if len(self) <= most:
            return np.ones(len(self), dtype=bool)
        measuring = np.flatnonzero(self.kinds != NONE)
        seen = np.stack([self.samples.frame, self.samples.target, self.kinds], axis=1)[measuring]
        _, view, count = np.unique(seen, axis=0, return_inverse=True, return_counts=True)
        view = view.reshape(-1)
        fewest = min(100, max(most // len(count), 1))
        quota = np.minimum(count, np.maximum(most * count // max(len(self), 1), fewest))
        order = np.lexsort((np.random.default_rng(0).random(len(measuring)), view))
        first = np.concatenate([[0], np.cumsum(count)[:-1]])
        place = np.arange(len(measuring)) - first[view[order]]
        result = np.zeros(len(self), dtype=bool)
        result[measuring[order[place < quota[view[order]]]]] = True
        return self.with_partners(result)

    def parts(self, size: int) -> list[slice]:
        """The rows in parts of ``size``; in one part where there are pairs, which stay together."""
        size = max(len(self), 1) if np.any(self.partner >= 0) else size
        return [slice(k, k + size) for k in range(0, len(self), size)]
