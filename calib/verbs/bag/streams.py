"""What a bag says over time: joint values and measured points, each on the clock of its own stamps.

Times are seconds from the first message of the bag. Two streams of one motion are seldom on one clock: a point is
stamped when a tracker's driver has it, or on another computer. The lag of the points behind the joints,

    lag = stamp of a point - stamp of the joint values at the same moment

is found in `calib.verbs.bag.lag`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from calib.basics.arrays import Array, read_only
from calib.basics.values import Value
from calib.errors import MeasurementError, choices


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
        """True if orientations were measured."""
        return bool(np.isfinite(self.quaternions).all())


@dataclass(frozen=True, slots=True, eq=False)
class Publisher(Value):
    """Joint values as one publisher sends them: some joints, all of them at the same times."""

    #: Names of its n joints.
    names: tuple[str, ...]
    #: shape (N,) [s], as stamped.
    times: Array
    #: shape (N, n) [rad] or [m].
    q: Array
    #: shape (N, n) [rad/s] or [m/s]; NaN if it sends none.
    speeds: Array


def merged(publishers: Sequence[Publisher], joints: Sequence[str]) -> JointStream:
    """Bring joints that several publishers send at their own times onto the times of the most frequent one.

    Args:
        publishers: Whoever sends joints; a joint that several send is taken from the one with the most messages.
        joints: The joints that are wanted, each sent by one of them.

    Returns:
        The joints at the times between the latest beginning and the earliest end. Values between two messages are
        interpolated linearly.

    Raises:
        MeasurementError: Publishers do not overlap in time.
    """
    by_size = sorted(publishers, key=lambda each: -len(each.times))
    source = {name: each for each in reversed(by_size) for name in each.names}
    used = [each for each in by_size if any(source[name] is each for name in joints)]
    ordered = {id(each): np.unique(each.times, return_index=True) for each in used}
    begin = max(times[0] for times, _ in ordered.values())
    end = min(times[-1] for times, _ in ordered.values())
    reference, _ = ordered[id(used[0])]
    common = reference[(reference >= begin) & (reference <= end)]
    if len(common) < _FEWEST:
        raise MeasurementError(
            f"The joints {choices(joints)} are not sent at the same time for long: {len(common)} messages, and "
            f"{_FEWEST} are needed. Record them together, or leave some of them out (--without)."
        )
    columns: dict[str, list[Array]] = {"q": [], "speeds": []}
    for name in joints:
        each = source[name]
        times, index = ordered[id(each)]
        place = each.names.index(name)
        for key, column in columns.items():
            values = getattr(each, key)[index, place]
            column.append(np.interp(common, times, values))
    return JointStream(
        tuple(joints), common, np.column_stack(columns["q"]), np.column_stack(columns["speeds"])
    )


#: Fewer messages are no recording.
_FEWEST = 10
