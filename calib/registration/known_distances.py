"""Known distances between the origins of measurement frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calib.data.cell import Cell
from calib.errors import ModelError, choices
from calib.registration.labels import joined_labels
from calib.registration.rows import Rows
from calib.registration.setup import Setup
from calib.units import Integers


class KnownDistance(NamedTuple):
    """A known distance between the origins of two frames, such as two sockets on one bar."""

    first: int  # Number of a frame
    second: int  # Number of the other
    length: float  # Their distance [m]
    sigma: float  # Its standard deviation [m]


def known_distances(cell: Cell, setup: Setup) -> tuple[KnownDistance, ...]:
    """The cell's known distances between set-ups, by the numbers of their frames; a "*" stands for any text."""
    result: list[KnownDistance] = []
    for known in cell.distances:
        pairs = known.pairs(setup.groups)
        if not pairs:
            raise ModelError(
                f"A distance is stated between the groups '{known.first}' and '{known.second}'; the table's column "
                f"'group' has {choices(setup.groups)}."
            )
        for ends in pairs:
            a, b = map(setup.groups.index, ends)
            result.append(KnownDistance(a, b, known.length, known.sigma))
    return tuple(result)


def joined_setups(rows: Rows, distances: Sequence[KnownDistance]) -> Integers:
    """The set-up of each row, those with a known distance between them taken for one, shape (N,)."""
    pairs = [(d.first, d.second) for d in distances]
    # A distance may be to a frame that these rows do not see.
    last = max(int(rows.samples.frame.max()), *(max(pair) for pair in pairs), 0)
    return joined_labels(np.arange(last + 1), pairs)[rows.samples.frame]
