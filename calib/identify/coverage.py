"""Where the measured poses lie: joint values asked for outside of them, and how much of the workspace they cover.

A fit answers for what was measured. Functions of a joint's value extrapolate badly beyond its measured range, and poses
in one corner leave most of the arm's errors free to be anything elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.model.robot import read_only

Array = NDArray[np.float64]
Integers = NDArray[np.int_]

#: A joint value is outside when it is further from the measured range than this share of the range.
_MARGIN = 0.05

#: Differences of joint values below this are none [rad or m].
_STILL = 1e-3

#: Rows that a sentence names one by one.
_NAMED = 3

#: Tips that spread less than this share of what the joints allow are a corner. Random poses reach 0.8 to 1.2, the
#: paper's 0.43, a 20 cm cube of a UR3's workspace 0.28.
_CORNER = 1.0 / 3.0

#: Squared Mahalanobis distance of the surface of a solid ellipsoid, uniformly filled, in three dimensions.
_SURFACE = 5.0

#: Thickness given to flat sets of tips, as a share of the workspace's spread.
_THICKNESS = 0.02


@dataclass(frozen=True, slots=True)
class Beyond:
    """A joint value outside the measured range.

    Attributes:
        joint: The joint's name.
        prismatic: Whether it slides.
        by: How far beyond the nearest measured value [rad or m].
    """

    joint: str
    prismatic: bool
    by: float

    def __str__(self) -> str:
        """Such as ``'elbow_joint' 38 deg beyond the measured range``."""
        far = f"{1e3 * self.by:.3g} mm" if self.prismatic else f"{np.degrees(self.by):.3g} deg"
        return f"'{self.joint}' {far}"


@dataclass(frozen=True, slots=True)
class OutsideRow:
    """A row with joint values outside the measured range.

    Attributes:
        index: Which of the rows asked for, from 0 on.
        beyond: The joints, the one furthest out first, in shares of their measured range.
    """

    index: int
    beyond: tuple[Beyond, ...]


def outside(
    measured: Array, asked: Array, names: Sequence[str], types: Sequence[str]
) -> tuple[OutsideRow, ...]:
    """The rows asked for that have joint values outside the range of the measured ones.

    A continuous joint's values are points on a circle: its range is what the largest gap leaves.

    Args:
        measured: shape (N, m), joint values that a fit has seen [rad or m].
        asked: shape (K, m), joint values that it should answer for.
        names: m joint names.
        types: m URDF joint types.

    Returns:
        Those rows, in the order of ``asked``; a margin of 5 % of the range is allowed, the distance is from the range.
    """
    if not len(measured) or not len(asked):
        return ()
    ranges = [_range(q, kind) for q, kind in zip(measured.T, types, strict=True)]
    far = np.column_stack(
        [
            _distance(q, low, span, kind)
            for q, (low, span), kind in zip(asked.T, ranges, types, strict=True)
        ]
    )
    spans = np.maximum([span for _, span in ranges], _STILL)
    out = far > np.maximum(_MARGIN * spans, _STILL)
    result = []
    for i in np.flatnonzero(out.any(axis=1)):
        furthest = np.argsort(-far[i] / spans, kind="stable")
        beyond = [
            Beyond(names[j], types[j] == "prismatic", float(far[i, j]))
            for j in furthest
            if out[i, j]
        ]
        result.append(OutsideRow(int(i), tuple(beyond)))
    return tuple(result)


def outside_sentence(rows: Sequence[OutsideRow], numbers: Integers | None = None) -> str:
    """The rows outside in plain words, the furthest joints of the first few; empty when there are none.

    Args:
        rows: From `outside`.
        numbers: shape (K,), the number of each row asked for as a person sees it; None: from 1 on.

    Example:
        >>> outside_sentence([OutsideRow(33, (Beyond("elbow_joint", False, 0.663),))])
        "row 34: 'elbow_joint' 38 deg beyond the measured range"
    """
    if not rows:
        return ""
    parts = []
    for row in rows[:_NAMED]:
        number = row.index + 1 if numbers is None else int(numbers[row.index])
        listed = ", ".join(str(joint) for joint in row.beyond)
        parts.append(f"row {number}: {listed} beyond the measured range")
    more = len(rows) - _NAMED
    if more > 0:
        parts.append(f"and {more} more row{'s' if more > 1 else ''}")
    return "; ".join(parts)


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """How much of what the arm can do was measured.

    Attributes:
        spread: Root mean square distance of the measured tips from their mean, over that of the workspace's.
        inside: Share of the workspace's tips inside the ellipsoid that the measured ones fill.
        joints: shape (m,), share of each joint's range that was used, 0 to 1.
        names: m joint names.
    """

    spread: float
    inside: float
    joints: Array
    names: tuple[str, ...]

    @property
    def corner(self) -> bool:
        """Whether the poses cover a corner of the workspace only."""
        return self.spread < _CORNER

    def sentence(self) -> str:
        """The finding in plain words; empty where the poses are spread well enough."""
        if not self.corner:
            return ""
        least = int(np.argmin(self.joints))
        return (
            f"The poses cover a corner of the workspace only: their tips spread over {100 * self.spread:.0f} % of the "
            f"distance that the joint limits allow, and '{self.names[least]}' uses {100 * self.joints[least]:.0f} % of "
            "its range. Elsewhere the result is a guess. Measure poses all over the workspace."
        )


def coverage(
    measured_tips: Array,
    everywhere_tips: Array,
    joints: Array,
    ranges: Array,
    names: Sequence[str],
    types: Sequence[str],
) -> Coverage:
    """How much of the workspace and of the joints' ranges the measured poses cover.

    Args:
        measured_tips: shape (N, 3), tip positions of the measured poses [m], in the base.
        everywhere_tips: shape (K, 3), tip positions spread over the joint limits [m], in the base.
        joints: shape (N, m), measured joint values [rad or m].
        ranges: shape (m, 2), the limits of each [rad or m]; a joint that turns has a full turn at most to use.
        names: m joint names.
        types: m URDF joint types.
    """
    spans = np.array([_range(q, kind)[1] for q, kind in zip(joints.T, types, strict=True)])
    turning = np.array([kind != "prismatic" for kind in types])
    room = np.minimum(ranges[:, 1] - ranges[:, 0], np.where(turning, 2.0 * np.pi, np.inf))
    # A joint that cannot move has been used in full; one without limits cannot be told.
    used = np.where(room > 0.0, np.clip(spans / np.where(room > 0.0, room, 1.0), 0.0, 1.0), 1.0)
    used = np.where(np.isfinite(room), used, 1.0)
    everywhere = _covariance(everywhere_tips)
    size = float(np.trace(everywhere))
    spread = float(np.sqrt(np.trace(_covariance(measured_tips)) / size)) if size > 0.0 else 1.0
    inside = _share_inside(measured_tips, everywhere_tips, size) if size > 0.0 else 1.0
    return Coverage(spread, inside, read_only(used), tuple(names))


def _share_inside(measured: Array, everywhere: Array, size: float) -> float:
    """Share of points inside the ellipsoid that has the mean and the covariance of the measured ones."""
    covariance = _covariance(measured) + _THICKNESS**2 * size / 3.0 * np.eye(3)
    away = everywhere - measured.mean(axis=0)
    square = np.sum(away * np.linalg.solve(covariance, away.T).T, axis=1)
    return float(np.mean(square <= _SURFACE))


def _covariance(points: Array) -> Array:
    """Covariance of points, shape (3, 3); zero for a single one."""
    away = points - points.mean(axis=0)
    result: Array = away.T @ away / max(len(points) - 1, 1)
    return result


def _range(q: Array, kind: str) -> tuple[float, float]:
    """Where the measured values begin, and how far they reach from there."""
    if kind != "continuous":
        return float(q.min()), float(np.ptp(q))
    turned = np.sort(np.mod(q, 2.0 * np.pi))
    gaps = np.diff(turned, append=turned[0] + 2.0 * np.pi)
    widest = int(np.argmax(gaps))
    return float(turned[(widest + 1) % len(turned)]), float(2.0 * np.pi - gaps[widest])


def _distance(q: Array, low: float, span: float, kind: str) -> Array:
    """How far values lie from a range, 0 inside, shape (K,)."""
    if kind != "continuous":
        return np.maximum(0.0, np.maximum(low - q, q - low - span))
    after = np.mod(q - low, 2.0 * np.pi)
    return np.where(after <= span, 0.0, np.minimum(after - span, 2.0 * np.pi - after))
