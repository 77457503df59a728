"""Counting in voxels: the region of a density, and points in it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calib.errors import CalibError
from calib.verbs.workspace.region import MOST_VOXELS, Density, Region


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 300), st.floats(0.01, 1.0))
def test_a_region_is_the_fewest_voxels_of_the_highest_density(seed, count, share):
    points = np.random.default_rng(seed).normal(size=(count, 3))
    density = Density.of(points, 0.7)
    assert density.counts.sum() == count
    assert np.all((density.smooth > 0) == (density.counts > 0))
    region = density.region(share)
    chosen = density.smooth[region.cells]
    left = density.smooth[~region.cells]
    assert chosen.min() >= left.max(initial=0.0)
    held = density.counts[region.cells].sum() / count
    assert held == pytest.approx(region.held, abs=1e-12)
    assert held >= share - 1e-9
    # Without its least dense voxel it would hold less than the share.
    least = density.counts[region.cells][chosen == chosen.min()].max() / count
    assert held - least < share


# Voxels.

#: 3 x 2 x 1 voxels of 0.1 m from (1, 2, 3), of which an L of four belongs to the region.
CELLS = np.array([[[1], [1]], [[1], [0]], [[1], [0]]], dtype=bool)
ELL = Region(np.array([1.0, 2.0, 3.0]), 0.1, CELLS, 0.5, 0.6)


def test_points_in_voxels():
    points = [[1.05, 2.05, 3.05], [1.05, 2.15, 3.05], [1.15, 2.15, 3.05], [1.29, 2.01, 3.09]]
    assert ELL.contains(points).tolist() == [True, True, False, True]
    assert ELL.contains([[0.99, 2.05, 3.05], [1.05, 2.05, 3.11], [1.31, 2.05, 3.05]]).sum() == 0
    assert ELL.volume == pytest.approx(4e-3, rel=1e-12)
    np.testing.assert_allclose(ELL.bounds, [[1.0, 2.0, 3.0], [1.3, 2.2, 3.1]], rtol=1e-12)


def test_the_order_is_that_of_smoothed_counts_and_the_share_that_of_counts():
    points = np.array([[0.0, 0.0, 0.0]] * 4 + [[0.55, 0.0, 0.0]] * 3 + [[0.66, 0.0, 0.0]])
    density = Density.of(points, 0.1)
    order = np.argsort(-density.smooth.ravel(), kind="stable")[:3]
    held = np.cumsum(density.counts.ravel()[order]) / len(points)
    np.testing.assert_allclose(density.smooth.ravel()[order], [4.0, 7.0 / 3.0, 5.0 / 3.0])
    np.testing.assert_allclose(density.needed.ravel()[order], held)
    assert density.region(0.5).held == held[0] == 0.5


def test_shares_and_grids_that_cannot_be_are_refused():
    density = Density.of(np.random.default_rng(0).normal(size=(50, 3)))
    for share in (0.0, 1.1, np.nan):
        with pytest.raises(CalibError):
            density.region(share)
    with pytest.raises(CalibError, match=f"{MOST_VOXELS:,}"):
        Density.of(np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]), 1e-4)


def test_the_points_of_a_region_are_the_centres_of_its_voxels():
    points = ELL.points
    assert points.shape == (4, 3)
    np.testing.assert_allclose(points[0], [1.05, 2.05, 3.05])
    assert ELL.contains(points).all()


def test_a_region_s_arrays_cannot_be_written_to():
    cells = CELLS.copy()
    region = Region(np.zeros(3), 0.1, cells, 0.5, 0.6)
    cells[:] = False
    assert region.cells.any()
    assert not region.cells.flags.writeable


def test_a_region_in_one_line():
    assert repr(ELL) == "Region(4 litres, 4 voxels of 100 mm, 60 % of the samples)"
