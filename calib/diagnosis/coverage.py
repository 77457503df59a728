"""Coverage: the measured part of the joints' ranges and of the workspace, and rows outside of it (extrapolation)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.basics.arrays import Array

#: A joint value is outside when it is further from the measured range than this share of the range.
_MARGIN = 0.05

#: A joint whose values differ by less than this did not move [rad or m]; nor is a value this near outside.
_STILL = 1e-3


@dataclass(frozen=True, slots=True)
class Beyond:
    """A joint value outside the measured range."""

    #: The joint's name
    joint: str
    #: Whether it slides
    prismatic: bool
    #: Distance from the nearest end of the measured range, > 0 [rad or m]
    by: float


@dataclass(frozen=True, slots=True)
class OutsideRow:
    """A row with joint values outside the measured range."""

    #: The number of the queried row, from 0
    index: int
    #: The joint furthest out first, in shares of their measured range
    beyond: tuple[Beyond, ...]


def outside(
    measured: Array,
    queried: Array,
    names: Sequence[str],
    types: Sequence[str],
) -> tuple[OutsideRow, ...]:
    """Find the queried rows with joint values outside the measured range.

    A continuous joint's range is the circle without the largest gap between its values; a margin of 5 % is allowed.

    Args:
        measured: Joint values of N fitted rows, shape (N, m) [rad or m].
        queried: Joint values of K rows, shape (K, m).
        names: Names of the joints.
        types: Their URDF types: ``"revolute"``, ``"continuous"`` or ``"prismatic"``.

    Returns:
        The rows outside, in their order.
    """
    if not len(measured) or not len(queried):
        return ()
    distances, spans = np.zeros(queried.shape), np.zeros(len(names))
    for j, kind in enumerate(types):
        low, spans[j] = _range(measured[:, j], kind)
        distances[:, j] = _distances(queried[:, j], low, spans[j], kind)
    spans = np.maximum(spans, _STILL)
    out = distances > np.maximum(_MARGIN * spans, _STILL)
    rows = []
    for i in np.flatnonzero(out.any(axis=1)):
        furthest_first = np.argsort(-distances[i] / spans, kind="stable")
        beyond = [
            Beyond(names[j], types[j] == "prismatic", float(distances[i, j]))
            for j in furthest_first
            if out[i, j]
        ]
        rows.append(OutsideRow(int(i), tuple(beyond)))
    return tuple(rows)


def _distances(q: Array, low: float, span: float, kind: str) -> Array:
    """Distance of values of a joint from its measured range; 0 inside.

    Args:
        q: The values, shape (K,), [rad] or [m].
        low: Where the range begins, [rad] or [m]; on the circle for a continuous joint.
        span: Its length, [rad] or [m].
        kind: The joint's URDF type.

    Returns:
        Distances from the nearer end, >= 0, shape (K,), [rad] or [m].
    """
    if kind != "continuous":
        return np.asarray(np.maximum(0.0, np.maximum(low - q, q - low - span)))
    after = np.mod(q - low, 2.0 * np.pi) - span
    nearest = np.minimum(after, 2.0 * np.pi - span - after)
    return np.where(after <= 0.0, 0.0, nearest)


def spread_of(tips: Array, everywhere: Array) -> float:
    """Compare the spread of measured tips with that of the workspace.

    Args:
        tips: Measured positions of the tip, shape (N, 3) [m].
        everywhere: Positions of the tip all over the workspace, shape (K, 3) [m].

    Returns:
        The root mean square distance of the measured tips from their mean, over that of the others.
    """
    possible = _variance(everywhere)
    if not possible > 0.0:
        # An arm whose tip cannot move at all has been measured everywhere.
        return 1.0
    return float(np.sqrt(_variance(tips) / possible))


def _variance(points: Array) -> float:
    """Variance of points (N, 3): their mean squared distance from their mean, over N - 1 [m^2]."""
    from_mean = points - points.mean(axis=0)
    return float(np.sum(from_mean**2)) / max(len(points) - 1, 1)


def shares_of_ranges(joints: Array, ranges: Array, types: Sequence[str]) -> Array:
    """Find the share of each joint's range that rows use.

    Args:
        joints: Joint values of the rows, shape (N, m) [rad or m].
        ranges: Lower and upper limit of each joint, shape (m, 2); of one that turns a full turn counts at most.
        types: Their URDF types.

    Returns:
        The shares, 0 to 1, shape (m,); 1 of a joint without a range.
    """
    spans = np.array([_range(q, kind)[1] for q, kind in zip(joints.T, types, strict=True)])
    turning = np.array([kind != "prismatic" for kind in types])
    most = np.where(turning, 2.0 * np.pi, np.inf)
    room = np.minimum(ranges[:, 1] - ranges[:, 0], most)
    limited = (room > 0.0) & np.isfinite(room)
    shares = spans / np.where(limited, room, 1.0)
    return np.where(limited, np.minimum(shares, 1.0), 1.0)


def _range(q: Array, kind: str) -> tuple[float, float]:
    """Find the range of a joint's measured values.

    Args:
        q: The values, shape (N,), [rad] or [m].
        kind: The joint's URDF type.

    Returns:
        Where the range begins and its length, [rad] or [m]. Of a continuous joint it is the circle without the largest
        gap between values, and begins between 0 and 2 pi.
    """
    if kind != "continuous":
        return float(q.min()), float(np.ptp(q))
    turned = np.sort(np.mod(q, 2.0 * np.pi))
    gaps = np.diff(turned, append=turned[0] + 2.0 * np.pi)
    widest = int(np.argmax(gaps))
    behind_gap = (widest + 1) % len(turned)
    return float(turned[behind_gap]), float(2.0 * np.pi - gaps[widest])
