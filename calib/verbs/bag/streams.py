"""What a bag says over time: joint values and measured points, each on the clock of its own stamps.

Times are seconds from the first message of the bag. Two streams of one motion are seldom on one clock: a point is
stamped when a tracker's driver has it, or on another computer. The lag of the points behind the joints,

    lag = stamp of a point - stamp of the joint values at the same moment

is found in `calib.verbs.bag.lag`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.basics.values import Value


@dataclass(frozen=True, eq=False)
class JointStream(Value):
    """Joint values over time, all joints at each of N times."""

    #: Names of the n joints.
    names: tuple[str, ...]
    #: shape (N,), increasing [s].
    times: Array
    #: shape (N, n) [rad] or [m].
    q: Array
    #: shape (N, n), what the bag says of speeds [rad/s] or [m/s]; NaN where it says nothing.
    speeds: Array

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for name in ("times", "q", "speeds"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @cached_property
    def _curve(self) -> Any:  # noqa: ANN401  SciPy's, without types
        """A curve through the values that does not overshoot where the arm comes to rest."""
        from scipy.interpolate import PchipInterpolator

        return PchipInterpolator(self.times, self.q, axis=0)

    def at(self, times: Array) -> Array:
        """Return the joint values at times between the first and the last, shape (M, n) [rad] or [m]."""
        inside = np.clip(times, self.times[0], self.times[-1])
        return np.asarray(self._curve(inside))

    @property
    def interval(self) -> float:
        """The usual time between two messages [s]."""
        return float(np.median(np.diff(self.times)))


@dataclass(frozen=True, slots=True, eq=False)
class PointStream(Value):
    """Positions, or poses, that an instrument measured, at M times."""

    #: The topic, with the frame that was chosen of it, as in the call.
    topic: str
    #: Name of the instrument's place, and of what it measured; empty if there is only one.
    group: str
    target: str
    #: shape (M,), increasing [s].
    times: Array
    #: shape (M, 3) [m].
    positions: Array
    #: shape (M, 4), unit quaternions, scalar last; NaN of points.
    quaternions: Array

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for name in ("times", "positions", "quaternions"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def has_poses(self) -> bool:
        """Whether orientations were measured."""
        return bool(np.isfinite(self.quaternions).all())


def merged(series: Mapping[str, tuple[Array, Array, Array]]) -> JointStream:
    """Bring joints that several publishers report at their own times onto the times of the most frequent one.

    Args:
        series: By joint its times (K,) [s], values (K,) and speeds (K,), in the order of the messages.

    Returns:
        All joints at the times between the latest beginning and the earliest end. Values between two messages are
        interpolated linearly.
    """
    sorted_series = {}
    for name, (times, values, speeds) in series.items():
        order = np.argsort(times, kind="stable")
        is_new = np.diff(times[order], prepend=-np.inf) > 0.0
        kept = order[is_new]
        sorted_series[name] = (times[kept], values[kept], speeds[kept])
    begin = max(times[0] for times, _, _ in sorted_series.values())
    end = min(times[-1] for times, _, _ in sorted_series.values())
    reference = max((times for times, _, _ in sorted_series.values()), key=len)
    common = reference[(reference >= begin) & (reference <= end)]
    q = np.column_stack([np.interp(common, t, v) for t, v, _ in sorted_series.values()])
    speeds = np.column_stack([np.interp(common, t, s) for t, _, s in sorted_series.values()])
    return JointStream(tuple(series), common, q, speeds)
