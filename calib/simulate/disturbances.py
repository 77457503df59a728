"""What disturbs a virtual measurement: outliers, a knocked target, encoders with steps; and random numbers for each.

Each purpose has random numbers of its own, all from one seed. So one thing can be changed about a virtual cell and the
rest stays: outliers leave the noise of other rows as it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.errors import CalibError, choices
from calib.measure.surroundings import vector

Array = NDArray[np.float64]

#: The purposes of random numbers. A new one goes to the end: the numbers of the others then stay.
STREAMS = (
    "errors",
    "targets",
    "frames",
    "tracker noise",
    "robot noise",
    "angle noise",
    "encoder",
    "outlier rows",
    "outlier directions",
    "poses",
    "validation poses",
)


def stream(seed: int, purpose: str) -> np.random.Generator:
    """The random numbers of one of `STREAMS`.

    Raises:
        CalibError: The seed is negative.
    """
    if seed < 0:
        raise CalibError(f"The seed is {seed}; it must be a whole number, 0 or more.")
    sequence = np.random.SeedSequence(int(seed), spawn_key=(STREAMS.index(purpose),))
    return np.random.default_rng(sequence)


@dataclass(frozen=True, slots=True)
class Outliers:
    """Rows whose measurement is displaced by ``size`` in a random direction; lengths are that much longer or shorter.

    Attributes:
        share: Of the rows to estimate from, 0 to 1; at least one row if it is above 0.
        count: Their number, in place of a share.
        size: [m].
    """

    share: float = 0.0
    count: int | None = None
    size: float = 5e-3

    def __post_init__(self) -> None:
        """Refuse what is no share, number or length."""
        if not (0.0 <= self.share <= 1.0 and (self.count or 0) >= 0 and 0.0 < self.size < np.inf):
            raise CalibError(
                f"Outliers: a share of {self.share}, a number of {self.count}, a size of {self.size} m; the share is "
                "from 0 to 1, the number 0 or more, the size above 0."
            )

    def choose(self, candidates: Sequence[int], seed: int) -> list[int]:
        """Which of some rows are outliers, in order; more of them are those of fewer and others.

        Raises:
            CalibError: More than there are rows.
        """
        among = len(candidates)
        number = self.count
        if number is None:
            number = max(round(self.share * among), 1) if self.share > 0.0 and among else 0
        if number > among:
            raise CalibError(
                f"{number} outliers were asked for among {among} measurements to estimate from. Ask for fewer, or "
                "measure at more poses."
            )
        order = stream(seed, "outlier rows").permutation(among)
        return sorted(candidates[i] for i in order[:number])


@dataclass(frozen=True, slots=True, eq=False)
class MovedTarget:
    """A target that sits elsewhere from some row on, as if it had been knocked.

    Attributes:
        row: Number of the first row, in the table's order and from 1, that finds it moved.
        by: shape (3,), displacement along the tip's axes [m].
        target: Name of the target; None: all of them, the whole mount.
    """

    row: int
    by: Array
    target: str | None = None

    def __post_init__(self) -> None:
        """Keep a read-only copy of the displacement."""
        object.__setattr__(self, "by", vector(self.by, "displacement of the moved target"))

    def rows(self, targets: Sequence[str]) -> NDArray[np.bool_]:
        """Which rows, given by their targets' names, find the target moved.

        Raises:
            CalibError: The table has no such row, or no such target.
        """
        if not 1 <= self.row <= len(targets):
            raise CalibError(
                f"The target is to move before row {self.row}; the table has the rows 1 to {len(targets)}. Name one of "
                "these."
            )
        if self.target not in (None, *targets):
            raise CalibError(
                f"The target '{self.target}' is to move; there are {choices(dict.fromkeys(targets))}. Name one of "
                "these."
            )
        mask = np.array([self.target in (None, name) for name in targets])
        mask[: self.row - 1] = False
        return mask


@dataclass(frozen=True, slots=True)
class Encoder:
    """The smallest steps in which joint values are read: of joints that turn [rad] and that slide [m]; 0: none.

    The robot stops somewhere within half a step of where it is sent, and what is read is the nearest step.
    """

    angle: float = 0.0
    length: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no step."""
        if not (0.0 <= self.angle < np.inf and 0.0 <= self.length < np.inf):
            raise CalibError(
                f"The encoder's steps are {self.angle} rad and {self.length} m; they must be 0 or above."
            )

    def measure(self, q: Array, sliding: Sequence[bool], seed: int) -> tuple[Array, Array]:
        """Where the robot stops when it is sent to q, and what is read there, shape (N, m) each, [rad] or [m]."""
        step = np.where(sliding, self.length, self.angle)
        stood = q + stream(seed, "encoder").uniform(-0.5, 0.5, q.shape) * step
        safe = np.where(step > 0.0, step, 1.0)
        return stood, np.where(step > 0.0, np.round(stood / safe) * step, stood)
