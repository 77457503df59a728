"""Known distances between the origins of measurement frames, which give sockets and planes a unit of length."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calib.basics.arrays import Integers
from calib.data.cell import Cell
from calib.errors import ModelError, choices
from calib.fit.registration.labels import joined_labels
from calib.fit.registration.rows import Rows
from calib.fit.registration.setup import Setup


class KnownDistance(NamedTuple):
    """A known distance between the origins of two frames, such as two sockets on one bar."""

    #: Index of a frame in `Setup.groups`, from 0
    first: int
    #: Index of the other
    second: int
    #: Distance of their origins [m]
    length: float
    #: Its standard deviation [m]
    sigma: float


def known_distances(cell: Cell, setup: Setup) -> tuple[KnownDistance, ...]:
    """Resolve the distances that a cell states between groups to the frames of a table.

    Args:
        cell: Its distances name groups; a "*" stands for the same text in both names.
        setup: Its groups are those of the table.

    Raises:
        ModelError: A distance whose groups the table lacks.
    """
    result: list[KnownDistance] = []
    for distance in cell.distances:
        pairs = distance.pairs(setup.groups)
        if not pairs:
            raise ModelError(
                f"A distance is stated between the groups '{distance.first}' and '{distance.second}'; the table's "
                f"column 'group' has {choices(setup.groups)}."
            )
        for first, second in pairs:
            frames = setup.groups.index(first), setup.groups.index(second)
            result.append(KnownDistance(*frames, distance.length, distance.sigma))
    return tuple(result)


def joined_stations(rows: Rows, distances: Sequence[KnownDistance]) -> Integers:
    """Number the stations of N rows, shape (N,); those with a known distance between them are one."""
    pairs = [(distance.first, distance.second) for distance in distances]
    # A distance may be to a frame that these rows do not see.
    highest = max((max(pair) for pair in pairs), default=0)
    highest = max(highest, int(rows.samples.frame.max()))
    return joined_labels(np.arange(highest + 1), pairs)[rows.samples.frame]
