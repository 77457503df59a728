"""Disturbances of a measurement besides noise: outliers, a target that was moved, the encoders' resolution."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array, Mask, read_only
from calib.basics.values import Value
from calib.errors import CalibError, choices
from calib.verbs.simulate.random_streams import stream


@dataclass(frozen=True, slots=True)
class Outliers:
    """Rows whose measurement is displaced in any direction; lengths are longer or shorter by that much."""

    #: Share of the rows to estimate from, 0 to 1; at least one row if it is above 0.
    share: float = 0.0
    #: Number of rows, in place of a share; None: the share counts.
    count: int | None = None
    #: Displacement [m].
    size: float = 5e-3

    @classmethod
    def parse(cls, text: str, size: float) -> Outliers:
        """Parse a number of rows, ``3``, or a share of them, ``5 %``.

        Args:
            text: As typed.
            size: Displacement of each outlier [m].

        Raises:
            CalibError: It is another text.
        """
        number = re.fullmatch(r"\s*(\d{1,9}|\d*\.?\d+(?=\s*%))\s*(%?)\s*", text)
        if number is None:
            raise CalibError(
                f'--outliers was given as "{text}"; it must be a number of rows, "3", or a share '
                'of them, "5 %".'
            )
        if number[2]:
            return cls(share=float(number[1]) / 100.0, size=size)
        return cls(count=int(number[1]), size=size)

    def choose(self, candidates: Sequence[int], seed: int) -> list[int]:
        """Choose which rows become outliers; if more are asked for, they are the same ones and others.

        Args:
            candidates: Indices of the rows to choose from.
            seed: Of the random numbers.

        Returns:
            Chosen ones of ``candidates``, in ascending order; for a share above 0 at least one, if there is any.

        Raises:
            CalibError: There are fewer candidates than outliers.
        """
        rows = len(candidates)
        number = self.count
        if number is None:
            number = max(round(self.share * rows), 1) if self.share > 0.0 and rows else 0
        if number > rows:
            raise CalibError(
                f"{number} outliers were asked for among {rows} measurements to estimate from."
            )
        order = stream(seed, "outlier rows").permutation(rows)
        return sorted(candidates[i] for i in order[:number])


@dataclass(frozen=True, slots=True, eq=False)
class MovedTarget(Value):
    """A target that is displaced from some row on, as if someone had hit it."""

    #: Number of the first row, from 1, that finds it moved.
    row: int
    #: Shape (3,), displacement in the tip [m].
    by: Array
    #: Its name; None: all targets.
    target: str | None = None

    def __post_init__(self) -> None:
        """Keep a read-only copy of the displacement."""
        object.__setattr__(self, "by", read_only(self.by))

    def rows(self, targets: Sequence[str]) -> Mask:
        """Return which of R rows find their target moved, shape (R,): those of a target that moves, from `row` on.

        Args:
            targets: Name of the target of each row, (R,).

        Raises:
            CalibError: There is no such row or target.
        """
        if not 1 <= self.row <= len(targets) or self.target not in (None, *targets):
            raise CalibError(
                f"The target '{self.target or 'of all'}' is to move before row {self.row}; there "
                f"are the rows 1 to {len(targets)} and the targets "
                f"{choices(dict.fromkeys(targets))}."
            )
        moved = np.array([self.target in (None, name) for name in targets])
        moved[: self.row - 1] = False
        return moved


@dataclass(frozen=True, slots=True, eq=False)
class FrameStep(Value):
    """A measurement frame that is displaced from some row on, as if someone had hit the instrument's stand."""

    #: Number of the first row of a pose, from 1, that is displaced.
    row: int
    #: Shape (3,), displacement of what is measured, along the measurement frame's axes [m].
    by: Array

    def __post_init__(self) -> None:
        """Keep a read-only copy of the displacement."""
        object.__setattr__(self, "by", read_only(self.by))


@dataclass(frozen=True, slots=True)
class StandingTargets:
    """Targets that stand still, and are read before the first stop of the robot, between stops, and after the last."""

    #: Number of targets; 0: none.
    count: int = 0
    #: Number of stops between two readings.
    every: int = 5


@dataclass(frozen=True, slots=True)
class Encoder:
    """Steps in which joint values are read: the robot stops within half a step of its command, and the step is read."""

    #: Step of joints that turn [rad]; 0: none.
    angle: float = 0.0
    #: Step of joints that slide [m]; 0: none.
    length: float = 0.0

    def measure(self, q: Array, sliding: Sequence[bool], seed: int) -> tuple[Array, Array]:
        """Draw where the robot stops if it is sent to joint values, up to half a step beside, and what is read there.

        A joint without an encoder step stops exactly, and is read exactly.

        Args:
            q: Joint values that the robot is sent to, shape (N, m), [rad] or [m].
            sliding: True for joints that slide, (m,).
            seed: Of the random numbers.

        Returns:
            True joint values, and those read, which are whole steps; shape (N, m) each, [rad] or [m].
        """
        step = np.where(sliding, self.length, self.angle)
        true = q + stream(seed, "encoder").uniform(-0.5, 0.5, q.shape) * step
        divisor = np.where(step > 0.0, step, 1.0)
        read = np.where(step > 0.0, np.round(true / divisor) * step, true)
        return true, read
