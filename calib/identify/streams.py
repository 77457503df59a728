"""Rows of one kind, as the compiled kernel reads them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

import calib.kinds as registry
from calib.identify.rows import Rows
from calib.model.batch import fixed
from calib.model.kinematics import Samples

if TYPE_CHECKING:
    from calib.model.kernel_types import Measured

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """The rows of one kind.

    Attributes:
        kind: Its number.
        index: shape (M,), which rows these are; None for all of them.
        samples: Where the robot stood.
        other: Where it stood in the other row of each pair; None of other kinds.
        measured: What was measured.
        lengths: Number of the lengths' instrument.
        angles: That of the angles, -1 where there are none.
        typical: Median standard deviation of a length and of an angle [m], [rad].
    """

    kind: int
    index: NDArray[np.int_] | None
    samples: Samples
    other: Samples | None
    measured: Measured
    lengths: int
    angles: int
    typical: tuple[float, float]

    @property
    def first(self) -> int:
        """The number of its first row."""
        return 0 if self.index is None else int(self.index[0])

    @property
    def width(self) -> int:
        """The scalars of a row."""
        return len(registry.at(self.kind).units)

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.samples)

    def own(self, values: Array) -> Array:
        """What belongs to these rows, of values of all rows."""
        return fixed(values if self.index is None else values[self.index])

    def put(self, values: Array, into: Array) -> None:
        """Write what was found for these rows where it belongs among all of them."""
        into[slice(None) if self.index is None else self.index] = values

    def part(self, first: int, last: int) -> NDArray[np.int_]:
        """The numbers of some of its rows."""
        return np.arange(first, last) if self.index is None else self.index[first:last]


def stream_of(rows: Rows, kind: int, numbers: dict[int, int]) -> Stream:
    """The rows of one kind."""
    from calib.model import kernel_types as kernel

    own = registry.at(kind)
    what = {
        "point": kernel.POSITION,
        "fixed": kernel.POSITION,
        "pose": kernel.POSE,
        "distance": kernel.DISTANCE,
        "pair": kernel.BETWEEN,
        "plane": kernel.HEIGHT,
    }[own.name]
    whole = bool(np.all(rows.kinds == kind))
    index = None if whole else np.flatnonzero(rows.kinds == kind)
    chosen = np.arange(len(rows)) if index is None else index
    count = len(chosen)
    nothing = np.empty((count, 0))

    def of(values: Array) -> Array:
        return values if index is None else values[index]

    return Stream(
        kind=kind,
        index=index,
        samples=rows.samples if index is None else rows.samples.select(index),
        other=rows.samples.select(rows.partner[chosen]) if own.paired else None,
        measured=kernel.Measured(
            what,
            fixed(of(rows.points)),
            fixed(of(rows.measured)[:, 3:12] if own.orientation else nothing),
            fixed(of(rows.measured)[:, 0] if own.readings else np.zeros(count)),
        ),
        lengths=numbers[kind],
        angles=len(numbers) if own.angles else -1,
        typical=(float(np.median(of(rows.sigma))), float(np.median(of(rows.sigma_angle)))),
    )
