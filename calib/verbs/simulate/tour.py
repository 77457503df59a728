"""The tour of a virtual cell: which target, group and pose each measured row belongs to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib.basics.arrays import Array
from calib.data.columns import SETS
from calib.errors import CalibError
from calib.verbs.simulate.truth import Truth

Indices = NDArray[np.int_]


@dataclass(frozen=True, slots=True, eq=False)
class Tour:
    """The R rows that are measured: all targets at each stop, one tour of the poses after the other."""

    #: (stops,), the pose of each stop
    route: Indices
    #: (R,), the stop of each row
    stop: Indices
    #: (R,), its target
    target: Indices
    #: (R,), its group
    group: Indices
    #: (R,), its set
    sets: tuple[str, ...]
    #: (R,), the other row of its pair; None: rows are no pairs
    partner: Indices | None

    @classmethod
    def of(
        cls, truth: Truth, sets: Sequence[str], *, visits: int = 1, paired: bool = False
    ) -> Tour:
        """Return the rows of poses, which are dealt out among the groups in turn.

        Args:
            truth: Has the targets and the groups.
            sets: The set of each pose.
            visits: Number of tours of all poses.
            paired: Whether rows are measured in pairs.

        Raises:
            CalibError: Pairs of an odd number of poses.
        """
        targets = len(truth.targets)
        route = np.tile(np.arange(len(sets)), visits)
        stop = np.repeat(np.arange(len(route)), targets)
        pose = route[stop]
        return cls(
            route=route,
            stop=stop,
            target=np.tile(np.arange(targets), len(route)),
            group=pose % len(truth.groups),
            sets=tuple(sets[i] for i in pose),
            partner=_partners(sets, pose, targets) if paired else None,
        )

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.stop)

    @property
    def pairs(self) -> tuple[str, ...]:
        """Name of each row's pair; empty if it has none."""
        names = [""] * len(self)
        if self.partner is not None:
            first = np.flatnonzero(np.arange(len(self)) < self.partner)
            for k, i in enumerate(first, start=1):
                names[i] = names[self.partner[i]] = f"pair {k}"
        return tuple(names)

    def with_partners(self, T: Array) -> Array:
        """Return poses (R, 4, 4) as a kind takes them: of a paired kind those of both rows, (R, 2, 4, 4)."""
        if self.partner is None:
            return T
        return np.stack([T, T[self.partner]], axis=1)


def _partners(sets: Sequence[str], pose: Indices, targets: int) -> Indices:
    """Return the other row of each row's pair: consecutive poses of one set, the same target, the same tour.

    Args:
        sets: The set of each pose.
        pose: The pose of each row, shape (R,).
        targets: Number of targets.

    Returns:
        shape (R,).

    Raises:
        CalibError: A set has an odd number of poses.
    """
    other = np.arange(len(sets))
    for name in SETS:
        members = [i for i, set_name in enumerate(sets) if set_name == name]
        if len(members) % 2:
            raise CalibError(f"Pairs need an even number of poses; {len(members)} are to '{name}'.")
        other[members[::2]] = members[1::2]
        other[members[1::2]] = members[::2]
    return np.asarray(np.arange(len(pose)) + (other[pose] - pose) * targets)
