"""Known distances between groups, and the stations that they join."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.data.cell import Cell, GroupDistance
from calib.fit.registration.known_distances import KnownDistance, joined_stations, known_distances
from calib.fit.registration.table_rows import rows_and_setup
from tests.fit.registration.tables import as_kind


def named(table, names):
    return replace(table, groups=tuple(names))


def test_a_star_stands_for_the_same_text_in_both_groups(four_frames, ur3):
    groups = ["a/0", "a/1", "b/0", "b/1", "c/1", "?/0", "[x]/0", "[x]/1"]
    table = named(as_kind(four_frames.points(8), "fixed"), groups)
    cell = Cell(
        distances=(GroupDistance("*/0", "*/1", 0.2, 1e-5), GroupDistance("a/0", "b/0", 0.5, 2e-5))
    )
    rows, setup = rows_and_setup(ur3, table, cell)
    known = known_distances(cell, setup)
    assert known == (
        KnownDistance(0, 1, 0.2, 1e-5),
        KnownDistance(2, 3, 0.2, 1e-5),
        KnownDistance(6, 7, 0.2, 1e-5),
        KnownDistance(0, 2, 0.5, 2e-5),
    )
    np.testing.assert_array_equal(joined_stations(rows, known), [0, 0, 0, 0, 1, 2, 3, 3])
    np.testing.assert_array_equal(joined_stations(rows, ()), np.arange(8))
