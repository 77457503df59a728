"""What goes wrong while a robot is measured: rows that are far off, a target that was knocked, encoders with steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.errors import CalibError, choices
from calib.measure.cell_parts import is_number, is_positive, vector
from calib.measure.random_streams import stream

Array = NDArray[np.float64]


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
        if not is_number(self.share) or not 0.0 <= self.share <= 1.0:
            message = f"The share of outliers is {self.share!r}; it must be a number from 0 to 1."
            raise CalibError(message)
        whole = isinstance(self.count, (int, np.integer)) and not isinstance(self.count, bool)
        if self.count is not None and not (whole and self.count >= 0):
            message = (
                f"The number of outliers is {self.count!r}; it must be a whole number, 0 or more."
            )
            raise CalibError(message)
        if not is_positive(self.size):
            message = f"Outliers are displaced by {self.size!r} m; it must be a positive number."
            raise CalibError(message)

    def number(self, among: int) -> int:
        """How many of some rows are outliers.

        Raises:
            CalibError: More than there are.
        """
        if self.count is None:
            return max(round(self.share * among), 1) if self.share > 0.0 and among else 0
        if self.count > among:
            message = (
                f"{self.count} outliers were asked for among {among} measurements to estimate from. Ask for fewer, or "
                "measure at more poses."
            )
            raise CalibError(message)
        return self.count

    def choose(self, candidates: Sequence[int], seed: int) -> list[int]:
        """Which of some rows are outliers, in order; more of them are those of fewer and others."""
        order = stream(seed, "outlier rows").permutation(len(candidates))
        return sorted(candidates[i] for i in order[: self.number(len(candidates))])


def outlier_directions(count: int, seed: int) -> Array:
    """Unit vectors, anyhow, one for each row, shape (count, 3)."""
    v = stream(seed, "outlier directions").standard_normal((count, 3))
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


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
        """Keep a read-only copy; refuse what is no row number or vector."""
        whole = isinstance(self.row, (int, np.integer)) and not isinstance(self.row, bool)
        if not (whole and self.row >= 1):
            message = f"The target moves before row {self.row!r}; rows are counted from 1."
            raise CalibError(message)
        object.__setattr__(self, "by", vector(self.by, "displacement of the moved target"))

    def rows(self, targets: Sequence[str]) -> NDArray[np.bool_]:
        """Which rows find the target moved.

        Args:
            targets: Name of each row's target.

        Raises:
            CalibError: The table has fewer rows, or no such target.
        """
        if self.row > len(targets):
            message = (
                f"The target is to move before row {self.row}; the table has {len(targets)} rows. Name one of "
                "these."
            )
            raise CalibError(message)
        if self.target is not None and self.target not in targets:
            message = (
                f"The target '{self.target}' is to move; there are {choices(dict.fromkeys(targets))}. Name one of "
                "these."
            )
            raise CalibError(message)
        mask = np.array([self.target in (None, name) for name in targets])
        mask[: self.row - 1] = False
        return mask


@dataclass(frozen=True, slots=True)
class Encoder:
    """The smallest steps in which joint values are read.

    The robot stops somewhere within half a step of where it is sent, and what is read is the nearest step.

    Attributes:
        angle: Step of joints that turn [rad]; 0: none.
        length: Step of joints that slide [m]; 0: none.
    """

    angle: float = 0.0
    length: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no step."""
        for value, unit in ((self.angle, "rad"), (self.length, "m")):
            if not is_number(value) or value < 0.0:
                message = (
                    f"The encoder's step is {value!r} {unit}; it must be a number, not below 0."
                )
                raise CalibError(message)

    def steps(self, sliding: Sequence[bool]) -> Array:
        """The step of each column of joint values, shape (m,), [rad] or [m]."""
        return np.array([self.length if slides else self.angle for slides in sliding])

    def stood(self, q: Array, sliding: Sequence[bool], seed: int) -> Array:
        """Where the robot stops when it is sent to q, shape (N, m), [rad] or [m]."""
        within = stream(seed, "encoder").uniform(-0.5, 0.5, q.shape)
        return np.asarray(q + within * self.steps(sliding))

    def read(self, stood: Array, sliding: Sequence[bool]) -> Array:
        """What is read where the robot stands, shape (N, m), [rad] or [m]."""
        step = self.steps(sliding)
        safe = np.where(step > 0.0, step, 1.0)
        return np.where(step > 0.0, np.round(stood / safe) * step, stood)
