"""Coverage: which part of the joints' ranges and of the workspace was measured, and which rows lie beyond it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.units import Array

#: A joint value is outside when it is further from the measured range than this share of the range,
_MARGIN = 0.05

#: and further than this [rad or m].
_STILL = 1e-3


@dataclass(frozen=True, slots=True)
class Beyond:
    """A joint value outside the measured range."""

    joint: str  # The joint's name
    prismatic: bool  # Whether it slides
    by: float  # How far beyond the nearest measured value [rad or m]


@dataclass(frozen=True, slots=True)
class OutsideRow:
    """A row with joint values outside the measured range."""

    index: int  # The number of the queried row, from 0
    beyond: tuple[Beyond, ...]  # The joint furthest out first, in shares of their measured range


def outside(
    measured: Array, queried: Array, names: Sequence[str], types: Sequence[str]
) -> tuple[OutsideRow, ...]:
    """Find the queried rows, (K, m), with joint values outside the range of the measured ones, (N, m) [rad or m].

    A continuous joint's range is what the largest gap on the circle leaves; a margin of 5 % is allowed.
    """
    if not len(measured) or not len(queried):
        return ()
    far, spans = np.zeros(queried.shape), np.zeros(len(names))
    for j, kind in enumerate(types):
        low, spans[j] = _range(measured[:, j], kind)
        after = queried[:, j] - low - spans[j]
        far[:, j] = np.maximum(0.0, np.maximum(low - queried[:, j], after))
        if kind == "continuous":
            after = np.mod(queried[:, j] - low, 2.0 * np.pi) - spans[j]
            nearest = np.minimum(after, 2.0 * np.pi - spans[j] - after)
            far[:, j] = np.where(after <= 0.0, 0.0, nearest)
    spans = np.maximum(spans, _STILL)
    out = far > np.maximum(_MARGIN * spans, _STILL)
    result = []
    for i in np.flatnonzero(out.any(axis=1)):
        order = [j for j in np.argsort(-far[i] / spans, kind="stable") if out[i, j]]
        beyond = (Beyond(names[j], types[j] == "prismatic", float(far[i, j])) for j in order)
        result.append(OutsideRow(int(i), tuple(beyond)))
    return tuple(result)


def spread_of(tips: Array, everywhere: Array) -> float:
    """Root mean square distance of measured tips (N, 3) from their mean, over that of tips all over the workspace."""
    one, other = (
        float(np.sum((points - points.mean(axis=0)) ** 2)) / max(len(points) - 1, 1)
        for points in (tips, everywhere)
    )
    # An arm whose tip cannot move at all has been measured everywhere.
    return float(np.sqrt(one / other)) if other > 0.0 else 1.0


def shares_of_ranges(joints: Array, ranges: Array, types: Sequence[str]) -> Array:
    """The share of each joint's range (m, 2), a full turn at most, that rows (N, m) use, 0 to 1, (m,)."""
    spans = np.array([_range(q, kind)[1] for q, kind in zip(joints.T, types, strict=True)])
    turning = np.array([kind != "prismatic" for kind in types])
    room = np.minimum(ranges[:, 1] - ranges[:, 0], np.where(turning, 2.0 * np.pi, np.inf))
    some = (room > 0.0) & np.isfinite(room)
    return np.where(some, np.minimum(spans / np.where(some, room, 1.0), 1.0), 1.0)


def _range(q: Array, kind: str) -> tuple[float, float]:
    """Where the measured values begin, and how far they reach from there."""
    if kind != "continuous":
        return float(q.min()), float(np.ptp(q))
    turned = np.sort(np.mod(q, 2.0 * np.pi))
    gaps = np.diff(turned, append=turned[0] + 2.0 * np.pi)
    widest = int(np.argmax(gaps))
    return float(turned[(widest + 1) % len(turned)]), float(2.0 * np.pi - gaps[widest])
